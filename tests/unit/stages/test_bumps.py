"""Light on normal maps: what comes from below the surface itself does not reach it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.light import Light
from tests.scenes import layers_of
from tests.unit.stages.lightmap_scenes import (
    ball_model,
    from_above,
    lamp,
    on_plane,
    run_stage,
)

UP = np.array([0.0, 0.0, 1.0])
LEANING = np.array([0.0, 0.8, 0.6])


def upward_wall(light: Light, normal: np.ndarray, **more: Any) -> np.ndarray:
    """(3,) radiance of a white pixel that looks up, a metre above the object."""
    scene = on_plane(ball_model(2), light)
    shape = scene.camera.rect.height, scene.camera.rect.width
    flat = {
        Layer.COVERAGE: np.ones(shape, np.float32),
        Layer.NORMAL: np.broadcast_to(normal.astype(np.float32), (*shape, 3)),
        Layer.POSITION: np.broadcast_to(np.float32([0, 0, 0.3]), (*shape, 3)),
        Layer.ALBEDO: np.ones((*shape, 3), np.float32),
        Layer.MATERIAL: np.broadcast_to(np.float32([0, 1, 0, 1]), (*shape, 4)),
    }
    smooth = {
        Layer(name): np.broadcast_to(a.astype(np.float32), (*shape, 3))
        for name, a in more.items()
    }
    layers = layers_of(scene.camera.rect, flat | smooth)
    out = run_stage(scene, pose=from_above(), layers=layers)
    return np.asarray(out[Layer.VIRTUAL][shape[0] // 2, shape[1] // 2])


def test_even_light_loses_what_lies_below_the_surface() -> None:
    even = Light((0.4, 0.4, 0.4), (), "given")
    free = upward_wall(even, LEANING)
    bumped = upward_wall(even, LEANING, smooth_normal=UP)
    assert free[0] > 0.1
    np.testing.assert_allclose(bumped, free * (1 + 0.6) / 2, rtol=1e-4)


@pytest.mark.parametrize(("elevation_deg", "left"), [(20.0, 1.0), (-20.0, 0.0)])
def test_a_lamp_below_the_surface_does_not_light_its_bumps(
    elevation_deg: float, left: float
) -> None:
    light = lamp(90, 40, 0.0, ambient=0.0)
    level = np.radians(40 - elevation_deg)
    smooth = np.array([0.0, -np.sin(level), np.cos(level)])
    free, bumped = (
        upward_wall(light, LEANING, **more)
        for more in ({}, {"smooth_normal": smooth})
    )
    assert free[0] > 0.2
    np.testing.assert_allclose(bumped, left * free, atol=1e-4)
