"""What each level of each stage costs per frame, as a job would spend it.

Fast levels are run over all that the plan asks of them. A reference would take minutes, so
it is run on tiles spread over the step, in the object's box and outside, and on one of a
few pixels, which shows what a run costs by itself: seconds = run + rate(box) x pixels of
the box + rate(rest) x pixels of the rest, with the interval that the tiles' spread gives
(stratified ratio estimate, Cochran, "Sampling Techniques", ch. 6). A tile has more rim for
its size than the whole: whether a stage's work goes by the pixels that it makes or by those
that it reads is not known, so the interval holds both. Times are of the processor, all
threads together, which other programs on the machine disturb least."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtrit

from arfx.core.cost import Prediction, sum_independent, with_spread
from arfx.core.rect import Rect
from arfx.measure.steps import Chain, FrameRenderer, StageRun
from arfx.plan.levels import sum_correlated

At = tuple[str, str]  # stage, level
TILES, TILE_S, TINY_PX = (
    4,
    0.6,
    4,
)  # a part of a step (box, rest), frame and level: how many, seconds of all, side of the least
FEWEST_PX, MOST_PX = 16, 64  # side of a tile
SLOW_S, FEW = (
    1.0,
    2,
    # a level that takes so long for next to nothing is timed on one frame alone, on so few
    # tiles a part
)
LEAST_SPREAD = 0.08  # of log seconds: no machine repeats itself better
OFTEN = 0.02  # fraction of frames under a new light from which on its cost is one of every frame
ONCE_S = 3.0  # a run that took longer is not made again


@dataclass
class Tiles:
    """Runs of a level on parts of a step.

    empty_s : of runs on next to nothing;  by_part : (pixels, seconds) of each tile
    rims : of each frame, pixels read for a pixel made by the whole step, as a fraction of
    the tiles'
    """

    empty_s: list[float] = field(default_factory=list)
    by_part: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    rims: list[float] = field(default_factory=list)

    def over(self, areas: Mapping[str, int]) -> Prediction:
        """Of one run over `areas`, pixels of each part.

        A part without tiles costs what the others do.
        """
        alone = float(np.median(self.empty_s))
        all_tiles = [t for tiles in self.by_part.values() for t in tiles]
        total, variance, free = 0.0, 0.0, 0
        for part, area in areas.items():
            tiles = self.by_part.get(part) or all_tiles
            px, s = np.array(tiles, float).T
            above = np.maximum(s - alone, 0.0)
            rate = above.sum() / px.sum()
            total += rate * area
            if len(tiles) > 1:
                left = above - rate * px
                error = (
                    math.sqrt((left**2).sum() / (len(tiles) - 1) / len(tiles)) / px.mean()
                )
                variance += (error * area) ** 2
                free += len(tiles) - 1
        rim = float(np.median(self.rims)) if self.rims else 1.0
        middle = alone + total * math.sqrt(rim)
        if not free:
            return with_spread(middle, 1.0)
        wide = float(stdtrit(free, 0.95)) * math.sqrt(
            variance
        )  # nine in ten (scipy.stats takes a second to import)
        ends = sorted((alone + total, alone + total * rim))
        least = with_spread(middle, LEAST_SPREAD)
        return Prediction(
            middle,
            max(min(ends[0] - wide, least.low_s), alone),
            max(ends[1] + wide, least.high_s),
        )


@dataclass
class Times:
    """Seconds per frame of every (stage, level) that was timed.

    whole : of runs over all of a step, frame by frame;  tiles, areas : of the levels that
    are too slow for that
    new_s : what a light that was not met before adds;  clock : of the processor, all threads
    """

    clock: Callable[[], float] = time.process_time
    whole: dict[At, list[float]] = field(default_factory=dict)
    tiles: dict[At, Tiles] = field(default_factory=dict)
    areas: dict[At, list[dict[str, int]]] = field(default_factory=dict)
    new_s: dict[At, list[float]] = field(default_factory=dict)

    def of(self, at: At) -> Prediction | None:
        """Mean over the frames; None = not timed."""
        if at in self.tiles:
            each = [self.tiles[at].over(areas) for areas in self.areas[at]]
            mean = sum_correlated(each).times(1 / len(each))
        elif at in self.whole:
            mean = with_spread(float(np.mean(self.whole[at])), LEAST_SPREAD)
        else:
            return None
        added = float(np.mean(self.new_s.get(at, [0.0])))
        return (
            sum_independent([mean, with_spread(added, LEAST_SPREAD)]) if added > 0 else mean
        )

    def run(self, run: StageRun, out: Rect) -> float:
        start = self.clock()
        run.rerun(out)
        return self.clock() - start

    def under_new_light(
        self, at: At, run: StageRun, out: Rect, known_s: float, fraction: float
    ) -> None:
        """fraction : of the clip's frames under a light that was not met before;  known_s :
        under one that was
        """
        if fraction > OFTEN:
            run.at.memo.of_light.clear()
            self.new_s.setdefault(at, []).append(
                fraction * max(self.run(run, out) - known_s, 0.0)
            )


def areas_of(out: Rect, box: Rect) -> dict[str, int]:
    """Pixels of a step's parts: in the object's box, and outside."""
    inside = box.clip(out).area
    return {"box": inside, "rest": out.area - inside}


def time_frame(
    times: Times,
    frame: FrameRenderer,
    usual: Mapping[str, str],
    wanted: Collection[At],
    new: Mapping[str, float],
) -> None:
    """Time `wanted`, each upon what the steps before it make at their `usual` level; the
    slow ones of the frame on tiles.

    new : by stage, fraction of the clip's frames under a light that was not met before"""
    before: Chain = ()
    for step in frame.plan.steps:
        for level in frame.prepared.stages[step.stage].levels:
            at = (step.stage, level)
            if at in wanted:
                time_one = _on_tiles if at in frame.slow else _whole
                time_one(
                    times, at, frame.run((*before, at)), step.out, new.get(step.stage, 0.0)
                )
        if step.stage in usual:
            before = (*before, (step.stage, usual[step.stage]))


