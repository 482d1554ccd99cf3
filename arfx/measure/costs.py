"""The price list of this machine: every stage and level timed on small standard scenes,
fitted, kept in the cache folder.

As in a job, as many threads as it would render with do the same work at once, so that what
they take from each other is in the price. Coefficients by non-negative least squares on
relative errors (scipy nnls): more work never costs less.
Cost: `arfx bench --calibrate` takes under a minute on a quiet machine."""

import itertools
import json
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray
from scipy.optimize import nnls

from arfx.core.cost import UNCALIBRATED, Price, Prices, prices_file, shipped_prices
from arfx.core.cube import CubeMap, face_directions
from arfx.core.facts import FrameFacts
from arfx.core.light import DirectionalLight, Light
from arfx.core.model import Model, Texture
from arfx.core.numerics import normalise
from arfx.core.stage import Stage
from arfx.core.waiting import Progress
from arfx.measure.bench import Cell, check, make_cells
from arfx.measure.bench_scene import BenchScene, ball, bench_scene
from arfx.measure.costs_output import time_output
from arfx.measure.timing import Runs, Stopwatch
from arfx.run.folder import write
from arfx.run.job import MOST_THREADS, worker_count
from arfx.stages import ON_DEPTH, STAGES

SCENES = Path(__file__).with_suffix(".toml")
LIMIT_S = 55.0
PREPARE_S = (
    1.0  # of one level: preparing it again and again would take all the time there is
)
SHORT_RUN_S, LONG_RUN_S = (
    0.01,
    0.1,
)  # a shorter run times the clock and the interpreter; a longer one is made once
ENVIRONMENT_SIZE = 16
LEAST_SPREAD = 0.12  # a shared machine never keeps its speed better than this


def fit(runs: Runs, terms: Iterable[str]) -> Price:
    """Coefficients >= 0 of the terms that make the relative errors smallest.

    The spread is that of log(measured / fitted), or of each scene from a fit to the others
    where that is more, and at least LEAST_SPREAD; a fit to few runs gets more."""
    names = [t for t in terms if any(row.get(t, 0.0) > 0 for row in runs.terms)]
    if not names:
        raise ValueError("nothing to fit")
    if len(runs.seconds) <= len(names) and "mpx" in names:
        # too few to tell terms apart: by pixels, and what is there or not
        names = [
            t for t in names if t in ("mpx", "depth_mpx") or t.startswith("new_")
        ]
    rows = np.array([[row.get(t, 0.0) for t in names] for row in runs.terms], float)
    measured = np.array(runs.seconds)
    found = _coefficients(rows, measured)
    fitted = np.maximum(rows @ found, 1e-9)
    free = max(len(measured) - int((found > 0).sum()), 1)
    deviation = np.sqrt((np.log(measured / fitted) ** 2).sum() / free)
    spread = max(deviation, LEAST_SPREAD) * (1 + 1.0 / free)
    return Price(
        {t: float(c) for t, c in zip(names, found, strict=True) if c > 0},
        float(min(max(spread, _cross_validation_error(rows, measured)), 1.0)),
        len(measured),
    )


def _coefficients(rows: ndarray, measured: ndarray) -> ndarray:
    """Two rounds: outliers of a busy machine, mostly upwards, get less weight in the second."""
    relative, ones = rows / measured[:, None], np.ones(len(measured))
    off = np.abs(1 - relative @ nnls(relative, ones)[0])
    usual = max(float(np.median(off)), 0.02)
    weight = np.minimum(1.0, 2 * usual / np.maximum(off, 1e-9)) ** 0.5
    return np.asarray(nnls(relative * weight[:, None], weight)[0])


def _cross_validation_error(rows: ndarray, measured: ndarray) -> float:
    """Root mean square of log(measured / predicted) of each scene from a fit to the others;
    0 for fewer than three scenes.
    """
    scenes = np.unique(rows.round(9), axis=0)
    off = [0.0]
    for scene in scenes if len(scenes) > 2 else ():
        out = (rows.round(9) == scene).all(1)
        fitted = np.maximum(
            rows[out] @ _coefficients(rows[~out], measured[~out]), 1e-9
        )
        off.append(float(np.clip(np.log(measured[out] / fitted), -1, 1).mean()))
    return float(np.linalg.norm(off)) / len(scenes) ** 0.5


