"""What worker processes are forked with (executors.py): imported once, by a process that
starts no thread and opens no OpenGL.

Stages of other distributions are left to the workers: nobody knows what theirs start."""

import atexit
import os
import sys

from arfx.core.machine import collect_seldom

collect_seldom()

import arfx.run.stretches  # noqa: E402
import arfx.run.worker  # noqa: E402, F401
from arfx.papers import FORMULAS  # noqa: E402
from arfx.stages import STAGES  # noqa: E402

for table in (STAGES, *FORMULAS.values()):
    table.load()
if "multiprocessing.forkserver" in " ".join(
    sys.orig_argv
):  # it ends at once, without taking apart all of that
    atexit.register(os._exit, 0)
