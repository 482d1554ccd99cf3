"""What each level of each stage costs per frame, as a job would spend it.

Levels are run over all that the plan asks of them. A reference that would take more than
SLOW_S of a frame is not: the price list predicts it. Times are of the processor, all threads
together, which other programs on the machine disturb least."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from arfx.core.cost import Prediction, Prices, measured, sum_independent, with_spread
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Stage
from arfx.measure.steps import Chain, FrameRenderer
from arfx.measure.timing import PROCESSOR, Stopwatch
from arfx.plan.levels import sum_correlated
from arfx.plan.planner import terms_of

LEAST_SPREAD = 0.08  # of log seconds: no machine repeats itself better
OFTEN = 0.02  # fraction of frames under a new light from which on its cost is one of every frame
ONCE_S = 3.0  # a run that took longer is not made again
SLOW_S = 2.0  # a reference that takes longer is predicted


@dataclass
class Times:
    """Of levels upon the steps before them.

    frames : whole;  new : by stage, fraction of the clip's frames under a light that was not
    met before
    """

    frames: Sequence[FrameRenderer]
    new: Mapping[str, float]
    prices: Prices
    clock: Stopwatch = PROCESSOR
    known: dict[Chain, Prediction] = field(default_factory=dict)

    def is_slow(self, chain: Chain) -> bool:
        """Whether the time of the chain's last step is predicted."""
        return self.predicted(chain).seconds > SLOW_S

    def predicted(self, chain: Chain) -> Prediction:
        """By the price list, of a reference; 0 for others, and where it has no price."""
        stage, level = chain[-1]
        found = []
        for frame in self.frames if level == "reference" else ():
            scene = frame.prepared.scene
            out = planned(frame, stage)
            need = stage.needs(out, frame.facts, scene, level).union(out)
            terms = terms_of(need.clip(scene.camera.rect), frame.facts, scene)
            new = {
                t: self.new.get(stage.name, 0.0)
                for t in stage.terms
                if t.startswith("new_")
            }
            price = self.prices.predict(f"{stage.name}/{level}", {**terms, **new})
            if price is not None and not out.empty:
                found.append(price)
        return mean(found)

    def of(self, chain: Chain) -> Prediction:
        """Seconds of the chain's last step, mean over the frames that have it."""
        if chain not in self.known:
            found = self.predicted(chain)
            slow = found.seconds > SLOW_S
            self.known[chain] = found if slow else self._measured(chain)
        return self.known[chain]

    def _measured(self, chain: Chain) -> Prediction:
        stage = chain[-1][0]
        known: list[float] = []
        added: list[float] = []
        for frame in self.frames:
            out = planned(frame, stage)
            if out.empty:
                continue
            run = frame.run(chain)
            rerun = partial(run.rerun, out)
            # loads code, and makes what is kept for this light
            seconds = self.clock.of(rerun)
            if not known or seconds <= ONCE_S:
                seconds = self.clock.of(rerun)
            known.append(seconds)
            fraction = self.new.get(stage.name, 0.0)
            if fraction > OFTEN and seconds <= ONCE_S:
                run.at.memo.of_light.clear()
                added.append(fraction * max(self.clock.of(rerun) - seconds, 0.0))
        parts = [float(np.mean(times)) for times in (known, added) if times]
        return sum_independent(with_spread(s, LEAST_SPREAD) for s in parts)


def fast(stage: Stage, level: str) -> tuple[Stage, str]:
    """The level, or the best one below a reference."""
    best = level == "reference" and len(stage.levels) > 1
    return stage, stage.levels[-2] if best else level


def planned(frame: FrameRenderer, stage: Stage) -> Rect:
    """What the frame's plan asks of a stage."""
    return next((s.out for s in frame.plan.steps if s.stage == stage.name), EMPTY)


def mean(parts: Sequence[Prediction]) -> Prediction:
    """Of predictions that are all wrong by the same factor; 0 for none."""
    return sum_correlated(parts).times(1 / len(parts)) if parts else measured(0.0)
