"""Tan, Chen, Sun 2009 as printed: peaks of the map, and the light that the fold makes of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from arfx.analyse.fold import Analysis, AnalysisJob
from arfx.analyse.light.icosphere import icosphere
from arfx.analyse.light.light_map import Observation
from arfx.analyse.params import LightParams
from arfx.core.cube import look_up
from arfx.core.numerics import normalise
from arfx.errors import ConfigError
from arfx.papers.s1_light import LightMap, PrintedLight, PrintedLightParams, eq9_lights, upright
from arfx.papers.s1_lightmap import printed_map
from tests.clips import clip_camera
from tests.unit.analyse.light.test_fold import AMBIENT, DIRECT, LAMP, MARKER, UP, Clip
from tests.unit.analyse.light.test_fold import run as corrected


def run(clip: Clip, **settings: Any) -> Analysis:
    analysis, taken = clip.made()
    fold = PrintedLight(AnalysisJob((MARKER,), clip_camera(), light=PrintedLightParams(**settings)), *[None] * 2)  # type: ignore
    fold.readings, fold._surroundings.samples = taken.readings, taken.samples
    return fold.finish(analysis)


def test_settings_out_of_bounds_are_named() -> None:
    for setting in ("peak", "peak_apart_deg"):
        with pytest.raises(ConfigError, match=f"light.{setting} must be between"):
            PrintedLightParams(**{setting: -1.0})  # type: ignore[arg-type]


@pytest.mark.parametrize("apart_deg", [0.5, 12, 40, 90])
@pytest.mark.parametrize("grey", [False, True])
def test_the_papers_lights_are_those_that_no_other_candidate_near_them_rivals(apart_deg: float, grey: bool) -> None:
    """Eq. (9) as it is written: each candidate beside all others. grey : values of few steps, many of them equal"""
    sphere = icosphere(3)
    value = np.random.default_rng(2).random((len(sphere.vertices), 3))
    value = np.round(value) if grey else value
    upper = sphere.centres[:, 2] >= 0
    n, M = sphere.centres[upper], value.mean(1)[sphere.faces[upper]].mean(1)
    near = (n @ n.T > np.cos(np.radians(apart_deg))) & ~np.eye(len(n), dtype=bool)
    peaks = [k for k in np.argsort(-M, kind="stable") if M[k] > 0.4 and (M[near[k]] < M[k]).all()]
    assert np.array_equal(eq9_lights(value, 3, 0.4, apart_deg), n[peaks].reshape(-1, 3))
    assert grey or len(peaks)


def test_the_papers_formula_finds_a_peak_within_its_own_error() -> None:
    done = run(Clip())
    report = done.summary["light"]
    assert report["formula"] == "paper" and report["lights"] and "no confidence" in report["reason"]
    for f in done.facts:
        assert f.light is not None and np.isfinite(f.light.radiance(np.eye(3))).all()


@pytest.mark.parametrize("level", [2, 3, 4, 5])
def test_the_papers_light_map_is_written_with_every_frame(level: int) -> None:
    """A surface with the marker's normal shows M there, whatever of it the peaks' lights carry."""
    clip = Clip(frames=12)
    done = run(clip, map_level=level)
    light = LightMap(level, LightParams().map_blur_rad)
    normals, seen, off = [], [], []
    for f in done.facts:
        normals.append(f.camera_from_world.rotation @ UP)  # type: ignore[union-attr]
        seen.append(AMBIENT + DIRECT * max(float(normals[-1] @ LAMP), 0.0))
    turn = upright(normalise(np.sum(normals, 0)))
    for f, n, x in zip(done.facts, normals, seen, strict=True):
        light.add(Observation(0.0, (turn @ n)[None], x[None], np.full((1, 3), 1e-6)))
        found = printed_map(f.light_map)
        assert found is not None
        cube, axes = found
        lamps = f.light.radiance(UP) - f.light.soft_radiance(UP)  # type: ignore[union-attr]
        shown = look_up(cube, (axes @ UP)[None])[0] + lamps
        off.append(float(np.abs(shown / light.sphere.interpolate(light.M, turn @ n) - 1).max()))
    assert np.median(off) < 0.15 and max(off) < 0.5, off  # (8) as printed has a cusp, texels and vertices cut it differently
    assert corrected(Clip(frames=4)).facts[0].light_map is None
