"""The mesh and its materials as arrays that surface.py reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from arfx.core.model import BLEND, MASK, OPAQUE, Material
from arfx.core.scene_mesh import SceneMesh, coordinate_slopes
from arfx.stages.raster.textures import StackBuilder

# Columns of the material tables, one row a part: base colour (3), opacity, then surface, emission.
ALPHA, METALLIC, ROUGHNESS, SPECULAR = 3, 4, 5, 6
CUTOFF = 10
# Columns of the textures' numbers, and what follows them.
BASE_SLOT, METAL_SLOT, EMISSIVE_SLOT, MODE, TWO_SIDED = range(5)
_MODES = {OPAQUE: 0, MASK: 1, BLEND: 2}
CUT_OUT = _MODES[MASK]


class SurfaceTables(NamedTuple):
    """Fields as of `SceneMesh`, and:

    uv_slopes : (m, 2, 3) float32, how texture coordinates grow along the world's axes, per metre
    floats : (p, 11) float32, ints : (p, 5) int32, materials;  slots : of textures, used by any part
    texels, table : of `TextureStack`"""

    faces: np.ndarray
    part: np.ndarray
    face_normal: np.ndarray
    normals: np.ndarray
    colours: np.ndarray
    uv: np.ndarray
    uv_slopes: np.ndarray
    floats: np.ndarray
    ints: np.ndarray
    slots: int
    texels: np.ndarray
    table: np.ndarray


def surface_tables(mesh: SceneMesh) -> SurfaceTables:
    """Pyramids of all textures are made here: some 10 ns a texel."""
    builder = StackBuilder()
    floats, ints = [], []
    for material, textured in zip(mesh.materials, mesh.textured, strict=True):
        surface = material.metallic, material.roughness, material.specular
        floats.append([*material.base_colour, *surface, *material.emissive, material.alpha_cutoff])
        numbers = _texture_numbers(material, builder) if textured else [-1, -1, -1]
        ints.append([*numbers, _MODES[material.alpha_mode], int(material.double_sided)])
    kinds = np.array(ints, np.int32)
    used = np.flatnonzero((kinds[:, :MODE] >= 0).any(0))
    slopes = coordinate_slopes(mesh.uv[mesh.faces], mesh.corners_m)
    stack = builder.build()
    return SurfaceTables(
        mesh.faces,
        mesh.part,
        mesh.face_normal,
        mesh.normals,
        mesh.colours,
        mesh.uv,
        slopes.astype(np.float32),
        np.array(floats, np.float32),
        kinds,
        1 + int(used.max(initial=-1)),
        stack.texels,
        stack.table,
    )


def _texture_numbers(material: Material, builder: StackBuilder) -> list[int]:
    pictures = (
        (material.base_texture, True),
        (material.metallic_roughness_texture, False),
        (material.emissive_texture, True),
    )
    return [-1 if picture is None else builder.add(picture, srgb) for picture, srgb in pictures]