def calibrate(
    progress: Progress = lambda *_: None,
    limit_s: float = LIMIT_S,
    processor: bool = False,
    stage: str | None = None,
) -> Prices:
    """Time, fit, and return the price list; nothing is written. Raises ConfigError for an
    unknown stage.

    stage : only this one, and nothing that is not a stage's
    limit_s : after this the remaining scenes are skipped (what has runs is fitted)
    processor : as of `Stopwatch`
    """
    check(stage, None, ())
    workers, threads = worker_count(1)
    concurrency = min(workers, MOST_THREADS) if threads else 1
    began = time.perf_counter()
    timed: dict[str, Runs] = defaultdict(Runs)
    alone: list[float] = []
    with ThreadPoolExecutor(concurrency) as pool:
        watch = Stopwatch(processor, pool, concurrency)
        if stage is None:
            time_output(timed, watch, partial(progress, "calibrate output"))
        scenes = tomllib.loads(SCENES.read_text(encoding="utf-8"))["scene"]
        for k, scene in enumerate(scenes):
            if time.perf_counter() - began > limit_s:
                break
            model = SHAPES[scene["shape"]](*scene["triangles"])
            width, height = scene["size"]
            at = bench_scene(width, height, scene["covered"], model)
            at = at.with_depth() if scene["deep"] else at
            alone += _time_scene(at, scene["slow"], stage, timed, watch)
            progress("calibrate scenes", k + 1, len(scenes))
    prices = {key: fit(runs, _terms_of(key)) for key, runs in timed.items()}
    for key, shipped in shipped_prices().prices.items():
        if _stage_of(key) in (STAGES if stage is None else [stage]):
            # of levels for which there was no time
            spread = max(shipped.spread, UNCALIBRATED)
            prices.setdefault(key, replace(shipped, spread=spread))
    share = float(np.clip(np.median(alone or [1.0]), 0.1, 1.0))
    source = f"measured on this machine in {time.perf_counter() - began:.0f} s"
    return Prices(prices, concurrency, source, True, share)


def _stage_of(key: str) -> str:
    """Of an entry of the price list: "dof" of "prepare dof/draft"."""
    return key.removeprefix("prepare ").partition("/")[0]


def _terms_of(key: str) -> Collection[str]:
    """Of an entry of the price list."""
    if key.startswith("prepare "):
        return "frames", "mfaces"
    name = _stage_of(key)
    stage = STAGES.get(name, Stage)  # encoding and the like: the usual terms
    deep = "depth" in stage.facts and name not in ON_DEPTH
    return dict.fromkeys([*stage.terms, *["depth_mpx"] * deep])


def save_prices(prices: Prices) -> Path:
    """Keep a price list for the next jobs on this machine.

    Returns where. Raises RenderError where it cannot be written.
    """
    path = prices_file()
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, json.dumps(prices.to_json(), indent=1))
    return path


def _time_scene(
    at: BenchScene,
    slow: bool,
    stage: str | None,
    timed: dict[str, Runs],
    watch: Stopwatch,
) -> list[float]:
    """slow : the levels `reference` alone, once;  otherwise all others, the cheap ones
    twice, and under a light that changes

    Returns what one thread alone took, as a fraction of what it took among others: of the
    runs that are long enough."""
    alone: list[float] = []
    for cell in make_cells(at, stage, None):
        levels, key = cell.stage.levels, f"{cell.stage.name}/{cell.level}"
        if (len(levels) > 1 and cell.level == levels[-1]) != slow:
            continue
        prepared, runs = timed[f"prepare {key}"], timed[key]
        if slow and len({terms["mpx"] for terms in runs.terms}) > 1:
            continue
        if sum(prepared.seconds) < PREPARE_S:
            prepare = partial(cell.frame.prepared.at, cell.stage, cell.level)
            prepared.add(cell.terms(), watch.of(prepare))
        once = [term for term in cell.stage.terms if term.startswith("new_")]
        if not slow:
            alone += _time_fast(cell, at, once, runs, watch)
            continue
        # seconds long: what loading it takes hardly shows
        for new in [once, []] if once else [[]]:
            runs.add(
                {**cell.terms(), **dict.fromkeys(new, 1.0)}, watch.of(cell.render)
            )
    return alone


