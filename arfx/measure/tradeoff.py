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
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from arfx.core.cost import Prediction, Prices, measured, sum_independent
from arfx.core.plan import FramePlan
from arfx.core.rect import Rect
from arfx.core.stage import Stage, level_named
from arfx.errors import NothingToDoError
from arfx.measure.difference import Difference, difference, mean_flicker, touched
from arfx.measure.steps import Chain, FrameRenderer, PreparedStages, chain_of, window_of
from arfx.measure.tradeoff_frames import Sample, pick_frames
from arfx.measure.tradeoff_pipelines import (
    LEFT_OUT,
    QUALITIES,
    Row,
    level_sets,
    worth_showing,
)
from arfx.measure.tradeoff_time import Times, areas_of, time_frame
from arfx.media.frames import ClipReader
from arfx.plan.planner import new_terms
from arfx.run.parameters import stages_of, under_other_formula
from arfx.run.planned import Job
from arfx.run.source import real_depth_layer
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
class _Part:
    """Of a job's stages some: under the settings that they have in a job of their own."""

    prepared: PreparedStages
    renderers: dict[int, FrameRenderer] = field(default_factory=dict)
    times: Times = field(default_factory=Times)


@dataclass
class _Work:
    """What the rows are made from.

    base : levels of the steps before those that are timed;  best : all at reference
    """

    job: Job
    stages: Mapping[str, Stage]
    samples: Sequence[Sample]
    renderers: dict[int, FrameRenderer]
    usual: Mapping[str, str]
    base: Mapping[str, str]
    best: Mapping[str, str]
    slow: frozenset[tuple[str, str]]
    new: Mapping[str, float]
    times: Times
    found: Measurements
    other_s: dict[str, Prediction] = field(
        default_factory=dict
    )  # by stage: its usual level under the other formula
    parts: dict[frozenset[str], _Part] = field(default_factory=dict)  # by what is left out

    def part(self, levels: Mapping[str, str]) -> _Part:
        """The job without the stages that have no level here: those that are left may have
        other settings then.
        """
        names = frozenset(levels)
        if names not in self.parts:
            own = stages_of(
                self.job.inputs.config.params, [n for n in self.stages if n in names]
            )
            self.parts[names] = _Part(
                PreparedStages(self.job.scene, {**self.stages, **own})
            )
        return self.parts[names]

    def frame(self, index: int, levels: Mapping[str, str]) -> FrameRenderer:
        """What renders a frame at these levels."""
        if levels.keys() >= self.usual.keys():
            return self.renderers[index]
        part = self.part(levels)
        if index not in part.renderers:
            part.renderers[index] = replace(self.renderers[index], prepared=part.prepared)
        return part.renderers[index]

    def image(self, index: int, levels: Mapping[str, str]) -> np.ndarray:
        return self.frame(index, levels).image(chain_of(self.renderers[index].plan, levels))

    def time(self, levels: Mapping[str, str]) -> Prediction:
        """Of all steps of a frame."""
        if levels.keys() >= self.usual.keys():
            return self.times.of_chain(levels.items())
        part = self.part(levels)
        changed = [
            n for n in levels if vars(part.prepared.stages[n]) != vars(self.stages[n])
        ]
        wanted = frozenset(
            (n, levels[n]) for n in changed if part.times.of((n, levels[n])) is None
        )
        for sample in self.samples if wanted else ():
            whole = replace(
                self.renderers[sample.index],
                prepared=part.prepared,
                window=self.job.inputs.camera.rect,
            )
            time_frame(
                part.times,
                whole,
                {n: level for n, level in self.base.items() if n in levels},
                wanted,
                self.new,
            )
        return sum_independent(
            [
                part.times.of(at) or self.times.of(at) or measured(0.0)
                for at in levels.items()
            ]
        )


