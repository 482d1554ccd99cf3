"""HLG and PQ by the formulas of ITU-R BT.2100-2, white by BT.2408; primaries."""

from __future__ import annotations

import math

import numpy as np
import pytest

from arfx.core.colour import Transfer, from_bt709

A, B = 0.17883277, 0.28466892  # BT.2100-2 table 5
C = 0.55991073


@pytest.mark.parametrize(
    ("name", "coded", "cd_m2"),
    [
        ("pq", 0.0, 0.0),
        ("pq", 0.5081, 100.0),  # BT.2408-7 table 1: levels of PQ
        ("pq", 0.5807, 203.0),
        ("pq", 0.7518, 1000.0),
        ("pq", 1.0, 10000.0),
    ],
)
def test_pq_is_light_of_the_display(name: str, coded: float, cd_m2: float) -> None:
    light = float(Transfer(name).decode(np.array(coded)))
    assert light * 203 == pytest.approx(cd_m2, rel=1e-3, abs=1e-9)


def test_hlg_is_light_of_the_scene_with_diffuse_white_at_three_quarters() -> None:
    white = (math.exp((0.75 - C) / A) + B) / 12
    assert 1000 * white**1.2 == pytest.approx(203, rel=2e-3), (
        "on a display of 1000 cd/m2"
    )
    t = Transfer("hlg")
    for coded, scene in (
        (0.0, 0.0),
        (0.25, 1 / 48),
        (0.5, 1 / 12),
        (0.75, white),
        (1, 1),
    ):
        assert float(t.decode(np.array(coded))) == pytest.approx(
            scene / white, abs=1e-6
        )


@pytest.mark.parametrize("name", ["hlg", "pq"])
def test_coded_values_come_back_also_beyond_black_and_white(name: str) -> None:
    t, v = Transfer(name), np.linspace(-0.3, 1.3, 3001)
    np.testing.assert_allclose(t.encode(t.decode(v)), v, atol=1e-9)
    assert (np.diff(t.decode(np.linspace(-1.5, 2.5, 4001))) >= 0).all()


def test_colours_of_models_in_the_primaries_of_bt2020() -> None:
    """ITU-R BT.2087-0, the matrix M2."""
    expected = [
        [0.6274, 0.3293, 0.0433],
        [0.0691, 0.9195, 0.0114],
        [0.0164, 0.0880, 0.8956],
    ]
    found = from_bt709(9)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    np.testing.assert_allclose(np.asarray(found).sum(1), 1, atol=1e-12)
    assert from_bt709(1) is None and from_bt709(2) is None
