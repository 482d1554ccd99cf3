"""What the compiled loops of this stage take: named tuples of arrays that belong together, each made in one place here.

A loop is compiled again for each mix of types, so the makers fix dtype and order; no field is ever None."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from arfx.core.layers import Layer
from arfx.core.pose import Pose

# Columns of a sample's sums: transmittance, albedo, normal, metallic, roughness, specular, emissive.
COLUMNS = 13


class Surfaces(NamedTuple):
    """What a hit's attributes are read from; fields as of `Mesh`. slots : how many of the three textures any material has

    texels : (n, 4) uint16 in linear light;  table : of `TextureStack`"""

    faces: np.ndarray
    part: np.ndarray
    face_normal: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    colours: np.ndarray
    texels_per_m: np.ndarray
    uv_slopes: np.ndarray
    floats: np.ndarray
    ints: np.ndarray
    slots: int
    texels: np.ndarray
    table: np.ndarray


class GBuffer(NamedTuple):
    """The layers that this stage writes, over one rectangle."""

    coverage: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    position: np.ndarray
    albedo: np.ndarray
    material: np.ndarray
    emissive: np.ndarray
    object_id: np.ndarray


OUTPUTS = tuple(Layer(name) for name in GBuffer._fields)


class Hits(NamedTuple):
    """What rays meet: face (n,) int32, -1 = none; barycentric u, v and depth (n,) float32."""

    face: np.ndarray
    u: np.ndarray
    v: np.ndarray
    depth: np.ndarray


class View(NamedTuple):
    """How pixels look into the world. lens : (h + 4, w + 4, 2) float32, directions of the pixels with two pixels of margin

    rotation : (3, 3) float64, camera from world;  eye : (3,) float64, world;  pixel : side of a sample at depth 1
    taps : of a texture along each side of a sample, at most"""

    lens: np.ndarray
    rotation: np.ndarray
    eye: np.ndarray
    pixel: np.float32
    taps: int


def view(lens: np.ndarray, camera_from_world: Pose, pixel: float = 0.0, taps: int = 1) -> View:
    """lens : a part of a lens's table or not, the same type comes of it"""
    rotation, eye = (
        np.ascontiguousarray(camera_from_world.rotation),
        camera_from_world.inverse().translation_m,
    )
    return View(np.ascontiguousarray(lens), rotation, eye, np.float32(pixel), taps)


class Samples(NamedTuple):
    """Layers along rays, put together front to back: sums (n, COLUMNS) float32, each layer weighted by its opacity times what
    is left of the light behind those before it; depth (n,) float32, inf = none; ident (n,) int32, 1 + part or 0."""

    sums: np.ndarray
    depth: np.ndarray
    ident: np.ndarray


def no_samples(n: int) -> Samples:
    sums = np.zeros((n, COLUMNS), np.float32)
    sums[:, 0] = 1
    return Samples(sums, np.full(n, np.inf, np.float32), np.zeros(n, np.int32))


class Fragments(NamedTuple):
    """Scratch of one pixel of s samples: face (s + 1,) int32, each once; sums (s + 1, 6) float32 over the samples that meet it:
    their number, barycentric u, v, depth, direction in the camera x, y."""

    face: np.ndarray
    sums: np.ndarray


def fragments(samples: int) -> Fragments:
    return Fragments(np.empty(samples + 1, np.int32), np.empty((samples + 1, 6), np.float32))


class Buffers(NamedTuple):
    """What OpenGL drew, (texels, 4) each, as `gl_draw` gives it: normal and depth float32; colour and opacity, metallic,
    roughness, specular and 1 + part uint16; emissive float32."""

    geometry: np.ndarray
    colour: np.ndarray
    surface: np.ndarray
    glow: np.ndarray
