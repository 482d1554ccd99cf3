"""`arfx demo`: a sample clip made, processed and reported, without any argument."""

from pathlib import Path

import click

from arfx_cli.console import Progress, arfx_command, note, say_job, wrote_json


@arfx_command("demo")
def command(folder: Path, overwrite: bool) -> None:
    """Make a sample clip, put a model onto its marker, and write out.mp4, picture.png and a report.

    \b
    Example:
      arfx demo"""
    import numpy as np

    from arfx.config.load import load
    from arfx.core.guard import Guard, atomic_write
    from arfx.measure.report import report_of_job
    from arfx.media.images import write_png
    from arfx.run.folder import JobFolder, load_previews
    from arfx.run.job import Options, process
    from arfx.run.lock import locked
    from arfx.run.parameters import parameters
    from arfx.run.place import REPORT_FILES
    from arfx.synth.clip import make_clip
    from arfx.synth.description import DEMO_SCENE, load_scene

    out, picture, report_dir = (
        folder / "out.mp4",
        folder / "picture.png",
        folder / "report",
    )
    guard = Guard((), overwrite)
    for path in (out, picture):
        guard.file(path, folder_made=True)
    guard.files(report_dir, REPORT_FILES)

    def finish(job: Path) -> None:
        report_of_job(job, report_dir)
        previews = load_previews(JobFolder(job).previews)
        with atomic_write(picture) as part:
            write_png(part, np.hstack(previews[len(previews) // 2][1:]))

    with locked(folder, "-o"), Progress() as progress:
        make_clip(
            load_scene(DEMO_SCENE),
            folder / "clip",
            progress=progress,
            overwrite=overwrite,
        )
        config = load(
            folder / "clip" / "job.toml", {"output": {"path": str(out)}}, parameters()
        )
        options = Options(
            overwrite=overwrite,
            report=report_dir,
            finish=finish,
            progress=progress,
            notice=note,
        )
        report = process(config, options)
    written = {
        "picture": "picture.png",
        "clip before": "clip/clip.mp4",
        "clip after": "out.mp4",
        "report": "report/report.html",
    }
    say_job(report)
    files = {
        what.replace(" ", "_"): str(folder / name) for what, name in written.items()
    }
    if wrote_json(files | {"job": report}):
        return
    for what, name in written.items():
        click.echo(f"{what + ':':12} {folder / name}")
