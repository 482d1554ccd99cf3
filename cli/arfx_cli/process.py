"""`arfx process`: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from arfx_cli.console import Progress, emit_json, json_option, overwrite_option, say, verbose_option
from arfx_cli.job_options import job_config, job_options, run_options


@click.command()
@job_options
@run_options
@overwrite_option
@json_option
@verbose_option
def command(
    output: Path | None,
    report_dir: Path | None,
    job_dir: Path | None,
    resume: bool,
    workers: int | None,
    overwrite: bool,
    as_json: bool,
    verbose: bool,
    **given: Any,
) -> None:
    """Put a virtual model onto the marker of CLIP.

    Frame times, audio, rotation and colour tags are kept; pixels that nothing virtual touches stay as they are.

    \b
    Example:
      arfx process clip.mp4 --camera camera.yaml --marker 36h11:3:165mm \\
        --model duck.glb --fit 15cm -o out.mp4 --report report
    """
    from arfx.run.job import JobFolder, Options, default_folder, process

    config = job_config(given, output)
    if report_dir is not None:
        from arfx_cli.report import check_report_folder

        check_report_folder(report_dir, overwrite)
    with Progress() as progress:
        options = Options(job_dir, resume, overwrite, workers, progress, lambda m: say(f"note: {m}"))
        report = process(config, options)
    path = Path(report["output"]["path"])
    folder = JobFolder(job_dir or default_folder(path))
    if report_dir is not None:
        from arfx.measure.report import report_of_job

        report_of_job(folder.path, report_dir)
    if job_dir is None:
        folder.remove()
    if verbose or not as_json:
        _say_summary(report)
    if as_json:
        emit_json(report)
    elif report_dir is not None:
        say(f"report: {report_dir / 'report.html'}")


def _say_summary(report: dict[str, Any]) -> None:
    pose, timing = report["pose"], report["timing"]
    reprojection = (pose.get("reprojection_px") or {}).get("median")
    say(
        f"{report['output']['frames']} frames to {report['output']['path']}: object in "
        f"{pose['frames_measured']} measured and {pose['frames_interpolated']} bridged frames, absent in {pose['frames_absent']}"
        + (f"; reprojection {reprojection:.2f} px" if reprojection is not None else "")
        + f"; {timing['wall_s']:.1f} s ({timing['frames_per_s']:.1f} frames/s)"
        + (f", resumed: the time of {timing['processes']} processes" if timing["resumed"] else "")
    )
