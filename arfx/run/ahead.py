"""Read ahead, write behind: items are made in a thread of their own, a few before they are asked for, or taken in one, a
few after they were given.

Right where making or taking one lets other threads run (a decoder, an encoder) while whoever is at the other end computes.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, TypeVar

from arfx.core import interrupt

T = TypeVar("T")


class Ahead(Generic[T]):
    """Context manager and iterator over `items`, in their order. Raises what they raise, after those before it.

    depth : items that wait at most;  seconds : spent on making those that were taken
    On leaving, the thread has ended: what `items` read from may be closed.
    """

    def __init__(self, items: Iterator[T], depth: int = 4) -> None:
        self.seconds = 0.0
        self._items = items
        self._pool = ThreadPoolExecutor(1, "read-ahead")
        self._coming = deque(self._pool.submit(self._made) for _ in range(depth + 1))

    def __enter__(self) -> Ahead[T]:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None) -> None:
        with interrupt.deferred():  # what it reads from is closed behind this
            self._pool.shutdown(cancel_futures=True)

    def __iter__(self) -> Ahead[T]:
        return self

    def __next__(self) -> T:
        item, error, seconds = self._coming[0].result()
        if error is not None:
            raise error  # it stays the next one: asked again, it says the same again
        self._coming.popleft()
        self._coming.append(self._pool.submit(self._made))
        self.seconds += seconds
        return item  # type: ignore[return-value]

    def _made(self) -> tuple[T | None, BaseException | None, float]:
        start = time.perf_counter()
        try:
            return next(self._items), None, time.perf_counter() - start
        except BaseException as e:  # StopIteration too: it ends the other side's loop
            return None, e, 0.0


class Behind(Generic[T]):
    """Context manager: calls `take` with what is put, in order, in a thread of its own, a few behind.

    depth : items that wait at most
    Raises what `take` raises, at a later `put` or on leaving; nothing is taken after that, nor after an error inside.
    """

    def __init__(self, take: Callable[[T], None], depth: int = 2) -> None:
        self._take, self._depth = take, depth
        self._pool = ThreadPoolExecutor(1, "write-behind")
        self._given: deque[Future[None]] = deque()
        self._over = False

    def __enter__(self) -> Behind[T]:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None) -> None:
        self._over |= kind is not None
        with interrupt.deferred():
            self._pool.shutdown()
        if kind is None:
            self._wait(0)

    def put(self, item: T) -> None:
        """Waits while `depth` items wait."""
        self._wait(self._depth)
        self._given.append(self._pool.submit(self._one, item))

    def _wait(self, most: int) -> None:
        while len(self._given) > most:
            self._given.popleft().result()

    def _one(self, item: T) -> None:
        if self._over:
            return
        try:
            self._take(item)
        except BaseException:
            self._over = True
            raise
