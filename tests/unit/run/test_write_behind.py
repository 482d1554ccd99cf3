"""Writing in a thread changes nothing about what is written, and its errors come out."""

import threading

import pytest

from arfx.run.source import behind


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
