"""The standard scene of the benchmark: a ball of 6,000 triangles on the plane, covering a
tenth of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.analyse.pose.visibility import with_model
from arfx.core.camera import Camera
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.model import Material, Model, Part, Texture
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.real_depth import RealDepth, tile_ranges
from arfx.core.rect import Rect
from arfx.core.scene import Placement, Scene

COVERED = 0.1
_LONGITUDES, _LATITUDES = 60, 51  # 2 x 60 x (51 - 1) = 6,000 triangles
_DIAMETER_M, _TILT_DEG = 0.2, 40.0


def ball(longitudes: int = _LONGITUDES, latitudes: int = _LATITUDES) -> Model:
    """A unit-diameter sphere, z up, smooth normals, textured so that texture lookups are
    timed too.
    """
    import trimesh

    sphere = trimesh.creation.uv_sphere(0.5, (latitudes, longitudes // 2))
    normals = 2 * np.asarray(sphere.vertices)
    turn = np.arctan2(normals[:, 1], normals[:, 0])
    tilt = np.arccos(np.clip(normals[:, 2], -1, 1))
    uv = np.stack([turn / (2 * np.pi) % 1, tilt / np.pi], -1)
    squares = np.kron(np.indices((8, 16)).sum(0) % 2, np.ones((16, 16), int))[
        ..., None
    ]
    colours = np.where(squares, (220, 180, 60, 255), (90, 120, 60, 255))
    texture, white = Texture(colours.astype(np.uint8)), (1.0, 1.0, 1.0, 1.0)
    material = Material("ball", white, base_texture=texture, roughness=0.6)
    faces = np.asarray(sphere.faces, np.int32)
    part = Part(normals / 2, faces, normals, material, uv)
    return Model((part,), up="z", source="benchmark ball")


@dataclass(frozen=True)
class BenchScene:
    """scene, the facts of its one frame, and the real picture: linear RGB float32 (h, w, 3).

    real_depth_m : (h, w) float32, measured depth of the real scene, None = it was not measured
    """

    scene: Scene
    facts: FrameFacts
    plate: ndarray
    real_depth_m: ndarray | None = None

    def with_depth(self) -> BenchScene:
        """With a measured depth: the plane, and a thing that hides the ball's left half."""
        camera, pose = self.scene.camera, self.facts.camera_from_world
        assert pose is not None
        x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.matrix).T
        normal = pose.rotation[:, 2]
        depth_m = (normal @ pose.translation_m) / np.minimum(rays @ normal, -1e-3)
        box = self.facts.model_box
        half = Rect(box.x0, box.y0, (box.x0 + box.x1) // 2, box.y1).clip(camera.rect)
        depth_m[half.slices] = 0.8 * self.facts.depth_range_m[0]
        ranges = tile_ranges(depth_m, (camera.width, camera.height))
        facts = self.facts.with_(real_depth=RealDepth.of(0, 1.0, "", ranges))
        return BenchScene(self.scene, facts, self.plate, depth_m.astype(np.float32))


def bench_scene(
    width: int, height: int, covered: float = COVERED, model: Model | None = None
) -> BenchScene:
    """The ball on a marker, seen from 40 degrees off the vertical by an undistorted camera
    of the given picture size.

    covered : fraction of the picture that it covers;  model : another ball than the standard one
    """
    focal = 0.9 * max(width, height)
    middle_x, middle_y = (width - 1) / 2, (height - 1) / 2
    matrix = np.array([[focal, 0, middle_x], [0, focal, middle_y], [0, 0, 1.0]])
    camera = Camera(width, height, matrix)
    model, marker = model or ball(), MarkerSpec("36h11", 0, 0.15)
    radius_px = np.sqrt(covered * width * height / np.pi)
    # a sphere's outline subtends asin(r / d): tan of it times the focal length is the
    # radius in the picture
    distance = _DIAMETER_M / 2 / np.sin(np.arctan(radius_px / focal))
    down, tilt = (rotation_from_euler_deg(turn, 0, 0) for turn in (180, -_TILT_DEG))
    rotation = down @ tilt
    centre = np.array([0, 0, _DIAMETER_M / 2])
    pose = Pose(rotation, np.array([0, 0, distance]) - rotation @ centre)
    placed = Placement(fit_m=_DIAMETER_M).world_from_model(model)
    scene = Scene(camera, model, placed, (marker,), {marker.key: Pose.identity()})
    seen = FrameFacts(0, 0.0, 0, MEASURED, pose, pose, opacity=1.0)
    (facts,) = with_model([seen], scene)
    plate = np.random.default_rng(0).uniform(0.05, 0.8, (height, width, 3))
    return BenchScene(scene, facts, plate.astype(np.float32))
