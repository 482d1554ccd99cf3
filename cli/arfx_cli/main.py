"""The `arfx` command: lists the commands without importing them, and turns errors into one
message and an exit code.
"""

import contextlib
import importlib
import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from arfx import __version__
from arfx.core import interrupt
from arfx.core.machine import collect_seldom
from arfx.core.opener import check_name
from arfx.errors import JobInterruptedError, explained
from arfx_cli.console import TABLE, tell

# command -> one-line help. Its module here, of that name, is imported only when it runs.
COMMANDS = {name: rows["help"] for name, rows in TABLE.items() if "help" in rows}
EXIT_CODES = (
    "Exit codes: 0 done; 2 usage or configuration; 3 input cannot be read; 4 nothing to"
    " work on; 5 rendering failed; 6 one of several clips or cameras failed; 130"
    " interrupted (Ctrl-C), 143 stopped by SIGTERM, 129 by SIGHUP: all three can be"
    " resumed. A signal that comes when the output is complete changes nothing: exit 0. A"
    " second one ends arfx at once."
)


class LazyGroup(click.Group):
    """A group whose commands are imported on use, so that `--help` answers at once."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        with interrupt.deferred():
            module: Any = importlib.import_module(f"arfx_cli.{cmd_name}")
            command: click.Command = module.command
        return command

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([*COMMANDS.items()])


@click.group(
    cls=LazyGroup,
    commands=COMMANDS,  # names, for "Did you mean"
    epilog=EXIT_CODES,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="arfx")
def cli() -> None:
    """Batch augmented reality: a recorded clip and a camera calibration in, the clip with a
    virtual model standing on its marker out.

    \b
    Example:
      arfx process clip.mp4 --camera camera.yaml --marker 36h11:3:165mm --model duck.glb \\
        --fit 15cm -o out.mp4
    """


def main(argv: Sequence[str] | None = None) -> None:
    """Run a command. Exits with the codes of EXIT_CODES; ARFX_DEBUG=1 shows tracebacks."""
    # numpy's own threads wait by spinning: beside rendering threads they took a third of
    # the processor, for small matrices
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    collect_seldom()
    arguments = list(sys.argv[1:] if argv is None else argv)
    with interrupt.catching():
        try:
            for name in arguments:
                check_name(name)
            if not {"-h", "--help", "--version"} & set(arguments):
                with contextlib.suppress(OSError):  # a folder that is no more
                    check_name(Path.cwd())
            code = cli.main(args=arguments, prog_name="arfx", standalone_mode=False)
            with (
                interrupt.committing()
            ):  # a signal that came before counts, also one that a library swallowed
                pass
        except (Exception, KeyboardInterrupt, SystemExit) as e:
            code = _report_error(e)
        code = code if isinstance(code, int) else 0
        interrupt.commit(code)
        sys.exit(code)


def _report_error(e: BaseException) -> int:
    """Say what went wrong in one message.

    Returns the exit code; raises `e` again where tracebacks are wanted.
    """
    if interrupt.pending() and not isinstance(
        e, JobInterruptedError
    ):  # whatever a library has made of it
        e = KeyboardInterrupt()
    elif isinstance(e, click.Abort) and isinstance(
        e.__cause__, EOFError
    ):  # which click takes for Ctrl-D
        e = e.__cause__
    if isinstance(e, (KeyboardInterrupt, click.Abort)):
        code = interrupt.exit_code() or 130
        tell(interrupt.cause())
        return code
    if isinstance(e, SystemExit) and "_ARFX_COMPLETE" in os.environ:
        return 0 if e.code is None else int(e.code)  # the shell's completion ends so
    if isinstance(e, click.ClickException):
        shown = io.StringIO()
        e.show(shown)
        tell(shown.getvalue().rstrip())
        return e.exit_code
    if os.environ.get("ARFX_DEBUG") == "1" and not isinstance(e, SystemExit):
        raise e
    code, message = explained(e)
    tell(f"error: {message}")
    return code
