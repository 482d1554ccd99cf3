"""Reading ahead in a thread changes nothing about what is read, and ends when nobody wants more."""

import threading
import time

import pytest

from arfx.run.background_io import Prefetch, WriteBehind


def test_the_items_come_in_order_and_then_it_is_over():
    with Prefetch(iter(range(100)), depth=3) as ahead:
        assert list(ahead) == list(range(100))
        with pytest.raises(StopIteration):
            next(ahead)


def test_an_error_comes_after_the_items_before_it():
    def items():
        yield 1
        yield 2
        raise OSError("broken off")

    with Prefetch(items()) as ahead:
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
    with Prefetch(source, depth=4) as ahead:
        assert next(ahead) == 0
        while len(made) < 6:
            time.sleep(0.01)
        time.sleep(0.1)
        assert len(made) == 6  # one taken, four waiting, one in the hand
        (thread,) = ahead._pool._threads
    assert not thread.is_alive()
    source.close()  # would raise if the thread still ran in it
    assert closed.is_set()


def test_what_is_put_is_taken_in_order_in_another_thread():
    taken = []
    with WriteBehind(lambda k: taken.append((k, threading.get_ident())), depth=2) as behind:
        for k in range(50):
            behind.put(k)
    assert [k for k, _ in taken] == list(range(50))
    (thread,) = behind._pool._threads
    assert {i for _, i in taken} == {thread.ident} != {threading.get_ident()}
    assert not thread.is_alive()


def test_an_error_in_the_thread_comes_out_once_and_nothing_is_taken_after_it():
    taken = []

    def take(k):
        if k == 3:
            raise OSError("disk full")
        taken.append(k)

    with pytest.raises(OSError, match="disk full"), WriteBehind(take) as behind:
        for k in range(100):
            behind.put(k)
    assert taken == [0, 1, 2]
    with pytest.raises(OSError, match="disk full"), WriteBehind(take) as behind:
        behind.put(3)  # the last: only leaving can tell


def test_after_an_error_outside_what_waits_is_left():
    taken, gate, begun = [], threading.Event(), threading.Event()

    def take(k):
        begun.set()
        gate.wait()
        taken.append(k)

    def open_when_left(behind):
        while not behind._failed:
            time.sleep(0.001)
        gate.set()

    with pytest.raises(ValueError, match="stop"), WriteBehind(take, depth=4) as behind:
        for k in range(4):
            behind.put(k)
        begun.wait()
        threading.Thread(target=open_when_left, args=(behind,)).start()
        raise ValueError("stop")
    assert taken == [0]
    assert not any(thread.is_alive() for thread in behind._pool._threads)
