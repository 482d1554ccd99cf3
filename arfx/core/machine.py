"""The processor that this runs on, on every system: how many cores may be used, its name, and who gets it."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Iterator
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
    return _cpuinfo("model name") or platform.processor() or "unknown"


def instructions() -> frozenset[str]:
    """Names of the processor's extensions of its instruction set; none where the system does not say."""
    return frozenset(_cpuinfo("flags").split())


def _cpuinfo(name: str) -> str:
    """What Linux says of the first core; "" elsewhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    return next((line.partition(":")[2].strip() for line in lines if line.startswith(name)), "")


@contextlib.contextmanager
def scheduling_kept() -> Iterator[None]:
    """Threads that the body starts, and its own, get no more of the processor afterwards than this one had before."""
    if not hasattr(os, "sched_setscheduler"):  # POSIX has it, macOS and Windows do not
        yield
        return
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        raised = os.sched_getscheduler(0)
        if raised != policy:
            for thread in _threads():
                with contextlib.suppress(OSError):  # it has ended
                    if os.sched_getscheduler(thread) == raised:
                        os.sched_setscheduler(thread, policy, priority)


def _threads() -> list[int]:
    """Of this process, as the scheduler numbers them; 0 = the one that asks."""
    try:
        return [0, *(int(name) for name in os.listdir("/proc/self/task"))]  # noqa: PTH208 - names alone
    except OSError:
        return [0]