def _time_fast(
    cell: Cell, at: BenchScene, once: Sequence[str], runs: Runs, watch: Stopwatch
) -> list[float]:
    """once : terms of what is done once for a new light. Returns as `_time_scene`."""
    terms, alone, facts_under = cell.terms(), list[float](), _measured_light(at)

    def render() -> None:
        cell.render(facts_under(at.scene.light))

    render()  # compiles, loads, makes what is kept for this light
    runs.add(terms, watch.of_concurrent(render))
    if runs.seconds[-1] < LONG_RUN_S:
        runs.add(terms, watch.of_concurrent(render))
    if SHORT_RUN_S < runs.seconds[-1] < LONG_RUN_S:
        alone.append(watch.of(render) / runs.seconds[-1])
    ambient = facts_under(Light((0.5, 0.5, 0.5), ()))
    fewer = cell.terms(ambient)
    if any(fewer[t] != terms[t] for t in cell.stage.terms if t not in once):
        cell.render(ambient)
        runs.add(fewer, watch.of_concurrent(partial(cell.render, ambient)))
    for term in once:
        new = facts_under(_new_light(len(runs.seconds)))
        seconds = watch.of_concurrent(partial(cell.render, new))
        runs.add({**terms, term: 1.0}, seconds)
    return alone


def sphere_cluster(longitudes: int, latitudes: int) -> Model:
    """Nine small balls, each a part of its own, with as many triangles as one large:
    outlines cost more than insides.
    """
    whole = ball(longitudes, latitudes)
    (one,) = ball(max(longitudes // 3, 8), max(latitudes // 3, 6)).parts
    rows, columns = np.indices((3, 3)).reshape(2, -1) - 1
    positions = 0.35 * np.stack([rows, columns, 0.3 * abs(rows * columns)], -1)
    parts = tuple(replace(one, vertices=one.vertices * 0.33 + at) for at in positions)
    return Model(parts, up=whole.up, source="benchmark pile")


def textured_ball(longitudes: int, latitudes: int) -> Model:
    """A ball with a texture for each property of its material, as a scanned thing has."""
    (one,) = ball(longitudes, latitudes).parts
    noise = np.random.default_rng(7).integers(0, 256, (512, 512, 4), np.uint8)
    noise[..., 3] = 255
    texture = Texture(noise)
    # along the picture's rows, to the east
    east = np.stack(
        [-one.normals[:, 1], one.normals[:, 0], np.zeros(len(one.normals))], -1
    )
    tangents = np.column_stack([normalise(east), np.ones(len(east))])
    names = ("base", "metallic_roughness", "emissive", "normal", "occlusion")
    textures: dict[str, Any] = {f"{name}_texture": texture for name in names}
    material = replace(one.material, **textures)
    part = replace(one, material=material, tangents=tangents)
    return Model((part,), up="z", source="benchmark ball with textures")


SHAPES = {"ball": ball, "pile": sphere_cluster, "textured": textured_ball}


def _new_light(number: int) -> Light:
    """One that was not met before: every number another."""
    turn = 0.3 + 0.17 * number
    towards = float(np.cos(turn)), float(np.sin(turn)), 1.3
    lamp = DirectionalLight(towards, (0.6 + turn / 50, 0.6, 0.5), 4.0)
    return Light((0.4, 0.4, 0.4 + turn / 90), (lamp,))


def _measured_light(at: BenchScene) -> Callable[[Light], FrameFacts]:
    """The scene's facts under a light, with surroundings as from an analysis. The light is never
    quite the same, as a measured one: what is kept for a light in steps is kept, what is
    made for the very light is made every time."""
    up = face_directions(ENVIRONMENT_SIZE)[..., 2:].clip(0)
    sky = up * np.array([0.5, 0.55, 0.6]) + 0.2
    environment = CubeMap.of(sky, None, np.full(3, 0.3))
    count = itertools.count()  # threads ask for the next at once

    def facts(light: Light) -> FrameFacts:
        red, green, blue = light.ambient_rgb
        ambient = (red * (1 + 1e-6 * next(count)), green, blue)
        perturbed = replace(light, ambient_rgb=ambient)
        return at.facts.with_(light=perturbed, environment=environment)

    return facts
