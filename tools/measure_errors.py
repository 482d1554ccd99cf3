"""Measures the errors of all levels that arfx ships (arfx/plan/default_errors.json), on
every sample scene and on real clips.

    python tools/measure_errors.py -o out/errors            # measures what the folder does
    not hold yet, then the table and plots
    python tools/measure_errors.py -o out/errors --write    # and writes default_errors.json

Every effect is measured on every clip: those that a scene does not name are switched on,
each beside light and shadow alone. Some scenes get a measured depth, so that what needs it
is not measured on one alone. Errors are those of `arfx tradeoff`; processor times too. The
folder gets one file a clip, table.md and hulls.png; a clip is measured anew when its file
is removed, or a stage of it with --stage. Scenes with a printed formula are left out: it
has one level."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # as `arfx` does, before numpy reads it

import numpy as np

if TYPE_CHECKING:
    from arfx.run.planned import Job

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
CLIPS, DUCK = DATA / "marker_clips", DATA / "models" / "mikedh-trimesh" / "Duck.glb"
REAL: dict[str, dict[str, Any]] = {
    "fieldvideo_long": {
        "input": {
            "clip": CLIPS / "wpilibsuite-allwpilib" / "fieldvideo_long.mp4", "end": "1s",
            "camera": CLIPS / "wpilibsuite-allwpilib" / "camera.json",
        },
        "marker": [{"spec": "36h11:3:165.1mm"}, {"spec": "36h11:4:165.1mm"}], "model": {"file": DUCK, "fit": "15cm"},
    },
    "aruco_tag": {
        "input": {"clip": CLIPS / "SciKit-Surgery-snappysonic" / "aruco_tag.avi"}, "marker": [{"spec": "4X4_50:0:5cm"}],
        "model": {"file": DUCK, "fit": "5cm"},
    },
}  # fmt: skip
WITH_DEPTH = ("0001-orbit", "0003-several-tilted-markers", "0903-partial-occlusion")
NOISE, HOLES, EDGE_PX = 0.004, 0.03, 1  # of that depth, as of scene 0022's
APERTURE = (
    1 / 30
)  # of the picture's width, where a clip does not say how large its blur is
SHIPPED = ROOT / "arfx" / "plan" / "default_errors.json"
SAMPLES = 256  # paths a pixel of gi's reference: the noise of 64 is 2 levels on white
WINDOW_PX = 8000  # of the pictures that are compared
FEWEST_PX = 200  # that an effect must touch to be counted
LEAST_ERROR = 0.02  # grey levels, of an effect's cheapest level, to be counted
NINE_IN_TEN = (5, 95)  # percentiles
STEP, HALF = 1.6, 0.5  # a step up costs so many times, or leaves so much of the error


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "errors")
    parser.add_argument(
        "--frames", type=int, default=2, help="how many stand for a clip"
    )
    parser.add_argument(
        "--window-px",
        type=int,
        default=WINDOW_PX,
        help="area of the pictures that are compared, about the object's middle",
    )
    parser.add_argument("--workers", type=int, default=2, help="clips at once")
    parser.add_argument(
        "--stage",
        action="append",
        metavar="S",
        help="measure this stage alone; others stay as they were",
    )
    parser.add_argument(
        "--clip",
        action="append",
        metavar="NAME",
        help="only clips whose name begins so",
    )
    parser.add_argument(
        "--write", action="store_true", help="write arfx/plan/default_errors.json"
    )
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    scenes = [
        p.parent.name for p in sorted((ROOT / "sample_scenes").glob("*/scene.toml"))
    ]
    names = [
        *scenes,
        *(n for n, job in REAL.items() if job["input"]["clip"].is_file()),
    ]
    began = time.perf_counter()
    with ProcessPoolExecutor(
        given.workers, get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        asked = [n for n in names if n.startswith(tuple(given.clip or [""]))]
        waiting = [
            n
            for n in asked
            if given.stage or not (given.output / f"{n}.json").is_file()
        ]
        futures = {
            pool.submit(
                measure_clip,
                n,
                given.output,
                given.frames,
                given.window_px,
                given.stage,
            ): n
            for n in waiting
        }
        for future in as_completed(futures):
            print(
                f"{futures[future]}: {future.result()},"
                f" {time.perf_counter() - began:.0f} s",
                flush=True,
            )
    found = {
        n: json.loads(p.read_text())
        for n in names
        if (p := given.output / f"{n}.json").is_file()
    }
    stages = in_order(found)
    (given.output / "table.md").write_text(table(found, stages), encoding="utf-8")
    plot(found, stages, given.output / "hulls.png")
    if given.write:
        shipped, now = (
            json.loads(SHIPPED.read_text(encoding="utf-8")),
            document(found, stages, given.frames),
        )
        now |= {key: {**shipped[key], **now[key]} for key in ("errors", "clips")}
        SHIPPED.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    print(table(found, stages).partition("\n\n##")[0])
    return 0


def measure_clip(
    name: str, folder: Path, frames: int, window_px: int, stages: Sequence[str] | None
) -> str:
    """Writes folder/NAME.json: stage -> level -> {error, seconds}. Returns what was done,
    in words.
    """
    from arfx.errors import NothingToDoError
    from arfx.papers import PAPER
    from arfx.run.worker import keep_memory
    from arfx.stages import ALWAYS

    keep_memory()
    job = planned(name, folder)
    if any(getattr(s.params, "formula", "") == PAPER for s in job.stages.values()):
        return "a printed formula, left out"
    file = folder / f"{name}.json"
    rows = json.loads(file.read_text()) if file.is_file() else {}
    usual = [n for n in job.stages if n in ALWAYS]
    for effects in (usual, *([n] for n in job.stages if n not in usual)):
        wanted = [
            n
            for n in effects
            if len(job.stages[n].levels) > 1 and n in (stages or effects)
        ]
        for stage in wanted:
            rows.pop(stage, None)
        try:
            rows |= (
                measured(job, [*usual, *effects], wanted, frames, window_px)
                if wanted
                else {}
            )
        except NothingToDoError:
            continue
    file.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return (
        f"{', '.join(rows) or 'nothing'} measured, {time.process_time():.0f} s of the"
        " processor"
    )


def measured(
    job: Job, names: Sequence[str], wanted: Sequence[str], frames: int, window_px: int
) -> dict[str, Any]:
    """Of the `wanted` stages, in a job of the stages `names`."""
    from arfx.core.stage import level_named
    from arfx.measure.tradeoff import LEFT_OUT, measure
    from arfx.plan.planner import plan_frame
    from arfx.run.parameters import stages_of

    stages = stages_of(
        job.inputs.config.params, [n for n in job.stages if n in names]
    )  # some set others' settings
    levels = {n: level_named(s.levels, "standard") for n, s in stages.items()}
    rect = job.inputs.camera.rect
    plans = [
        plan_frame(list(stages.values()), levels, f, job.scene, rect)
        for f in job.facts
    ]
    part = replace(job, stages=stages, plan=replace(job.plan, frames=plans))
    found = measure(part, frames, lambda *_: None, wanted, window_px)
    rows: dict[str, Any] = {}
    for r in found.effects:
        if (
            r.level != LEFT_OUT
            and sum(d.pixels for d in r.by_frame.values()) >= FEWEST_PX
        ):
            rows.setdefault(r.name, {})[r.level] = {
                "error": r.average("mean"),
                "seconds": r.seconds,
            }
    return {
        name: of
        for name, of in rows.items()
        if max(row["error"] for row in of.values()) >= LEAST_ERROR
    }


def planned(name: str, folder: Path) -> Job:
    """The clip's job with every effect, up to its plan."""
    from arfx.config.load import load
    from arfx.media.clip import probe
    from arfx.run.folder import JobFolder
    from arfx.run.inputs import open_inputs
    from arfx.run.job import Options, plan_job
    from arfx.run.parameters import parameters
    from arfx.stages import ALWAYS, STAGES
    from arfx.synth.clip import make_clip
    from arfx.synth.description import DepthInput, load_scene

    made = folder / "clips" / name
    more: dict[str, Any] = {"output": {"path": str(folder / "none.mkv")}}
    if name in REAL:
        made.mkdir(parents=True, exist_ok=True)
        files, more, clip = None, {**REAL[name], **more}, REAL[name]["input"]["clip"]
    else:
        files, clip = made / "job.toml", made / "clip.mp4"
        if not files.is_file():
            folder_of_scene = ROOT / "sample_scenes" / name
            scene = load_scene(folder_of_scene / "scene.toml")
            if name in WITH_DEPTH:
                depth = DepthInput(
                    file="depth.mkv", noise=NOISE, holes=HOLES, edge_px=EDGE_PX
                )
                scene = scene.model_copy(update={"depth": depth})
            make_clip(scene, made, overwrite=True, truth_pictures=False)
    own = {} if files is None else tomllib.loads(files.read_text(encoding="utf-8"))
    more["pipeline"] = {
        "stages": [n for n in STAGES if n not in ALWAYS],
        "quality": "standard",
    }
    more["gi"] = {**own.get("gi", {}), "samples": SAMPLES}
    if "dof" not in own:
        more["dof"] = {"aperture_px": probe(clip).width * APERTURE}
    inputs = open_inputs(load(files, more, parameters()))
    work = JobFolder(made / "job")
    work.open(resume=False)
    return plan_job(
        inputs, work, Options(progress=lambda *_: None, notice=lambda _: None)
    )


