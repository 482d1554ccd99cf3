"""The machine that this runs on: usable cores, the processor's name and scheduling, the
user's cache folder; and how often this process looks for garbage."""

import contextlib
import gc
import os
import platform
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_QUOTA = Path("/sys/fs/cgroup/cpu.max")


@cache
def usable_cores() -> int:
    """Cores that this process may use: of those of the machine the ones it is bound to, and
    what a container allows.
    """
    bound_to = getattr(os, "sched_getaffinity", None)  # Linux alone has it
    cores = len(bound_to(0)) if bound_to else os.cpu_count() or 1
    try:
        quota, period = _QUOTA.read_text(encoding="ascii").split()
        return max(min(cores, round(int(quota) / int(period))), 1)
    except (OSError, ValueError, ZeroDivisionError):  # no groups, or no limit ("max")
        return cores


def processor_name() -> str:
    """As its maker calls it, where the system says so; "unknown" where it says nothing."""
    return _cpuinfo("model name") or platform.processor() or "unknown"


def instructions() -> frozenset[str]:
    """Names of the processor's extensions of its instruction set; none where the system
    does not say.
    """
    return frozenset(_cpuinfo("flags").split())


def _cpuinfo(name: str) -> str:
    """What Linux says of the first core; "" elsewhere."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    found = re.search(rf"^{name}\b[^:\n]*:(.*)", text, re.MULTILINE)
    return found[1].strip() if found else ""


def collect_seldom() -> None:
    """Look for garbage seldom: importing all that a job needs makes 300,000 objects that
    stay, and looking through them took a thirtieth of a short command, and a tenth of a
    worker process."""
    gc.set_threshold(400_000, 10, 100)


@contextlib.contextmanager
def preserve_scheduling() -> Iterator[None]:
    """Threads that the body starts, and its own, get no more of the processor afterwards
    than this one had before.
    """
    if not hasattr(
        os, "sched_setscheduler"
    ):  # POSIX has it, macOS and Windows do not
        yield
        return
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        raised = os.sched_getscheduler(0)
        tasks = Path("/proc/self/task").glob("*") if raised != policy else ()
        for thread in (0, *(int(task.name) for task in tasks)):  # 0 = this one
            with contextlib.suppress(OSError):  # it has ended
                if os.sched_getscheduler(thread) == raised != policy:
                    os.sched_setscheduler(thread, policy, priority)


def cache_folder() -> Path:
    """arfx's own folder in the user's cache folder; it may not exist yet. Raises
    RuntimeError where the user has no home.
    """
    home = Path.home()
    by_system = {"win32": "AppData/Local", "darwin": "Library/Caches"}
    usual = home / by_system.get(sys.platform, ".cache")
    return Path(os.environ.get("XDG_CACHE_HOME") or usual) / "arfx"
