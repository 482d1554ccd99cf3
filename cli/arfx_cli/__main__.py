"""Starts the command: signals are caught and streams made safe before anything heavy is imported.

The process ends here too, with the exit code alone: what libraries do at exit cannot change it.
"""

import os
import sys
from typing import Any

from arfx.core import interrupt
from arfx_cli import streams


def start() -> None:
    """The `arfx` command. Does not return."""
    os.environ["PYTHONSAFEPATH"] = (
        "1"  # processes that are started import nothing from the folder that they run in
    )
    code: Any = 1
    try:
        interrupt.catch()
        with (
            interrupt.deferred()
        ):  # a half-done import may fail later, with another message
            streams.make_safe()
            from arfx_cli.main import main
        main()
    except SystemExit as e:
        code = e.code
    except KeyboardInterrupt:
        sys.stderr.write(f"{interrupt.cause()}\n")
        code = interrupt.exit_code() or 130
    except BaseException:  # ARFX_DEBUG
        sys.excepthook(*sys.exc_info())
    interrupt.exit_process(
        streams.closing_code(code if isinstance(code, int) else int(code is not None))
    )


if __name__ == "__main__":
    start()
