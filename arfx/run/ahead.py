"""Read ahead, write behind: items are made in a thread of their own, a few before they are asked for, or taken in one, a
few after they were given.

Right where making or taking one lets other threads run (a decoder, an encoder) while whoever is at the other end computes.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Generic, TypeVar

from arfx.core import interrupt

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
        with interrupt.held():  # what it reads from is closed behind this
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


class Behind(Generic[T]):
    """Context manager: calls `take` with what is put, in order, in a thread of its own, a few behind.

    depth : items that wait at most
    Raises what `take` raises, at a later `put` or on leaving; nothing is taken after that, nor after an error inside.
    """

    def __init__(self, take: Callable[[T], None], depth: int = 2) -> None:
        self._take = take
        self._error: BaseException | None = None
        self._waiting: queue.Queue[tuple[T] | None] = queue.Queue(depth)
        self._thread = threading.Thread(target=self._work, name="write-behind", daemon=True)
        self._left = False

    def __enter__(self) -> Behind[T]:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None) -> None:
        self._left = kind is not None
        with interrupt.held():
            self._waiting.put(None)
            self._thread.join()
        if kind is None and self._error is not None:
            raise self._error

    def put(self, item: T) -> None:
        """Waits while `depth` items wait."""
        if self._error is not None:
            raise self._error
        self._waiting.put((item,))

    def _work(self) -> None:
        while (entry := self._waiting.get()) is not None:
            if self._error is not None or self._left:
                continue  # so that nobody waits for a place
            try:
                self._take(entry[0])
            except BaseException as e:
                self._error = e
