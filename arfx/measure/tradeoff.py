"""What accuracy costs on one clip: every level of every effect against its reference, and whole pipelines.

Frames that stand for the clip are rendered: each effect at each of its levels while the others stay at their usual one, and
whole pipelines on the way from the reference down to the cheapest. Errors are grey levels and FLIP over the pixels that the
effect touches; the clip's light, poses and plan are those of the job. Cost: the references; their window is made so small
that they take about REFERENCE_S together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.plan import FramePlan
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Stage, level_named
from arfx.errors import NothingToDoError
from arfx.measure.difference import Difference, difference, touched, unrest
from arfx.measure.tradeoff_frames import Sample, pick_frames
from arfx.measure.tradeoff_render import Chain, FrameBench, Shop, chain_of, window_of
from arfx.media.frames import ClipReader
from arfx.run.job import Planned
from arfx.run.parameters import make_stages

QUALITIES = ("draft", "standard", "high", "reference")
REFERENCE_S, PROBE_PX = 25.0, 1500
Progress = Callable[[str, int, int | None], None]


@dataclass
class Row:
    """One level of one effect, or one whole pipeline. seconds : per frame, median;  by_frame : what was found in each

    formula : which the stage ran under;  unrest : of this and of the reference, grey levels from a frame to the next
    """

    name: str
    level: str
    formula: str
    seconds: float = 0.0
    by_frame: dict[int, Difference] = field(default_factory=dict)
    unrest: tuple[float, float] | None = None
    pictures: dict[int, np.ndarray] = field(default_factory=dict)
    levels: Mapping[str, str] = field(default_factory=dict)

    def worst(self, what: str) -> float:
        return max((getattr(d, what) for d in self.by_frame.values()), default=0.0)

    def average(self, what: str) -> float:
        """Over all touched pixels of all frames; frames in which the effect touches nothing do not count."""
        weights = [d.pixels for d in self.by_frame.values()]
        if not sum(weights):
            return 0.0
        return float(np.average([getattr(d, what) for d in self.by_frame.values()], weights=weights))

    def worst_frame(self) -> int | None:
        return max(self.by_frame, key=lambda i: self.by_frame[i].p99, default=None)


@dataclass
class Found:
    """samples : the frames;  effects, pipelines : rows;  windows : where the references were rendered, by frame"""

    samples: list[Sample]
    effects: list[Row]
    pipelines: list[Row]
    windows: dict[int, Any]
    places: dict[tuple[str, str], str] = field(default_factory=dict)
    prepare_s: dict[tuple[str, str], float] = field(default_factory=dict)
    spent_s: dict[str, float] = field(default_factory=dict)


def measure(planned: Planned, frames: int, progress: Progress) -> Found:
    """planned : the job, up to its plan. Raises NothingToDoError where no frame shows the object."""
    stages = make_stages(planned.inputs.config)
    camera = planned.inputs.camera.rect
    samples = pick_frames(planned.facts, camera, frames)
    plans = {p.index: p for p in planned.plans}
    samples = [s for s in samples if plans[s.index].steps]
    if not samples:
        raise NothingToDoError("no frame of the clip shows the object: there is nothing to measure", "see `arfx plan`")
    first = samples[0].index
    following = first + 1 if first + 1 in plans and _same_steps(plans, first) else None
    wanted = [s.index for s in samples] + ([] if following is None else [following])
    plates = _plates(planned, wanted)
    facts = {f.index: f for f in planned.facts}
    shop = Shop(planned.scene, stages)
    slow = frozenset((n, s.levels[-1].name) for n, s in stages.items() if s.levels[-1].name == "reference" and _dear(s))
    probe = FrameBench(facts[first], plates[first], plans[first], EMPTY, shop, slow)
    area = _window_px(probe, len(wanted), camera)
    benches = {
        i: FrameBench(facts[i], plates[i], plans[i], window_of(plans[i], facts[i], camera, area), shop, slow) for i in wanted
    }
    if following is not None:
        benches[following].window = benches[first].window
    names = [s.stage for s in plans[first].steps]
    usual = {n: level_named(stages[n].levels, planned.inputs.config.pipeline.quality).name for n in names}
    best = {n: stages[n].levels[-1].name for n in names}
    found = Found(samples, [], [], {i: b.window for i, b in benches.items()})
    effects = [n for n in names if len(stages[n].levels) > 1]
    total = len(effects) + len(QUALITIES) + 2
    for k, name in enumerate(effects):
        progress("effects", k, total)
        found.effects += _of_stage(name, stages[name], usual, benches, samples, following, found)
    found.effects += _other_formulas(planned, effects, usual, benches, samples, shop)
    progress("pipelines", len(effects), total)
    found.pipelines = _whole(stages, usual, best, benches, samples, found)
    found.pipelines += _other_pipeline(planned, usual, best, benches, samples)
    found.prepare_s, found.spent_s = shop.prepare_s, shop.spent_s
    progress("pipelines", total, total)
    return found


def _same_steps(plans: Mapping[int, FramePlan], index: int) -> bool:
    return [s.stage for s in plans[index].steps] == [s.stage for s in plans[index + 1].steps]


def _dear(stage: Stage) -> bool:
    return stage.levels[-1].seconds_per_mpx > 2.0


def _window_px(probe: FrameBench, frames: int, camera: Rect) -> float:
    """Pixels in which all references of all frames take about REFERENCE_S, each run twice; from a few pixels of one frame."""
    probe.window = window_of(probe.plan, probe.facts, camera, PROBE_PX)
    best = {n: s.levels[-1].name for n, s in probe.shop.stages.items()}
    probe.image(chain_of(probe.plan, best))
    areas = {s.stage: s.out.area for s in probe.plan.steps}
    price = sum(s / areas[name] for (name, level), s in probe.seconds.items() if (name, level) in probe.slow)
    return max(REFERENCE_S / max(2 * frames * price, 1e-9), PROBE_PX)


def _plates(planned: Planned, wanted: Sequence[int]) -> dict[int, np.ndarray]:
    """Linear light of whole frames, by frame."""
    pts = [planned.meta["pts"][i] for i in wanted]
    out = {}
    with ClipReader(planned.inputs.info) as reader:
        for frame in reader.frames(min(pts), max(pts)):
            if frame.pts in pts:
                out[wanted[pts.index(frame.pts)]] = frame.linear(planned.inputs.camera.rect)
    return out


def _of_stage(
    name: str,
    stage: Stage,
    usual: Mapping[str, str],
    benches: Mapping[int, FrameBench],
    samples: Sequence[Sample],
    following: int | None,
    found: Found,
) -> list[Row]:
    """A row for each level, the reference's too, against the reference with all other stages at their usual level."""
    best = stage.levels[-1].name
    rows = [Row(name, le.name, getattr(stage.params, "formula", ""), levels={**usual, name: le.name}) for le in stage.levels]
    for sample in samples:
        b = benches[sample.index]
        if name not in [s.stage for s in b.plan.steps]:
            continue
        chains = {r.level: chain_of(b.plan, r.levels) for r in rows}
        images = {level: b.image(chain) for level, chain in chains.items()}
        without = b.image(chain_of(b.plan, usual, (name,)))
        where = touched((images[best], without), *((images[best], images[le]) for le in images))
        for r in rows:
            r.by_frame[sample.index] = difference(images[best], images[r.level], where)
            r.pictures[sample.index] = images[r.level]
        worst = max((r for r in rows if r.level != best), key=lambda r: r.by_frame[sample.index].p99, default=None)
        if worst is not None:
            found.places.setdefault((name, worst.level), _place(worst.by_frame[sample.index], b.coverage(chains[best])))
    for r in rows:
        timed = [b.seconds[name, r.level] for b in benches.values() if (name, r.level) in b.seconds]
        r.seconds = float(np.median(timed)) if timed else 0.0
    if following is not None:
        _unrest(rows, best, benches[following - 1], benches[following])
    return rows


