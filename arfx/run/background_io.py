"""Decode ahead and encode behind, each in a thread of its own: codecs let other threads run
meanwhile.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from arfx.core import interrupt

T = TypeVar("T")
_END = object()


def ahead(items: Iterator[T], depth: int = 4) -> Generator[T]:
    """The items, in their order; of these `depth` wait at most. Raises what they raise,
    after those before it. When it is closed, what `items` read from may be closed."""
    pool = ThreadPoolExecutor(1, "ahead")
    try:
        pending = deque(pool.submit(next, items, _END) for _ in range(depth + 1))
        while (item := pending.popleft().result()) is not _END:
            pending.append(pool.submit(next, items, _END))
            yield item  # type: ignore[misc]
    finally:
        with interrupt.deferred():  # the caller closes what `items` read from next
            pool.shutdown(cancel_futures=True)


@contextlib.contextmanager
def behind(
    write: Callable[[T], None], depth: int = 2
) -> Iterator[Callable[[T], None]]:
    """Yields what hands an item to `write`, in order, while `depth` others wait at most.

    Raises what `write` raises, at a later item or at the end; after an error, there or in
    the body, what waits is left."""
    pool = ThreadPoolExecutor(1, "behind")
    pending: deque[Future[None]] = deque()

    def put(item: T) -> None:
        while len(pending) > depth:
            pending.popleft().result()
        pending.append(pool.submit(write, item))

    try:
        yield put
        for future in pending:
            future.result()
    finally:
        with interrupt.deferred():
            pool.shutdown(cancel_futures=True)
