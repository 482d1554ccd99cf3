"""Reading ahead in a thread changes nothing about what is read, and ends when nobody wants more."""

import threading
import time
from contextlib import closing

import pytest

from arfx.run.background_io import ahead, behind


def test_the_items_come_in_order_and_then_it_is_over():
    items = ahead(iter(range(100)), depth=3)
    assert list(items) == list(range(100))
    with pytest.raises(StopIteration):
        next(items)


def test_an_error_comes_after_the_items_before_it():
    def items():
        yield 1
        yield 2
        raise OSError("broken off")

    with closing(ahead(items())) as read:
        assert next(read) == 1 and next(read) == 2
        with pytest.raises(OSError, match="broken off"):
            next(read)


def test_no_more_than_depth_wait_and_the_thread_ends_on_leaving():
    made, threads, closed = [], set(), threading.Event()

    def items():
        try:
            for k in range(1000):
                made.append(k)
                threads.add(threading.current_thread())
                yield k
        finally:
            closed.set()

    source = items()
    with closing(ahead(source, depth=4)) as read:
        assert next(read) == 0
        while len(made) < 6:
            time.sleep(0.01)
        time.sleep(0.1)
        assert len(made) == 6  # one taken, four waiting, one in the hand
    (thread,) = threads
    assert not thread.is_alive()
    source.close()  # would raise if the thread still ran in it
    assert closed.is_set()


def test_what_is_put_is_taken_in_order_in_another_thread():
    taken = []
    with behind(
        lambda k: taken.append((k, threading.current_thread())), depth=2
    ) as put:
        for k in range(50):
            put(k)
    assert [k for k, _ in taken] == list(range(50))
    (thread,) = {thread for _, thread in taken}
    assert thread is not threading.current_thread() and not thread.is_alive()


def test_an_error_in_the_thread_comes_out_once():
    taken = []

    def take(k):
        if k >= 3:
            raise OSError("disk full")
        taken.append(k)

    with pytest.raises(OSError, match="disk full"), behind(take) as put:
        for k in range(100):
            put(k)
    assert taken == [0, 1, 2]
    with pytest.raises(OSError, match="disk full"), behind(take) as put:
        put(3)  # the last: only leaving can tell


def test_after_an_error_outside_what_waits_is_left():
    taken, gate, begun = [], threading.Event(), threading.Event()

    def take(k):
        begun.set()
        gate.wait()
        taken.append(k)

    with pytest.raises(ValueError, match="stop"), behind(take, depth=4) as put:
        for k in range(4):
            put(k)
        begun.wait()
        threading.Timer(0.2, gate.set).start()
        raise ValueError("stop")
    assert taken == [0]
