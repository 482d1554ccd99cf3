"""Is what arfx predicts true? Whole jobs on small clips, each in a process of its own, held
against their plans.

budgets      ten budgets from draft to reference on one clip: predicted and measured time,
late where that is a tenth over the
             budget, error against the reference; a plot
errors       ten --max-error limits on one clip: the error that was measured in the output
predictions  ten jobs that no price was fitted to: predicted and measured seconds, and
whether the interval held

Times of the wall are right on a machine that does nothing else. With `--clock processor`
all of arfx's times are those of the processor, which hold under load too, in jobs of one
worker. --calibrate measures a price list by that clock first and leaves it in the folder
for the next call."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # as `arfx` does, before numpy reads it

import av
import numpy as np

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "sample_scenes"
# scene, width, frames (2 to 4 s), pipeline, quality, codec: none of them is a scene or a
# size of the calibration
JOBS = (
    ("0007-studio-shallow-focus", 400, 72, "lightmap,dof", "draft", "h264"),
    ("0007-studio-shallow-focus", 560, 60, "lightmap,dof", "standard", "ffv1"),
    ("0030-watercolor", 448, 72, "lightmap,watercolor", "standard", "h264"),
    ("0041-indirect-light", 384, 54, "lightmap,gi", "standard", "h264"),
    ("0041-indirect-light", 512, 72, "lightmap,gi", "draft", "h265"),
    ("0050-only-what-is-called-for", 720, 72, "lightmap,dof", "high", "h264"),
    ("0050-only-what-is-called-for", 840, 60, "auto", "standard", "prores"),
    ("0001-orbit", 520, 72, "auto", "standard", "h264"),
    ("0021-wall-out-of-focus", 640, 48, "lightmap,gi,dof", "draft", "h264"),
    ("0030-watercolor", 320, 72, "lightmap,dof,watercolor", "high", "ffv1"),
)


@dataclass(frozen=True)
class Ran:
    """One job. predicted : {s, low_s, high_s} of all of it, None = not known;  seconds,
    after_s : measured, of all and from the
    plan on;  levels : of every shot and stage, as text"""

    output: Path
    predicted: Mapping[str, float] | None
    seconds: float
    after_s: float
    levels: str


def clip(folder: Path, scene: str, width: int, frames: int) -> Path:
    """The job file of a sample scene rendered at this size; made once."""
    from arfx.synth.clip import make_clip
    from arfx.synth.description import load_scene

    made = folder / f"{scene}-{width}-{frames}"
    if not (made / "job.toml").is_file():
        described = load_scene(SCENES / scene / "scene.toml")
        height = 2 * round(described.clip.height * width / described.clip.width / 2)
        size = described.clip.model_copy(update={"width": width, "height": height})
        first, *_ = described.shot
        shot = first.model_copy(update={"frames": frames})
        described = described.model_copy(update={"clip": size, "shot": (shot,)})
        make_clip(described, made, truth_pictures=False)
    return made / "job.toml"


def run(
    folder: Path,
    name: str,
    job: Path,
    pipeline: Mapping[str, Any],
    clock: str,
    codec: str = "ffv1",
) -> Ran:
    """One job in a process of its own."""
    suffix = ".mov" if codec == "prores" else ".mkv"
    asked: dict[str, Any] = {
        "job": str(job),
        "output": str(folder / f"{name}{suffix}"),
        "codec": codec,
        "clock": clock,
        "pipeline": dict(pipeline),
    }
    command = [
        sys.executable,
        str(Path(__file__)),
        "-o",
        str(folder),
        "one",
        json.dumps(asked),
    ]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{name}: {done.stderr.strip().splitlines()[-1:]}")
    told = json.loads(done.stdout.splitlines()[-1])
    return Ran(Path(asked["output"]), **told)


def one(asked: Mapping[str, Any]) -> dict[str, Any]:
    """What `run` runs."""
    if asked["clock"] == "processor":
        time.perf_counter = time.process_time
    from arfx.config.load import load
    from arfx.run.folder import JobFolder
    from arfx.run.job import Options, process
    from arfx.run.parameters import parameters

    marks: list[float] = []

    def progress(phase: str, *_: object) -> None:
        if phase == "render" and not marks:
            marks.append(time.perf_counter())

    output = Path(asked["output"])
    more = {
        "output": {"path": str(output), "codec": asked["codec"]},
        "pipeline": asked["pipeline"],
    }
    config = load(Path(asked["job"]), more, parameters())
    output.unlink(missing_ok=True)
    folder = JobFolder(output.with_name(output.name + ".job"))
    options = Options(
        folder.path,
        overwrite=True,
        workers=1 if asked["clock"] == "processor" else None,
        progress=progress,
        notice=lambda _: None,
    )
    report = process(config, options)
    after = time.perf_counter() - marks[0]
    summary = json.loads(folder.plan_summary.read_text(encoding="utf-8"))
    levels = {f"{row['stage']} {row['level']}" for row in summary["levels"]["chosen"]}
    return {
        "predicted": report["predicted"]["wall"], "seconds": report["timing"]["wall_s"], "after_s": after,
        "levels": ", ".join(sorted(levels)),
    }  # fmt: skip


def pictures(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as file:
        return [f.to_ndarray(format="rgb24") for f in file.decode(video=0)]


def mean_error(
    reference: Sequence[np.ndarray],
    test: Sequence[np.ndarray],
    plain: Sequence[np.ndarray],
) -> float:
    """Grey levels, over all pixels of all frames that either of the two changes or in which
    they differ.
    """
    from arfx.measure.difference import level_difference, touched

    total = count = 0.0
    for a, b, source in zip(reference, test, plain, strict=True):
        where = touched((a, source), (a, b))
        total += float(level_difference(a, b)[where].sum())
        count += int(where.sum())
    return total / max(count, 1.0)


def budgets(
    folder: Path, job: Path, pipeline: str, clock: str, count: int = 10
) -> int:
    """Print and plot. Returns how many budgets were not kept."""
    base = {"stages": pipeline.split(",")}
    for name in ("first", "reference"):  # the first may have code to compile
        best = run(folder, name, job, {**base, "quality": "reference"}, clock)
    least = run(folder, "draft", job, {**base, "quality": "draft"}, clock)
    if best.predicted is None or least.predicted is None:
        raise SystemExit("no price is known for a level: --calibrate")
    wanted, plain = pictures(best.output), pictures(job.with_name("clip.mp4"))
    # spaced by what is left after the analysis, which a budget cannot change
    before = max(r.seconds - r.after_s for r in (least, best))
    ends = (
        max(least.predicted["high_s"] - before, 0.1),
        max(best.predicted["high_s"] - before, 0.2),
    )
    rows, bad = [], 0
    print(
        "| asked, s | predicted | taken | error | levels | |\n|---|---|---|---|---|---|"
    )
    for k, budget in enumerate(
        before + np.geomspace(1.02 * ends[0], 1.1 * ends[1], count)
    ):
        ran = run(
            folder, f"budget-{k}", job, {**base, "budget": f"{budget:.3f}s"}, clock
        )
        error = mean_error(wanted, pictures(ran.output), plain)
        late = ran.seconds > 1.1 * budget
        bad += late
        rows.append((float(budget), ran, error))
        print(
            f"| {budget:.2f} | {_told(ran)} | {error:.2f} | {ran.levels} |"
            f" {'late' if late else 'kept'} |",
            flush=True,
        )
    _plot(folder / "budgets.png", rows)
    return bad


def errors(
    folder: Path,
    job: Path,
    pipeline: str,
    tradeoff: Path | None,
    clock: str,
    count: int = 10,
) -> int:
    """Print. Returns how many limits were not kept."""
    base: dict[str, Any] = {"stages": pipeline.split(",")} | (
        {} if tradeoff is None else {"tradeoff": str(tradeoff)}
    )
    best = run(folder, "reference", job, {**base, "quality": "reference"}, clock)
    wanted, plain = pictures(best.output), pictures(job.with_name("clip.mp4"))
    bad = 0
    for k, limit in enumerate(np.geomspace(0.2, 8.0, count)):
        ran = run(
            folder, f"error-{k}", job, {**base, "max_error": float(limit)}, clock
        )
        error = mean_error(wanted, pictures(ran.output), plain)
        bad += error > limit
        verdict = "holds" if error <= limit else "BROKEN"
        print(
            f"| {limit:.2f} | {error:.2f} | {_told(ran)} | {ran.levels} | {verdict} |",
            flush=True,
        )
    return bad


def predictions(
    folder: Path,
    clock: str,
    jobs: Sequence[tuple[str, int, int, str, str, str]] = JOBS,
) -> int:
    """Print. Returns 0 where the median relative error is at most 15 % and eight in ten lie
    in their interval.
    """
    off, held, known = [], 0, 0
    for k, (scene, width, frames, pipeline, quality, codec) in enumerate(jobs):
        stages = pipeline if pipeline == "auto" else pipeline.split(",")
        ran = run(
            folder,
            f"job-{k}",
            clip(folder, scene, width, frames),
            {"stages": stages, "quality": quality},
            clock,
            codec,
        )
        told, measured = ran.predicted, ran.seconds
        name = (
            f"{scene[:4]}, {width} px, {frames} frames, {pipeline} {quality}, {codec}"
        )
        if told is None:
            print(f"| {name} | {_told(ran)} | unknown |", flush=True)
            continue
        known += 1
        held += told["low_s"] <= measured <= told["high_s"]
        off.append(abs(measured / told["s"] - 1))
        print(
            f"| {name} | {_told(ran)} | {measured / told['s'] - 1:+.0%} |", flush=True
        )
    median = float(np.median(off)) if off else np.inf
    print(f"median relative error {median:.0%}; {held} of {known} in their interval")
    return 0 if median <= 0.15 and held >= 0.8 * len(jobs) else 1


def _told(ran: Ran) -> str:
    """Two columns: predicted and measured."""
    p = ran.predicted
    return (
        "unknown"
        if p is None
        else f"{p['s']:.2f} ({p['low_s']:.2f} to {p['high_s']:.2f})"
    ) + f" | {ran.seconds:.2f}"


def _plot(path: Path, rows: Sequence[tuple[float, Ran, float]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    x = [b for b, _, _ in rows]
    left.plot(x, x, ":", color="#888", label="budget")
    left.plot(x, [r.seconds for _, r, _ in rows], "o-", ms=4, label="measured")
    left.plot(
        x,
        [(r.predicted or {}).get("high_s", np.nan) for _, r, _ in rows],
        "v--",
        ms=4,
        label="predicted, upper end",
    )
    left.set(xscale="log", yscale="log", xlabel="budget, s", ylabel="s")
    left.legend(fontsize=7, frameon=False)
    right.plot(x, [max(e, 0.01) for _, _, e in rows], "o-", ms=4, color="#b04")
    right.set(xscale="log", xlabel="budget, s", ylabel="mean error, grey levels")
    figure.savefig(path, dpi=110)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=ROOT / "out" / "prices",
        help="folder for clips, jobs and plots",
    )
    parser.add_argument(
        "--calibrate",
        action="store_true",
        help="measure the price list that the jobs then use",
    )
    parser.add_argument(
        "--clock",
        choices=("wall", "processor"),
        default="wall",
        help="what is calibrated and judged by",
    )
    parser.add_argument(
        "--scene",
        default="0022-before-and-behind",
        help="of budgets and errors; this one has measured depth",
    )
    parser.add_argument("--width", type=int, default=160)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--pipeline", default="lightmap,dof")
    parser.add_argument(
        "--tradeoff",
        type=Path,
        help="tradeoff.json of the clip, for `errors`; default the shipped table",
    )
    parser.add_argument("--only", help="numbers of JOBS, for `predictions`: 0,3")
    parser.add_argument("what", choices=("budgets", "errors", "predictions", "one"))
    parser.add_argument("asked", nargs="?", help=argparse.SUPPRESS)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    os.environ["XDG_CACHE_HOME"] = str(
        given.output.absolute() / "cache"
    )  # where the price list lies
    if given.what == "one":
        print(json.dumps(one(json.loads(given.asked)), default=float))
        return 0
    if given.calibrate:
        from arfx.measure.costs import LIMIT_S, calibrate, save_prices

        # the limit is of the wall, which other programs shorten
        processor = given.clock == "processor"
        print(
            save_prices(
                calibrate(
                    processor=processor, limit_s=300.0 if processor else LIMIT_S
                )
            ),
            flush=True,
        )
    if given.what == "predictions":
        numbers = (
            range(len(JOBS))
            if given.only is None
            else [int(n) for n in given.only.split(",")]
        )
        return predictions(given.output, given.clock, [JOBS[n] for n in numbers])
    job = clip(given.output, given.scene, given.width, given.frames)
    if given.what == "budgets":
        return budgets(given.output, job, given.pipeline, given.clock)
    return errors(given.output, job, given.pipeline, given.tradeoff, given.clock)


if __name__ == "__main__":
    sys.exit(main())
