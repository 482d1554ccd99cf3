"""The mesh and its materials as arrays that surface.py reads."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.model import BLEND, MASK, OPAQUE, TEXTURE_SLOTS, Material, Texture
from arfx.core.scene_mesh import SceneMesh
from arfx.stages.raster.textures import texture_stack

# Columns of the materials' numbers, one row a part. Each begins a run of those of its name.
BASE, METALLIC, EMISSION, COAT_FACTORS, SHEEN_FACTORS = 0, 4, 7, 10, 12
CUTOFF, NORMAL_SCALE, OCCLUSION_STRENGTH = 16, 17, 18
# Columns of the textures' numbers: the slots that are drawn, then what follows them.
SLOTS = tuple(name for name in TEXTURE_SLOTS if name != "clearcoat_normal_texture")
(
    BASE_SLOT,
    METAL_SLOT,
    EMISSIVE_SLOT,
    NORMAL_SLOT,
    OCCLUSION_SLOT,
    COAT_SLOT,
    COAT_ROUGHNESS_SLOT,
    SHEEN_SLOT,
    SHEEN_ROUGHNESS_SLOT,
    MODE,
    TWO_SIDED,
) = range(len(SLOTS) + 2)
_MODES = {OPAQUE: 0, MASK: 1, BLEND: 2}
CUT_OUT = _MODES[MASK]


class SurfaceTables(NamedTuple):
    """Fields as of `SceneMesh`, and:

    floats : (p, 19) float32, ints : (p, 11) int32, of the materials
    uv_first : (p, 9) int32, column of `uv` that each slot's texture begins at
    laid : (p, 9, 2, 3) float32, picture_from_uv of each slot;  slots : used by any part
    texels, table : of `TextureStack`"""

    faces: ndarray
    part: ndarray
    face_normal: ndarray
    normals: ndarray
    tangents: ndarray
    colours: ndarray
    uv: ndarray
    floats: ndarray
    ints: ndarray
    uv_first: ndarray
    laid: ndarray
    slots: int
    texels: ndarray
    table: ndarray


def surface_tables(mesh: SceneMesh) -> SurfaceTables:
    """Pyramids of all textures are made here: some 10 ns a texel."""
    uses: list[tuple[Texture, bool]] = []
    count = len(mesh.materials)
    ints = np.full((count, TWO_SIDED + 1), -1, np.int32)
    uv_first = np.zeros((count, len(SLOTS)), np.int32)
    laid = np.tile(np.eye(2, 3, dtype=np.float32), (count, len(SLOTS), 1, 1))
    for part, material in enumerate(mesh.materials):
        ints[part, MODE] = _MODES[material.alpha_mode]
        ints[part, TWO_SIDED] = material.double_sided
        for slot, name in enumerate(SLOTS):
            texture = material.textures.get(name)
            if texture is not None and mesh.has_uv[part, texture.uv_set]:
                ints[part, slot] = len(uses)
                uses.append((texture, TEXTURE_SLOTS[name]))
                uv_first[part, slot] = 2 * texture.uv_set
                laid[part, slot] = texture.picture_from_uv
    used = np.flatnonzero((ints[:, :MODE] >= 0).any(0))
    return SurfaceTables(
        mesh.faces,
        mesh.part,
        mesh.face_normal,
        mesh.normals,
        mesh.tangents,
        mesh.colours,
        mesh.uv,
        np.array([_factors(material) for material in mesh.materials], np.float32),
        ints,
        uv_first,
        laid,
        1 + int(used.max(initial=-1)),
        *texture_stack(uses),
    )


def has_extras(mesh: SceneMesh) -> bool:
    """Has any part what goes beyond base, metal and emission: occlusion, bumps, coat or sheen?"""
    return any(
        material.occlusion_texture is not None
        or material.normal_texture is not None
        or material.clearcoat > 0
        or any(material.sheen_colour)
        for material in mesh.materials
    )


def _factors(material: Material) -> list[float]:
    """One row of the materials' numbers."""
    surface = material.metallic, material.roughness, material.specular
    coat = material.clearcoat, material.clearcoat_roughness
    sheen = *material.sheen_colour, material.sheen_roughness
    scales = material.alpha_cutoff, material.normal_scale, material.occlusion_strength
    return [
        *material.base_colour,
        *surface,
        *material.emissive,
        *coat,
        *sheen,
        *scales,
    ]
