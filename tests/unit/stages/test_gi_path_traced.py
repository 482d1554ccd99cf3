"""Every level beside an outside path tracer's pictures
(sample_scenes/0041-indirect-light/path-traced): PSNR and mean error.
"""

from __future__ import annotations

from functools import cache

import pytest

from tests.unit.stages.gi_path_traced import NAMES, NO_GI, REGIONS, errors

UNSEEN_GREY = 0.5  # mean error that no display shows


@cache
def without(name: str) -> dict[str, tuple[float, float]]:
    return errors(name, NO_GI)


@cache
def standard(name: str) -> dict[str, tuple[float, float]]:
    return errors(name, "standard")


@pytest.mark.parametrize("name", NAMES)
def test_standard_halves_the_error_of_no_indirect_light(name: str) -> None:
    found = standard(name)
    for region in REGIONS:
        psnr_db, grey = found[region]
        assert psnr_db >= 36, (region, psnr_db)
        assert grey <= 0.5 * without(name)[region][1] + 0.01, (
            region,
            grey,
            without(name)[region],
        )


@pytest.mark.parametrize("name", NAMES)
def test_draft_is_nearer_than_nothing(name: str) -> None:
    found = errors(name, "draft")
    for region in REGIONS:
        assert found[region][1] <= max(0.9 * without(name)[region][1], UNSEEN_GREY)


@pytest.mark.parametrize("name", ["coloured-box", "mirror-ball", "glowing-ball"])
def test_standard_is_near_at_the_contact(name: str) -> None:
    assert standard(name)["contact"][1] < 0.6


def test_planes_take_each_others_change() -> None:
    """The floor's shadow is missing from the wall: twice the error where each plane is on
    its own.
    """
    assert standard("box-in-a-corner")["plane"][1] < 0.35


def test_a_lamps_shadow_in_a_corner_is_as_deep_as_the_wall_makes_it() -> None:
    """45 dB where the soft light that is left in the shadow is taken as if no wall stood
    beside it.
    """
    assert standard("box-in-a-corner")["contact"][0] > 48


def test_a_mirror_shows_no_ring_at_the_horizon() -> None:
    """1.2 grey levels where the plane beyond the picture has the mean of what the object shades."""
    assert standard("mirror-ball")["object"][1] < 0.9


@pytest.mark.parametrize(
    ("name", "samples"),
    [("coloured-box", 24), ("mirror-ball", 8), ("box-in-a-corner", 16)],
)
def test_our_reference_agrees_with_the_outside_one(name: str, samples: int) -> None:
    """Few samples: noise is part of the error.

    With 64 all four scenes are over 42 dB in every region.
    """
    for region, (psnr_db, _) in errors(name, "reference", samples).items():
        assert psnr_db >= 40, region