def _whole(times: Times, at: At, run: StageRun, out: Rect, new: float) -> None:
    first = times.run(run, out)  # loads code, and makes what is kept for this light
    known = times.whole.setdefault(at, [])
    seconds = (
        first if known and first > ONCE_S else times.run(run, out)
    )  # code that is compiled may take longer than ONCE_S
    known.append(seconds)
    if seconds <= ONCE_S:
        times.under_new_light(at, run, out, seconds, new)


def _on_tiles(times: Times, at: At, run: StageRun, out: Rect, new: float) -> None:
    box = run.facts.model_box
    inside = box.clip(out)
    times.areas.setdefault(at, []).append(areas_of(out, box))
    tiles = times.tiles.setdefault(at, Tiles())
    if tiles.empty_s and tiles.empty_s[0] > SLOW_S:
        return  # nothing but one frame's tiles: their interval is all that is known
    tiny = _tile(inside if not inside.empty else out, 0.5, 0.5, TINY_PX)
    alone = times.run(run, tiny)  # loads code, and makes what is kept for this light
    slow = alone > SLOW_S
    if not slow:
        alone = times.run(run, tiny)
    tiles.empty_s.append(alone)
    times.under_new_light(at, run, tiny, alone, new)
    least_px, made_px, read_px = run.need(tiny).area, 0, 0
    rng = np.random.default_rng(run.facts.index)
    for part, rects in (("box", [inside]), ("rest", subtract(out, inside))):
        side = FEWEST_PX
        for point in _spread_points(rng, rects, FEW if slow else TILES):
            tile = _tile(*point, side)
            seconds = times.run(run, tile)
            tiles.by_part.setdefault(part, []).append((tile.area, seconds))
            made_px, read_px = made_px + tile.area, read_px + run.need(tile).area - least_px
            rate = max(seconds - alone, 1e-6) / tile.area
            side = int(
                np.clip(
                    math.sqrt(max(TILE_S / TILES, 0.3 * alone) / rate), FEWEST_PX, MOST_PX
                )
            )
    if read_px > 0:
        whole_px = run.need(out).area - least_px
        tiles.rims.append(float(np.clip(whole_px / out.area * made_px / read_px, 0.1, 1.0)))


def subtract(whole: Rect, hole: Rect) -> list[Rect]:
    """The rectangle without another one, as at most four that do not overlap."""
    if hole.empty:
        return [whole]
    parts = (
        Rect(whole.x0, whole.y0, whole.x1, hole.y0),
        Rect(whole.x0, hole.y1, whole.x1, whole.y1),
        Rect(whole.x0, hole.y0, hole.x0, hole.y1),
        Rect(hole.x1, hole.y0, whole.x1, hole.y1),
    )
    return [p for p in parts if not p.empty]


def _spread_points(
    rng: np.random.Generator, rects: list[Rect], count: int
) -> list[tuple[Rect, float, float]]:
    """`count` points spread evenly over rectangles: the rectangle, and the point as
    fractions of its sides.
    """
    areas = np.array([r.area for r in rects], float)
    if not areas.sum():
        return []
    ends = np.cumsum(areas) / areas.sum()
    across = (rng.permutation(count) + rng.random(count)) / count
    out = []
    for k in range(count):
        at = (k + rng.random()) / count
        i = min(int(np.searchsorted(ends, at, side="right")), len(rects) - 1)
        along = (at - (ends[i - 1] if i else 0.0)) / (areas[i] / areas.sum())
        out.append(
            (rects[i], along, across[k])
            if rects[i].width >= rects[i].height
            else (rects[i], across[k], along)
        )
    return out


def _tile(where: Rect, u: float, v: float, side: int) -> Rect:
    """A square (less where the rectangle is less) about the point (u, v) of a rectangle,
    within it.
    """
    width, height = min(side, where.width), min(side, where.height)
    x0 = where.x0 + round(min(max(u * where.width - width / 2, 0), where.width - width))
    y0 = where.y0 + round(min(max(v * where.height - height / 2, 0), where.height - height))
    return Rect(x0, y0, x0 + width, y0 + height)
