"""What accuracy costs on one clip: every level of every effect against its reference, and
whole pipelines.

Frames that stand for the clip are rendered: each effect at each of its levels while the
others stay at their usual one, and whole pipelines, among them those on the way from the
reference down to the cheapest (tradeoff_pipelines.py). Errors are grey levels and FLIP over
the pixels that the effect touches; the clip's light, poses and plan are those of the job.
Times are of whole steps (tradeoff_time.py).
Cost: the references; the window of the pictures is made so small that they take about
REFERENCE_S together.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from arfx.core.cost import Prediction, Prices, measured, sum_independent
from arfx.core.rect import Rect
from arfx.core.stage import Stage, level_named
from arfx.core.waiting import Progress
from arfx.errors import NothingToDoError
from arfx.measure.difference import Difference, difference, mean_flicker, touched
from arfx.measure.steps import (
    Chain,
    FrameRenderer,
    PreparedStages,
    chain_of,
    open_frames,
    window_of,
)
from arfx.measure.tradeoff_frames import Sample, pick_frames
from arfx.measure.tradeoff_pipelines import (
    LEFT_OUT,
    QUALITIES,
    Row,
    level_sets,
    worth_showing,
)
from arfx.measure.tradeoff_time import Times, areas_of, time_frame
from arfx.plan.planner import new_terms
from arfx.run.parameters import stages_of, under_other_formula
from arfx.run.planned import Job
from arfx.stages import ALWAYS

REFERENCE_S, LEAST_PX = 60.0, 600
# of a picture: comparing whole ones of 1080p took twice as long as the references
MOST_PX = 600_000


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
class Setup:
    """The job's stages, some of them under other settings.

    frames : to render with them, by number;  times : of the stages that are others"""

    prepared: PreparedStages
    frames: dict[int, FrameRenderer] = field(default_factory=dict)
    times: Times = field(default_factory=Times)


@dataclass
class _Work:
    """What the rows are made from.

    main : the job's own settings;  base : levels of the steps before those that are timed;
    best : all at reference
    """

    job: Job
    samples: Sequence[Sample]
    main: Setup
    usual: Mapping[str, str]
    base: Mapping[str, str]
    best: Mapping[str, str]
    slow: frozenset[tuple[str, str]]
    new: Mapping[str, float]
    found: Measurements
    other_s: dict[str, Prediction] = field(
        default_factory=dict
    )  # by stage: its usual level under the other formula
    parts: dict[frozenset[str], Setup] = field(default_factory=dict)  # by what is left

    def with_stages(self, stages: Mapping[str, Stage]) -> Setup:
        """These in place of the job's own."""
        prepared = PreparedStages(self.job.scene, {**self.main.prepared.stages, **stages})
        frames = {i: replace(b, prepared=prepared) for i, b in self.main.frames.items()}
        return Setup(prepared, frames)

    def setup(self, levels: Mapping[str, str]) -> Setup:
        """Of the job without the stages that have no level here: those that are left may
        have other settings then.
        """
        if levels.keys() >= self.usual.keys():
            return self.main
        names = frozenset(levels)
        if names not in self.parts:
            left = [n for n in self.main.prepared.stages if n in names]
            self.parts[names] = self.with_stages(
                stages_of(self.job.inputs.config.params, left)
            )
        return self.parts[names]

    def image(self, index: int, levels: Mapping[str, str]) -> np.ndarray:
        frame = self.setup(levels).frames[index]
        return frame.image(chain_of(frame.plan, levels))

    def time(self, levels: Mapping[str, str]) -> Prediction:
        """Of all steps of a frame."""
        part, own = self.setup(levels), self.main.prepared.stages
        changed = [n for n in levels if vars(part.prepared.stages[n]) != vars(own[n])]
        wanted = {(n, levels[n]) for n in changed if part.times.of((n, levels[n])) is None}
        self.measure(part, wanted, levels)
        return sum_independent(
            part.times.of(at) or self.main.times.of(at) or measured(0.0)
            for at in levels.items()
        )

    def measure(
        self, setup: Setup, wanted: Collection[tuple[str, str]], among: Collection[str]
    ) -> None:
        """Time these levels of a setup's stages, upon those among which they run."""
        base = {n: at for n, at in _levels(setup, self.base).items() if n in among}
        for sample in self.samples if wanted else ():
            whole = replace(setup.frames[sample.index], window=self.job.inputs.camera.rect)
            time_frame(setup.times, whole, base, wanted, self.new)


