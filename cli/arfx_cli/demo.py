"""`arfx demo`: a sample clip made, processed and reported, without any argument."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from arfx_cli.console import Progress, emit_json, message_options, note, overwrite_option
from arfx_cli.job_summary import say_job


@click.command()
@click.option(
    "-o", "--output", "folder", type=click.Path(path_type=Path, file_okay=False), default=Path("demo"), show_default=True,
    help="Folder for all that is made.",
)  # fmt: skip
@overwrite_option
@message_options
def command(folder: Path, overwrite: bool, as_json: bool) -> None:
    """Make a sample clip, put a model onto its marker, and write out.mp4, picture.png and a report.

    \b
    Example:
      arfx demo
    """
    from arfx.config.load import load
    from arfx.errors import ConfigError
    from arfx.measure.report import report_of_job
    from arfx.run.job import Options, process
    from arfx.run.parameters import parameters
    from arfx.run.preview import load_previews
    from arfx.synth.demo import make_demo_clip

    made = [folder / n for n in ("clip", "job", "report", "out.mp4", "picture.png")]
    if any(p.exists() for p in made) and not overwrite:
        raise ConfigError(f"{folder} holds an earlier demo", "--overwrite replaces it; or name another with -o")
    for path in made:
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    with Progress() as progress:
        make_demo_clip(folder / "clip", progress)
        config = load(folder / "clip" / "job.toml", {"output": {"path": str(folder / "out.mp4")}}, parameters())
        report = process(config, Options(folder / "job", overwrite=True, progress=progress, notice=note))
    report_of_job(folder / "job", folder / "report")
    previews = load_previews(folder / "job" / "previews")
    _save(previews[len(previews) // 2], folder / "picture.png")
    shutil.rmtree(folder / "job")
    written = {"picture": "picture.png", "clip before": "clip/clip.mp4", "clip after": "out.mp4", "report": "report/report.html"}
    say_job(report)
    if as_json:
        emit_json({what.replace(" ", "_"): str(folder / name) for what, name in written.items()} | {"job": report})
        return
    for what, name in written.items():
        click.echo(f"{what + ':':12} {folder / name}")


def _save(preview: tuple, path: Path) -> None:
    import cv2
    import numpy as np

    _, before, after = preview
    cv2.imwrite(str(path), np.hstack([before, after])[..., ::-1])
