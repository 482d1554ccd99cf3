"""`arfx calibrate`: intrinsics from pictures or video of a board, with a verdict."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from arfx.core.guard import Guard
from arfx.errors import InputError
from arfx_cli.console import FILE, FOLDER, Progress, detail, emit_json, message_options, note, overwrite_option, quiet, say

if TYPE_CHECKING:
    import numpy as np

STILLS = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".jp2"}
VIDEO_SEARCHED = 120  # frames of a video that are searched for the board: the sharpest of equal intervals


@click.command()
@click.argument("inputs", metavar="IMAGES|VIDEO...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--board", required=True, metavar="SPEC",
    help="chessboard:9x6:25mm (inner corners) or charuco:12x8:18mm:14mm:5X5_100[:legacy].",
)  # fmt: skip
@click.option("-o", "--output", required=True, type=FILE, help="Camera file to write (YAML).")
@click.option("--report", type=FOLDER, help="Folder for residuals.png and coverage.png; default: beside -o.")
@overwrite_option
@message_options
def command(inputs: tuple[Path, ...], board: str, output: Path, report: Path | None, overwrite: bool, as_json: bool) -> None:
    """Camera intrinsics from pictures or videos of a printed board, with a verdict: good, usable or poor.

    Of a video, sharp and varied frames are taken. `arfx target` prints boards. The file is OpenCV YAML with ROS's names.

    \b
    Example:
      arfx calibrate left*.jpg --board chessboard:9x6:25mm -o camera.yaml"""
    from arfx.calibrate.board import BoardSpec

    spec = BoardSpec.parse(board)
    folder, stem = (report, "") if report else (output.absolute().parent, f"{output.stem}-")
    pictures = [folder / f"{stem}{name}" for name in ("residuals.png", "coverage.png")]
    for path in inputs:
        if not path.exists():
            raise InputError(f"{path} does not exist", "give images or videos of the board")
    paths = _flatten(inputs)
    guard = Guard((("picture", path) for path in paths), overwrite)
    for path in (output, *pictures):
        guard.file(path, folder_made=report is not None and path in pictures)

    from arfx.calibrate.calibration import calibrate, find_board
    from arfx.calibrate.document import document, file_extras, summary
    from arfx.calibrate.plots import write_plots
    from arfx.media.cameras import save_camera

    total = len(paths) if all(p.suffix.lower() in STILLS for p in paths) else None  # unknown for videos
    with Progress("pictures") as progress:
        found = find_board(_pictures(paths), spec, lambda searched, _: progress("search", searched, total))
    result = calibrate(found)
    folder.mkdir(parents=True, exist_ok=True)
    written = write_plots(result, folder, stem)
    save_camera(output, result.fitted.camera, **file_extras(result))
    for line in summary(result):
        say(line)
    if quiet() and result.verdict.word != "good":
        note(f"the calibration is {result.verdict.word}: {'; '.join(result.verdict.reasons)}")
    for row in document(result)["models"]:
        detail(f"{'*' if row['chosen'] else ' '} {row['model']}: held out {row['held_out_rms_px']:.4f} px {row['rejected']}")
    say(f"wrote {output}, {written[0]}, {written[1]}")
    if as_json:
        emit_json(document(result) | {"output": str(output), "plots": [str(p) for p in written]})


def _flatten(inputs: tuple[Path, ...]) -> list[Path]:
    """Folders stand for the pictures in them, by name."""
    out: list[Path] = []
    for path in inputs:
        inside = sorted(p for p in path.iterdir() if p.suffix.lower() in STILLS) if path.is_dir() else [path]
        if not inside:
            raise InputError(f"folder {path} holds no pictures", "supported: " + " ".join(sorted(STILLS)))
        out += inside
    return out


def _pictures(paths: list[Path]) -> Iterator[tuple[str, np.ndarray]]:
    """(name, (h, w) uint8 upright) of every still, and of sharp frames of every video."""
    import cv2

    from arfx.media.images import decode_picture

    names = [p.name for p in paths]
    for path in paths:
        name = path.name if names.count(path.name) == 1 else str(path)
        if path.suffix.lower() in STILLS:
            yield name, decode_picture(path, "picture", cv2.IMREAD_GRAYSCALE)  # turned upright as EXIF says
        else:
            yield from _video(path, name)


def _video(path: Path, name: str) -> Iterator[tuple[str, np.ndarray]]:
    import numpy as np

    from arfx.calibrate.screen import sharpest_of_each
    from arfx.media.clip import probe
    from arfx.media.frames import ClipReader

    info = probe(path)
    for notice in info.notices:
        note(f"{path}: {notice}")
    expected = info.frame_count_stated or int((info.duration_s or 0) * (info.fps or 30)) or 1000
    with ClipReader(info) as reader:
        frames = ((f"{name}@{f.time_s:.3f}s", np.ascontiguousarray(f.luma())) for f in reader.frames())
        yield from sharpest_of_each(frames, max(1, -(-expected // VIDEO_SEARCHED)))
