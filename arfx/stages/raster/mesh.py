"""The model in world coordinates as flat arrays that both back ends read: geometry, material tables, edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from arfx.core.model import BLEND, MASK, OPAQUE, TEXTURE_SLOTS
from arfx.core.numerics import divide, normalise, same_rows
from arfx.core.scene import Scene
from arfx.stages.raster.arrays import Surfaces
from arfx.stages.raster.textures import StackBuilder, TextureStack

# Columns of the material tables, one row a part.
RED, GREEN, BLUE, ALPHA, METALLIC, ROUGHNESS, SPECULAR, EMIT_R, EMIT_G, EMIT_B, CUTOFF = range(11)
BASE_TEXTURE, MR_TEXTURE, EMISSIVE_TEXTURE, MODE, TWO_SIDED = range(5)
DRAWN_SLOTS = ("base_texture", "metallic_roughness_texture", "emissive_texture")
MODES = {OPAQUE: 0, MASK: 1, BLEND: 2}
_CREASE_COS = np.cos(np.radians(20.0))  # edges sharper than this are visible inside the silhouette


@dataclass(frozen=True, eq=False)
class Mesh:
    """All parts together; coordinates are world metres relative to `centre_m`, so that float32 is enough.

    vertices (n, 3) float64; normals (n, 3), uv (n, 2), colours (n, 4) float32; faces (m, 3), part (m,) int32
    face_normal (m, 3) float32; uv_slopes (m, 2, 3) float32, how each texture coordinate grows along the
    world's axes on the face; texels_per_m (m,) float32, of the finest of a face's textures, at most
    floats (p, 11) float32, ints (p, 5) int32 : material tables;  edges (e, 4) int32 : vertex, vertex, face, face or -1
    sharp (e,) bool : an edge that shows whatever side it is seen from"""

    centre_m: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    colours: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    face_normal: np.ndarray
    texels_per_m: np.ndarray
    uv_slopes: np.ndarray
    floats: np.ndarray
    ints: np.ndarray
    textures: TextureStack
    edges: np.ndarray
    sharp: np.ndarray

    @cached_property
    def layered(self) -> bool:
        """Can a ray go on behind a hit (transparency, cut-outs)?"""
        return bool((self.ints[:, MODE] != 0).any())

    @cached_property
    def surfaces(self) -> Surfaces:
        """What the compiled loops read."""
        slots = 1 + int(
            np.flatnonzero((self.ints[:, : EMISSIVE_TEXTURE + 1] >= 0).any(0)).max(initial=-1)
        )
        return Surfaces(
            self.faces,
            self.part,
            self.face_normal,
            self.normals,
            self.uv,
            self.colours,
            self.texels_per_m,
            self.uv_slopes,
            self.floats,
            self.ints,
            slots,
            self.textures.linear,
            self.textures.table,
        )

    @property
    def corners_m(self) -> np.ndarray:
        """(m, 3, 3) float64."""
        return np.asarray(self.vertices[self.faces])

    @cached_property
    def hidden(self) -> np.ndarray:
        """(m,) bool, faces that are not shown from behind."""
        return self.ints[self.part, TWO_SIDED] == 0


def build_mesh(scene: Scene) -> Mesh:
    """Raises InputError where the model is too large in the scene."""
    m = scene.world_from_model
    scene.check_extent()
    corners = scene.model_corners_m
    centre = corners.mean(0)
    rotation = m[:3, :3] / np.cbrt(abs(np.linalg.det(m[:3, :3])))
    textures = StackBuilder()
    vertices, normals, uvs, colours, faces, parts, floats, ints = [], [], [], [], [], [], [], []
    start = 0
    for k, p in enumerate(scene.model.parts):
        n, mat = len(p.vertices), p.material
        vertices.append(p.vertices @ m[:3, :3].T + m[:3, 3] - centre)
        normals.append(p.normals @ rotation.T)
        drawn = [mat.textures.get(name) for name in DRAWN_SLOTS]
        uv = next((p.uv_on(t) for t in drawn if t is not None), None)
        uvs.append(np.zeros((n, 2)) if uv is None else uv)
        colours.append(np.ones((n, 4)) if p.colours is None else p.colours)
        faces.append(p.faces + start)
        parts.append(np.full(len(p.faces), k))
        floats.append(
            [
                *mat.base_colour,
                mat.metallic,
                mat.roughness,
                mat.specular,
                *mat.emissive,
                mat.alpha_cutoff,
            ]
        )
        numbers = [
            textures.add(None if uv is None else texture, TEXTURE_SLOTS[name])
            for name, texture in zip(DRAWN_SLOTS, drawn, strict=True)
        ]
        ints.append([*numbers, MODES[mat.alpha_mode], int(mat.double_sided)])
        start += n
    v, f, uv = np.concatenate(vertices), np.concatenate(faces).astype(np.int32), np.concatenate(uvs)
    cross = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    part = np.concatenate(parts).astype(np.int32)
    face_normal = normalise(cross)
    edges, sharp = _edges(v, f, part, face_normal)
    slopes, stack, kinds = (
        _uv_slopes(uv[f], v[f], cross),
        textures.build(),
        np.array(ints, np.int32),
    )
    sizes = np.append(stack.table[:, :2], [[0, 0]], 0)[kinds[:, :MODE]].max(
        1
    )  # -1, none, finds the zeros
    return Mesh(
        centre,
        v,
        np.concatenate(normals).astype(np.float32),
        uv.astype(np.float32),
        np.concatenate(colours).astype(np.float32),
        f,
        part,
        face_normal.astype(np.float32),
        (np.linalg.norm(slopes, axis=2) * sizes[part]).max(1).astype(np.float32),
        slopes,
        np.array(floats, np.float32),
        kinds,
        stack,
        edges,
        sharp,
    )


def _uv_slopes(uv: np.ndarray, corners: np.ndarray, cross: np.ndarray) -> np.ndarray:
    # a place on the face is a + s e1 + t e2: s grows along e2 x n, t along n x e1, both over the square of n
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    square = (cross**2).sum(1)[:, None]
    s, t = divide(np.cross(e2, cross), square), divide(np.cross(cross, e1), square)
    return (
        (uv[:, 1] - uv[:, 0])[:, :, None] * s[:, None]
        + (uv[:, 2] - uv[:, 0])[:, :, None] * t[:, None]
    ).astype(np.float32)


def _edges(
    vertices: np.ndarray, faces: np.ndarray, part: np.ndarray, face_normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edges between positions, with their two faces. Edges of one face, or of more than two, are listed by face: always sharp."""
    first, position = same_rows(vertices.astype(np.float32))
    at = position[faces]
    e = np.sort(np.concatenate([at[:, [0, 1]], at[:, [1, 2]], at[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((e[:, 1], e[:, 0]))
    e, owner = e[order], owner[order]
    new = np.r_[True, (e[1:] != e[:-1]).any(1)]
    start = np.flatnonzero(new)
    count = np.diff(np.r_[start, len(e)])
    pair = start[count == 2]
    a, b = owner[pair], owner[pair + 1]
    flat = (face_normal[a] * face_normal[b]).sum(1) > _CREASE_COS
    other = start[count != 2]
    start = np.r_[pair, other]
    edges = np.stack([*first[e[start]].T, owner[start], np.r_[b, np.full(len(other), -1)]], 1)
    sharp = np.r_[~flat | (part[a] != part[b]), np.ones(len(other), bool)]
    return edges.astype(np.int32), sharp
