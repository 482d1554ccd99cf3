"""Scenes for indirect light, and one run of raster by rays, lightmap and gi on them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import trimesh

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, neutral
from arfx.core.light import DirectionalLight, Light
from arfx.core.model import Material, Model, Part
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, level_named
from arfx.run.parameters import stage_of
from arfx.stages.gi import GiParams
from arfx.stages.gi import stage as stage_module
from arfx.stages.triangles import Triangles
from tests.scenes import box_model, facts, layers_of
from tests.unit.stages.lightmap_scenes import (
    MADE,
    from_above,
    ground_points,
    on_plane,
)

__all__ = ["box_model", "from_above", "ground_points", "on_plane"]

MATT_WHITE = Material(base_colour=(1.0, 1.0, 1.0, 1.0), specular=0.0, roughness=1.0)
MATT_RED = Material(base_colour=(0.8, 0.04, 0.03, 1.0), specular=0.0, roughness=1.0)
BLACK = Material(base_colour=(0.0, 0.0, 0.0, 1.0), specular=0.0, roughness=1.0)
MIRROR = Material(base_colour=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
GLOWING = Material(
    base_colour=(0.0, 0.0, 0.0, 1.0), specular=0.0, emissive=(1.0, 0.5, 0.0)
)
EVEN = Light((1.0, 1.0, 1.0), ())
NIGHT = Light((0.0, 0.0, 0.0), ())
LAMP = Light(
    (0.4, 0.4, 0.4), (DirectionalLight((0.5, 0.5, 0.7), (0.5, 0.5, 0.5), 8.0),)
)
CAMERA = Camera(160, 120, np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]))
stage_module.TRANSPORTS_KEPT = (
    8  # tests come back to the same few models at other levels and heights
)


@cache
def ball(material: Material, subdivisions: int = 3) -> Model:
    b = trimesh.creation.icosphere(subdivisions=subdivisions)
    part = Part(
        np.array(b.vertices),
        np.array(b.faces, np.int32),
        np.array(b.vertices),
        material,
    )
    return Model((part,), up="z", source="ball")


def box(material: Material) -> Model:
    return box_model(material=material)


def plain_plate(camera: Camera = CAMERA, rgb: Any = (0.5, 0.5, 0.5)) -> np.ndarray:
    return np.broadcast_to(
        np.asarray(rgb, np.float32), (camera.height, camera.width, 3)
    ).copy()


def surface(s: Scene, f: FrameFacts) -> dict[Layer, np.ndarray]:
    """What raster writes, by trimesh's own ray caster: nearest hits at pixel centres."""
    assert f.camera_from_world is not None
    rect, part = s.camera.rect, s.model.parts[0]
    layers = {name: neutral(name, rect) for name in MADE}
    y, x = np.mgrid[0 : rect.height, 0 : rect.width]
    d = (
        s.camera.directions(np.stack([x, y], -1).astype(float))
        @ f.camera_from_world.rotation
    )
    eye = f.camera_from_world.inverse().translation_m
    corners = s.model_points_m[part.faces].astype(np.float32)
    o = np.broadcast_to(eye, d.shape).reshape(-1, 3)
    found = Triangles(corners).first_hits(o, d.reshape(-1, 3))
    prim = np.asarray(found["primID"]).astype(int).reshape(rect.height, rect.width)
    met = prim >= 0
    t = np.asarray(found["tfar"], float).reshape(prim.shape)
    u, v = (
        np.asarray(found[k], float).reshape(prim.shape)[met][:, None] for k in "uv"
    )
    n = part.normals[part.faces[prim[met]]] @ s.world_from_model[:3, :3].T
    n = n[:, 0] * (1 - u - v) + n[:, 1] * u + n[:, 2] * v
    m = part.material
    layers[Layer.COVERAGE][met] = 1
    layers[Layer.NORMAL][met] = n / np.linalg.norm(n, axis=1, keepdims=True)
    layers[Layer.POSITION][met] = (eye + t[..., None] * d)[met]
    layers[Layer.ALBEDO][met] = m.base_colour[:3]
    layers[Layer.MATERIAL][met] = [m.metallic, m.roughness, m.specular, 1]
    layers[Layer.EMISSIVE][met] = m.emissive
    return layers


@cache
def ready(s: Scene, level: str, params: GiParams | None) -> ReadyStage:
    stage = stage_of("gi", params or GiParams())
    return ReadyStage.of(stage, s, level_named(stage.levels, level))


def run_gi(
    s: Scene, level: str = "standard", pose: Pose | None = None, plate: np.ndarray | None = None,
    params: GiParams | None = None, **changes: Any,
) -> dict[Layer, np.ndarray]:  # fmt: skip
    """VIRTUAL (indirect light alone) and SHADOW (its ratio alone), with COVERAGE, over the
    whole picture.
    """
    f = facts(s, pose or from_above()).with_(**changes)
    layers = surface(s, f) | {
        Layer.PLATE: plain_plate(s.camera) if plate is None else plate
    }
    made = ready(s, level, params).run(layers_of(s.camera.rect, layers), f)
    made = {
        name: Layers(s.camera.rect, {name: a})[name] if isinstance(a, Pixels) else a
        for name, a in made.items()
    }
    return made | {
        Layer.COVERAGE: layers[Layer.COVERAGE],
        Layer.NORMAL: layers[Layer.NORMAL],
    }


def inner(coverage: np.ndarray) -> np.ndarray:
    """Pixels of the object whose neighbours are all of it too."""
    c = coverage > 0.5
    out: np.ndarray = c.copy()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            out &= np.roll(c, (dy, dx), (0, 1))
    return out
