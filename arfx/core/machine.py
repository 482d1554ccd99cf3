"""The processor that this runs on, on every system: how many cores may be used, and its name."""

from __future__ import annotations

import os
import platform
from functools import cache
from pathlib import Path

_QUOTA = Path("/sys/fs/cgroup/cpu.max")


@cache
def usable_cores() -> int:
    """Cores that this process may use: of those of the machine the ones it is bound to, and what a container allows."""
    bound_to = getattr(os, "sched_getaffinity", None)  # Linux alone has it
    cores = len(bound_to(0)) if bound_to else os.cpu_count() or 1
    try:
        quota, period = _QUOTA.read_text(encoding="ascii").split()
        return max(min(cores, round(int(quota) / int(period))), 1)
    except (OSError, ValueError, ZeroDivisionError):  # no control groups here, or no limit ("max")
        return cores


def processor_name() -> str:
    """As its maker calls it, where the system says so; "unknown" where it says nothing."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")
