"""The report of a job: report.json and a self-contained report.html, from a report document
or from a job folder.

Source of the fields: `arfx.run.summary`. Cost: the pictures dominate, about 30 ms a preview."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.config.load import load
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts, read_facts
from arfx.core.numerics import finite
from arfx.core.opener import read_text, regular
from arfx.core.pose import Pose
from arfx.errors import ConfigError, InputError, RenderError
from arfx.measure.pose_plot import STATUS_COLOUR, pose_plot
from arfx.run.folder import JobFolder, load_previews, write
from arfx.run.pages import render
from arfx.run.parameters import parameters

Pictures = Sequence[tuple[int, ndarray, ndarray]]


def write_report(
    folder: Path,
    report: Mapping[str, Any],
    facts: Sequence[FrameFacts],
    before_after: Pictures,
    camera: Camera | None = None,
    points_m: ndarray | None = None,
) -> Path:
    """Write report.json and report.html into `folder`, which is made; both appear whole or
    not at all.

    before_after : (frame number, input, output), RGB uint8 (h, w, 3), in order of frames
    camera, points_m : with both, (n, 3) world points whose place in the picture is plotted
    before and after smoothing Returns the path of report.html. Raises RenderError where the
    folder cannot be written."""
    document = finite(report)
    html = render(
        "measure/report.html",
        clip=Path(str(document["input"]["path"])).name,
        report=document,
        times={f.index: f.time_s for f in facts},
        pictures=before_after,
        pose_plot=pose_plot(facts, camera, points_m),
        colours=STATUS_COLOUR,
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise RenderError(
            f"report folder {folder} cannot be made: {e.strerror}",
            "name another place",
        ) from None
    write_json(folder / "report.json", document)
    write(folder / "report.html", html)
    return folder / "report.html"


def write_json(path: Path, document: Any) -> None:
    """document : without what is not finite. Raises RenderError."""
    write(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def report_of_job(job: Path, folder: Path) -> Path:
    """The report of a finished job, from its folder. Returns the path of report.html.

    Raises InputError where `job` is no job folder, or the job is not finished."""
    files = JobFolder(job)
    report = read_report(job)
    try:
        facts = list(read_facts(regular(files.facts, "report")))
        pictures = load_previews(files.previews) if files.previews.is_dir() else []
        return write_report(
            folder, report, facts, pictures, *_camera_and_cubes(files, report)
        )
    except (
        ConfigError,
        InputError,
        OSError,
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as e:
        why = (
            e.message
            if isinstance(e, (ConfigError, InputError))
            else f"{type(e).__name__}: {e}"
        )
        raise InputError(
            f"job folder {job} is damaged: {why}", "process the clip again"
        ) from e


def read_report(job: Path) -> dict[str, Any]:
    """report.json of a finished job. Raises InputError."""
    files = JobFolder(job)
    keep = "`arfx process ... --job DIR` keeps one"
    for there, what, hint in (
        (job.is_dir(), f"there is no job folder {job}", keep),
        (
            files.job.exists(),
            f"{job} is not a job folder: it holds no job.toml",
            keep,
        ),
        (
            files.report.exists(),
            f"the job in {job} is not finished",
            "run the same `arfx process` command again with --resume",
        ),
    ):
        if not there:
            raise InputError(what, hint)
    try:
        report = json.loads(read_text(files.report, "report"))
    except (RecursionError, ValueError) as e:
        raise InputError(
            f"{files.report} cannot be read: {e}", "process the clip again"
        ) from None
    if (
        not isinstance(report, dict)
        or not {"input", "output", "pose", "stages", "timing"} <= report.keys()
    ):
        raise InputError(
            f"{files.report} is not the report of a job", "process the clip again"
        )
    return report


def _camera_and_cubes(
    files: JobFolder, report: Mapping[str, Any]
) -> tuple[Camera, ndarray | None]:
    """The job's camera, and world points to plot: the corners of a cube on each marker that
    has a pose.
    """
    camera = Camera.from_json(json.loads(read_text(files.inputs, "report"))["camera"])
    specs = {spec.key: spec for spec in load(files.job, {}, parameters()).markers}
    cubes = []
    for key, pose in report["pose"].get("world_from_marker", {}).items():
        if key in specs:
            heights = np.repeat([[0, 0, 0], [0, 0, specs[key].size_m]], 4, axis=0)
            corners = np.tile(specs[key].corners_m, (2, 1)) + heights
            cubes.append(Pose.from_json(pose).apply(corners))
    return camera, np.concatenate(cubes) if cubes else None
