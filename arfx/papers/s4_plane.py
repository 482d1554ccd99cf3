"""Step 1 of Yao, Tao, Wu 2018: the real scene is a mesh of its planes.

Planes come from measured depth (points, normals, k nearest neighbours, the dominant plane:
analyse/depth/planes.py) or are the markers'. Here they become triangles, which step 2 voxelises and
step 4 renders.

Deviations. A plane that was not seen to end goes on to FARTHEST radii of the object. The plane's
albedo is not stated: a parameter. The object stands on its marker, or where the user puts it, not
always at the plane's centre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from arfx.core.model import Material, Model, Part
from arfx.core.numerics import normalise
from arfx.core.scene import Scene
from arfx.stages.light.planes import planes_of


def step1_mesh(scene: Scene, albedo: float) -> tuple[Part, ...]:
    """A rectangle for each of the scene's planes, metres, anchor axes. albedo : of all of them"""
    planes = planes_of(scene)
    matt = Material(
        "plane", base_colour=(albedo, albedo, albedo, 1.0), specular=0.0, roughness=1.0
    )
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    parts = []
    for (origin, x, y, normal), bounds in zip(
        planes.axes.astype(float), planes.bounds.astype(float), strict=True
    ):
        x0, y0, x1, y1 = np.clip(bounds, -planes.half_m, planes.half_m)
        corners = np.array(
            [origin + a * x + b * y for a, b in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        )
        parts.append(Part(corners, faces, np.tile(normal, (4, 1)), matt))
    return tuple(parts)


def real_scene(scene: Scene, mesh: tuple[Part, ...]) -> Scene:
    """The scene with the real planes' mesh in place of the virtual object."""
    return replace(
        scene,
        model=Model(mesh, up="z", source="planes"),
        world_from_model=scene.world_from_anchor.matrix,
    )


def real_and_virtual(scene: Scene, mesh: tuple[Part, ...]) -> Scene:
    """The scene with both."""
    anchor_from_model = scene.world_from_anchor.inverse().matrix @ scene.world_from_model
    turn, offset = anchor_from_model[:3, :3], anchor_from_model[:3, 3]
    moved = (
        replace(
            p,
            vertices=p.vertices @ turn.T + offset,
            normals=normalise(p.normals @ turn.T),
        )
        for p in scene.model.parts
    )
    return real_scene(scene, (*mesh, *moved))
