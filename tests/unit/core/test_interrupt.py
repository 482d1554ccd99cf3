"""No signal is lost, whoever swallows what it raises, and none changes an outcome that stands."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading

import pytest

from arfx.core import interrupt

pytestmark = [pytest.mark.process, pytest.mark.usefixtures("ctrl_c")]


def press(number: int = signal.SIGINT) -> None:
    signal.raise_signal(number)


def test_a_signal_that_is_swallowed_is_raised_again() -> None:
    with interrupt.catching():
        with contextlib.suppress(
            BaseException
        ):  # as libraries do while they are imported
            press(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            interrupt.check()
        assert (interrupt.exit_code(), interrupt.cause()) == (
            143,
            "stopped by SIGTERM",
        )
        interrupt._now.number = 0
    interrupt.check()


@pytest.mark.parametrize(
    ("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)]
)
def test_every_signal_has_its_code(name: str, code: int) -> None:
    with pytest.raises(KeyboardInterrupt), interrupt.catching():
        try:
            press(getattr(signal, name))
        finally:
            assert interrupt.exit_code() == code


def test_what_must_be_whole_is_not_cut_in_two() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), interrupt.catching():
        with interrupt.deferred():
            press()
            interrupt.check()
            done.append("all of it")
        done.append("more")
    assert done == ["all of it"]


def test_before_an_output_is_in_place_a_signal_stops_it() -> None:
    with pytest.raises(KeyboardInterrupt), interrupt.catching():
        with contextlib.suppress(KeyboardInterrupt):
            press()
        with interrupt.committing():
            pytest.fail("put in place all the same")


def test_once_an_output_is_in_place_none_changes_the_outcome() -> None:
    done = []
    with pytest.raises(
        KeyboardInterrupt
    ):  # behind it all, for the program that called the library
        with interrupt.catching():
            with interrupt.committing():
                press()
                done.append("in place")
            interrupt.check()
            assert interrupt.exit_code() == 0
            done.append("reported")
        pytest.fail("lost")
    assert (
        done == ["in place", "reported"]
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )


def test_a_signal_that_came_too_late_for_one_job_stops_the_next() -> None:
    with pytest.raises(KeyboardInterrupt), interrupt.catching():
        with interrupt.committing():
            press()
        interrupt.resume()
        pytest.fail("lost")


def test_an_output_that_cannot_be_put_in_place_settles_nothing() -> None:
    with interrupt.catching():
        with pytest.raises(OSError), interrupt.committing():
            raise OSError("full")
        with pytest.raises(KeyboardInterrupt):
            press()
        interrupt._now.number = 0


def test_ignored_and_own_handlers_stay() -> None:
    before = signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # nohup, a script's background
    try:
        with interrupt.catching():
            press()
            interrupt.check()
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_threads_neither_hold_nor_raise() -> None:
    with interrupt.catching():
        inside, leave = threading.Event(), threading.Event()

        def work() -> None:
            with interrupt.deferred():
                inside.set()
                leave.wait()

        t = threading.Thread(target=work)
        t.start()
        inside.wait()
        with pytest.raises(KeyboardInterrupt):
            press()
        leave.set()
        t.join()
        interrupt._now.number = 0


def run(code: str) -> subprocess.CompletedProcess[str]:
    code = "import os, signal, sys, time\nfrom arfx.core import interrupt\n" + code
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def test_the_second_signal_ends_the_process_at_once_and_an_echo_of_the_first_does_not() -> (
    None
):
    echo = (
        "interrupt._SAME_SIGNAL_S = 1e9\ninterrupt.catch()\nwith interrupt.deferred():\n"
        " for _ in range(3): signal.raise_signal(signal.SIGINT)\n print('went on',"
        " flush=True)\n"
    )
    assert run(echo).stdout == "went on\n"
    second = echo.replace("1e9", "-1")
    done = run(second)
    assert (done.returncode, done.stdout) == (130, "")
    done = run(second.replace("with", "interrupt.commit()\nwith"))
    assert (done.returncode, done.stdout) == (0, ""), "the output is complete"
    done = run(second.replace("with", "interrupt.commit(5)\nwith"))
    assert (done.returncode, done.stdout) == (5, ""), "it had failed before"


def test_nothing_that_happens_at_the_end_changes_the_exit_code() -> None:
    done = run(
        "import atexit, threading\ninterrupt.catch()\n@atexit.register\ndef late():\n for n"
        " in interrupt.STOPPING: os.kill(os.getpid(), n)\n print('at"
        " exit')\nthreading.Thread(target=time.sleep,"
        " args=(1000,)).start()\ninterrupt.exit_process(7)"
    )
    assert (done.returncode, done.stdout, done.stderr) == (7, "at exit\n", "")


def test_a_signal_while_python_starts_arfx_is_not_lost() -> None:
    """Red with handlers of Python's own: what SIGINT raises in an import is swallowed, and
    --version answers with exit 0.
    """
    code = (
        "class Finder:\n def find_spec(self, name, *_):\n  if name == 'click':\n   try:"
        " signal.raise_signal(signal.{})\n   except BaseException:"
        " pass\nsys.meta_path.insert(0, Finder())\nsys.argv = ['arfx', '--version']\nfrom"
        " arfx_cli.__main__ import start\nstart()"
    )
    for number, code_, cause in (
        ("SIGINT", 130, "interrupted"),
        ("SIGTERM", 143, "stopped by SIGTERM"),
    ):
        done = run(code.format(number))
        assert (done.returncode, done.stdout, done.stderr) == (
            code_,
            "",
            cause + "\n",
        )


def test_a_worker_ends_with_its_parent() -> None:
    code = (
        "import multiprocessing\n"
        "def work(pipe):\n interrupt.in_worker(); pipe.send(0); time.sleep(1000)\n"
        "if __name__ == '__main__':\n"
        " mine, its = multiprocessing.get_context('fork').Pipe()\n"
        " multiprocessing.get_context('fork').Process(target=work, args=(its,)).start()\n"
        " mine.recv(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert (
        run(code).returncode == -signal.SIGKILL
    )  # it returns when the worker, too, has closed standard output
