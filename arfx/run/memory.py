"""Memory of this process and of the machine, on every system."""

import contextlib
import re
import sys
from pathlib import Path

import psutil

_CONTAINER = Path("/sys/fs/cgroup")
_STATUS = Path("/proc/self/status")  # of Linux


def peak_mb() -> float:
    """Peak memory of this process; its memory now where the system keeps no record; 0 where
    it is unknown.
    """
    with contextlib.suppress(
        OSError
    ):  # resource counts that of the process that started this one, too
        if found := re.search(
            r"^VmHWM:\s*(\d+) kB",
            _STATUS.read_text(encoding="utf-8", errors="replace"),
            re.MULTILINE,
        ):
            return int(found[1]) / 2**10
    try:
        import resource  # not on Windows
    except ImportError:
        try:
            memory = psutil.Process().memory_info()
        except (psutil.Error, OSError):
            return 0.0
        return float(getattr(memory, "peak_wset", memory.rss)) / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (
        2**20 if sys.platform == "darwin" else 2**10
    )  # bytes there, KiB elsewhere


def free_mb() -> float | None:
    """Memory available without swapping, a container's limit included; None where it is unknown."""
    try:
        free = psutil.virtual_memory().available / 2**20
    except (psutil.Error, OSError, RuntimeError):
        return None
    try:
        limit, used = (
            float((_CONTAINER / f"memory.{n}").read_text(encoding="ascii"))
            for n in ("max", "current")
        )
    except (OSError, ValueError):  # no control groups here, or no limit ("max")
        return free
    return min(free, (limit - used) / 2**20)
