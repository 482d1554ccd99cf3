"""Small scenes and facts that several tests stand on."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from arfx.core.camera import Camera
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.marker import MarkerSpec
from arfx.core.model import Material, Model, Part
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.rect import Rect
from arfx.core.scene import Placement, Scene


@cache
def box_model(size: float = 1.0, material: Material | None = None) -> Model:
    """An axis-aligned cube with flat normals, z up.

    One and the same each time: what stages keep of a model is made once.
    """
    faces, vertices, normals = [], [], []
    for axis in range(3):
        for sign in (-1, 1):
            n = np.zeros(3)
            n[axis] = sign
            u, v = np.roll(np.eye(3)[axis], 1), np.roll(np.eye(3)[axis], 2)
            corners = [
                n + a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
            ]
            if (
                np.dot(np.cross(corners[1] - corners[0], corners[2] - corners[0]), n)
                < 0
            ):
                corners = corners[::-1]
            start = len(vertices)
            vertices += corners
            normals += [n] * 4
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    half = size / 2
    part = Part(
        np.array(vertices) * half,
        np.array(faces, np.int32),
        np.array(normals, float),
        material or Material(),
    )
    return Model((part,), up="z", source="box")


def camera(
    width: int = 160, height: int = 120, distortion: tuple[float, ...] = ()
) -> Camera:
    k = np.array(
        [
            [0.9 * width, 0, width / 2 + 7.3],
            [0, 0.9 * width, height / 2 - 4.1],
            [0, 0, 1],
        ]
    )
    return Camera(width, height, k, np.array(distortion))


def look_at(
    distance_m: float = 0.5, tilt_deg: float = 40.0, turn_deg: float = 20.0
) -> Pose:
    """camera_from_world of a camera that looks at the world's origin from above its plane."""
    r = (
        rotation_from_euler_deg(180, 0, 0)
        @ rotation_from_euler_deg(-tilt_deg, 0, 0)
        @ rotation_from_euler_deg(0, 0, turn_deg)
    )
    return Pose(r, np.array([0.0, 0.0, distance_m]))


def scene(
    cam: Camera | None = None, model: Model | None = None, fit_m: float = 0.12
) -> Scene:
    cam, model = cam or camera(), model or box_model()
    marker = MarkerSpec("36h11", 3, 0.1)
    return Scene(
        cam,
        model,
        Placement(fit_m=fit_m).world_from_model(model),
        (marker,),
        {marker.key: Pose.identity()},
    )


def facts(
    s: Scene, pose: Pose | None = None, index: int = 0, opacity: float = 1.0
) -> FrameFacts:
    pose = pose or look_at()
    p = s.camera.project(pose.apply(s.model_points_m))
    z = pose.apply(s.model_points_m)[:, 2]
    box = Rect.around(p, 1.0).clip(s.camera.rect)
    return FrameFacts(
        index, index / 30, status=MEASURED, camera_from_world=pose, opacity=opacity, model_box=box,
        depth_range_m=(float(z.min()), float(z.max())),
    )  # fmt: skip


def layers_of(
    rect: Rect, arrays: Mapping[Layer, np.ndarray], others: Layers | None = None
) -> Layers:
    """Layers written all over a rectangle, in place of `others` or beside them."""
    return Layers(
        rect,
        {
            **(others.written if others else {}),
            **{name: Pixels(rect, array) for name, array in arrays.items()},
        },
    )