Found = Mapping[
    str, Mapping[str, Mapping[str, Mapping[str, float]]]
]  # clip, stage, level, {error, seconds}


def in_order(found: Found) -> dict[str, list[str]]:
    """Levels of each stage that was measured, cheapest first."""
    from arfx.stages import STAGES

    return {
        n: list(s.levels)
        for n, s in STAGES.items()
        if any(n in of for of in found.values())
    }


def spread(values: Sequence[float]) -> dict[str, float]:
    low, high = np.percentile(values, NINE_IN_TEN)
    return {
        "low": round(float(low), 4),
        "mean": round(float(np.mean(values)), 4),
        "high": round(float(high), 4),
    }


def document(
    found: Found, stages: Mapping[str, Sequence[str]], frames: int
) -> dict[str, Any]:
    """errors : stage -> level -> {low, mean, high} over the clips;  clips : what was found
    on each, for the tests
    """
    errors, clips = {}, {}
    for stage, levels in stages.items():
        shown = {n: of[stage] for n, of in found.items() if stage in of}
        errors[stage] = {
            level: spread([of[level]["error"] for of in shown.values()])
            for level in levels[:-1]
        }
        clips[stage] = {
            n: [round(of[level]["error"], 4) for level in levels[:-1]]
            for n, of in shown.items()
        }
    scenes = sum(n not in REAL for n in found)
    source = (
        f"shipped table: upper ends over {scenes} sample scenes and {len(found) - scenes}"
        f" real clips, {frames} frames each"
    )
    return {"source": source, "errors": errors, "clips": clips}


