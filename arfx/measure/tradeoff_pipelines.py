"""Rows of a comparison: levels of effects and whole pipelines, and which of them no other
beats.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from arfx.core.cost import Prediction, measured
from arfx.core.stage import Stage
from arfx.measure.difference import Difference

QUALITIES = ("draft", "standard", "high", "reference")
LEFT_OUT = "left out"  # in place of a level


@dataclass(eq=False)
class Row:
    """One level of one effect, or one whole pipeline. time : per frame;  by_frame : what
    was found in each;  predicted : the time of one of its steps was not measured

    formula : which the stage ran under;  other : stages under the formula that the job does
    not use, in place of its own;  flicker : of this and of the reference, grey
    levels from a frame to the next"""

    name: str
    level: str
    formula: str
    time: Prediction = field(default_factory=lambda: measured(0.0))
    predicted: bool = False
    by_frame: dict[int, Difference] = field(default_factory=dict)
    flicker: tuple[float, float] | None = None
    pictures: dict[int, ndarray] = field(default_factory=dict)
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

    def worst_frame(self) -> int | None:
        return max(self.by_frame, key=lambda i: self.by_frame[i].p99, default=None)


def front(rows: Sequence[Row]) -> list[Row]:
    """Those that no other beats in both time and mean error, cheapest first."""
    out: list[Row] = []
    for r in sorted(rows, key=lambda r: (r.seconds, r.average("mean"))):
        if not out or r.average("mean") < out[-1].average("mean") - 1e-9:
            out.append(r)
    return out