def _unrest(rows: Sequence[Row], best: str, first: FrameBench, second: FrameBench) -> None:
    """How much each level changes from one frame to the next beyond the footage's own motion, beside its reference."""
    if first.plan.index not in rows[0].pictures:
        return
    pairs = {r.level: (first.image(chain_of(first.plan, r.levels)), second.image(chain_of(second.plan, r.levels))) for r in rows}
    where = touched((pairs[best][0], first.original()))
    values = {level: unrest(a, b, first.original(), second.original(), where) for level, (a, b) in pairs.items()}
    for r in rows:
        r.unrest = (values[r.level], values[best])


def _place(d: Difference, coverage: np.ndarray) -> str:
    """Where a difference is largest, in words."""
    import cv2

    x, y = d.worst_px
    edge = np.asarray((coverage > 0.02) & (coverage < 0.98)).astype(np.uint8)
    if cv2.dilate(edge, np.ones((5, 5), np.uint8))[y, x]:
        return "at the silhouette"
    return "on the object" if coverage[y, x] > 0.5 else "beside the object"


def _other_formulas(
    planned: Planned,
    effects: Sequence[str],
    usual: Mapping[str, str],
    benches: Mapping[int, FrameBench],
    samples: Sequence[Sample],
    shop: Shop,
) -> list[Row]:
    """Each effect under the formula that the job does not use, at its usual level, against the job's own reference."""
    rows = []
    for name in effects:
        stage = shop.stages[name]
        if not hasattr(stage.params, "formula"):
            continue
        row = _formula_row(name, stage, usual, benches, samples)
        if row.by_frame:
            rows.append(row)
    return rows


