from __future__ import annotations

import numpy as np
import pytest

from arfx.core.colour import Transfer, yuv_from_rgb
from arfx.core.marker import FAMILIES, MarkerSpec, canonical_family
from arfx.core.numerics import angle_between, condition, divide, normalise
from arfx.core.units import length_m, time_s
from arfx.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("25mm", 0.025),
        ("0.165m", 0.165),
        ("6.5in", 0.1651),
        ("-2 cm", -0.02),
        ("1ft", 0.3048),
        ("0", 0.0),
    ],
)
def test_lengths(text: str, metres: float) -> None:
    assert length_m(text) == pytest.approx(metres, abs=1e-12)


@pytest.mark.parametrize("text", ["25", "mm", "5 parsec", "", "1e999m", "3,5cm"])
def test_lengths_without_unit_or_sense_are_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        length_m(text)


@pytest.mark.parametrize(
    ("text", "s"),
    [
        ("1.5", 1.5),
        ("90s", 90),
        ("2min", 120),
        ("01:02.5", 62.5),
        ("1:02:03", 3723),
        ("500ms", 0.5),
    ],
)
def test_times(text: str, s: float) -> None:
    assert time_s(text) == pytest.approx(s)


@pytest.mark.parametrize(
    "name",
    ["36h11", "tag36h11", "APRILTAG_36h11", "DICT_APRILTAG_36H11", "april tag 36h11"],
)
def test_family_spellings(name: str) -> None:
    if " " in name:
        with pytest.raises(ConfigError, match="36h11"):
            canonical_family(name)
    else:
        assert canonical_family(name) == "36h11"


def test_every_family_exists_in_opencv_with_that_many_ids() -> None:
    import cv2

    for family, count in FAMILIES.items():
        names = [
            f"DICT_{family}",
            f"DICT_ARUCO_{family}",
            f"DICT_APRILTAG_{family}",
            f"DICT_ARUCO_{family.upper()}",
        ]
        name = next(n for n in names if hasattr(cv2.aruco, n))
        assert (
            len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList)
            == count
        ), family


def test_marker_specs() -> None:
    m = MarkerSpec.parse("tag36h11:3:165.1mm")
    assert (m.key, m.size_m) == (
        "36h11:3",
        pytest.approx(0.1651),
    ) and MarkerSpec.parse(str(m)) == m
    assert np.allclose(m.corners_m[0], [-0.08255, 0.08255, 0])
    for bad in (
        "36h11:3",
        "36h11:x:1cm",
        "36h11:587:1cm",
        "36h11:3:0mm",
        "nope:1:1cm",
    ):
        with pytest.raises(ConfigError):
            MarkerSpec.parse(bad)


@pytest.mark.parametrize("name", ["srgb", "bt709", "bt1886", "gamma:2.2"])
def test_transfers_invert_and_are_continuous(name: str) -> None:
    t = Transfer(name)
    v = np.linspace(0, 1.2, 5001)
    np.testing.assert_allclose(t.encode(t.decode(v)), v, atol=2e-6)
    assert (np.diff(t.decode(v)) > 0).all() and np.diff(t.decode(v)).max() < 2e-3
    with pytest.raises(ConfigError):
        Transfer("gamma:x")


def test_half_a_shadow_on_200_is_146() -> None:
    t = Transfer("srgb")
    assert round(float(t.encode(0.5 * t.decode(np.float64(200 / 255)))) * 255) == 146


@pytest.mark.parametrize("matrix", ["bt709", "bt601", "bt2020"])
def test_yuv_of_grey_has_no_chroma_and_is_full_scale(matrix: str) -> None:
    m = yuv_from_rgb(matrix)
    np.testing.assert_allclose(m @ np.ones(3), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(
        np.abs(m @ np.array([[0, 0, 1], [1, 0, 0]]).T)[[1, 2], [0, 1]], 0.5
    )


def test_guarded_operations_on_hard_values() -> None:
    hard = np.array([0.0, -0.0, 1e-320, np.inf, -np.inf, np.nan, 1e308, 1.0])
    assert np.isfinite(divide(1.0, hard)).all() and divide(0.0, 0.0, 7.0) == 7.0
    assert np.isfinite(
        normalise(
            np.array(
                [
                    [0.0, 0, 0],
                    [1e-300, 0, 0],
                    [np.inf, 1, 0],
                    [np.nan, 0, 0],
                    [3, 4, 0],
                ]
            )
        )
    ).all()
    for delta in (1e-1, 1e-4, 1e-8, 1e-12):
        a, b = np.array([1.0, 0, 0]), np.array([np.cos(delta), np.sin(delta), 0])
        assert angle_between(a, b) == pytest.approx(delta, rel=1e-3)
        assert angle_between(a, -b) == pytest.approx(np.pi - delta, abs=1e-12)
    assert (
        condition(np.zeros((2, 2))) == np.inf
        and condition(np.full((2, 2), np.nan)) == np.inf
    )
    assert condition(np.diag([4.0, 2])) == 2
