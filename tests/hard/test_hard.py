"""The small version of `make hard`: every sweep, that a broken one is caught, and that
every stated case has its test.

The hard scenes themselves are run by tests/golden, the stated cases where they are written.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.hard import clips
from tests.hard.cases import CASES
from tests.hard.closed_forms import CLOSED_FORMS
from tests.hard.estimates import ESTIMATES
from tests.hard.pixels import PIXELS
from tests.hard.sweeps import (
    ANSWER,
    CAMERA,
    DELTAS,
    EITHER,
    EXACT,
    REFUSAL,
    Answer,
    Expected,
    Sweep,
    always,
    least_sigma,
    run,
)

ROOT = Path(__file__).parents[2]
SWEEPS = (*CLOSED_FORMS, *ESTIMATES)
FEW = DELTAS[::3]


@pytest.mark.parametrize(
    "sweep", SWEEPS, ids=[f"{s.name} to {s.towards}" for s in SWEEPS]
)
def test_answers_and_refusals_are_what_is_owed(sweep: Sweep) -> None:
    for r in run(
        replace(sweep, kinds=tuple(draws[:2] for draws in sweep.kinds)), FEW
    ):
        assert not r.wrong, f"{r.formula} {r.kind}: {r.wrong}"


@pytest.mark.parametrize("sweep", PIXELS, ids=[s.towards for s in PIXELS])
def test_answers_and_refusals_through_pixels(sweep: Sweep) -> None:
    (found,) = run(replace(sweep, kinds=(CAMERA[:2],)), sweep.deltas[::3])
    assert (
        not found.wrong
        and found.count(ANSWER)[0] >= 2
        and found.count(REFUSAL)[0] >= 1
    ), found


_SINGULAR = [
    "turns edge-on",
    "is covered by 0 to 95 %",
    "a card slides along a side",
    "is blurred by 1 to 60 px",
]


@pytest.mark.parametrize("name", _SINGULAR)
def test_poses_towards_a_singularity_are_as_good_as_they_say(name: str) -> None:
    clip = next(c for c in clips.CLIPS if c.name == name)
    found = clips.analyse(clip)
    assert not found.wrong and (found.opacity == 0).any() and found.owed.any(), (
        found.wrong
    )


def test_the_sweeps_show_what_is_wrong_in_print() -> None:
    named = {s.name: s for s in SWEEPS}
    paper = {
        name: next(r for r in run(named[name], FEW) if r.formula == "paper")
        for name in ("voxel wall", "weight of a normal, eq. 8")
    }
    assert paper["voxel wall"].worst == pytest.approx(0.875, abs=0.1), (
        "a wall leaks 87.5 % at level 3"
    )
    assert paper["weight of a normal, eq. 8"].worst > 0.05, "a cusp"


def _sweep(answer: Answer | None, expected: Expected) -> list[str]:
    made = Sweep(
        "",
        "",
        "",
        lambda *_: answer,
        lambda *_: expected,
        kinds=((EXACT,),),
        deltas=(1.0,),
    )
    return run(made)[0].wrong


def test_what_is_judged_wrong() -> None:
    assert _sweep(None, Expected(ANSWER, 1.0)), "refused where an answer is owed"
    assert _sweep(Answer(0.0), Expected(REFUSAL, 1.0)), "answered where a refusal is"
    assert not _sweep(None, Expected(REFUSAL, 1.0)) and not _sweep(
        None, Expected(EITHER, 1.0)
    )
    assert not _sweep(Answer(3.0), Expected(ANSWER, 1.0)) and not _sweep(
        Answer(3.0), Expected(EITHER, 1.0)
    )
    for bad in (5.0, np.nan, np.inf):
        assert _sweep(Answer(bad), Expected(ANSWER, 1.0)) and _sweep(
            Answer(bad), Expected(EITHER, 1.0)
        )
    assert not _sweep(Answer(5.0, stated=2.0), Expected(ANSWER, 1.0)), "it said so"
    assert _sweep(Answer(5.0, stated=0.1), Expected(ANSWER, 1.0))
    assert always(1.0, 2.0)(0.1, EXACT).bound == 0.25


def test_least_sigma_is_that_of_a_line() -> None:
    x = np.array([-1.0, 0.0, 1.0, 2.0])
    found = least_sigma(lambda p: p[0] + p[1] * x, [0.0, 0.0], 0.1)
    a = np.stack([np.ones(4), x], 1)
    assert np.allclose(found, 0.01 * np.linalg.inv(a.T @ a), rtol=1e-6)
    assert np.isinf(least_sigma(lambda p: p[0] + p[1] + 0 * x, [0.0, 0.0], 0.1)).all()


def test_every_stated_case_names_tests_that_exist() -> None:
    for case in CASES:
        for node in case.tests:
            file, name = node.split("::")
            assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8"), node