def measure(
    job: Job,
    frames: int,
    progress: Progress,
    only: Collection[str] | None = None,
    window_px: int | None = None,
) -> Measurements:
    """job : up to its plan;  only : the levels of these effects under the job's formula,
    and no pipelines; None = everything
    window_px : area of the pictures, no reference is timed; None = as REFERENCE_S allows

    Raises NothingToDoError where no frame shows the object."""
    stages = job.stages
    plans = {p.index: p for p in job.plan.frames}
    samples = [
        s
        for s in pick_frames(job.facts, job.inputs.camera.rect, frames)
        if plans[s.index].steps
    ]
    if not samples:
        raise NothingToDoError(
            "no frame of the clip shows the object: there is nothing to measure",
            "see `arfx plan`",
        )
    first = samples[0].index
    names = [s.stage for s in plans[first].steps]
    following = (
        first + 1
        if only is None
        and first + 1 in plans
        and [s.stage for s in plans[first + 1].steps] == names
        else None
    )
    slow = frozenset(
        (n, s.levels[-1])
        for n, s in stages.items()
        if s.levels[-1] == "reference" and _is_slow(n, job.prices)
    )
    quality = job.inputs.config.pipeline.quality
    usual = {n: level_named(stages[n].levels, quality) for n in names}
    work = _Work(
        job,
        samples,
        Setup(PreparedStages(job.scene, stages)),
        usual,
        {n: usual[n] if (n, usual[n]) not in slow else stages[n].levels[-2] for n in names},
        {n: stages[n].levels[-1] for n in names},
        slow,
        _new_light_fractions(job, names),
        Measurements(samples, [], [], {}),
    )
    shown = [s.index for s in samples] + ([] if following is None else [following])
    work.main.frames |= open_frames(job, shown, work.main.prepared, slow)
    other = {
        n: other
        for n in names
        if only is None and (other := under_other_formula(n, stages[n].params)) is not None
    }
    effects = [n for n in names if len(stages[n].levels) > 1 or n in other]
    if only is not None:
        effects = [n for n in effects if n in only]
    total = len(samples) + len(effects) + len(QUALITIES) + 2
    for k, sample in enumerate(samples):
        progress("times", k, total)
        wanted = frozenset(
            (n, level)
            for n in (names if only is None else effects)
            for level in stages[n].levels
            if window_px is None or (n, level) not in slow
        )
        time_frame(
            work.main.times, work.main.frames[sample.index], work.base, wanted, work.new
        )
    chains = [{**usual, n: work.best[n]} for n in effects]
    _choose_windows(
        work, chains if only is not None else [work.best, *chains], following, window_px
    )
    found = work.found
    for k, name in enumerate(effects):
        progress("effects", len(samples) + k, total)
        found.effects += _of_stage(work, name, following)
    found.effects += [
        row for name, stage in other.items() for row in _of_other_formula(work, name, stage)
    ]
    if only is None:
        progress("pipelines", len(samples) + len(effects), total)
        found.pipelines = _pipelines(work, REFERENCE_S)
        found.pipelines += _other_pipeline(work, other)
    found.prepare_s = work.main.prepared.prepare_s
    progress("pipelines", total, total)
    return found


def _is_slow(stage: str, prices: Prices) -> bool:
    """Whether the reference takes more than two seconds for a megapixel, or that is unknown."""
    found = prices.predict(
        f"{stage}/reference", {"frames": 1.0, "mpx": 1.0, "object_mpx": 0.2}
    )
    return found is None or found.seconds > 2.0


def _new_light_fractions(job: Job, names: Sequence[str]) -> dict[str, float]:
    """By stage: the fraction of its frames whose light was not met before."""
    new = dict(
        zip(
            (f.index for f in job.facts),
            new_terms(job.stages.values(), job.facts),
            strict=True,
        )
    )
    out = {}
    for name in names:
        terms = {term for term in job.stages[name].terms if term.startswith("new_")}
        runs = [
            bool(new[p.index] & terms)
            for p in job.plan.frames
            if any(s.stage == name for s in p.steps)
        ]
        out[name] = float(np.mean(runs)) if runs else 0.0
    return out


