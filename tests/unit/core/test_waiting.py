"""Work that counts no steps: told after two seconds, left at once on a signal."""

from __future__ import annotations

import signal
import threading
import time

import pytest

from arfx.core.waiting import wait_for
from arfx.errors import InputError


def test_what_the_work_returns_or_raises_comes_back_and_short_work_says_nothing() -> (
    None
):
    told: list[tuple[str, int, int | None]] = []
    assert wait_for("model", lambda: 3, lambda *a: told.append(a)) == 3 and not told

    def fail() -> None:
        raise InputError("damaged")

    with pytest.raises(InputError, match="damaged"):
        wait_for("model", fail, lambda *_: None)


def test_long_work_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("arfx.core.waiting._SOON_S", 0)
    told: list[tuple[str, int, int | None]] = []
    wait_for("model", lambda: time.sleep(1.5), lambda *a: told.append(a))
    assert told == [("model", 1, None)]


def test_a_signal_ends_the_wait_not_the_work() -> None:
    go_on, began = threading.Event(), time.monotonic()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Timer(0.2, signal.raise_signal, [signal.SIGINT]).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            wait_for("model", lambda: go_on.wait(20), lambda *_: None)
    finally:
        signal.signal(signal.SIGINT, before)
        go_on.set()
    assert time.monotonic() - began < 5
