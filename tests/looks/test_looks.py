"""The short form of `make looks`: one clip of each kind, and that what is wrong is noticed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.looks import film, gates
from tests.looks.gates import LOOKS, findings, shown

SHORT = {
    "constant, six tilted prints": 40,
    "dim, six small prints": 40,
    "blue ink": 36,
    "steps of 20 %": 48,
    "hand over its own print": 48,
}


@pytest.mark.parametrize("name", SHORT)
def test_the_light_holds_on_a_telephones_clip(name: str) -> None:
    (look, measures), *_ = [of for of in LOOKS if of[0].name == name]
    missed = [
        f
        for f in findings(replace(look, frames=SHORT[name]), measures)
        if not f.holds
    ]
    assert not missed


def test_light_that_flickers_or_lags_is_noticed() -> None:
    look = film.Look("made up", film.Phone(film.steps), frames=60)
    truth = film.true_lights(look, of_object=True)
    rng = np.random.default_rng(0)
    none = [np.zeros(3)] * look.frames
    exact = shown(truth, none)

    def missed(lights: list) -> set[str]:
        s = gates.Seen(look, None, np.zeros(3), shown(lights, none), exact)  # type: ignore[arg-type]
        every = (gates.luma_flicker(s), gates.chroma_flicker(s), gates.behind(s))
        return {f.gate.split(",")[0] for f in every if not f.holds}

    assert missed(truth) == set()
    assert missed(
        [one.scaled(1 + 0.02 * rng.normal() * np.ones(3)) for one in truth]
    ) == {
        "luma",
        "luma behind the exposure",
    }
    assert "chroma" in missed(
        [one.scaled(1 + 0.02 * rng.normal(size=3)) for one in truth]
    )
    late = [truth[max(k - 3, 0)] for k in range(look.frames)]
    assert "luma behind the exposure" in missed(late)
