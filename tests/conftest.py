"""What tests of several rooms share."""

from __future__ import annotations

import gc
import inspect
import os
import re
import signal
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from arfx.errors import RenderError

# As `arfx` does, before numpy reads it: two test processes with a pool of threads each get in each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Where bytecode is not to be written every process that a test starts would compile that of arfx again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

gc.disable()  # until all tests are collected: what importing makes stays, and was looked over for a quarter of that time

STARTS = r"""apart=True|\benv=|subprocess|Popen|at_a_moment|Thread|run_(threads|processes)|(Prefetch|WriteBehind|BackgroundTask)\(
    |raise_signal|os\.kill"""


# Their tests share what takes long to make. Test processes take tests off the end of each other's lists: there it is made twice.
TOGETHER = {"test_film_grain.py", "test_main_job.py", "test_markers.py", "test_opengl_jobs.py", "test_presets.py"}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files in TOGETHER come first. `-m process` takes every test whose source starts a process or a thread or sends a signal,
    marked by hand or not."""
    items.sort(key=lambda item: item.path.name not in TOGETHER)
    if "process" in config.getoption("markexpr"):
        for item in items:
            if isinstance(item, pytest.Function) and re.search(STARTS, inspect.getsource(item.function), re.VERBOSE):
                item.add_marker(pytest.mark.process)


def pytest_configure(config: pytest.Config) -> None:
    """Before several test processes compile the same kernels side by side, what jobs call is compiled once."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        from arfx.run.kernels import compile_ahead
        from arfx_cli.console import Progress

        with Progress() as progress:
            compile_ahead(None, progress)


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Signals as at a terminal: tests started in the background, or by nohup, leave them ignored, for children too."""
    names = [getattr(signal, name) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name)]
    before = [signal.signal(name, signal.default_int_handler) for name in names]
    yield
    for name, handler in zip(names, before, strict=True):
        signal.signal(name, handler)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked `opengl` run where a context opens in this process, and are skipped with the reason elsewhere."""
    if item.get_closest_marker("opengl"):
        from arfx.stages.raster.gl_context import open_context

        try:
            item.user_properties.append(("OpenGL", open_context().detail))
        except RenderError as e:
            pytest.skip(e.message)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """What ran by OpenGL, or why nothing did: nobody has to look for it among the skips."""
    stats = terminalreporter.stats
    told = {v for group in ("passed", "failed") for r in stats.get(group, ()) for k, v in r.user_properties if k == "OpenGL"}
    reasons = {r.longrepr[2].removeprefix("Skipped: ") for r in stats.get("skipped", ()) if isinstance(r.longrepr, tuple)}
    told |= {f"not tested, because {reason}" for reason in reasons if "OpenGL" in reason}
    for line in sorted(told):
        terminalreporter.write_line(f"OpenGL: {line}")
