"""What accuracy costs on one clip: every level of every effect against its reference, and
whole pipelines.

Frames that stand for the clip are rendered: each effect at each of its levels while the
others stay at their usual one, and whole pipelines. Errors are grey levels and FLIP over
the pixels that the effect touches; the clip's light, poses and plan are those of the job.
Times are of whole steps (tradeoff_time.py).
Cost: the references; the window of the pictures is made so small that they take about
REFERENCE_S together.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.cost import sum_independent
from arfx.core.layers import Layer
from arfx.core.numerics import divide
from arfx.core.stage import Stage, level_named
from arfx.core.waiting import Progress
from arfx.errors import NothingToDoError
from arfx.measure.difference import Difference, difference, mean_flicker, touched
from arfx.measure.steps import FrameRenderer, open_frames, window_of
from arfx.measure.tradeoff_frames import Sample, pick_frames
from arfx.measure.tradeoff_pipelines import LEFT_OUT, QUALITIES, Row
from arfx.measure.tradeoff_time import Times, fast, planned
from arfx.plan.planner import new_terms
from arfx.run.parameters import stages_of, under_other_formula
from arfx.run.planned import Job
from arfx.stages import ALWAYS

REFERENCE_S, LEAST_PX = 60.0, 600
PIPELINE = "pipeline"  # the name of rows that are no effect's
# of a picture: comparing whole ones of 1080p took twice as long as the references
MOST_PX = 600_000

Levels = Mapping[str, str]  # by stage; one that is left out has none
OWN: Mapping[str, Stage] = MappingProxyType({})


@dataclass
class Measurements:
    """samples : the frames;  effects, pipelines : rows;  windows : what the pictures show,
    by frame
    """

    samples: list[Sample]
    effects: list[Row]
    pipelines: list[Row]
    windows: dict[int, Any]
    locations: dict[tuple[str, str], str] = field(default_factory=dict)
    prepare_s: dict[tuple[str, str], float] = field(default_factory=dict)


@dataclass
class _Work:
    """What the rows are made from.

    frames : by number, in the window of their pictures;  following : the one of them after
    the first sample, of which flicker alone is measured
    usual : levels of the job's quality;  best : all at reference
    """

    job: Job
    samples: Sequence[int]
    frames: dict[int, FrameRenderer]
    following: int | None
    usual: Levels
    best: Levels
    times: Times
    left: dict[frozenset[str], dict[str, Stage]] = field(default_factory=dict)

    @property
    def sampled(self) -> list[FrameRenderer]:
        return [self.frames[i] for i in self.samples]

    def stages(
        self, names: Collection[str], other: Mapping[str, Stage] = OWN
    ) -> Mapping[str, Stage]:
        """Those of the job, or, where others of it are left out, those of a job without
        them: they may have other settings then. other : some in place of these
        """
        own, key = self.job.stages, frozenset(names)
        if self.usual.keys() <= key:
            return {**own, **other}
        if key not in self.left:
            left = stages_of(
                self.job.inputs.config.params, [n for n in own if n in key]
            )
            self.left[key] = {
                n: own[n] if repr(vars(stage)) == repr(vars(own[n])) else stage
                for n, stage in left.items()
            }
        return {**self.left[key], **other}

    def image(
        self, frame: FrameRenderer, levels: Levels, other: Mapping[str, Stage] = OWN
    ) -> ndarray:
        return frame.image(frame.chain(levels, self.stages(levels, other)))

    def time(self, row: Row) -> None:
        """Note what a frame takes: the effect's step, or all of a pipeline. Each step is
        timed upon what those before it make at their usual level."""
        stages = self.stages(row.levels, row.other)
        names = list(row.levels)
        usual = [
            fast(stages[n], level_named(stages[n].levels, self.usual[n]))
            for n in names
        ]
        chains = [
            (*usual[:k], (stages[n], row.levels[n]))
            for k, n in enumerate(names)
            if row.name in (n, PIPELINE)
        ]
        row.time = sum_independent(map(self.times.of, chains))
        row.predicted = any(map(self.times.is_slow, chains))

    def reference(self, name: str) -> Levels:
        """Of an effect, with all others at their usual level, or of pipelines."""
        if name == PIPELINE:
            return self.best
        return {**self.usual, name: self.best[name]}


def measure(
    job: Job,
    frames: int,
    progress: Progress,
    only: Collection[str] | None = None,
    window_px: int | None = None,
) -> Measurements:
    """job : up to its plan;  only : the levels of these effects, and no pipelines; None =
    everything
    window_px : area of the pictures; None = as REFERENCE_S allows

    Raises NothingToDoError where no frame shows the object."""
    steps = {p.index: [s.stage for s in p.steps] for p in job.plan.frames}
    picked = pick_frames(job.facts, job.inputs.camera.rect, frames)
    samples = [s for s in picked if steps[s.index]]
    if not samples:
        raise NothingToDoError(
            "no frame of the clip shows the object: there is nothing to measure",
            "see `arfx plan`",
        )
    first, names = samples[0].index, steps[samples[0].index]
    flickers = only is None and steps.get(first + 1) == names
    work = _opened(job, [s.index for s in samples], names, flickers)
    wanted = [n for n in work.usual if only is None or n in only]
    other = {
        n: stage
        for n in wanted
        if only is None
        and (stage := under_other_formula(n, job.stages[n].params)) is not None
    }
    effects = [n for n in wanted if len(job.stages[n].levels) > 1 or n in other]
    compared = [*[PIPELINE] * (only is None), *effects]
    _choose_windows(work, [*map(work.reference, compared)], window_px)
    found = Measurements(
        samples, [], [], {i: f.window for i, f in work.frames.items()}
    )
    total = len(effects) + 2
    for k, name in enumerate(effects):
        progress("effects", k, total)
        found.effects += _of_stage(work, name, found)
    if only is None:
        progress("pipelines", len(effects), total)
        found.pipelines = _pipelines(work)
    if other:
        found.effects += [
            _of_other_formula(work, n, {n: s}) for n, s in other.items()
        ]
        found.pipelines.append(_of_other_formula(work, PIPELINE, other))
    found.prepare_s = work.sampled[0].prepared.prepare_s
    progress("pipelines", total, total)
    return found


def _opened(
    job: Job, samples: Sequence[int], names: Sequence[str], flickers: bool
) -> _Work:
    """names : stages of the samples;  flickers : with the frame after the first sample"""
    following = samples[0] + 1 if flickers else None
    stages, quality = job.stages, job.inputs.config.pipeline.quality
    frames = open_frames(job, [*samples, *[samples[0] + 1] * flickers])
    whole = [replace(frames[i]) for i in samples]
    return _Work(
        job,
        samples,
        frames,
        following,
        {n: level_named(stages[n].levels, quality) for n in names},
        {n: stages[n].levels[-1] for n in names},
        Times(whole, _new_light_fractions(job, names), job.prices),
    )


def _new_light_fractions(job: Job, names: Sequence[str]) -> dict[str, float]:
    """By stage: the fraction of its frames whose light was not met before."""
    met = new_terms(job.stages.values(), job.facts)
    new = {f.index: terms for f, terms in zip(job.facts, met, strict=True)}
    out = {}
    for name in names:
        terms = job.stages[name].terms
        runs = [
            p.index for p in job.plan.frames if name in {s.stage for s in p.steps}
        ]
        out[name] = float(np.mean([not new[i].isdisjoint(terms) for i in runs]))
    return out


def _choose_windows(
    work: _Work, sets: Sequence[Levels], window_px: int | None
) -> None:
    """As `measure` says, and at most MOST_PX."""
    frames, first, times = work.frames, work.sampled[0], work.times
    area = float(MOST_PX if window_px is None else window_px)
    if window_px is None:
        chains = [first.chain(levels, work.stages(levels)) for levels in sets]
        steps = {c[: k + 1] for c in chains for k in range(len(c))}
        per_px = len(frames) * sum(
            times.predicted(c).seconds / planned(first, c[-1][0]).area
            for c in filter(times.is_slow, steps)
        )
        least = float(divide(REFERENCE_S, per_px, where_zero=area))
        area = min(area, max(least, LEAST_PX))
    for i in frames:
        shown = frames[i - 1] if i == work.following else frames[i]
        window = window_of(shown.plan, shown.facts, work.job.inputs.camera.rect, area)
        frames[i] = replace(frames[i], window=window)


def _of_stage(work: _Work, name: str, found: Measurements) -> list[Row]:
    """A row for each level, the reference's too, against the reference with all other
    stages at their usual level; the first tells what leaving out the effect would change,
    where a job can do without."""
    stage, usual, best = work.job.stages[name], work.usual, work.reference(name)
    formula = getattr(stage.params, "formula", "")
    rows = [
        Row(name, level, formula, levels={**usual, name: level})
        for level in stage.levels
    ]
    levels = list(rows)
    without = {n: level for n, level in usual.items() if n != name}
    if name not in ALWAYS:
        rows.insert(0, Row(name, LEFT_OUT, formula, levels=without))
    _compare(work, rows)
    for row in levels:
        work.time(row)
    for i in rows[-1].by_frame:
        worst = max(levels[:-1], key=lambda r: r.by_frame[i].p99, default=None)
        if worst is not None:
            frame = work.frames[i]
            chain = frame.chain(best, work.stages(best))
            coverage = frame.layer(chain, Layer.COVERAGE)
            location = _location(worst.by_frame[i], coverage)
            found.locations.setdefault((name, worst.level), location)
    _measure_flicker(work, levels)
    return rows


def _compare(work: _Work, rows: Sequence[Row]) -> None:
    """Note the pictures of rows of one name, and how far they are from the reference's,
    where it changes anything: what is there without the effect, or the frame as it was.
    """
    name = rows[0].name
    for i, frame in zip(work.samples, work.sampled, strict=True):
        if name not in {PIPELINE, *(s.stage for s in frame.plan.steps)}:
            continue
        reference, without = work.image(frame, work.reference(name)), frame.original()
        if name != PIPELINE:
            left = {n: at for n, at in work.usual.items() if n != name}
            without = work.image(frame, left)
        for r in rows:
            r.pictures[i] = work.image(frame, r.levels, r.other)
        where = touched(
            (reference, without), *((reference, r.pictures[i]) for r in rows)
        )
        for r in rows:
            r.by_frame[i] = difference(reference, r.pictures[i], where)


def _measure_flicker(work: _Work, rows: Sequence[Row]) -> None:
    """How much each level changes from one frame to the next beyond the footage's own
    motion, beside its reference, the last.
    """
    first = work.samples[0]
    if work.following is None or first not in rows[0].pictures:
        return
    a, b = work.frames[first], work.frames[work.following]
    where = touched((rows[-1].pictures[first], a.original()))
    plates = a.original(), b.original()
    values = [
        mean_flicker(work.image(a, r.levels), work.image(b, r.levels), *plates, where)
        for r in rows
    ]
    for r, value in zip(rows, values, strict=True):
        r.flicker = (value, values[-1])


def _location(d: Difference, coverage: ndarray) -> str:
    """Where a difference is largest, in words."""
    x, y = d.worst_px
    edge = np.asarray((coverage > 0.02) & (coverage < 0.98)).astype(np.uint8)
    if cv2.dilate(edge, np.ones((5, 5), np.uint8))[y, x]:
        return "at the silhouette"
    return "on the object" if coverage[y, x] > 0.5 else "beside the object"


def _of_other_formula(work: _Work, name: str, other: Mapping[str, Stage]) -> Row:
    """An effect, or the whole pipeline, under the other formula, at usual levels or the nearest
    that its stages have, against the job's own reference.
    """
    stages = {**work.job.stages, **other}
    levels = {n: level_named(stages[n].levels, at) for n, at in work.usual.items()}
    formula = next(iter(other.values())).params.formula
    row = Row(name, levels.get(name, "usual"), formula, levels=levels, other=other)
    _compare(work, [row])
    work.time(row)
    return row


def _pipelines(work: _Work) -> list[Row]:
    """Those that have a quality's name, cheapest first."""
    stages = work.job.stages
    named: dict[tuple[str, ...], Row] = {}
    for quality in QUALITIES:
        levels = {n: level_named(stages[n].levels, quality) for n in work.usual}
        row = Row(PIPELINE, quality, "", levels=levels)
        named.setdefault(tuple(levels.values()), row)
    rows = list(named.values())
    _compare(work, rows)
    for row in rows:
        work.time(row)
    return sorted(rows, key=lambda r: r.seconds)
