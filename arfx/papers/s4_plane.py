"""Step 1 of Yao, Tao, Wu 2018: the real scene is a mesh of its planes.

Planes come from measured depth (points, normals, k nearest neighbours, the dominant plane:
analyse/depth/planes.py) or are the markers'. Here they become triangles, which step 2 voxelises and
step 4 renders.

Deviations. A plane that was not seen to end goes on to FARTHEST radii of the object. The plane's
albedo is not stated: a parameter. The object stands on its marker, or where the user puts it, not
always at the plane's centre."""

from dataclasses import replace

import numpy as np

from arfx.core.model import Material, Model, Part
from arfx.core.scene import Scene
from arfx.stages.light.planes import planes_of


def step1_mesh(scene: Scene, albedo: float) -> Scene:
    """The scene with a rectangle for each of its real planes, anchor axes, in place of the object.

    albedo : of all of them"""
    planes = planes_of(scene)
    colour = (albedo, albedo, albedo, 1.0)
    matt = Material("plane", base_colour=colour, specular=0.0, roughness=1.0)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    bounds = np.clip(planes.bounds.astype(float), -planes.half_m, planes.half_m)
    parts = []
    for (origin, x, y, normal), (x0, y0, x1, y1) in zip(
        planes.axes.astype(float), bounds, strict=True
    ):
        places = (x0, y0), (x1, y0), (x1, y1), (x0, y1)
        corners = np.array([origin + a * x + b * y for a, b in places])
        parts.append(Part(corners, faces, np.tile(normal, (4, 1)), matt))
    return replace(
        scene,
        model=Model(tuple(parts), up="z", source="planes"),
        world_from_model=scene.world_from_anchor.matrix,
    )
