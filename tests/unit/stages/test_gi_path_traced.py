"""Every level beside an outside path tracer's pictures (sample_scenes/0041-indirect-light/path-traced): PSNR and mean error."""

from __future__ import annotations

from functools import cache

import pytest

from tests.unit.stages.gi_path_traced import NAMES, NO_GI, REGIONS, errors

UNSEEN_GREY = 0.5  # mean error that no display shows


@cache
def without(name: str) -> dict[str, tuple[float, float]]:
    return errors(name, NO_GI)


@pytest.mark.parametrize("name", NAMES)
def test_standard_halves_the_error_of_no_indirect_light(name: str) -> None:
    found = errors(name, "standard")
    for region in REGIONS:
        psnr_db, grey = found[region]
        assert psnr_db >= 36, (region, psnr_db)
        assert grey <= max(0.5 * without(name)[region][1], UNSEEN_GREY), (region, grey, without(name)[region])


@pytest.mark.parametrize("name", NAMES)
def test_draft_is_nearer_than_nothing(name: str) -> None:
    found = errors(name, "draft")
    for region in REGIONS:
        assert found[region][1] <= max(0.9 * without(name)[region][1], UNSEEN_GREY)


@pytest.mark.parametrize("name", ["coloured-box"])
def test_high(name: str) -> None:
    for psnr_db, _ in errors(name, "high").values():
        assert psnr_db >= 36


@pytest.mark.parametrize(("name", "samples"), [("coloured-box", 24), ("mirror-ball", 8), ("box-in-a-corner", 16)])
def test_our_reference_agrees_with_the_outside_one(name: str, samples: int) -> None:
    """Few samples: noise is part of the error. With 64 all four scenes are over 42 dB in every region."""
    for region, (psnr_db, _) in errors(name, "reference", samples).items():
        assert psnr_db >= 40, region
