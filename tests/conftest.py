"""What tests of several rooms share."""

from __future__ import annotations

import gc
import inspect
import os
import re
import signal
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from arfx.errors import RenderError

# `make check` tries the same examples every time: what it says of one commit does not change
# from run to run. `make fuzz` looks for new ones.
hypothesis.settings.register_profile("check", derandomize=True)
hypothesis.settings.load_profile("check")

# As `arfx` does, before numpy reads it: two test processes with a pool of threads each get
# in each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Where bytecode is not to be written every process that a test starts would compile that of
# arfx again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# until all tests are collected: what importing makes stays, and was looked over for a
# quarter of that time
gc.disable()

STARTS = r"""apart=True|\benv=|subprocess|Popen|at_a_moment|Thread|run_(threads|processes)|(ahead|behind)\(
    |raise_signal|os\.kill"""


# Files that take long, the longest first. Their tests come first, dealt out to as many
# heaps as there are test processes. Short tests follow: a process that is done takes half
# of what is left off the end of another's list. So both end together, and what the tests of
# a file share is made once.
LONG = (
    "golden/test_sample_scenes", "cli/test_cluster", "cli/test_opengl_jobs", "unit/reproduce/test_papers", "cli/test_process",
    "unit/stages/test_gi", "unit/stages/test_dof", "plugins/test_film_grain", "unit/run/test_stretches",
    "unit/analyse/light/test_sweep", "real/test_calibration", "unit/calibrate/test_calibration",
    "property/test_joined_stretches", "real/test_markers", "contract/test_stages", "cli/test_messages",
    "unit/stages/test_gi_path_traced", "unit/analyse/motion/test_flow", "real/test_main_job", "cli/test_resume",
    "cli/test_calibrate", "unit/run/test_damaged_job", "cli/test_occlusion", "cli/test_signals",
    "unit/analyse/depth/test_planes", "hard/test_hard", "golden/test_presets", "unit/stages/test_lightmap_plane",
    "unit/stages/test_raster", "unit/run/test_savings", "cli/test_batch", "unit/stages/test_watercolor_stage",
    "unit/run/test_analysis", "cli/test_inspect", "cli/test_streams", "architecture/test_wheel", "cli/test_light",
    "cli/test_anchor_plane", "cli/test_depth", "cli/test_report", "unit/papers/test_s4_gi", "cli/test_platforms",
    "cli/test_bench",
)  # fmt: skip


def longest_first(items: list[pytest.Item], processes: int) -> list[pytest.Item]:
    """In the order in which they are shared out: to each process in turn as many as to any
    other, one behind the other.
    """
    here = Path(__file__).parent
    names = [
        (
            item.path.relative_to(here).with_suffix("").as_posix()
            if here in item.path.parents
            else ""
        )
        for item in items
    ]
    ranks = {name: rank for rank, name in enumerate(LONG)}
    short, files = list[pytest.Item](), defaultdict[int, list[pytest.Item]](list)
    for item, name in zip(items, names, strict=True):
        (files[ranks[name]] if name in ranks else short).append(item)
    heaps: list[list[pytest.Item]] = [[] for _ in range(processes)]
    for n, rank in enumerate(sorted(files)):  # there and back: 0 1 1 0 0 1 …
        turn = n % (2 * processes)
        heaps[min(turn, 2 * processes - 1 - turn)] += files[rank]
    out, left = [], len(items)
    for k, heap in enumerate(heaps):
        more = max(left // (processes - k) - len(heap), 0)
        out += [*heap, *short[:more]]
        short, left = short[more:], left - len(heap) - more
    return [*out, *short]


def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Files in LONG come first. `-m process` takes every test whose source starts a process
    or a thread or sends a signal, marked by hand or not."""
    items[:] = longest_first(
        items, getattr(config, "workerinput", {}).get("workercount", 1)
    )
    if "process" in config.getoption("markexpr"):
        for item in items:
            if isinstance(item, pytest.Function) and re.search(
                STARTS, inspect.getsource(item.function), re.VERBOSE
            ):
                item.add_marker(pytest.mark.process)


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Signals as at a terminal: tests started in the background, or by nohup, leave them
    ignored, for children too.
    """
    names = [
        getattr(signal, name)
        for name in ("SIGINT", "SIGHUP")
        if hasattr(signal, name)
    ]
    before = [signal.signal(name, signal.default_int_handler) for name in names]
    yield
    for name, handler in zip(names, before, strict=True):
        signal.signal(name, handler)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked `opengl` run where a context opens in this process, and are skipped with
    the reason elsewhere.
    """
    if item.get_closest_marker("opengl"):
        from arfx.stages.raster.gl_context import open_context

        try:
            item.user_properties.append(("OpenGL", open_context().detail))
        except RenderError as e:
            pytest.skip(e.message)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """What ran by OpenGL, or why nothing did: nobody has to look for it among the skips."""
    stats = terminalreporter.stats
    told = {
        v
        for group in ("passed", "failed")
        for r in stats.get(group, ())
        for k, v in r.user_properties
        if k == "OpenGL"
    }
    reasons = {
        r.longrepr[2].removeprefix("Skipped: ")
        for r in stats.get("skipped", ())
        if isinstance(r.longrepr, tuple)
    }
    told |= {
        f"not tested, because {reason}" for reason in reasons if "OpenGL" in reason
    }
    for line in sorted(told):
        terminalreporter.write_line(f"OpenGL: {line}")