def _formula_row(
    name: str, stage: Any, usual: Mapping[str, str], benches: Mapping[int, FrameBench], samples: Sequence[Sample]
) -> Row:
    other = "paper" if stage.params.formula == "corrected" else "corrected"
    best, row = stage.levels[-1].name, Row(name, usual[name], other, levels=usual)
    changed = type(stage)(replace(stage.params, formula=other))
    shop: Shop | None = None
    seconds = []
    for sample in samples:
        b = benches[sample.index]
        if name not in [s.stage for s in b.plan.steps]:
            continue
        if shop is None:
            shop = Shop(b.shop.scene, {**b.shop.stages, name: changed})
        there = FrameBench(b.facts, b.plate, b.plan, b.window, shop, b.slow)
        reference = b.image(chain_of(b.plan, {**usual, name: best}))
        image = there.image(chain_of(b.plan, usual))
        where = touched((reference, b.image(chain_of(b.plan, usual, (name,)))), (reference, image))
        row.by_frame[sample.index] = difference(reference, image, where)
        row.pictures[sample.index] = image
        seconds.append(there.seconds[name, usual[name]])
    row.seconds = float(np.median(seconds)) if seconds else 0.0
    return row


def _whole(
    stages: Mapping[str, Stage],
    usual: Mapping[str, str],
    best: Mapping[str, str],
    benches: Mapping[int, FrameBench],
    samples: Sequence[Sample],
    found: Found,
) -> list[Row]:
    """Pipelines by quality, and those in between that give the least error for each second saved."""
    wanted: dict[tuple[str, ...], tuple[str, Mapping[str, str]]] = {}
    for quality in QUALITIES:
        levels = {n: level_named(stages[n].levels, quality).name for n in usual}
        wanted.setdefault(tuple(levels.values()), (quality, levels))
    for levels in _between(usual, found.effects, best):
        wanted.setdefault(tuple(levels.values()), ("mixed", levels))
    rows = [Row("pipeline", quality, "", levels=levels) for quality, levels in wanted.values()]
    for sample in samples:
        b = benches[sample.index]
        images = {id(r): b.image(chain_of(b.plan, r.levels)) for r in rows}
        reference = b.image(chain_of(b.plan, best))
        where = touched((reference, b.original()), *((reference, i) for i in images.values()))
        for r in rows:
            r.by_frame[sample.index] = difference(reference, images[id(r)], where)
            r.pictures[sample.index] = images[id(r)]
    for r in rows:
        r.seconds = _chain_seconds(r.levels, benches, samples)
    return rows


def _chain_seconds(levels: Mapping[str, str], benches: Mapping[int, FrameBench], samples: Sequence[Sample]) -> float:
    per_frame = []
    for sample in samples:
        b = benches[sample.index]
        chain: Chain = chain_of(b.plan, levels)
        per_frame.append(sum(b.seconds.get(step, 0.0) for step in chain))
    return float(np.median(per_frame))


def _between(usual: Mapping[str, str], effects: Sequence[Row], best: Mapping[str, str]) -> list[dict[str, str]]:
    """Level sets on the way down from everything at its best but the references, by error lost per second saved."""
    from arfx.core.cost import exactly
    from arfx.plan.levels import Option, ladder

    state, moves = dict(usual), []
    for name in usual:
        options = [Option(r.level, exactly(r.seconds), r.average("mean"), 1) for r in effects if r.name == name]
        worth = ladder(options[:-1] or options) if options else []
        if not worth:
            continue
        state[name] = worth[0].level
        for a, b in zip(worth, worth[1:], strict=False):  # noqa: RUF007
            moves.append(((b.error - a.error) / max(a.cost.seconds - b.cost.seconds, 1e-9), name, b.level))
    out = [dict(state)]
    for _, name, level in sorted(moves):
        state[name] = level
        out.append(dict(state))
    return out


def _other_pipeline(
    planned: Planned,
    usual: Mapping[str, str],
    best: Mapping[str, str],
    benches: Mapping[int, FrameBench],
    samples: Sequence[Sample],
) -> list[Row]:
    """The whole pipeline with every stage under the other formula."""
    shop = next(iter(benches.values())).shop
    swapped: dict[str, Stage] = dict(shop.stages)
    other = ""
    for name, stage in shop.stages.items():
        if hasattr(stage.params, "formula"):
            other = "paper" if stage.params.formula == "corrected" else "corrected"
            swapped[name] = type(stage)(replace(stage.params, formula=other))  # type: ignore[call-arg]
    if not other:
        return []
    row, there = Row("pipeline", "usual", other, levels=usual), Shop(shop.scene, swapped)
    seconds = []
    for sample in samples:
        b = benches[sample.index]
        bench = FrameBench(b.facts, b.plate, b.plan, b.window, there, b.slow)
        image, reference = bench.image(chain_of(b.plan, usual)), b.image(chain_of(b.plan, best))
        row.by_frame[sample.index] = difference(reference, image, touched((reference, b.original()), (reference, image)))
        row.pictures[sample.index] = image
        seconds.append(sum(bench.seconds.get(step, 0.0) for step in chain_of(b.plan, usual)))
    row.seconds = float(np.median(seconds))
    return [row]


def facts_of(samples: Sequence[Sample], facts: Sequence[FrameFacts]) -> list[dict[str, Any]]:
    times = {f.index: f.time_s for f in facts}
    return [{"frame": s.index, "time_s": times[s.index], "stands_for": s.words, **s.facts} for s in samples]
