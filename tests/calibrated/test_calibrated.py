"""The small version of `make calibrated`, and that it notices what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.analyse.job import Analysis
from arfx.analyse.params import LightParams
from arfx.core.light import DirectionalLight, triple
from arfx.synth.clip import frame_truth
from arfx.synth.world import World
from tests.calibrated import clips, pixels, readings
from tests.calibrated.scenes import CASES, DISTANCE_M, clip_normals, drawn
from tests.calibrated.score import LIKELY, MEASURED, REFUSED, Claim, Row, goals

NAMED = {case.name: case for case in CASES}


def test_a_few_clips_of_every_kind_make_no_false_claim() -> None:
    rows = [
        clips.row((clips.READINGS, i, case.clips - 1))
        for i, case in enumerate(CASES)
        if case.clips and i % 2 == 0
    ]
    missed = [
        g
        for g in goals(rows)
        if not g.holds
        and ("false" in g.name or "refused" in g.name or "beyond" in g.name)
    ]
    assert not missed, missed
    assert sum(bool(r.claims) for r in rows if r.owed) >= 1, (
        "one that refuses all makes none either"
    )


def test_a_direction_that_is_off_is_noticed() -> None:
    """Lights that the analysis claims, on the other side."""
    truth = drawn(NAMED["one lamp, 50 to 65°"], 2)

    def lit(params: LightParams) -> Analysis:
        return readings.lit(truth, params)

    def mirrored(params: LightParams) -> Analysis:
        found = lit(params)
        facts = [
            f.with_(
                light=f.light
                and replace(f.light, lights=tuple(map(behind, f.light.lights)))
            )
            for f in found.facts
        ]
        return replace(found, facts=tuple(facts))

    def behind(light: DirectionalLight) -> DirectionalLight:
        return replace(light, direction=triple(-light.unit))

    good, bad = (clips.measured("readings", truth, fit) for fit in (lit, mirrored))
    assert good.claims and not any(c.false for c in good.claims)
    assert any(c.false for c in bad.claims)
    missed = {g.name for g in goals([bad]) if not g.holds}
    assert all(
        any(word in name for name in missed)
        for word in ("false", "median", "three cones")
    )


def claim(verdict: str, error_deg: float, mean_deg: float, cone_deg: float) -> Claim:
    return Claim(verdict, error_deg, mean_deg, error_deg, True, cone_deg, 10)


def row_of(
    verdict: str, *claims: Claim, owed: bool = False, never: bool = False
) -> Row:
    return Row(
        "readings", "a case", 0, 1, owed, never, verdict, "", claims, None, 0.0
    )


@pytest.mark.parametrize(
    ("rows", "missed"),
    [
        ([row_of(MEASURED, claim(MEASURED, 0.3, 0.3, 0.6), owed=True)], ()),
        ([row_of(MEASURED, claim(MEASURED, 5.0, 0.3, 1.0))], ("false",)),
        # of two lamps their mean, which looks the same, is not what the cone has to hold
        ([row_of(LIKELY, claim(LIKELY, 5.0, 0.3, 1.0))], ("false",)),
        ([row_of(LIKELY, claim(LIKELY, 50.0, 50.0, 12.0))], ("false",)),
        ([row_of(REFUSED, owed=True)], ("claimed",)),
        ([row_of(MEASURED, claim(MEASURED, 2.0, 2.0, 2.5), owed=True)], ("median",)),
        (
            [row_of(MEASURED, claim(MEASURED, 2.0, 2.0, 0.5), owed=True)],
            ("median", "three cones"),
        ),
        ([row_of(LIKELY, claim(LIKELY, 0.1, 0.1, 20.0), never=True)], ("refused",)),
        ([row_of(REFUSED, never=True)], ()),
    ],
)
def test_goals_are_missed_where_they_should_be(
    rows: list[Row], missed: tuple[str, ...]
) -> None:
    found = [g.name for g in goals(rows) if not g.holds and "hold " not in g.name]
    assert len(found) == len(missed) and all(
        any(word in name for name in found) for word in missed
    ), found


def test_a_simulated_surface_is_lit_as_the_lamp_and_an_even_sky_light_it() -> None:
    clip = drawn(replace(NAMED["one lamp, 50 to 65°"], size_deg=(0, 0)), 3)
    lamp = clip.lamps[0]
    for n in clip_normals(clip, 20):
        exact = clip.ambient + lamp.rgb * max(float(n @ lamp.direction), 0.0)
        assert clip.irradiance(n, 20) == pytest.approx(exact, rel=5e-3)


@pytest.mark.parametrize(
    "name",
    [
        "one print turned by hand, filmed",
        "moved half-way",
        "hand-held, cube of markers",
    ],
)
def test_what_is_filmed_is_what_was_drawn(name: str) -> None:
    """Print, lamps and camera of the filmed scene, against the drawn clip."""
    clip = drawn(NAMED[name], 1000, pixels.FRAMES)
    world = World(pixels.scene(clip))
    for n in (0, pixels.FRAMES - 1):
        truth = frame_truth(world, n)
        pose = truth.markers["36h11:3"].camera_from_marker
        on = [light for light in truth.lights if np.mean(light["rgb"]) > 0]
        axes = "camera" if clip.camera_rests else "marker"
        directions = [
            light[axes] if axes == "camera" else light[axes]["36h11:3"]
            for light in on
        ]
        np.testing.assert_allclose(
            directions,
            [lamp.direction for lamp in clip.lamps if lamp.on[n] > 0],
            atol=1e-6,
        )
        if clip.camera_rests:
            np.testing.assert_allclose(pose.rotation, clip.turns[n], atol=1e-6)
            np.testing.assert_allclose(
                pose.translation_m, clip.places_m[n], atol=1e-9
            )
        else:
            assert np.linalg.norm(pose.translation_m) == pytest.approx(
                DISTANCE_M, abs=0.02
            )


def test_equal_seeds_give_equal_clips_and_others_do_not() -> None:
    a, b, c = (
        readings.analysis(drawn(NAMED["gloss"], seed))[1][5][2].mean
        for seed in (1, 1, 2)
    )
    assert np.array_equal(a, b) and not np.array_equal(a, c)
