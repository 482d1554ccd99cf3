"""Ctrl-C, SIGTERM and SIGHUP: noted the moment they come, so that none is lost where a library swallows what they raise.

A signal raises KeyboardInterrupt in the main thread, and `check`, called often, raises it again. Where work must not be cut
in two, it is held until the end. Once an output is in place under its final name, signals no longer change the outcome.
A second signal ends the process at once: whatever arfx writes is whole or absent at any moment.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time

TYPE_CHECKING = False  # as in typing, which takes longer to import than a signal may wait
if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import Any

STOPPING: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)
_SAME_S = 0.3  # `timeout`, a container's init or a wrapper send what the terminal has sent already


class _State:
    """number : of the first signal that came, 0 = none;  at : when;  held : note it only
    settled : the outcome stands;  code : the exit code that it has
    before : the handlers that were there, by signal; empty = none is caught"""

    number, at, code = 0, 0.0, 0
    held = settled = False

    def __init__(self) -> None:
        self.before: dict[int, Any] = {}


_now = _State()


def _handle(number: int, _: object) -> None:
    if not _now.number:
        _now.number, _now.at = number, time.monotonic()
        if not (_now.held or _now.settled):
            raise KeyboardInterrupt
    elif time.monotonic() - _now.at > _SAME_S:
        with contextlib.suppress(OSError):
            if os.isatty(2):
                os.write(2, b"\x1b[?25h")  # a progress bar hides the cursor
        os._exit(exit_code() or _now.code)


def catch(signals: Sequence[signal.Signals] = STOPPING) -> None:
    """Catch `signals` from here on, and forget those that came. One that is ignored (nohup, a job in a script's background)
    stays so, and one that the program handles itself is left to it. Elsewhere than in the main thread nothing is caught."""
    global _now
    _now = _State()
    if not _in_main_thread():
        return
    for number in signals:
        before = signal.getsignal(number)
        if before in (signal.SIG_DFL, signal.default_int_handler):
            _now.before[number] = signal.signal(number, _handle)


@contextlib.contextmanager
def caught(signals: Sequence[signal.Signals] = STOPPING) -> Iterator[None]:
    """Catch `signals` in the body, unless they are caught already. One that came when the outcome was settled is passed on
    behind it."""
    global _now
    if _now.before:
        yield
        return
    catch(signals)
    late = 0
    try:
        yield
        late = _now.number
    finally:
        for number, before in _now.before.items():
            signal.signal(number, before)
        _now = _State()
    if late:
        signal.raise_signal(late)


def came() -> bool:
    """Whether a signal came before the outcome was settled."""
    return bool(_now.number) and not _now.settled


def check() -> None:
    """Raise KeyboardInterrupt if a signal came, where it is not held: what it raised may have been swallowed."""
    if came() and not _now.held:
        raise KeyboardInterrupt


def exit_code() -> int:
    """0 = none came in time; 130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP."""
    return 128 + (_now.number if _now.number != getattr(signal, "SIGBREAK", 0) else signal.SIGINT) if came() else 0


def cause() -> str:
    """What stopped the work, in words."""
    return "interrupted" if exit_code() in (0, 130) else f"stopped by {signal.Signals(_now.number).name}"


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Signals are noted in the body, and raised behind it. Other threads than the main one never see them anyway."""
    if not _in_main_thread():
        yield
        return
    before, _now.held = _now.held, True
    try:
        yield
    finally:
        _now.held = before
    check()


@contextlib.contextmanager
def completing() -> Iterator[None]:
    """The body puts the output in place. Raises KeyboardInterrupt in front of it if a signal came; behind it none counts."""
    if not _in_main_thread():
        yield
        return
    with held():
        if came():
            raise KeyboardInterrupt
        yield
        _now.settled = True


def settle(code: int = 0) -> None:
    """From here on no signal changes the outcome, whatever it is. code : the exit code"""
    _now.settled, _now.code = True, code


def go_on() -> None:
    """More is to be done after an output was completed: signals count again, those too that came meanwhile."""
    _now.settled = False
    check()


@contextlib.contextmanager
def starting_workers() -> Iterator[None]:
    """No process started in the body is left half started, nor sees Ctrl-C before `in_worker` says that it never shall."""
    with held():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
        try:
            yield
        finally:
            if before is not None:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)


def in_worker() -> None:
    """First in a worker process: leave Ctrl-C to the parent, and end when the parent has ended, however that was."""
    import multiprocessing

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), name="parent", daemon=True).start()


def _end_with(sentinel: int) -> None:
    from multiprocessing.connection import wait

    wait([sentinel])
    os._exit(1)


def leave(code: int) -> None:
    """End the process with `code`. Nothing can change it any more: no signal, no thread that is still at work."""
    import atexit

    for number in STOPPING:
        with contextlib.suppress(ValueError, OSError):
            signal.signal(number, signal.SIG_IGN)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