def _levels(setup: Setup, levels: Mapping[str, str]) -> dict[str, str]:
    """These levels, or the nearest that the stages have under their formula."""
    return {
        name: level_named(setup.prepared.stages[name].levels, level)
        for name, level in levels.items()
    }


def _choose_windows(
    work: _Work,
    chains: Sequence[Mapping[str, str]],
    following: int | None,
    window_px: int | None,
) -> None:
    """As `measure` says, and at most MOST_PX."""
    camera: Rect = work.job.inputs.camera.rect
    frames = work.main.frames
    most = MOST_PX if window_px is None else window_px
    area = float(min(max(b.plan.changed.area for b in frames.values()), most))
    while True:
        for i, b in frames.items():
            of = frames[i - 1] if i == following else b
            frames[i] = replace(b, window=window_of(of.plan, of.facts, camera, area))
        if window_px is not None or area <= LEAST_PX:
            break
        if sum(_pictures_s(work, b, chains) for b in frames.values()) <= REFERENCE_S:
            break
        area = max(area * 0.8, LEAST_PX)
    work.found.windows = {i: b.window for i, b in frames.items()}


def _pictures_s(
    work: _Work, b: FrameRenderer, levels: Sequence[Mapping[str, str]]
) -> float:
    """What those slow steps of the frame's pictures will take that were not made yet."""
    chains = [chain_of(b.plan, of) for of in levels]
    slow: set[Chain] = {
        c[: k + 1]
        for c in chains
        for k, at in enumerate(c)
        if at in b.slow and at in work.main.times.tiles
    }
    slow -= b.rendered.keys()
    outs = {c: b.out(c) for c in slow}
    box = b.facts.model_box
    return sum(
        work.main.times.tiles[c[-1]].over(areas_of(out, box)).seconds
        for c, out in outs.items()
        if not out.empty
    )


def _of_stage(work: _Work, name: str, following: int | None) -> list[Row]:
    """A row for each level, the reference's too, against the reference with all other
    stages at their usual level; the first tells what leaving out the effect would change,
    where a job can do without."""
    stage = work.main.prepared.stages[name]
    usual = work.usual
    renderers = work.main.frames
    found = work.found
    best, formula = work.best[name], getattr(stage.params, "formula", "")
    rows = [
        Row(
            name,
            level,
            formula,
            work.main.times.of((name, level)) or measured(0.0),
            levels={**usual, name: level},
        )
        for level in stage.levels
    ]
    if name not in ALWAYS:
        rows.insert(
            0,
            Row(
                name,
                LEFT_OUT,
                formula,
                levels={n: level for n, level in usual.items() if n != name},
            ),
        )
    chosen = {**usual, name: best}
    _compare(work, rows, chosen, (name,))
    for i in rows[-1].by_frame:
        worst = max(
            (r for r in rows if r.level not in (best, LEFT_OUT)),
            key=lambda r: r.by_frame[i].p99,
            default=None,
        )
        if worst is not None:
            coverage = renderers[i].coverage(chain_of(renderers[i].plan, chosen))
            found.locations.setdefault(
                (name, worst.level), _location(worst.by_frame[i], coverage)
            )
    if following is not None:
        _measure_flicker(
            [r for r in rows if r.level != LEFT_OUT],
            best,
            renderers[following - 1],
            renderers[following],
        )
    return rows


def _compare(
    work: _Work, rows: Sequence[Row], best: Mapping[str, str], of: Sequence[str] = ()
) -> None:
    """Note each row's pictures and how far they are from those at `best` levels, where the
    stages `of` change anything.

    of : at their usual level where they are left out; none = all, against the frame as it was
    """
    for sample in work.samples:
        b = work.main.frames[sample.index]
        if not {s.stage for s in b.plan.steps}.issuperset(of):
            continue
        reference = b.image(chain_of(b.plan, best))
        without = (
            work.image(sample.index, {n: at for n, at in work.usual.items() if n not in of})
            if of
            else b.original()
        )
        for r in rows:
            at = (r.frames or work.setup(r.levels).frames)[sample.index]
            r.pictures[sample.index] = at.image(chain_of(b.plan, r.levels))
        where = touched(
            (reference, without), *((reference, r.pictures[sample.index]) for r in rows)
        )
        for r in rows:
            r.by_frame[sample.index] = difference(
                reference, r.pictures[sample.index], where
            )


