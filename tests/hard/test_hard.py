"""The small version of `make hard`: every sweep, that a broken one is caught, and that every stated case has its test.

The hard scenes themselves are run by tests/golden, the stated cases where they are written.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.hard.cases import CASES
from tests.hard.sweeps import DELTAS, SWEEPS, run

ROOT = Path(__file__).parents[2]
FEW = DELTAS[::3]


@pytest.mark.parametrize("sweep", SWEEPS, ids=[f"{s.name} to {s.towards}" for s in SWEEPS])
def test_errors_stay_bounded_or_are_refused(sweep) -> None:  # type: ignore[no-untyped-def]
    for r in run(sweep, FEW):
        assert r.sound, f"{r.formula} {r.kind}: {r.errors}"


def test_the_sweeps_show_what_is_wrong_in_print() -> None:
    named = {s.name: s for s in SWEEPS}
    paper = {
        name: next(r for r in run(named[name], FEW) if r.formula == "paper")
        for name in ("voxel wall", "weight of a normal, eq. 8")
    }
    assert paper["voxel wall"].worst == pytest.approx(0.875, abs=0.1), "a wall leaks 87.5 % at level 3"
    assert paper["weight of a normal, eq. 8"].worst > 0.05, "a cusp"


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e3])
def test_a_value_that_is_not_finite_or_too_far_off_is_caught(wrong: float) -> None:
    broken = replace(SWEEPS[0], error=lambda delta, formula, rounded: wrong if delta < 1e-3 else 0.0)
    assert not any(r.sound for r in run(broken, FEW))
    assert all(r.sound for r in run(replace(broken, error=lambda *_: None), FEW)), "a refusal is no error"


def test_every_stated_case_names_tests_that_exist() -> None:
    for case in CASES:
        for node in case.tests:
            file, name = node.split("::")
            assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8"), node
