"""Ctrl-C, SIGTERM and SIGHUP: recorded when they arrive, so that none is lost where a
library swallows what they raise.

A signal raises KeyboardInterrupt in the main thread, and `check`, called often, raises it
again. Where work must not be cut in two, it is deferred until the end. Once an output is in
place under its final name, signals no longer change the outcome. A second signal ends the
process at once: whatever arfx writes is complete or absent at all times."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time

TYPE_CHECKING = (
    False  # as in typing, which takes longer to import than a signal may wait
)
if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import Any

STOPPING: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
)
# `timeout`, a container's init or a wrapper send what the terminal has sent already
_SAME_SIGNAL_S = 0.3


class _State:
    """number : of the first signal received, 0 = none;  at : when;  deferred : only record it
    committed : the outcome is final;  code : its exit code
    previous : the handlers that were there, by signal; empty = none is caught"""

    number, at, code = 0, 0.0, 0
    deferred = committed = False

    def __init__(self) -> None:
        self.previous: dict[int, Any] = {}


_now = _State()


def _handle(number: int, _: object) -> None:
    if not _now.number:
        _now.number, _now.at = number, time.monotonic()
        if not (_now.deferred or _now.committed):
            raise KeyboardInterrupt
    elif time.monotonic() - _now.at > _SAME_SIGNAL_S:
        with contextlib.suppress(OSError):
            if os.isatty(2):
                os.write(2, b"\x1b[?25h")  # a progress bar hides the cursor
        os._exit(exit_code() or _now.code)


def catch(signals: Sequence[signal.Signals] = STOPPING) -> None:
    """Catch `signals` from here on, and forget those received. One that is ignored (nohup,
    a job in a script's background) stays so, and one that the program handles itself is
    left to it. Elsewhere than in the main thread nothing is caught."""
    global _now
    _now = _State()
    if not _in_main_thread():
        return
    for number in signals:
        previous = signal.getsignal(number)
        if previous in (signal.SIG_DFL, signal.default_int_handler):
            _now.previous[number] = signal.signal(number, _handle)


@contextlib.contextmanager
def catching(signals: Sequence[signal.Signals] = STOPPING) -> Iterator[None]:
    """Catch `signals` in the body, unless they are caught already. One received after the
    outcome was final is passed on afterwards."""
    global _now
    if _now.previous:
        yield
        return
    catch(signals)
    late = 0
    try:
        yield
        late = _now.number
    finally:
        for number, previous in _now.previous.items():
            signal.signal(number, previous)
        _now = _State()
    if late:
        signal.raise_signal(late)


def pending() -> bool:
    """Whether a signal was received before the outcome was final."""
    return bool(_now.number) and not _now.committed


def check() -> None:
    """Raise KeyboardInterrupt if a signal was received and is not deferred: what it raised
    may have been swallowed.
    """
    if pending() and not _now.deferred:
        raise KeyboardInterrupt


def exit_code() -> int:
    """0 = none came in time; 130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP."""
    if not pending():
        return 0
    is_break = _now.number == getattr(signal, "SIGBREAK", None)
    return 128 + (signal.SIGINT if is_break else _now.number)


def cause() -> str:
    """What stopped the work, in words."""
    if exit_code() in (0, 130):
        return "interrupted"
    return f"stopped by {signal.Signals(_now.number).name}"


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Signals are recorded in the body, and raised after it.

    Other threads than the main one never see them anyway.
    """
    if not _in_main_thread():
        yield
        return
    previous, _now.deferred = _now.deferred, True
    try:
        yield
    finally:
        _now.deferred = previous
    check()


@contextlib.contextmanager
def committing() -> Iterator[None]:
    """The body puts the output in place.

    Raises KeyboardInterrupt before it if a signal was received; after it none counts.
    """
    main = _in_main_thread()
    with deferred():
        if main and pending():
            raise KeyboardInterrupt
        yield
        if main:
            _now.committed = True


def commit(code: int = 0) -> None:
    """From here on no signal changes the outcome, whatever it is. code : the exit code"""
    _now.committed, _now.code = True, code


def resume() -> None:
    """More is to be done after an output was completed: signals count again, including
    those received meanwhile.
    """
    _now.committed = False
    check()


@contextlib.contextmanager
def starting_workers() -> Iterator[None]:
    """No process started in the body is left half started, nor sees Ctrl-C before
    `in_worker` turns that off.
    """
    if (
        os.name == "posix"
    ):  # Python's tracker of shared memory goes first: its start unblocks Ctrl-C again
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()
    masks = hasattr(signal, "pthread_sigmask")
    with deferred():
        previous = (
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            if masks
            else set()
        )
        try:
            yield
        finally:
            if masks:
                signal.pthread_sigmask(signal.SIG_SETMASK, previous)


def in_worker() -> None:
    """First in a worker process: leave Ctrl-C to the parent, and end when the parent has
    ended, however that was.
    """
    import multiprocessing

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(
            target=_end_with, args=(parent.sentinel,), name="parent", daemon=True
        ).start()


def _end_with(sentinel: int) -> None:
    from multiprocessing.connection import wait

    wait([sentinel])
    os._exit(1)


def exit_process(code: int) -> None:
    """End the process with `code`.

    Nothing can change it any more: no signal, no thread that is still at work.
    """
    import atexit

    for number in STOPPING:
        with contextlib.suppress(ValueError, OSError):
            signal.signal(number, signal.SIG_IGN)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
