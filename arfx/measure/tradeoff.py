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
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.cost import Prediction, measured, sum_independent
from arfx.core.numerics import divide
from arfx.core.stage import Stage, level_named
from arfx.core.waiting import Progress
from arfx.errors import NothingToDoError
from arfx.measure.difference import Difference, difference, mean_flicker, touched
from arfx.measure.steps import FrameRenderer, open_frames, window_of
from arfx.measure.tradeoff_frames import Sample, pick_frames
from arfx.measure.tradeoff_time import Times, fast, planned
from arfx.plan.planner import new_terms
from arfx.run.parameters import stages_of, under_other_formula
from arfx.run.planned import Job
from arfx.stages import ALWAYS

QUALITIES = ("draft", "standard", "high", "reference")
LEFT_OUT = "left out"  # in place of a level
REFERENCE_S, LEAST_PX = 60.0, 600
PIPELINE = "pipeline"  # the name of rows that are no effect's
# of a picture: comparing whole ones of 1080p took twice as long as the references
MOST_PX = 600_000

Levels = Mapping[str, str]  # by stage; one that is left out has none


@dataclass(eq=False)
class Row:
    """One level of one effect, or one whole pipeline. time : per frame;  by_frame : what
    was found in each;  predicted : the time of one of its steps was not measured

    formula : which the stage ran under;  other : stages under the formula that the job does
    not choose, in place of its own
    flicker : of this and of the reference, grey levels from a frame to the next"""

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


@dataclass
class Measurements:
    """samples : the frames;  effects, pipelines : rows;  windows : what the pictures show,
    by frame
    """

    samples: list[Sample]
    effects: list[Row]
    pipelines: list[Row]
    windows: dict[int, Any]
    prepare_s: dict[tuple[str, str], float] = field(default_factory=dict)


@dataclass
class _Work:
    """What the rows are made from.

    frames : the samples, by number, in the window of their pictures;  following : the frame
    after the first of them, of which flicker alone is measured
    usual : levels of the job's quality
    """

    job: Job
    frames: dict[int, FrameRenderer]
    following: FrameRenderer | None
    usual: Levels
    times: Times
    left: dict[frozenset[str], dict[str, Stage]] = field(default_factory=dict)

    @property
    def first(self) -> FrameRenderer:
        return next(iter(self.frames.values()))

    def stages(self, names: Collection[str]) -> Mapping[str, Stage]:
        """Those of the job, or, where others of it are left out, those of a job without
        them: they may have other settings then.
        """
        own, key = self.job.stages, frozenset(names)
        if self.usual.keys() <= key:
            return own
        if key not in self.left:
            left = stages_of(
                self.job.inputs.config.params, [n for n in own if n in key]
            )
            self.left[key] = {
                n: own[n] if repr(vars(stage)) == repr(vars(own[n])) else stage
                for n, stage in left.items()
            }
        return self.left[key]

    def of_row(self, row: Row) -> dict[str, Stage]:
        return {**self.stages(row.levels), **row.other}

    def image(self, frame: FrameRenderer, row: Row) -> ndarray:
        return frame.image(frame.chain(row.levels, self.of_row(row)))

    def time(self, row: Row) -> None:
        """Note what a frame takes: the effect's step, or all of a pipeline. Each step is
        timed upon what those before it make at their usual level."""
        stages = self.of_row(row)
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
    quality, stages = job.inputs.config.pipeline.quality, job.stages
    flickers = only is None and steps.get(first + 1) == names
    numbers = [s.index for s in samples]
    opened = open_frames(job, [*numbers, *[first + 1] * flickers])
    sampled = {i: opened[i] for i in numbers}
    met = new_terms(stages.values(), job.facts)
    new = {f.index: terms for f, terms in zip(job.facts, met, strict=True)}
    new[job.facts[0].index] = frozenset()  # it is one of many
    work = _Work(
        job,
        sampled,
        opened[first + 1] if flickers else None,
        {n: level_named(stages[n].levels, quality) for n in names},
        Times([*sampled.values()], new, job.prices),
    )
    tables = {
        n: _levels_of(work, n, only is None)
        for n in names
        if len(stages[n].levels) > 1 and (only is None or n in only)
    }
    if only is None:
        tables[PIPELINE] = _pipelines(work)
    _choose_windows(work, [rows[-1].levels for rows in tables.values()], window_px)
    for k, (name, rows) in enumerate(tables.items()):
        progress("levels", k, len(tables))
        _compare(work, rows)
        for row in rows[1:]:
            work.time(row)
        if name != PIPELINE:
            _measure_flicker(work, rows[1:])
    progress("levels", len(tables), len(tables))
    pipelines = tables.pop(PIPELINE, [])[1:]
    return Measurements(
        samples,
        [r for n, rows in tables.items() for r in rows[n in ALWAYS :]],
        sorted(pipelines, key=lambda r: r.seconds),
        {i: frame.window for i, frame in work.frames.items()},
        work.first.prepared.prepare_s,
    )


