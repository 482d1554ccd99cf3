"""The Stage contract: what every effect declares and does. One screen, few members.

A stage is a class with these members; its one instance is made per job from `params` (what the user meant).
`prepare` makes what the code needs (textures, kernels) once per clip and worker; `run` is pure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from arfx.core.cost import Cost
from arfx.core.facts import FrameFacts
from arfx.core.layers import Dimmed, Layer, Layers, Patch
from arfx.core.rect import Rect
from arfx.core.scene import Scene


@dataclass(frozen=True, slots=True)
class Level:
    """One rung of a stage's quality ladder. seconds_per_mpx : shipped default price on one core."""

    name: str
    seconds_per_mpx: float


@dataclass(frozen=True, slots=True)
class Demand:
    """Does this frame call for the stage?

    rect : pixels it may change, empty = not called for;  reason : in units
    follows : it can only change pixels in which an earlier stage of the frame writes (the composite)
    """

    rect: Rect
    reason: str
    follows: bool = False


@dataclass(frozen=True)
class Window:
    """What `run` sees: its layers, the facts of the same frames, oldest first; the last is the frame itself.

    out : the pixels that are kept of what it makes, None = all: a slow stage may leave the others as they are
    last : nobody reads what it makes but the edit of the frame, so IMAGE may be left as `Dimmed`
    """

    layers: tuple[Layers, ...]
    facts: tuple[FrameFacts, ...]
    out: Rect | None = None
    last: bool = False

    @property
    def now(self) -> Layers:
        return self.layers[-1]


@runtime_checkable
class Stage(Protocol):
    name: ClassVar[str]
    reads: ClassVar[frozenset[Layer]]
    writes: ClassVar[frozenset[Layer]]
    levels: ClassVar[tuple[Level, ...]]  # cheapest first, reference last
    needs_facts: ClassVar[frozenset[str]]  # folds of the analysis it needs, by name ("pose", "light", ...)
    reach: ClassVar[int]  # earlier frames it must see; 0 nearly always
    params: Any  # frozen dataclass: its section of the job file

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand: ...

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Rect: ...

    def cost(self, need: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Cost: ...

    def prepare(self, scene: Scene, level: Level) -> Any: ...

    def run(
        self, window: Window, scene: Scene, prepared: Any, level: Level, rng: np.random.Generator
    ) -> Mapping[Layer, np.ndarray | Patch | Dimmed]: ...


def level_named(levels: Sequence[Level], name: str) -> Level:
    """The level of that name, or the nearest one the stage has: the best if it has none so high."""
    order = ("draft", "standard", "high", "reference")
    for level in levels:
        if level.name == name:
            return level
    at = order.index(name)
    below = [le for le in levels if le.name in order and order.index(le.name) <= at]
    return below[-1] if below else levels[0]
