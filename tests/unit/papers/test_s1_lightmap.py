"""Tan, Chen, Sun 2009 as printed: shading by the light map, and Phong's highlight."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.cube import CubeMap, face_directions
from arfx.core.light import DirectionalLight, Light
from arfx.core.numerics import normalise
from arfx.core.pose import rotation_from_euler_deg
from arfx.papers.s1_lightmap import phong
from tests.scenes import box_model
from tests.unit.stages.lightmap_scenes import on_plane, towards
from tests.unit.stages.test_lightmap_shading import (
    BARE,
    PRINTED,
    TWO,
    any_normals,
    far,
    shaded,
    surface,
)


def test_a_highlight_is_brightest_where_the_eye_sees_the_light_mirrored() -> None:
    n, d = np.tile([0.0, 0, 1], (4, 1)), normalise(np.array([0.6, 0, 0.8]))
    v = normalise(
        np.array([[-0.6, 0, 0.8], [-0.5, 0, 0.8], [0.6, 0, 0.8], [-0.6, 0, 0.8]])
    )
    one, aside, back, rough = phong(n, v, d, np.array([0.3, 0.3, 0.3, 0.9]))
    assert (
        one == pytest.approx(1)
        and rough == pytest.approx(1)
        and 0.1 < aside < 0.9
        and back < 1e-3
    )
    assert not phong(n, v, -d, np.full(4, 0.3)).any()


def test_the_papers_formula_shades_by_its_light_map() -> None:
    light, turn = Light((0.3, 0.2, 0.1), TWO), rotation_from_euler_deg(20, -35, 110)
    s, d = on_plane(box_model(), light), face_directions(24)
    cube = np.stack(
        [
            0.5 + 0.2 * d[..., 0],
            0.4 + 0.1 * d[..., 1] * d[..., 2],
            0.6 - 0.3 * d[..., 2],
        ],
        -1,
    )
    n = any_normals(s)
    found = CubeMap.of(cube, turn)
    made = shaded(s, surface(s, n, far(s)), PRINTED, light_map=found)
    m = n @ turn.T
    of_map = np.stack(
        [
            0.5 + 0.2 * m[..., 0],
            0.4 + 0.1 * m[..., 1] * m[..., 2],
            0.6 - 0.3 * m[..., 2],
        ],
        -1,
    )
    np.testing.assert_allclose(
        made, 0.87 * of_map, atol=6e-3
    )  # float16 and texels of 4 degrees
    # without the even light, what is left is the lights' share of M
    lamps = light.radiance(n) - light.soft_radiance(n)
    share = lamps / light.radiance(n)
    np.testing.assert_allclose(
        shaded(s, surface(s, n, far(s)), PRINTED, soft=False, light_map=found),
        0.87 * of_map * share,
        atol=6e-3,
    )
    same = shaded(
        s, surface(s, n, far(s)), BARE, light_map=found
    )  # the corrected formula knows lights alone
    np.testing.assert_allclose(same, 0.87 * light.radiance(n), atol=2e-6)


def test_a_light_that_the_plane_hides_takes_its_share_of_the_map() -> None:
    s = on_plane(
        box_model(),
        Light((0.2,) * 3, (DirectionalLight(towards(0, -30), (0.6,) * 3, 0.0),)),
    )
    n, constant = any_normals(s), CubeMap.of(np.full((6, 4, 4, 3), 0.5))
    lobe = 0.6 * np.clip(n @ np.array(towards(0, -30)), 0, None)
    made = shaded(
        s,
        surface(s, n, far(s)),
        PRINTED.model_copy(update={"plane_blocks": True}),
        light_map=constant,
    )
    np.testing.assert_allclose(
        made[..., 0], 0.87 * 0.5 * 0.2 / (0.2 + lobe), atol=1e-5
    )
