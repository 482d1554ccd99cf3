"""Runs jobs by OpenGL in a process in which nothing has opened a context yet: `python -m
tests.cli.opengl_jobs FOLDER`.

FOLDER holds clips as `arfx synth` makes them. results.json there gets, for each job in
turn, its exit code and how many pictures this process drew by OpenGL. Stops at the first
job that fails."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from arfx.config.load import load
from arfx.errors import JobInterruptedError, RenderError
from arfx.run import schedule
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.stages.raster import backends, gl_context, gl_draw
from arfx.synth import description
from arfx_cli.main import main

SCENES = FIRST, *OTHERS = (
    "0001-orbit",
    "0006-wide-lens-upright",
    "0003-several-tilted-markers",
)
FRAMES = 4  # in two chunks
BACKEND = "raster.backend=pyrender"


def job(scene: Path, *more: str) -> list[str]:
    return ["process", "--config", str(scene / "job.toml"), "--codec", "ffv1", *more]


def interrupt(scene: Path, folder: Path) -> None:
    """Leaves a job of which one chunk of two is rendered."""
    document = {
        "output": {"path": str(folder.with_suffix("")), "codec": "ffv1"},
        "raster": {"backend": "pyrender"},
    }

    def stop(phase: str, done: int, _: int | None) -> None:
        if phase == "render" and done > FRAMES // 2:
            raise KeyboardInterrupt

    with contextlib.suppress(JobInterruptedError):
        process(
            load(scene / "job.toml", document, parameters()),
            Options(folder, progress=stop),
        )
    assert len(list((folder / "chunks").iterdir())) == 1


def jobs(folder: Path) -> Iterator[tuple[str, list[str]]]:
    clip = folder / FIRST
    for name, more in {
        "default": (),
        "1": ("--workers", "1"),
        "2": ("--workers", "2"),
    }.items():
        yield (
            name,
            job(clip, "--set", BACKEND, *more, "-o", str(folder / f"{name}.mkv")),
        )
    interrupt(clip, folder / "resumed.mkv.job")
    yield (
        "resumed",
        job(clip, "--set", BACKEND, "--resume", "-o", str(folder / "resumed.mkv")),
    )
    for name in OTHERS:
        yield (
            name,
            job(folder / name, "--set", BACKEND, "-o", str(folder / f"{name}.mkv")),
        )
    yield (
        "tradeoff",
        [
            "tradeoff",
            "--config",
            str(folder / OTHERS[0] / "job.toml"),
            "--set",
            BACKEND,
            "--frames",
            "1",
            "--formula",
            "paper",
        ],
    )
    # now `auto`, as where a graphics card runs OpenGL
    backends._graphics_card = lambda: True
    gl_context.open_context().software = False
    shorter = description.DEMO_SCENE.read_text().replace(
        "frames = 72", f"frames = {FRAMES}"
    )
    description.DEMO_SCENE = folder / "demo.toml"
    description.DEMO_SCENE.write_text(
        shorter.replace("width = 640\nheight = 360", "width = 384\nheight = 216")
    )
    yield "demo", ["demo", "-o", str(folder / "demo")]


def run(folder: Path) -> None:
    schedule.SHORTEST, drawn = FRAMES // 2, 0
    draw = gl_draw.Drawing.__call__

    def counted(*args: Any) -> Any:
        nonlocal drawn
        drawn += 1
        return draw(*args)

    gl_draw.Drawing.__call__ = counted  # type: ignore[method-assign]
    results: dict[str, list[int]] = {}
    for name, args in jobs(folder):
        drawn = 0
        try:
            main(args)
        except SystemExit as e:
            results[name] = [int(e.code or 0), drawn]
        if results[name][0]:
            break
    try:
        opened = gl_context.open_context().detail
    except RenderError as e:
        opened = f"{e.message}"
    (folder / "results.json").write_text(
        json.dumps({"opened": opened, "jobs": results})
    )


if __name__ == "__main__":
    run(Path(sys.argv[1]))
