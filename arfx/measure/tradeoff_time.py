"""What each level of each stage costs per frame, as a job would spend it.

Fast levels are run over all that the plan asks of them. A reference would take minutes: its
time is that of the window in which its picture was rendered, for as many pixels as the plan
asks for. Pixels beside the object's box cost between nothing and as much as those of the box:
these two are the ends of the interval. Times are of the processor, all threads together,
which other programs on the machine disturb least."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from arfx.core.cost import Prediction, measured, sum_independent, with_spread
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Stage
from arfx.measure.steps import Chain, FrameRenderer, window_of
from arfx.measure.timing import PROCESSOR, Stopwatch
from arfx.plan.levels import sum_correlated

LEAST_SPREAD = 0.08  # of log seconds: no machine repeats itself better
OFTEN = 0.02  # fraction of frames under a new light from which on its cost is one of every frame
ONCE_S = 3.0  # a run that took longer is not made again
SLOW_S = 2.0  # a reference that takes longer over the whole is timed by its picture
PROBE_PX, PROBE_S = (
    64,
    2.0,
)  # the least window, and a run that tells what a pixel costs


@dataclass
class Times:
    """Of levels upon the steps before them.

    frames : whole;  new : by stage, fraction of the clip's frames under a light that was not
    met before
    slow_s : of references, seconds by themselves and for a pixel more
    """

    frames: Sequence[FrameRenderer]
    new: Mapping[str, float]
    clock: Stopwatch = PROCESSOR
    whole: dict[Chain, Prediction] = field(default_factory=dict)
    slow_s: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)

    def is_slow(self, chain: Chain) -> bool:
        """Whether the last step's time is that of its picture."""
        stage, level = chain[-1]
        if level != "reference":
            return False
        alone, per_px = self.alone_and_per_px(chain)
        return alone + per_px * planned(self.frames[0], stage).area > SLOW_S

    def of(self, chain: Chain, pictures: Sequence[FrameRenderer]) -> Prediction:
        """Seconds of the chain's last step, mean over the frames that have it.

        pictures : frames, of which those that are slow were rendered
        """
        if self.is_slow(chain):
            return mean(
                [p for frame in pictures for p in self.scaled(frame, chain[-1])]
            )
        if chain in self.whole:
            return self.whole[chain]
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
        spread = [with_spread(seconds, LEAST_SPREAD) for seconds in parts]
        self.whole[chain] = sum_independent(spread)
        return self.whole[chain]

    def alone_and_per_px(self, chain: Chain) -> tuple[float, float]:
        """Seconds that its last step takes by itself, and more of each pixel: in windows of
        one frame, up to one that takes PROBE_S longer; upon fast levels.
        """
        (stage, level), before = chain[-1], [fast(*step) for step in chain[:-1]]
        key = (stage.name, level)
        if key not in self.slow_s:
            frame, area, per_px = self.frames[0], PROBE_PX, 0.0
            run, whole = frame.run((*before, chain[-1])), frame.plan.changed.area
            few = window_of(frame.plan, frame.facts, frame.window, area)
            run(few)  # loads code, and makes what is kept for this light
            alone = seconds = self.clock.of(partial(run.rerun, few))
            while seconds < alone + PROBE_S and area < whole:
                area *= 4
                few = window_of(frame.plan, frame.facts, frame.window, area)
                seconds = self.clock.of(partial(run.rerun, few))
                per_px = max(seconds - alone, 0.0) / few.area
            self.slow_s[key] = (alone, per_px)
        return self.slow_s[key]

    def scaled(
        self, frame: FrameRenderer, step: tuple[Stage, str]
    ) -> list[Prediction]:
        """Of the whole frame, from the first time that the step was rendered in the window."""
        chain = next((c for c in frame.seconds if c[-1] == step), None)
        if chain is None:
            return []
        whole, out, box = (
            planned(frame, step[0]),
            frame.out(chain),
            frame.facts.model_box,
        )
        alone = min(self.alone_and_per_px(chain)[0], frame.seconds[chain])
        ratios = [whole.area / out.area]
        if in_window := box.clip(out).area:
            ratios.append(box.clip(whole).area / in_window)
        ends = sorted(
            alone + (frame.seconds[chain] - alone) * ratio for ratio in ratios
        )
        low, high = (with_spread(end, LEAST_SPREAD) for end in (ends[0], ends[-1]))
        return [Prediction(math.sqrt(ends[0] * ends[-1]), low.low_s, high.high_s)]


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
