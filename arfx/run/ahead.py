"""Read ahead: items of an iterator are made in a thread of their own, a few before they are asked for.

Right where making one waits for other threads (a decoder's) while whoever takes them computes.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Generic, TypeVar

T = TypeVar("T")
_LOOK_S = 0.05  # how soon a thread whose items nobody takes any more sees that


class Ahead(Generic[T]):
    """Context manager and iterator over `items`, in their order. Raises what they raise, after those before it.

    depth : items that wait at most;  seconds : spent on making those that were taken
    On leaving, the thread has ended: what `items` read from may be closed.
    """

    def __init__(self, items: Iterator[T], depth: int = 4) -> None:
        self.seconds = 0.0
        self._items = items
        self._waiting: queue.Queue[tuple[T | None, BaseException | None, float]] = queue.Queue(depth)
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._work, name="read-ahead", daemon=True)

    def __enter__(self) -> Ahead[T]:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None) -> None:
        self._left.set()
        self._thread.join()

    def __iter__(self) -> Ahead[T]:
        return self

    def __next__(self) -> T:
        item, error, seconds = self._waiting.get()
        self.seconds += seconds
        if error is not None:
            self._waiting.put((None, error, 0.0))  # asked again, it says the same again
            raise error
        return item  # type: ignore[return-value]

    def _work(self) -> None:
        error: BaseException | None = None
        while error is None:
            start, item = time.perf_counter(), None
            try:
                item = next(self._items)
            except BaseException as e:  # StopIteration too: it ends the other side's loop
                error = e
            if not self._put((item, error, time.perf_counter() - start)):
                return

    def _put(self, entry: tuple[T | None, BaseException | None, float]) -> bool:
        while not self._left.is_set():
            try:
                self._waiting.put(entry, timeout=_LOOK_S)
            except queue.Full:
                continue
            return True
        return False
