"""`arfx reproduce`: every equation, number and figure of the four papers beside what the
program gives.
"""

import tempfile
from pathlib import Path

from arfx_cli.console import (
    Progress,
    arfx_command,
    detail,
    print_table,
    say,
    wrote_json,
)


@arfx_command("reproduce")
def command(paper: str, folder: Path, short: bool, overwrite: bool) -> None:
    """Compute every equation, printed number and figure of the published methods, from
    scenes that are made for it.

    s1 is the light map (Tan, Chen, Sun 2009), s2 depth of field (Zhao et al. 2012), s3
    watercolour (Jia, Tang 2013), s4 environment map and cone tracing (Yao, Tao, Wu 2018).
    Each gets a page, s1.html …, with a row for everything that it
    states: as printed, by the printed method here, by the corrected one, and why they
    differ; and with pictures and plots
    where the paper has figures and tables.

    \b
    Example:
      arfx reproduce all -o reproduced"""
    from arfx.core.guard import Guard
    from arfx.errors import JobInterruptedError
    from arfx.reproduce import PAPERS
    from arfx.reproduce.document import page_name, reproduce, text
    from arfx.reproduce.work import Work
    from arfx.run.place import PAGE_START, files_locked

    papers = list(PAPERS) if paper == "all" else [paper]
    pages = {page_name(name): PAGE_START.encode() for name in papers}
    try:
        with (
            files_locked(Guard((), overwrite), folder, pages),
            Progress("steps") as progress,
            tempfile.TemporaryDirectory(prefix="arfx-reproduce-") as scratch,
        ):
            work = Work(Path(scratch), short, progress, detail)
            document = reproduce(papers, folder, work)
    except JobInterruptedError:  # its message says that the job can be resumed
        raise KeyboardInterrupt from None
    if wrote_json(document):
        return
    print_table("reproduce/rows.jinja", words=7, text=text, **document)
    for name in pages:
        say(f"page: {folder / name}")