def _measure_flicker(
    rows: Sequence[Row], best: str, first: FrameRenderer, second: FrameRenderer
) -> None:
    """How much each level changes from one frame to the next beyond the footage's own
    motion, beside its reference.
    """
    if first.plan.index not in rows[0].pictures:
        return
    pairs = {
        r.level: (
            first.image(chain_of(first.plan, r.levels)),
            second.image(chain_of(second.plan, r.levels)),
        )
        for r in rows
    }
    where = touched((pairs[best][0], first.original()))
    values = {
        level: mean_flicker(a, b, first.original(), second.original(), where)
        for level, (a, b) in pairs.items()
    }
    for r in rows:
        r.flicker = (values[r.level], values[best])


def _location(d: Difference, coverage: np.ndarray) -> str:
    """Where a difference is largest, in words."""
    x, y = d.worst_px
    edge = np.asarray((coverage > 0.02) & (coverage < 0.98)).astype(np.uint8)
    if cv2.dilate(edge, np.ones((5, 5), np.uint8))[y, x]:
        return "at the silhouette"
    return "on the object" if coverage[y, x] > 0.5 else "beside the object"


def _of_other_formula(work: _Work, name: str, changed: Stage) -> list[Row]:
    """An effect under the other formula, at its usual level, against the job's own reference."""
    setup = work.with_stages({name: changed})
    usual = _levels(setup, work.usual)
    row = Row(name, usual[name], changed.params.formula, levels=usual, frames=setup.frames)
    _compare(work, [row], {**work.usual, name: work.best[name]}, (name,))
    work.measure(setup, {(name, usual[name])}, usual)
    row.time = setup.times.of((name, usual[name])) or measured(0.0)
    work.other_s[name] = row.time
    return [row] if row.by_frame else []


def _pipelines(work: _Work, reference_s: float) -> list[Row]:
    """Pipelines by quality, and those in between that give the least error for each second.

    reference_s : what the references of those in between may take"""
    qualities = [
        {n: level_named(work.main.prepared.stages[n].levels, quality) for n in work.usual}
        for quality in QUALITIES
    ]
    named: dict[tuple[str, ...], Row] = {}
    for quality, levels in zip(QUALITIES, qualities, strict=True):
        named.setdefault(
            tuple(levels.values()), Row("pipeline", quality, "", levels=levels)
        )
    own = {
        n: getattr(work.main.prepared.stages[n].params, "formula", "") for n in work.usual
    }
    rows = list(named.values())
    for sample, r in itertools.product(work.samples, rows):
        work.image(sample.index, r.levels)
    for levels in level_sets(
        [r for r in work.found.effects if r.formula == own[r.name]], work.usual
    ):
        seconds = sum(
            _pictures_s(work, work.setup(levels).frames[s.index], [levels])
            for s in work.samples
        )
        if levels not in qualities and seconds <= reference_s:
            reference_s -= seconds
            rows.append(Row("pipeline", "mixed", "", levels=levels))
            for sample in work.samples:
                work.image(sample.index, levels)
    _compare(work, rows, work.best)
    for r in rows:
        r.time = work.time(r.levels)
    return worth_showing(rows)


def _other_pipeline(work: _Work, other: Mapping[str, Stage]) -> list[Row]:
    """The whole pipeline with every stage under the other formula."""
    if not other:
        return []
    there = work.with_stages(other)
    row = Row(
        "pipeline",
        "usual",
        next(s.params.formula for s in other.values()),
        levels=_levels(there, work.usual),
        frames=there.frames,
    )
    _compare(work, [row], work.best)
    timed = [
        work.other_s.get(name) or work.main.times.of((name, level))
        for name, level in work.usual.items()
    ]
    row.time = sum_independent(p for p in timed if p is not None)
    return [row]
