"""What worker processes are forked with (executors.py): imported once, by a process that starts no thread."""

from arfx.core.machine import collect_seldom

collect_seldom()

import trimesh  # noqa: E402, F401

import arfx.run.stretches  # noqa: E402
import arfx.run.worker  # noqa: E402, F401
from arfx.run.kernels import JOB, listed_kernels  # noqa: E402
from arfx.run.parameters import parameters  # noqa: E402

parameters()  # imports all stages
for kernel in listed_kernels((JOB,)):
    if kernel.is_cached:
        kernel.load()