def faults(
    rows: Mapping[str, Mapping[str, float]], levels: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """(level, what is wrong with the step up to it) for the levels below the reference."""
    for a, b in pairwise(levels[:-1]):
        seconds, (less, more) = (
            rows[b]["seconds"] / rows[a]["seconds"],
            (rows[b]["error"], rows[a]["error"]),
        )
        if less >= more or seconds <= 1 or (seconds < STEP and less > HALF * more):
            yield b, f"time x {seconds:.2f}, error {more:.3g} to {less:.3g}"


def table(found: Found, stages: Mapping[str, Sequence[str]]) -> str:
    """Markdown: the levels over all clips, then every clip; steps that are none are marked."""
    lines = [
        "| stage | level | clips | error: mean (nine in ten between) | ms a frame, median |"
        " steps up that are none |"
    ]
    lines.append("|---|---|---|---|---|---|")
    bad = {
        (n, s): dict(faults(of[s], levels))
        for s, levels in stages.items()
        for n, of in found.items()
        if s in of
    }
    for stage, levels in stages.items():
        shown = {n: of[stage] for n, of in found.items() if stage in of}
        for level in levels:
            e = spread([of[level]["error"] for of in shown.values()])
            ms = 1e3 * float(
                np.median([of[level]["seconds"] for of in shown.values()])
            )
            count = sum(level in bad[n, stage] for n in shown)
            error = f"{e['mean']:.2f} ({e['low']:.2f} to {e['high']:.2f})"
            lines.append(
                f"| {stage} | {level} | {len(shown)} | {error} | {ms:.3g} | {count or ''} |"
            )
    for stage, levels in stages.items():
        lines += [
            "",
            f"## {stage}: error, ms a frame",
            "",
            f"| clip | {' | '.join(levels[:-1])} | not a step |",
        ]
        lines.append("|---" * (len(levels) + 1) + "|")
        for n, of in found.items():
            if stage in of:
                cells = (
                    f"{of[stage][level]['error']:.3f},"
                    f" {1e3 * of[stage][level]['seconds']:.3g}"
                    for level in levels[:-1]
                )
                what = "; ".join(
                    f"{level}: {why}" for level, why in bad[n, stage].items()
                )
                lines.append(f"| {n} | {' | '.join(cells)} | {what} |")
    return "\n".join(lines) + "\n"


def plot(found: Found, stages: Mapping[str, Sequence[str]], file: Path) -> None:
    """Time and error of every level on every clip, and the lower convex hull of the levels'
    medians and means.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatter

    from arfx.core.cost import measured
    from arfx.plan.levels import Option, convex_hull

    across = 2
    figure = Figure(
        figsize=(11, 3.4 * -(-len(stages) // across)), layout="constrained"
    )
    axes = figure.subplots(-(-len(stages) // across), across, squeeze=False).ravel()
    for axis, (stage, levels) in zip(axes, stages.items(), strict=False):
        shown = [of[stage] for of in found.values() if stage in of]
        for of in shown:
            axis.plot(
                *zip(
                    *((1e3 * of[x]["seconds"], of[x]["error"]) for x in levels[:-1]),
                    strict=True,
                ),
                lw=0.5,
                color="#bbb",
            )
        options = [
            Option(
                x,
                measured(float(np.median([of[x]["seconds"] for of in shown]))),
                np.mean([of[x]["error"] for of in shown]),
                1,
            )
            for x in levels
        ]
        hull = [o for o in convex_hull(options) if o.error > 0]
        axis.plot(
            [1e3 * o.cost.seconds for o in hull],
            [o.error for o in hull],
            "-",
            color="#06c",
            label="lower convex hull",
        )
        for o, level in zip(options, levels, strict=True):
            if o.error > 0:
                axis.plot(
                    1e3 * o.cost.seconds,
                    o.error,
                    "o",
                    color="#06c" if o in hull else "#b04",
                    ms=6,
                )
                axis.annotate(
                    level,
                    (1e3 * o.cost.seconds, o.error),
                    (5, 5),
                    textcoords="offset points",
                    fontsize=8,
                )
        axis.set(
            xscale="log", yscale="log", xlabel="ms a frame", ylabel="grey levels"
        )
        for along in (axis.xaxis, axis.yaxis):
            along.set_major_formatter("{x:g}")
            along.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
        axis.tick_params(which="both", labelsize=7)
        axis.set_title(
            f"{stage}: clips (grey), medians and means (points)",
            fontsize=9,
            loc="left",
        )
        axis.legend(fontsize=7, frameon=False)
    for axis in axes[len(stages) :]:
        axis.set_axis_off()
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
