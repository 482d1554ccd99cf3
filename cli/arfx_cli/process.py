"""`arfx process`: the main job."""

from functools import partial
from typing import Any

from arfx_cli.console import Progress, arfx_command, say, say_job, wrote_json
from arfx_cli.job_options import job_config, job_options, run_options


@arfx_command("process", *job_options())
def command(**given: Any) -> None:
    """Put a virtual model onto the marker of CLIP.

    Frame times, audio, rotation and colour tags are kept; pixels that nothing virtual
    touches stay as they are.

    \b
    Example:
      arfx process clip.mp4 --camera camera.yaml --marker 36h11:3:165mm \\
        --model duck.glb --fit 15cm -o out.mp4 --report report"""
    from arfx.measure.report import report_of_job
    from arfx.run.job import process

    with Progress() as progress:
        options = run_options(given, progress)
        config = job_config(given)
        if options.report is not None:
            options.finish = partial(report_of_job, folder=options.report)
        report = process(config, options)
    say_job(report)
    if options.report is not None:
        say(f"report: {options.report / 'report.html'}")
    wrote_json(report)
