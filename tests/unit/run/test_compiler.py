"""Kernels that a helper process compiles: kept, the same as compiled by numba alone, and
nothing else is kept.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba

from arfx.run import compiler

MODULE = """
import numba
import numpy as np

@numba.njit(cache=True)
def part(x, y):
    return x * y + x / (1.0 + y * y)

@numba.njit(cache=True)
def inner(a, y):
    return part(a, y) - np.sqrt(abs(a))

@numba.njit(cache=True)
def whole(a, out):
    room = np.empty(len(a))
    for i in range(len(a)):
        room[i] = inner(a[i], 2.5)
    for i in range(len(a)):
        out[i] = part(room[i], 0.5) + room.sum()
"""
ROWS = [
    [
        "kernels_here",
        "whole",
        (
            "(Array(float64, 1, 'C', False, aligned=True), Array(float64, 1, 'C', False,"
            " aligned=True))"
        ),
    ]
]
ROWS += [["kernels_here", "inner", "(float64, float64)"]]
COMPILE = "from arfx.run.kernels import Kernel, _compile"
CALL = """
import numpy as np
import kernels_here
a, out = np.linspace(-2, 3, 50), np.empty(50)
kernels_here.whole(a, out)
print(out.tobytes().hex(), kernels_here.inner(2.0, 3.0), sum(kernels_here.whole.stats.cache_hits.values()), end=" ")
print(sum(kernels_here.inner.stats.cache_hits.values()))
"""


def run(code: str, folder: Path) -> str:
    here = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=here,
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def test_a_helper_keeps_what_it_is_asked_for_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "kernels_here.py").write_text(MODULE)
    alone = run(CALL, tmp_path).rsplit(maxsplit=2)[0]
    for file in (tmp_path / "__pycache__").iterdir():
        file.unlink()
    run(f"{COMPILE}\n_compile([Kernel(*row, 1.0) for row in {ROWS}], print)", tmp_path)
    kept = sorted(
        file.name.split("-")[0] for file in (tmp_path / "__pycache__").glob("*.nbi")
    )
    assert kept == ["kernels_here.inner", "kernels_here.whole"]
    *same, hits_whole, hits_inner = run(CALL, tmp_path).split()
    assert " ".join(same) == alone
    assert (hits_whole, hits_inner) == ("1", "1")


def test_it_was_tried_with_the_numba_that_is_used_here() -> None:
    """If this fails: does the test above hold with the new one, and is it still quicker?
    Then compiler.TRIED is its version.
    """
    assert numba.__version__.startswith(compiler.TRIED)
