"""`arfx calibrate`: intrinsics from pictures or video of a board, with a verdict."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from arfx.core import interrupt
from arfx.core.guard import Guard
from arfx.core.naming import fixed_folder, has_field, named
from arfx.core.opener import folder_entries
from arfx.errors import ConfigError, InputError, explained, on_one_line
from arfx_cli.console import (
    Progress,
    arfx_command,
    detail_template,
    note,
    print_table,
    quiet,
    say,
    tell,
    wrote_json,
)

if TYPE_CHECKING:
    from numpy import ndarray

    from arfx.calibrate.board import BoardSpec
    from arfx.calibrate.calibration import Picture

STILLS = {
    ".jpg",
    ".jpeg",
    ".png",
    ".bmp",
    ".tif",
    ".tiff",
    ".webp",
    ".pgm",
    ".ppm",
    ".jp2",
    ".heic",
    ".heif",
}
# frames of a video that are searched for the board: the sharpest of equal intervals
VIDEO_SEARCHED = 120


class _Camera(NamedTuple):
    """source : what its pictures come from;  paths : pictures and videos;  output : its file"""

    source: Path
    paths: list[Path]
    output: Path

    @property
    def plot(self) -> Path:
        """Of the residuals."""
        return self.output.with_name(f"{self.output.stem}-residuals.png")


@arfx_command("calibrate")
def command(
    inputs: tuple[Path, ...],
    board: str,
    output: Path,
    overwrite: bool,
) -> None:
    """Camera intrinsics from pictures or videos of a printed board, with a verdict: good,
    usable or poor.

    Of a video, sharp and varied frames are taken. `arfx target` prints boards. The file is
    OpenCV YAML with ROS's names.

    With {stem} in -o every argument is a camera of its own: a video, or a folder with its
    pictures; {stem} is its name. A folder without pictures stands for the folders and
    videos in it. A camera that fails does not stop the others: exit code 6.

    \b
    Example:
      arfx calibrate left*.jpg --board chessboard:9x6:25mm -o camera.yaml
      arfx calibrate rig --board chessboard:9x6:25mm -o 'cameras/{stem}.yaml'"""
    from arfx.calibrate.board import BoardSpec

    spec = BoardSpec.parse(board)
    for path in inputs:
        if not path.exists():
            raise InputError(
                f"{path} does not exist", "give images or videos of the board"
            )
    several = has_field(output)
    if several:
        cameras = _several(inputs, output)
    else:
        cameras = [_Camera(inputs[0], _pictures_in(inputs), output)]
    read = (("picture", path) for camera in cameras for path in camera.paths)
    guard = Guard(read, overwrite)
    for camera in cameras:
        for path in (camera.output, camera.plot):
            guard.file(path, folder_made=several)
    if not several:
        wrote_json(_calibrate(cameras[0], spec, ""))
        return
    rows = []
    for k, camera in enumerate(cameras):
        of = f"{k + 1} of {len(cameras)}"
        done, code = None, 0
        try:
            camera.output.parent.mkdir(parents=True, exist_ok=True)
            done = _calibrate(camera, spec, f"{of} {camera.source.name}")
            message = done["verdict"]
        except Exception as e:
            if interrupt.pending():
                raise
            code, message = explained(e)
            message = on_one_line(message)
            tell(f"{of} {camera.source}: error: {message}")
        rows.append(
            {
                "input": str(camera.source),
                "output": str(camera.output),
                "exit_code": code,
                "message": message,
                "calibration": done,
            }
        )
    failed = sum(row["exit_code"] != 0 for row in rows)
    document = {"cameras": rows, "failed": failed}
    if not wrote_json(document):
        print_table("calibrate/cameras.jinja", words=3, **document)
    if failed:
        click.get_current_context().exit(6)


def _calibrate(camera: _Camera, spec: BoardSpec, title: str) -> dict[str, Any]:
    """Calibrate, write and say it; returns the document of --json. title : before lines of
    progress
    """
    from arfx.calibrate.advice import TILTED_DEG
    from arfx.calibrate.calibration import (
        calibrate,
        document,
        file_extras,
        find_board,
    )
    from arfx.calibrate.plot import write_plot
    from arfx.media.cameras import save_camera
    from arfx.run.pages import render

    paths = camera.paths
    stills = all(p.suffix.lower() in STILLS for p in paths)
    total = len(paths) if stills else None  # unknown for videos
    with Progress("pictures") as progress:
        if title:
            progress.begin(title)
        found = find_board(
            _pictures(paths),
            spec,
            lambda searched, _: progress("search", searched, total),
        )
    result = calibrate(found)
    write_plot(result, camera.plot)
    save_camera(camera.output, result.fitted.camera, **file_extras(result))
    d = document(result)
    known = d["standard_deviations"]
    say(
        render(
            "calibrate/summary.jinja",
            d=d,
            numbers=[*zip(known, result.fitted.values, known.values(), strict=True)],
            tilts=result.seen.tilt_deg,
            least=TILTED_DEG,
        )
    )
    for notice in found.notices * quiet():
        note(notice)
    if quiet() and result.verdict.word != "good":
        note(
            f"the calibration is {result.verdict.word}: {'; '.join(result.verdict.reasons)}"
        )
    detail_template("calibrate/models.jinja", models=d["models"])
    say(f"wrote {camera.output}, {camera.plot}")
    return d | {"output": str(camera.output), "plot": str(camera.plot)}


def _several(inputs: tuple[Path, ...], pattern: Path) -> list[_Camera]:
    """One camera for each argument, or for what is in a folder that holds no pictures itself."""
    own = fixed_folder(pattern).resolve()  # plots of an earlier run are there
    out: dict[Path, _Camera] = {}
    for path in inputs:
        sources = [path] if not path.is_dir() or _stills(path) else _cameras_in(path)
        for source in sources:
            if source.resolve() == own:
                continue
            file = named(pattern, source)
            if file in out:
                raise ConfigError(
                    f"{out[file].source} and {source} go to one output, {file}",
                    "{stem} and {parent} keep them apart",
                )
            out[file] = _Camera(source, _pictures_in((source,)), file)
    return list(out.values())


def _stills(folder: Path) -> list[Path]:
    return [p for p in folder_entries(folder) if p.suffix.lower() in STILLS]


def _cameras_in(folder: Path) -> list[Path]:
    from arfx.media.codecs import CLIP_SUFFIXES

    found = []
    for p in folder_entries(folder):
        video = p.is_file() and p.suffix.lower() in CLIP_SUFFIXES
        if video or (p.is_dir() and _stills(p)):
            found.append(p)
    if not found:
        raise InputError(
            f"folder {folder} holds no pictures, no folders of pictures and no videos",
            "a folder for each camera",
        )
    return found


def _pictures_in(inputs: tuple[Path, ...]) -> list[Path]:
    """Folders stand for the pictures in them, by name."""
    out: list[Path] = []
    for path in inputs:
        inside = _stills(path) if path.is_dir() else [path]
        if not inside:
            supported = " ".join(sorted(STILLS))
            raise InputError(
                f"folder {path} holds no pictures", f"supported: {supported}"
            )
        out += inside
    return out


def _pictures(paths: list[Path]) -> Iterator[Picture]:
    """Every still, turned upright as EXIF says, and sharp frames of every video."""
    import cv2

    from arfx.calibrate.calibration import Picture
    from arfx.media.images import decode_picture, exif_turn

    names = [p.name for p in paths]
    for path in paths:
        name = path.name if names.count(path.name) == 1 else str(path)
        if path.suffix.lower() not in STILLS:
            yield from (Picture(*frame) for frame in _video(path, name))
            continue
        try:
            gray = decode_picture(path, "picture", cv2.IMREAD_GRAYSCALE)
            yield Picture(name, gray, exif_turn(path))
        except InputError as e:
            yield Picture(name, e)


def _video(path: Path, name: str) -> Iterator[tuple[str, ndarray]]:
    import numpy as np

    from arfx.calibrate.screen import sharpest_of_each
    from arfx.media.clip import probe
    from arfx.media.frames import ClipReader

    info = probe(path)
    for notice in info.notices:
        note(f"{path}: {notice}")
    length = int((info.duration_s or 0) * (info.fps or 30))
    expected = info.frame_count_stated or length or 1000
    with ClipReader(info) as reader:
        frames = (
            (f"{name}@{f.time_s:.3f}s", np.ascontiguousarray(f.luma()))
            for f in reader.frames()
        )
        yield from sharpest_of_each(frames, max(1, -(-expected // VIDEO_SEARCHED)))
