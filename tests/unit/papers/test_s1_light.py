"""Tan, Chen, Sun 2009 as printed: peaks of the map, and the light made of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.analyse.job import Analysis
from arfx.core.cube import look_up
from arfx.core.facts import read_facts, write_facts
from arfx.core.numerics import angle_between, normalise
from arfx.papers.s1_light import (
    LightMap,
    Observation,
    PrintedLight,
    PrintedLightParams,
    eq8_weight,
    eq9_lights,
    hemisphere,
    lights_of,
    squared_weight,
    upright,
)
from arfx.papers.s1_lightmap import printed_map
from tests.unit.analyse.light.test_light import AMBIENT, DIRECT, LAMP, UP, Clip
from tests.unit.analyse.light.test_light import run as corrected


def run(clip: Clip, **settings: Any) -> Analysis:
    analysis, taken = clip.made()
    params = PrintedLightParams(**settings)
    return PrintedLight.with_light(
        analysis, taken.readings, taken.samples, params, None
    )


def seen(normals: list[np.ndarray] | np.ndarray, level: float = 0.6) -> Observation:
    """Of one frame. level : light of each"""
    n = np.atleast_2d(normals)
    return Observation(n, np.full(n.shape, level), np.full(n.shape, 1e-6))


def off_deg(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.degrees(angle_between(found, true)))


def test_settings_out_of_bounds_are_named() -> None:
    for setting in ("peak", "peak_apart_deg", "least_light"):
        with pytest.raises(
            ValidationError, match=f"{setting}\n.*greater than or equal"
        ):
            PrintedLightParams(**{setting: -1.0})  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match=r"albedos\n.*'brightness' or 'known'"):
        PrintedLightParams(albedos="unknown")  # type: ignore[arg-type]


def test_settings_that_change_nothing_are_said() -> None:
    done = run(Clip(frames=4), most_lights=1, ink=0.04)
    assert any(
        "most_lights, ink" in notice and "without effect" in notice
        for notice in done.notices
    )
    assert not any(
        "without effect" in notice
        for notice in run(Clip(frames=4), albedos="known", ink=0.04).notices
    )


@pytest.mark.parametrize("level", [2, 3, 4, 5])
def test_figure_1_is_a_hemisphere_of_triangles_one_of_them_at_its_pole(
    level: int,
) -> None:
    n = hemisphere(level)
    assert (n[:, 2] >= 0).all() and np.linalg.norm(n, axis=1) == pytest.approx(1)
    assert (
        abs(len(n) - 10 * 4**level) < 8 * 2**level
    )  # half of all triangles, but for those on the rim
    assert n[n[:, 2].argmax()] == pytest.approx([0, 0, 1], abs=1e-12)


def test_one_single_normal_is_a_peak_whichever_it_is() -> None:
    """A marker at rest. A normal on a corner of triangles ties with all of them, and (9)
    rejects each.
    """
    rng = np.random.default_rng(0)
    for n in normalise(rng.normal(size=(50, 3))):
        (light,), (cube,), turn = lights_of([seen(n)], PrintedLightParams())
        (found,) = light.lights
        assert off_deg(found.unit, n) < 1e-5
        assert found.rgb == pytest.approx(
            [0.6] * 3, rel=1e-6
        ) and light.ambient_rgb == pytest.approx([0] * 3, abs=1e-6)
        assert look_up(cube, (turn @ n)[None])[0] == pytest.approx(
            [0.6] * 3, rel=1e-6
        )
        away = n @ -turn.T  # a direction that no marker faced
        assert look_up(cube, away[None])[0] == pytest.approx([0] * 3, abs=1e-9)


def test_constant_light_on_a_marker_at_rest_stays_one_peak() -> None:
    """In some hundred frames M is equal to the last digit in many triangles around the normal."""
    up = normalise(np.array([0.3, -0.2, 0.9]))
    lights, _, _ = lights_of([seen(up)] * 400, PrintedLightParams())
    assert all(
        len(light.lights) == 1 and off_deg(light.lights[0].unit, up) < 1e-5
        for light in lights
    )


def test_light_that_gets_darker_leaves_one_peak_beside_the_normal() -> None:
    """(7) replaces at the normal itself and averages beside it: the ring around it is
    brighter, and equal by symmetry.
    """
    lights, _, _ = lights_of(
        [seen(UP, 0.6 - 0.01 * k) for k in range(20)], PrintedLightParams()
    )
    assert all(
        len(light.lights) == 1 and off_deg(light.lights[0].unit, UP) < 15
        for light in lights
    )
    assert off_deg(lights[-1].lights[0].unit, UP) > 3


def test_all_peaks_are_lights(tmp_path: Any) -> None:
    """Five markers, 45 degrees and more from each other."""
    around = np.radians([0, 90, 180, 270])
    normals = np.column_stack([np.cos(around), np.sin(around), np.ones(4)])
    five = normalise(np.concatenate([normals, UP[None]]))
    (light,), _, _ = lights_of([seen(five)], PrintedLightParams(peak=0.3))
    assert len(light.lights) == 5
    assert max(min(off_deg(li.unit, n) for li in light.lights) for n in five) < 6
    done = run(Clip(frames=3))
    facts = [f.with_(light=light) for f in done.facts]
    write_facts(tmp_path / "facts.jsonl", facts)
    assert [f.light for f in read_facts(tmp_path / "facts.jsonl")] == [light] * 3


def test_the_critical_brightness_is_a_share_or_a_value() -> None:
    two = normalise(np.array([[0.0, 0, 1], [1, 0, 1]]))

    def peaks(**settings: Any) -> list[float]:
        return [
            li.rgb[0]
            for li in lights_of([seen(two)], PrintedLightParams(**settings))[0][
                0
            ].lights
        ]

    bright, less = peaks(peak=0.1)
    assert 0.6 > bright > less > 0.1 and peaks(peak=1.0) == [bright]
    assert (
        peaks(peak=0.5 * (1 + less / bright)) == [bright]
        and len(peaks(peak=0.99 * less / bright)) == 2
    )
    assert peaks(least_light=0.6) == [] and peaks(
        least_light=(bright + less) / 2
    ) == [bright]
    assert peaks(least_light=0.99 * less) == [bright, less]


@pytest.mark.parametrize("apart_deg", [0.5, 12, 40, 90])
@pytest.mark.parametrize("grey", [False, True])
def test_the_papers_lights_are_those_that_no_other_candidate_near_them_rivals(
    apart_deg: float, grey: bool
) -> None:
    """Eq. (9) as it is written: each candidate beside all others. grey : values of few
    steps, of which many are equal
    """
    n = hemisphere(3)
    value = np.random.default_rng(2).random(n.shape)
    value = np.round(value) if grey else value
    M = value.mean(1)
    near = (n @ n.T > np.cos(np.radians(apart_deg))) & ~np.eye(len(n), dtype=bool)
    found = eq9_lights(value, n, 0.4, apart_deg)
    strict = [k for k in range(len(n)) if M[k] >= 0.4 and (M[near[k]] < M[k]).all()]
    if grey:  # and of equal ones one
        assert set(strict) < set(found) or apart_deg < 5
        assert (
            all((M[near[k]] <= M[k]).all() for k in found)
            and not near[np.ix_(found, found)].any()
        )
    else:
        assert sorted(found) == strict and (np.diff(M[found]) <= 0).all() and strict


def test_brightness_as_albedo_makes_the_first_pictures_light_1() -> None:
    done = run(Clip())
    first, known = (
        f.light for f in (done.facts[0], run(Clip(), albedos="known").facts[0])
    )
    assert first is not None and known is not None
    assert first.radiance(done.facts[0].camera_from_world.rotation.T @ UP).mean() < 3  # type: ignore[union-attr]
    x, true = first.radiance(UP), known.radiance(UP)
    assert x.mean() == pytest.approx(1, abs=0.1)
    assert x / x.mean() == pytest.approx(
        true / true.mean(), rel=0.1
    )  # the light's colour stays


def test_the_printed_bias_is_a_setting_and_no_bias() -> None:
    clip = Clip(bias=0.02)
    good, printed = (
        run(clip, albedos="known", printed_bias=on).summary["light"]["bias"]
        for on in (False, True)
    )
    assert good == pytest.approx([0.02] * 3, abs=2e-3)
    assert min(printed) > 1


def test_a_light_that_is_given_has_no_map() -> None:
    done = run(Clip(), given=(30.0, 50.0))
    assert [f.light.source for f in done.facts if f.light] == ["given"] * len(
        done.facts
    )
    assert all(f.light_map is None for f in done.facts)


def test_the_papers_formula_finds_a_peak_within_its_own_error() -> None:
    done = run(Clip())
    report = done.summary["light"]
    assert (
        report["formula"] == "paper"
        and report["lights"]
        and "no confidence" in report["reason"]
    )
    for f in done.facts:
        assert f.light is not None and np.isfinite(f.light.radiance(np.eye(3))).all()


@pytest.mark.parametrize("level", [2, 3, 4, 5])
def test_the_papers_light_map_is_written_with_every_frame(level: int) -> None:
    clip = Clip(frames=12)
    done = run(clip, map_level=level, albedos="known")
    normals = [f.camera_from_world.rotation @ UP for f in done.facts]  # type: ignore[union-attr]
    turn = upright(normalise(np.sum(normals, 0)))
    light = LightMap(level, PrintedLightParams().map_blur_rad)
    directions = normalise(np.random.default_rng(0).normal(size=(300, 3)))
    for f, n in zip(done.facts, normals, strict=True):
        light.add(turn @ n, AMBIENT + DIRECT * max(float(n @ LAMP), 0.0))
        found = printed_map(f.light_map)
        assert found is not None and f.camera_from_world is not None
        cube, axes = found
        shown = look_up(cube, directions @ f.camera_from_world.rotation @ axes.T)
        assert shown == pytest.approx(
            look_up(light.cube, directions @ turn.T), abs=0.01
        )
    assert corrected(Clip(frames=4)).facts[0].light_map is None


@pytest.mark.parametrize(
    ("f", "table"),
    [
        (eq8_weight, [1, 0.8040, 0.3359, 0.1129, 0.0127, 0.0014]),
        (squared_weight, [1, 0.9962, 0.9092, 0.6833, 0.2180, 0.0325]),
    ],
)
def test_weights_are_those_of_the_table(f: Callable, table: list[float]) -> None:
    angles = np.radians([0, 1, 5, 10, 20, 30])
    assert np.abs(f(np.cos(angles), 0.2) - table).max() < 5.1e-5


def test_only_the_weight_as_meant_excludes_normals_that_turn_away() -> None:
    cosine = np.cos(np.radians([89.0, 91, 135, 180]))
    assert (eq8_weight(cosine, 2.0) > 0).all()
    assert (squared_weight(cosine, 2.0) > 0).tolist() == [True, False, False, False]


def test_constant_light_stays_constant_for_1000_updates() -> None:
    """M begins at black, and the newest reading replaces all older ones."""
    M = LightMap(3, 0.2)
    for _ in range(1000):
        M.add(UP, np.full(3, 0.7))
    near = M.n[:, 2] > np.cos(np.radians(10))
    assert near.sum() > 9 and np.abs(M.M[near] / 0.7 - 1).max() < 1e-6


@pytest.mark.parametrize("where", ["normal", "value", "variance", "no normal"])
def test_what_is_not_finite_is_left_out(where: str) -> None:
    n, x, v = UP[None].copy(), np.full((1, 3), 0.9), np.full((1, 3), 1e-6)
    {"normal": n, "value": x, "variance": v, "no normal": n}[where][0, 1] = np.nan
    if where == "no normal":
        n[:] = 0
    assert not list(Observation(n, x, v).usable)
