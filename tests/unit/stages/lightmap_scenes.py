"""Balls and boxes on a plane, and what a light of some size leaves of the plane by
closed-form rays: no triangles, no embree.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import trimesh

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.light import DIFFUSE, DirectionalLight, Light
from arfx.core.model import Material, Model, Part
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, level_named
from arfx.run.parameters import stage_of
from arfx.stages.lightmap import LightmapParams
from tests.scenes import box_model, facts

RADIUS_M = 0.06
MADE = frozenset(Layer) - {Layer.PLATE, Layer.IMAGE}
DARK = Light((0.0, 0.0, 0.0), ())


@cache
def ball_model(subdivisions: int = 4) -> Model:
    """A ball of 20 x 4^subdivisions triangles, normals of the true sphere.

    One model, whose ambient shadow is made once.
    """
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    part = Part(
        np.array(ball.vertices),
        np.array(ball.faces, np.int32),
        np.array(ball.vertices),
        Material(specular=0.0),
    )
    return Model((part,), up="z", source="ball")


def on_plane(
    model: Model, light: Light, camera: Camera | None = None, height_m: float = 0.0
) -> Scene:
    """The model, 12 cm large, its lowest point `height_m` over the plane z = 0."""
    size = float(np.ptp(model.vertices, axis=0).max())
    m = np.diag([2 * RADIUS_M / size] * 3 + [1.0])
    m[2, 3] = height_m - m[2, 2] * float(model.vertices[:, 2].min())
    camera = camera or Camera(
        320, 240, np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    )
    return Scene(camera, model, m, light=light)


def from_above(
    tilt_deg: float = 35.0, distance_m: float = 0.6, turn_deg: float = 20.0
) -> Pose:
    r = (
        rotation_from_euler_deg(180, 0, 0)
        @ rotation_from_euler_deg(-tilt_deg, 0, 0)
        @ rotation_from_euler_deg(0, 0, turn_deg)
    )
    return Pose(r, np.array([0.0, 0.0, distance_m]))


def towards(azimuth_deg: float, elevation_deg: float) -> tuple[float, float, float]:
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return (
        float(np.cos(e) * np.cos(a)),
        float(np.cos(e) * np.sin(a)),
        float(np.sin(e)),
    )


def lamp(
    azimuth_deg: float,
    elevation_deg: float,
    size_deg: float,
    rgb: Any = (0.5, 0.5, 0.5),
    ambient: Any = 0.2,
) -> Light:
    ambient_rgb = (ambient,) * 3 if np.isscalar(ambient) else tuple(ambient)
    return Light(
        ambient_rgb,
        (
            DirectionalLight(
                towards(azimuth_deg, elevation_deg), tuple(rgb), size_deg
            ),
        ),
        "given",
    )


def one_sided(shape: tuple[float, float, float], level: float = 0.4) -> Light:
    """Soft light whose radiance in direction d is level (1 + shape . d)."""
    soft = np.zeros((9, 3))
    soft[0], soft[[3, 1, 2]] = level, level / np.sqrt(3) * np.array(shape)[:, None]
    return Light.of_soft(
        soft * DIFFUSE[:, None] / 0.28209479177387814, (), "environment"
    )


def run_stage(
    s: Scene, level: str = "standard", pose: Pose | None = None, params: LightmapParams | None = None,
    layers: Layers | None = None, ready: ReadyStage | None = None, faint: float | None = None, **changes: Any,
) -> dict[Layer, np.ndarray]:  # fmt: skip
    """VIRTUAL and SHADOW over the whole picture; without layers nothing virtual covers it.
    faint : None = the stage's own
    """
    stage: Any = stage_of("lightmap", params or LightmapParams())
    if faint is not None:
        stage.faint = faint
    f: FrameFacts = facts(s, pose or from_above()).with_(**changes)
    if layers is None:
        layers = Layers(s.camera.rect)
    made = (ready or ReadyStage.of(stage, s, level_named(stage.levels, level))).run(
        layers, f
    )
    return {
        name: Layers(s.camera.rect, {name: a})[name] if isinstance(a, Pixels) else a
        for name, a in made.items()
    }


def ground_points(s: Scene, pose: Pose) -> np.ndarray:
    """(h, w, 3) where the pixels' viewing rays meet z = 0; NaN where they do not."""
    y, x = np.mgrid[0 : s.camera.height, 0 : s.camera.width]
    d = s.camera.directions(np.stack([x, y], -1).astype(float)) @ pose.rotation
    eye = pose.inverse().translation_m
    with np.errstate(all="ignore"):
        t = np.where(d[..., 2] < 0, -eye[2] / d[..., 2], np.nan)
    return eye + t[..., None] * d


