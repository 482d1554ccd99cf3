"""The plan of one frame: which steps, on which pixels, at which level, and what was left out and why."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from arfx.core.rect import Rect


@dataclass(frozen=True, slots=True)
class Step:
    """One stage run.

    out : pixels it must deliver; need : pixels it is given; seconds : predicted, None = unknown; between : its interval
    """

    stage: str
    level: str
    out: Rect
    need: Rect
    reason: str
    seconds: float | None
    between: tuple[float, float] | None = None

    def to_json(self) -> dict:
        return {
            "stage": self.stage, "level": self.level, "out": self.out.to_json(), "need": self.need.to_json(),
            "reason": self.reason, "seconds": self.seconds, "between": self.between,
        }  # fmt: skip

    @staticmethod
    def from_json(d: dict) -> Step:
        between = d.get("between")
        return Step(
            d["stage"], d["level"], Rect.from_json(d["out"]), Rect.from_json(d["need"]), d["reason"], d["seconds"],
            None if between is None else (between[0], between[1]),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Skip:
    stage: str
    reason: str

    def to_json(self) -> dict:
        return {"stage": self.stage, "reason": self.reason}


@dataclass(frozen=True, slots=True)
class FramePlan:
    """rect : all pixels that are read or changed; changed : pixels that are written back to the frame."""

    index: int
    rect: Rect
    changed: Rect
    steps: tuple[Step, ...]
    skipped: tuple[Skip, ...]

    @property
    def seconds(self) -> float | None:
        parts = [s.seconds for s in self.steps]
        return None if any(p is None for p in parts) else float(sum(p for p in parts if p is not None))

    def to_json(self) -> dict:
        return {
            "index": self.index, "rect": self.rect.to_json(), "changed": self.changed.to_json(),
            "steps": [s.to_json() for s in self.steps], "skipped": [s.to_json() for s in self.skipped],
        }  # fmt: skip

    @staticmethod
    def from_json(d: dict) -> FramePlan:
        return FramePlan(
            d["index"], Rect.from_json(d["rect"]), Rect.from_json(d["changed"]),
            tuple(Step.from_json(s) for s in d["steps"]), tuple(Skip(s["stage"], s["reason"]) for s in d["skipped"]),
        )  # fmt: skip


def levels_of(plans: Iterable[FramePlan]) -> set[tuple[str, str]]:
    """(stage, level) of everything that runs."""
    return {(step.stage, step.level) for plan in plans for step in plan.steps}
