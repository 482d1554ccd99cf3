"""Scenes with known answers for the raster tests, and the back ends that open here."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.core.layers import Layer, Layers
from arfx.core.model import Material, Model, Part
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, level_named
from arfx.stages.raster import Raster, RasterParams
from tests.scenes import facts

LENSES = {
    "ideal": (),
    "barrel": (-0.27, 0.1, 0.001, -0.0015, -0.02),
    "rational": (0.3, -0.4, 0.0007, -0.0006, 0.02, 0.6, -0.5, 0.05),
}
PLAIN = Material(
    base_colour=(0.2, 0.4, 0.6, 1.0), metallic=0.25, roughness=0.5, double_sided=True
)


BOTH = [pytest.param("rays"), pytest.param("pyrender", marks=pytest.mark.opengl)]


def camera(lens: str = "ideal", width: int = 320, height: int = 240) -> Camera:
    k = np.array(
        [[300.0, 0, 151.3], [0, 310.0, 131.8], [0, 0, 1]]
    )  # the principal point well off the centre
    return Camera(width, height, k, np.array(LENSES[lens]))


def quad(
    corners: np.ndarray, material: Material = PLAIN, uv: np.ndarray | None = None
) -> Part:
    """Four corners, counter-clockwise from the front."""
    c = np.asarray(corners, float)
    n = np.cross(c[1] - c[0], c[2] - c[0])
    normals = np.tile(n / np.linalg.norm(n), (4, 1))
    return Part(c, np.array([[0, 1, 2], [0, 2, 3]], np.int32), normals, material, uv)


def square(
    half: float,
    z: float = 0.0,
    material: Material = PLAIN,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Part:
    """Facing +z, texture upright seen from there."""
    x, y = centre
    corners = [
        [x - half, y - half, z],
        [x + half, y - half, z],
        [x + half, y + half, z],
        [x - half, y + half, z],
    ]
    return quad(
        np.array(corners), material, np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
    )


def scene_of(parts: list[Part], lens: str = "ideal") -> Scene:
    """Model units are metres, model axes the world's."""
    return Scene(camera(lens), Model(tuple(parts), "z", "test"), np.eye(4))


def in_front(
    distance_m: float = 1.0, tilt_deg: float = 0.0, turn_deg: float = 0.0
) -> Pose:
    """Camera that looks at the origin against world z; world x is right, y is up in the picture."""
    r = rotation_from_euler_deg(180, 0, 0) @ rotation_from_euler_deg(
        tilt_deg, turn_deg, 0
    )
    return Pose(r, np.array([0.0, 0.0, distance_m]))


def render(
    scene: Scene,
    pose: Pose,
    backend: str,
    level: str = "standard",
    samples: int = 0,
    rect: Rect | None = None,
) -> dict[Layer, np.ndarray]:
    ready = ReadyStage.of(
        Raster(RasterParams(backend=backend, samples=samples)),
        scene,
        level_named(Raster.levels, level),
    )
    f = facts(scene, pose).with_(model_box=scene.camera.rect)
    return dict(ready.run(Layers(rect or scene.camera.rect), f))