def hides_ball(
    points: np.ndarray,
    directions: np.ndarray,
    height_m: float = 0.0,
    inside: float = 1.0,
) -> np.ndarray:
    """(n, k) bool: does a ball of RADIUS_M stand between points (n, 3) and a light in
    directions (k, 3)?
    """
    c = np.array([0, 0, RADIUS_M + height_m]) - points
    along = c @ directions.T
    return (along > 0) & (
        (c * c).sum(1)[:, None] - along**2 < (inside * RADIUS_M) ** 2
    )


def hides_box(
    points: np.ndarray, directions: np.ndarray, height_m: float = 0.0
) -> np.ndarray:
    """The same for an upright cube of side 2 RADIUS_M: slabs."""
    low = np.array([-RADIUS_M, -RADIUS_M, height_m])
    with np.errstate(all="ignore"):
        a = (low - points)[:, None] / directions
        b = (low + 2 * RADIUS_M - points)[:, None] / directions
    near, far = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    return (near < far) & (far > 1e-9)


HIDES = {"ball": hides_ball, "box": hides_box}
MODELS = {"ball": ball_model, "box": box_model}


def disc_samples(
    direction: np.ndarray, size_deg: float, n: int, seed: int = 0
) -> np.ndarray:
    """(n x n, 3) jittered directions, even over a disc of that full angle."""
    g = np.random.default_rng(seed)
    u, v = (
        (np.stack(np.meshgrid(np.arange(n), np.arange(n))) + g.random((2, n, n))) / n
    ).reshape(2, -1)
    w = np.asarray(direction) / np.linalg.norm(direction)
    side = np.cross(w, [0.3, -0.7, 0.2])
    side /= np.linalg.norm(side)
    r = np.tan(np.radians(size_deg / 2)) * np.sqrt(u)
    d = (
        w
        + (r * np.cos(2 * np.pi * v))[:, None] * side
        + (r * np.sin(2 * np.pi * v))[:, None] * np.cross(w, side)
    )
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def hemisphere_samples(n: int, seed: int = 1) -> np.ndarray:
    """(n x n, 3) jittered directions with a density as their cosine to +z."""
    g = np.random.default_rng(seed)
    u, v = (
        (np.stack(np.meshgrid(np.arange(n), np.arange(n))) + g.random((2, n, n))) / n
    ).reshape(2, -1)
    r = np.sqrt(u)
    return np.stack(
        [r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v), np.sqrt(1 - u)], -1
    )


def true_ratio(
    light: Light,
    hides: Any,
    points: np.ndarray,
    samples: int = 16,
    height_m: float = 0.0,
) -> np.ndarray:
    """(n, 3) light that is left of the plane at points (n, 3) on it, by samples x samples
    rays for every part of the light.

    A directional light's radiance is its disc's, each ray weighted by its cosine to the plane.
    """
    out = np.empty((len(points), 3))
    sky = hemisphere_samples(2 * samples)
    discs = [
        (disc_samples(li.unit, li.angular_size_deg, samples), li)
        for li in light.lights
        if li.unit[2] > 0
    ]
    for a in range(0, len(points), 500):
        p = points[a : a + 500]
        ambient = np.asarray(light.ambient_rgb)
        left = ambient * (1 - hides(p, sky, height_m).mean(1))[:, None]
        whole = ambient.copy()
        for rays, li in discs:
            weight = np.clip(rays[:, 2], 0, None)
            open_ = ((1 - hides(p, rays, height_m)) * weight).sum(1) / weight.sum()
            left = left + np.asarray(li.rgb) * li.unit[2] * open_[:, None]
            whole = whole + np.asarray(li.rgb) * li.unit[2]
        out[a : a + 500] = left / whole
    return out
