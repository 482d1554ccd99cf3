"""The plan of one frame: which steps, on which pixels, at which level, and what was left
out and why.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from arfx.core.codec import Document
from arfx.core.cost import Prediction
from arfx.core.rect import Rect


@dataclass(frozen=True, slots=True)
class Step(Document):
    """One stage run.
    out : pixels it must deliver; need : pixels it is given; cost : predicted, None = unknown
    """

    stage: str
    level: str
    out: Rect
    need: Rect
    reason: str
    cost: Prediction | None


@dataclass(frozen=True, slots=True)
class Skip(Document):
    stage: str
    reason: str


@dataclass(frozen=True, slots=True)
class FramePlan(Document):
    """rect : all pixels that are read or changed; changed : pixels that are written back to
    the frame.
    """

    index: int
    rect: Rect
    changed: Rect
    steps: tuple[Step, ...]
    skipped: tuple[Skip, ...]


def levels_of(plans: Iterable[FramePlan]) -> set[tuple[str, str]]:
    """(stage, level) of everything that runs."""
    return {(step.stage, step.level) for plan in plans for step in plan.steps}