def _choose_windows(
    work: _Work, sets: Sequence[Levels], window_px: int | None
) -> None:
    """As `measure` says, and at most MOST_PX."""
    first, times = work.first, work.times
    area = float(MOST_PX if window_px is None else window_px)
    if window_px is None:
        chains = [first.chain(levels, work.stages(levels)) for levels in sets]
        steps = {c[: k + 1] for c in chains for k in range(len(c))}
        count = len(work.frames) + (work.following is not None)
        per_px = count * sum(
            times.predicted(c).seconds / planned(first, c[-1][0]).area
            for c in filter(times.is_slow, steps)
        )
        least = float(divide(REFERENCE_S, per_px, where_zero=area))
        area = min(area, max(least, LEAST_PX))
    for i, frame in work.frames.items():
        window = window_of(frame.plan, frame.facts, work.job.inputs.camera.rect, area)
        work.frames[i] = replace(frame, window=window)
    if work.following is not None:
        work.following = replace(work.following, window=work.first.window)


def _levels_of(work: _Work, name: str, formulas: bool) -> list[Row]:
    """A job without the effect, the effect under its other formula, and each of its levels,
    the reference last, with all other stages at their usual level.
    """
    stage, usual = work.job.stages[name], work.usual
    formula = getattr(stage.params, "formula", "")
    without = {n: level for n, level in usual.items() if n != name}
    return [
        Row(name, LEFT_OUT, formula, levels=without),
        *(_other_formula(work, name, [name]) if formulas else []),
        *(
            Row(name, level, formula, levels={**usual, name: level})
            for level in stage.levels
        ),
    ]


def _other_formula(work: _Work, name: str, stages: Collection[str]) -> list[Row]:
    """A row of these stages under their other formula, at usual levels or the nearest that
    they have then; none where no stage has another.
    """
    found = {n: under_other_formula(n, work.job.stages[n].params) for n in stages}
    other = {n: stage for n, stage in found.items() if stage is not None}
    if not other:
        return []
    own = {**work.job.stages, **other}
    levels = {n: level_named(own[n].levels, at) for n, at in work.usual.items()}
    formula = next(iter(other.values())).params.formula
    level = levels.get(name, "usual")
    return [Row(name, level, formula, levels=levels, other=other)]


def _compare(work: _Work, rows: Sequence[Row]) -> None:
    """Note the pictures of rows of one name, and how far they are from the reference's, the
    last, where any is another.
    """
    for i, frame in work.frames.items():
        if rows[0].name not in {PIPELINE, *(s.stage for s in frame.plan.steps)}:
            continue
        for r in rows:
            r.pictures[i] = work.image(frame, r)
        reference = rows[-1].pictures[i]
        own = [(reference, r.pictures[i]) for r in rows if not r.other]
        for r in rows:
            where = touched(*own, (reference, r.pictures[i]))
            r.by_frame[i] = difference(reference, r.pictures[i], where)


def _measure_flicker(work: _Work, rows: Sequence[Row]) -> None:
    """How much each level changes from one frame to the next beyond the footage's own
    motion, beside its reference, the last.
    """
    a, b = work.first, work.following
    if b is None or a.facts.index not in rows[0].pictures:
        return
    where = touched((rows[-1].pictures[a.facts.index], a.original()))
    plates = a.original(), b.original()
    values = [
        mean_flicker(work.image(a, r), work.image(b, r), *plates, where) for r in rows
    ]
    for r, value in zip(rows, values, strict=True):
        r.flicker = (value, values[-1])


def _pipelines(work: _Work) -> list[Row]:
    """The frame as it was, all under the other formula, and those that have a quality's name,
    the reference last."""
    rows: dict[tuple[str, ...], Row] = {(): Row(PIPELINE, LEFT_OUT, "")}
    for quality in QUALITIES:
        levels = {
            n: level_named(work.job.stages[n].levels, quality) for n in work.usual
        }
        row = Row(PIPELINE, quality, "", levels=levels)
        rows.setdefault(tuple(levels.values()), row)
    left_out, *own = rows.values()
    return [left_out, *_other_formula(work, PIPELINE, work.usual), *own]
