"""Decode ahead and encode behind, each in a thread of its own: codecs let other threads run
meanwhile.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from arfx.core import interrupt

T = TypeVar("T")


class Prefetch(Generic[T]):
    """Context manager and iterator over `items`, in their order. Raises what they raise,
    after those before it.

    depth : items that wait at most;  seconds : spent on making those that were returned
    On leaving, the thread has ended: what `items` read from may be closed."""

    def __init__(self, items: Iterator[T], depth: int = 4) -> None:
        self.seconds = 0.0
        self._items = items
        self._pool = ThreadPoolExecutor(1, "prefetch")
        self._pending = deque(self._pool.submit(self._next_item) for _ in range(depth + 1))

    def __enter__(self) -> Prefetch[T]:
        return self

    def __exit__(self, *exc: object) -> None:
        with interrupt.deferred():  # the caller closes what `items` read from next
            self._pool.shutdown(cancel_futures=True)

    def __iter__(self) -> Prefetch[T]:
        return self

    def __next__(self) -> T:
        item, seconds = self._pending[
            0
        ].result()  # an error, StopIteration too, stays first and is raised again
        self._pending.popleft()
        self._pending.append(self._pool.submit(self._next_item))
        self.seconds += seconds
        return item

    def _next_item(self) -> tuple[T, float]:
        start = time.perf_counter()
        return next(self._items), time.perf_counter() - start


class WriteBehind(Generic[T]):
    """Context manager: calls `write` with what is put, in order, in a thread of its own.

    depth : items that wait at most
    Raises what `write` raises, at a later `put` or on leaving; nothing is written after
    that, nor after an error inside."""

    def __init__(self, write: Callable[[T], None], depth: int = 2) -> None:
        self._write, self._depth = write, depth
        self._pool = ThreadPoolExecutor(1, "write-behind")
        self._pending: deque[Future[None]] = deque()
        self._failed = False

    def __enter__(self) -> WriteBehind[T]:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._failed |= kind is not None
        with interrupt.deferred():
            self._pool.shutdown()
        if kind is None:
            self._wait(0)

    def put(self, item: T) -> None:
        """Waits while `depth` items wait."""
        self._wait(self._depth)
        self._pending.append(self._pool.submit(self._write_one, item))

    def _wait(self, most: int) -> None:
        while len(self._pending) > most:
            self._pending.popleft().result()

    def _write_one(self, item: T) -> None:
        if not self._failed:
            try:
                self._write(item)
            except BaseException:
                self._failed = True
                raise