def measure(
    job: Job,
    frames: int,
    progress: Callable[[str, int, int | None], None],
    only: Collection[str] | None = None,
    reference_s: float = REFERENCE_S,
) -> Measurements:
    """job : up to its plan;  only : the levels of these effects under the job's formula,
    and no pipelines; None = everything
    reference_s : what all references of the pictures may take together

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
        stages,
        samples,
        {},
        usual,
        {n: usual[n] if (n, usual[n]) not in slow else stages[n].levels[-2] for n in names},
        {n: stages[n].levels[-1] for n in names},
        slow,
        _new_light_fractions(job, names),
        Times(),
        Measurements(samples, [], [], {}),
    )
    _open_renderers(
        work, [s.index for s in samples] + ([] if following is None else [following]), plans
    )
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
        )
        time_frame(work.times, work.renderers[sample.index], work.base, wanted, work.new)
    chains = [{**usual, n: work.best[n]} for n in effects]
    _choose_windows(
        work, chains if only is not None else [work.best, *chains], following, reference_s
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
        found.pipelines = _pipelines(work, reference_s)
        found.pipelines += _other_pipeline(work, other)
    found.prepare_s = next(iter(work.renderers.values())).prepared.prepare_s
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


def _open_renderers(
    work: _Work, wanted: Sequence[int], plans: Mapping[int, FramePlan]
) -> None:
    job = work.job
    pts = {job.analysed.pts[i]: i for i in wanted}
    facts = {f.index: f for f in job.facts}
    prepared = PreparedStages(job.scene, work.stages)
    camera = job.inputs.camera
    maps = job.inputs.depth
    deep = maps is not None and any(
        "depth" in work.stages[s.stage].facts for i in wanted for s in plans[i].steps
    )
    with ClipReader(job.inputs.info, careful=job.analysed.careful) as reader:
        for frame in reader.frames(min(pts), max(pts)):
            if frame.pts in pts:
                i = pts[frame.pts]
                depth = (
                    real_depth_layer(maps, facts[i], frame, camera, camera.rect)
                    if deep and maps is not None
                    else None
                )
                plate = frame.linear(camera.rect)
                work.renderers[i] = FrameRenderer(
                    facts[i], plate, plans[i], camera.rect, prepared, work.slow, depth
                )


def _levels(prepared: PreparedStages, levels: Mapping[str, str]) -> dict[str, str]:
    """These levels, or the nearest that the stages have under their formula."""
    return {
        name: level_named(prepared.stages[name].levels, level)
        for name, level in levels.items()
    }


def _choose_windows(
    work: _Work,
    chains: Sequence[Mapping[str, str]],
    following: int | None,
    reference_s: float,
) -> None:
    """As large as lets all references of these pictures take `reference_s`, and at most MOST_PX."""
    camera: Rect = work.job.inputs.camera.rect
    area = float(min(max(b.plan.changed.area for b in work.renderers.values()), MOST_PX))
    while True:
        for i, b in work.renderers.items():
            of = work.renderers[i - 1] if i == following else b
            work.renderers[i] = replace(
                b, window=window_of(of.plan, of.facts, camera, area)
            )
        if (
            sum(_pictures_s(work, b, chains) for b in work.renderers.values())
            <= reference_s
            or area <= LEAST_PX
        ):
            break
        area = max(area * 0.8, LEAST_PX)
    work.found.windows = {i: b.window for i, b in work.renderers.items()}


def _pictures_s(
    work: _Work, b: FrameRenderer, levels: Sequence[Mapping[str, str]]
) -> float:
    """What those slow steps of the frame's pictures will take that were not made yet."""
    chains = [chain_of(b.plan, of) for of in levels]
    slow: set[Chain] = {
        c[: k + 1]
        for c in chains
        for k, at in enumerate(c)
        if at in b.slow and at in work.times.tiles
    }
    slow -= b.rendered.keys()
    outs = {c: b.out(c) for c in slow}
    box = b.facts.model_box
    return sum(
        work.times.tiles[c[-1]].over(areas_of(out, box)).seconds
        for c, out in outs.items()
        if not out.empty
    )


def _of_stage(work: _Work, name: str, following: int | None) -> list[Row]:
    """A row for each level, the reference's too, against the reference with all other
    stages at their usual level; the first tells what leaving out the effect would change,
    where a job can do without."""
    stage = work.stages[name]
    usual = work.usual
    renderers = work.renderers
    found = work.found
    best, formula = work.best[name], getattr(stage.params, "formula", "")
    rows = [
        Row(
            name,
            level,
            formula,
            work.times.of((name, level)) or measured(0.0),
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
        b = work.renderers[sample.index]
        if not {s.stage for s in b.plan.steps}.issuperset(of):
            continue
        reference = b.image(chain_of(b.plan, best))
        without = (
            work.image(sample.index, {n: at for n, at in work.usual.items() if n not in of})
            if of
            else b.original()
        )
        for r in rows:
            at = (
                work.frame(sample.index, r.levels)
                if r.prepared is None
                else replace(b, prepared=r.prepared)
            )
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
    prepared = PreparedStages(work.job.scene, {**work.stages, name: changed})
    times = Times()
    usual = _levels(prepared, work.usual)
    row = Row(name, usual[name], changed.params.formula, levels=usual, prepared=prepared)
    _compare(work, [row], {**work.usual, name: work.best[name]}, (name,))
    for i in row.by_frame:
        whole = replace(
            work.renderers[i], prepared=prepared, window=work.job.inputs.camera.rect
        )
        time_frame(
            times, whole, _levels(prepared, work.base), {(name, usual[name])}, work.new
        )
    work.other_s[name] = row.time = times.of((name, usual[name])) or measured(0.0)
    return [row] if row.by_frame else []


def _pipelines(work: _Work, reference_s: float) -> list[Row]:
    """Pipelines by quality, and those in between that give the least error for each second.

    reference_s : what the references of those in between may take"""
    qualities = [
        {n: level_named(work.stages[n].levels, quality) for n in work.usual}
        for quality in QUALITIES
    ]
    named: dict[tuple[str, ...], Row] = {}
    for quality, levels in zip(QUALITIES, qualities, strict=True):
        named.setdefault(
            tuple(levels.values()), Row("pipeline", quality, "", levels=levels)
        )
    own = {n: getattr(work.stages[n].params, "formula", "") for n in work.usual}
    rows = list(named.values())
    for sample, r in itertools.product(work.samples, rows):
        work.image(sample.index, r.levels)
    for levels in level_sets(
        [r for r in work.found.effects if r.formula == own[r.name]], work.usual
    ):
        seconds = sum(
            _pictures_s(work, work.frame(s.index, levels), [levels]) for s in work.samples
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
    there = PreparedStages(work.job.scene, {**work.stages, **other})
    usual = _levels(there, work.usual)
    row = Row(
        "pipeline",
        "usual",
        next(s.params.formula for s in other.values()),
        levels=usual,
        prepared=there,
    )
    _compare(work, [row], work.best)
    timed = [
        work.other_s.get(name) or work.times.of((name, level))
        for name, level in work.usual.items()
    ]
    row.time = sum_independent(p for p in timed if p is not None)
    return [row]
