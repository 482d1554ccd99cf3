"""arfx, which sends a signal at one moment of its work, the same on a busy machine as on an
idle one:

python at_a_moment.py PHASE N SIGNAL self|group ARGUMENTS…      at the N-th call of the
progress of PHASE, N from 1
python at_a_moment.py PHASE +N SIGNAL self|group ARGUMENTS…     at the first that says N
frames or more
"""

from __future__ import annotations

import os
import sys
from typing import Any

from arfx.run import schedule
from arfx_cli.__main__ import start
from arfx_cli.console import Progress


def main() -> None:
    phase, call, number, whom, *sys.argv[1:] = sys.argv[1:]
    schedule.SHORTEST = 15  # as tests/cli/conftest.py has it
    told, calls = Progress.__call__, 0

    def tell(self: Any, at: str, done: int, total: int | None) -> None:
        nonlocal calls
        told(self, at, done, total)
        calls += at == phase and (not call.startswith("+") or done >= int(call))
        if at == phase and calls == (1 if call.startswith("+") else int(call)):
            (os.killpg if whom == "group" else os.kill)(os.getpid(), int(number))

    Progress.__call__ = tell  # type: ignore[method-assign]
    start()


if __name__ == "__main__":
    main()
