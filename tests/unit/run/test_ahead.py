"""Reading ahead in a thread changes nothing about what is read, and ends when nobody wants more."""

import threading
import time

import pytest

from arfx.run.ahead import Ahead


def test_the_items_come_in_order_and_then_it_is_over():
    with Ahead(iter(range(100)), depth=3) as ahead:
        assert list(ahead) == list(range(100))
        with pytest.raises(StopIteration):
            next(ahead)


def test_an_error_comes_after_the_items_before_it():
    def items():
        yield 1
        yield 2
        raise OSError("broken off")

    with Ahead(items()) as ahead:
        assert next(ahead) == 1 and next(ahead) == 2
        with pytest.raises(OSError, match="broken off"):
            next(ahead)


def test_no_more_than_depth_wait_and_the_thread_ends_on_leaving():
    made, closed = [], threading.Event()

    def items():
        try:
            for k in range(1000):
                made.append(k)
                yield k
        finally:
            closed.set()

    source = items()
    with Ahead(source, depth=4) as ahead:
        assert next(ahead) == 0
        until = time.monotonic() + 10
        while len(made) < 6 and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(0.1)
        assert len(made) == 6  # one taken, four waiting, one in the hand
        thread = ahead._thread
    assert not thread.is_alive()
    source.close()  # would raise if the thread still ran in it
    assert closed.is_set()
