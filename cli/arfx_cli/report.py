"""`arfx report`: the report of a finished job."""

from pathlib import Path

from arfx_cli.console import arfx_command, detail_job, say, wrote_json


@arfx_command("report")
def command(job_dir: Path, output: Path | None, overwrite: bool) -> None:
    """Write report.json and report.html (one file, no outside links) of a finished job.

    JOBDIR is the folder that `arfx process --job JOBDIR` kept.

    \b
    Example:
      arfx report out.job -o report"""
    from arfx.core.guard import Guard
    from arfx.measure.report import read_report, report_of_job
    from arfx.run.folder import JobFolder
    from arfx.run.place import REPORT_FILES, files_locked

    report = read_report(job_dir)
    folder = output or job_dir.absolute().with_name(
        job_dir.absolute().name.removesuffix(".job") + ".report"
    )
    guard = Guard((("job", path) for path in JobFolder(job_dir).files()), overwrite)
    with files_locked(guard, folder, REPORT_FILES):
        page = report_of_job(job_dir, folder)
    say(f"report: {page}")
    detail_job(report)
    wrote_json(report)
