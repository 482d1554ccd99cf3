"""Long work that counts no steps: it is told to go on, and Ctrl-C is heard in the middle of
a library's loop.
"""

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

T = TypeVar("T")
Notice = Callable[[str], None]  # is told what people should know
Progress = Callable[[str, int, int | None], None]  # (phase, done, in all or None)
# Phases of progress that count seconds, and what they are
WAITS = {
    "model": "reading the model",
    "plan": "planning the frames",
    "table": "reading the jobs",
    "check": "checking the jobs",
}
_SOON_S = 2  # before that nothing is said


def wait_for(phase: str, work: Callable[[], T], progress: Progress) -> T:
    """What `work` returns or raises. It runs in a thread: a signal ends the wait at once,
    the thread ends with the process.

    phase : of WAITS;  progress(phase, seconds, None) : called every second"""
    if threading.current_thread() is not threading.main_thread():
        return work()
    future = Future[T]()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as e:
            future.set_exception(e)

    threading.Thread(target=run, name=phase, daemon=True).start()
    seconds = 0
    while not wait([future], 1).done:
        seconds += 1
        if seconds >= _SOON_S:
            progress(phase, seconds, None)
    return future.result()
