"""Which whole pipelines of a clip are worth a look: the qualities by name, and those
between them that no other beats.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from arfx.core.cost import Prediction, measured
from arfx.core.stage import Stage
from arfx.measure.difference import Difference
from arfx.plan.levels import Option, way_down

QUALITIES = ("draft", "standard", "high", "reference")
LEFT_OUT = "left out"  # in place of a level
APART = 1.3  # in time: of two that are nearer to each other one is enough


@dataclass(eq=False)
class Row:
    """One level of one effect, or one whole pipeline. time : per frame;  by_frame : what
    was found in each

    formula : which the stage ran under;  other : stages under the formula that the job does
    not use, in place of its own;  flicker : of this and of the reference, grey
    levels from a frame to the next"""

    name: str
    level: str
    formula: str
    time: Prediction = field(default_factory=lambda: measured(0.0))
    by_frame: dict[int, Difference] = field(default_factory=dict)
    flicker: tuple[float, float] | None = None
    pictures: dict[int, np.ndarray] = field(default_factory=dict)
    levels: Mapping[str, str] = field(default_factory=dict)
    other: Mapping[str, Stage] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        return self.time.seconds

    def worst(self, what: str) -> float:
        return max((getattr(d, what) for d in self.by_frame.values()), default=0.0)

    def average(self, what: str) -> float:
        """Over all touched pixels of all frames; frames in which the effect touches nothing
        do not count.
        """
        weights = [d.pixels for d in self.by_frame.values()]
        if not sum(weights):
            return float(getattr(Difference(), what))
        return float(
            np.average(
                [getattr(d, what) for d in self.by_frame.values()], weights=weights
            )
        )

    def total(self) -> float:
        """Grey levels times pixels, all frames together."""
        return float(sum(d.mean * d.pixels for d in self.by_frame.values()))

    def worst_frame(self) -> int | None:
        return max(self.by_frame, key=lambda i: self.by_frame[i].p99, default=None)


def level_sets(
    effects: Sequence[Row], usual: Mapping[str, str]
) -> list[dict[str, str]]:
    """Levels by stage, on the way from everything at its best to all that can be left out,
    by error lost per second saved.

    effects : every level of the effects, by itself;  usual : levels of the stages that have
    no other
    """
    options: dict[tuple[int, str], list[Option]] = {}
    for r in effects:
        options.setdefault((0, r.name), []).append(
            Option(r.level, r.time, r.total(), 1)
        )
    sets = [
        {**usual, **{name: o.level for (_, name), o in state.items()}}
        for state in way_down(options)
    ]
    return [
        {name: level for name, level in levels.items() if level != LEFT_OUT}
        for levels in sets
    ]


def front(rows: Sequence[Row]) -> list[Row]:
    """Those that no other beats in both time and mean error, cheapest first."""
    out: list[Row] = []
    for r in sorted(rows, key=lambda r: (r.seconds, r.average("mean"))):
        if not out or r.average("mean") < out[-1].average("mean") - 1e-9:
            out.append(r)
    return out


def worth_showing(rows: Sequence[Row]) -> list[Row]:
    """All with a quality's name, and of the others those that nothing beats and that are
    APART from what is shown; cheapest first."""
    shown = [r for r in rows if r.level in QUALITIES]
    for r in front(rows):
        near = (
            max(r.seconds, s.seconds) < APART * min(r.seconds, s.seconds)
            for s in front(shown)
        )
        if r not in shown and not any(near):
            shown.append(r)
    return sorted(shown, key=lambda r: r.seconds)
