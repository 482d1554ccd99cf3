"""The model's surface as voxels: how much of each voxel's face it covers, its albedo and what it emits. Once per clip.

Axes are the anchor's (z out of the plane). Every triangle is sampled at less than half a voxel; samples carry their area,
so large and small triangles count alike and the order does not matter. Memory and time grow with the surface: cells live
in bricks of 4 x 4 x 4. Source: docs/methods/gi.md#voxels. Leaves out: textures of metalness and roughness."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, MASK, Part
from arfx.core.numerics import divide, normalise
from arfx.core.scene import Scene

BRICK = 4  # cells a side
_FINEST = 0.5  # of a voxel: distance of samples
_MOST = 4096  # samples along an edge
# A flat wall covers a voxel's face once, a slanted one that crosses a corner less: twice the area is opaque, so that
# slanted walls do not leak and what grazes a voxel does not fill it.
_GAIN = 2.0


@dataclass(frozen=True)
class Volume:
    """A cube of n^3 voxels. low_m : (x, y, z) of its lowest corner, anchor axes;  voxel_m : side of a voxel"""

    n: int
    low_m: tuple[float, float, float]
    voxel_m: float


@dataclass(frozen=True, eq=False)
class Voxels:
    """cells (v, 3) int32 x, y, z, in the order of bricks;  opacity (v,) 0..1;  albedo, emission (v, 3) float32
    normal (v, 3) float32 : unit, mean of the surface, anchor axes; 0 where two sides cancel"""

    volume: Volume
    cells: np.ndarray
    opacity: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray
    normal: np.ndarray

    @property
    def centres_m(self) -> np.ndarray:
        """(v, 3) float64, anchor axes."""
        return np.asarray(self.volume.low_m) + (self.cells + 0.5) * self.volume.voxel_m


class _Material(NamedTuple):
    """colours (n, 4) and uv (n, 2) of a part's corners, base and glow textures, emission (3,), cutoff of opacity

    reflectance (2,) : of the base colour, and of white beside it: metals count as diffuse, as voxels are
    coarser than any highlight."""

    colours: np.ndarray
    uv: np.ndarray
    base: np.ndarray
    glow: np.ndarray
    emission: np.ndarray
    reflectance: np.ndarray
    cutoff: np.float32


def volume_around(points_m: np.ndarray, n: int) -> Volume:
    """The smallest cube with one empty voxel around the points (k, 3); voxel borders lie on z = 0, where the plane is."""
    p = points_m[np.isfinite(points_m).all(1)]
    low, high = p.min(0), p.max(0)
    side = max(float((high - low).max()), 1e-9)
    voxel = side / (n - 3)
    low = (low + high) / 2 - voxel * n / 2
    # what stands on the plane fills the voxels over it: not by rounding those under it
    low[2] = (np.floor(p[:, 2].min() / voxel - 1 + 1e-3) - 1e-3) * voxel
    return Volume(n, (float(low[0]), float(low[1]), float(low[2])), voxel)


def voxelise(scene: Scene, n: int, within: Volume | None = None) -> Voxels:
    """Every part of the scene's model. n : voxels a side, a power of two. Triangles without area or not finite count for
    nothing. within : a cube, what is outside is left out; None = the smallest that holds the model"""
    anchor = scene.world_from_anchor.inverse().matrix @ scene.world_from_model
    used = np.concatenate([p.vertices[np.unique(p.faces)] for p in scene.model.parts])
    volume = within or volume_around(used @ anchor[:3, :3].T + anchor[:3, 3], n)
    per_side = -(-n // BRICK)
    linear = anchor[:3, :3] / np.cbrt(abs(np.linalg.det(anchor[:3, :3])))
    tables = []
    for part in scene.model.parts:
        v = (
            part.vertices @ anchor[:3, :3].T + anchor[:3, 3] - np.asarray(volume.low_m)
        ) / volume.voxel_m
        v = v.astype(np.float32)
        faces = part.faces[np.isfinite(v[part.faces]).all((1, 2))]
        tables.append(
            (
                v,
                np.ascontiguousarray(faces, np.int32),
                (part.normals @ linear.T).astype(np.float32),
                part,
            )
        )
    bricks = np.full(per_side**3, -1, np.int32)
    for v, faces, _, _ in tables:
        _mark(v, faces, n, per_side, bricks)
    where = np.flatnonzero(bricks == 0)
    bricks[where] = np.arange(len(where), dtype=np.int32)
    sums = np.zeros((len(where), BRICK**3, 11), np.float32)
    for v, faces, normals, part in tables:
        _accumulate(v, faces, normals, _material(part), n, per_side, bricks, sums)
    brick, cell = np.nonzero(sums[:, :, 0] > 0)
    s = sums[brick, cell].astype(float)
    zyx = np.array(np.unravel_index(where[brick], (per_side,) * 3)) * BRICK + np.unravel_index(
        cell, (BRICK,) * 3
    )
    mean = divide(s[:, 1:], s[:, :1])
    opacity = np.minimum(_GAIN * s[:, 0], 1) * np.clip(mean[:, 9], 0, 1)
    return Voxels(
        volume,
        np.ascontiguousarray(zyx[::-1].T, np.int32),
        opacity.astype(np.float32),
        mean[:, :3].astype(np.float32),
        mean[:, 3:6].astype(np.float32),
        normalise(mean[:, 6:9]).astype(np.float32),
    )


def _material(part: Part) -> _Material:
    m, count = part.material, len(part.vertices)
    colours = np.tile(np.asarray(m.base_colour, np.float32), (count, 1))
    if part.colours is not None:
        colours *= part.colours.astype(np.float32)
    first = m.base_texture or m.emissive_texture
    laid = None if first is None else part.uv_on(first)
    uv = np.zeros((count, 2), np.float32) if laid is None else laid.astype(np.float32)
    base, glow = np.ones((1, 1, 4), np.float32), np.ones((1, 1, 3), np.float32)
    decode = SRGB.decode(np.arange(256) / 255).astype(np.float32)
    if m.base_texture is not None and laid is not None:
        picture = m.base_texture.picture
        base = np.dstack([decode[picture[..., :3]], picture[..., 3:].astype(np.float32) / 255])
    if m.emissive_texture is not None and laid is not None:
        glow = decode[m.emissive_texture.picture[..., :3]]
    f0 = 0.08 * m.specular * (1 - m.metallic)
    reflectance = np.array([(1 - m.metallic) * (1 - f0) + m.metallic, f0], np.float32)
    cutoff = m.alpha_cutoff if m.alpha_mode == MASK else -1.0
    if m.alpha_mode not in (MASK, BLEND):
        colours[:, 3] = base[..., 3] = 1
    return _Material(
        colours,
        uv,
        np.ascontiguousarray(base),
        np.ascontiguousarray(glow),
        np.asarray(m.emissive, np.float32),
        reflectance,
        np.float32(cutoff),
    )


@numba.njit(cache=True, nogil=True)
def _steps(a, b, c):  # pragma: no cover - compiled
    """Samples along each edge, 0 for a triangle without area, and its area."""
    e0, e1, e2 = b - a, c - a, c - b
    longest = max(
        e0[0] * e0[0] + e0[1] * e0[1] + e0[2] * e0[2],
        e1[0] * e1[0] + e1[1] * e1[1] + e1[2] * e1[2],
        e2[0] * e2[0] + e2[1] * e2[1] + e2[2] * e2[2],
    )
    x = e0[1] * e1[2] - e0[2] * e1[1]
    y = e0[2] * e1[0] - e0[0] * e1[2]
    z = e0[0] * e1[1] - e0[1] * e1[0]
    area = np.float32(0.5) * np.sqrt(x * x + y * y + z * z)
    if not area > 0:
        return 0, area
    return min(int(np.sqrt(longest) / np.float32(_FINEST)) + 1, _MOST), area


@numba.njit(cache=True, nogil=True, inline="always")
def _sample(a, b, c, i, j, m):  # pragma: no cover - compiled
    """Centroid of sub-triangle j of row i when every edge is cut into m: weights of the three corners, and its voxel."""
    third = np.float32(1.0 / 3.0) if j % 2 == 0 else np.float32(2.0 / 3.0)
    p, q = (np.float32(i) + third) / np.float32(m), (np.float32(j // 2) + third) / np.float32(m)
    w = np.float32(1) - p - q
    x, y = np.floor(a[0] * w + b[0] * p + c[0] * q), np.floor(a[1] * w + b[1] * p + c[1] * q)
    return w, p, q, int(x), int(y), int(np.floor(a[2] * w + b[2] * p + c[2] * q))


@numba.njit(cache=True, nogil=True)
def _mark(v, faces, n, per_side, bricks):  # pragma: no cover - compiled
    """bricks : 0 where a sample falls, else as it was."""
    for f in range(faces.shape[0]):
        a, b, c = v[faces[f, 0]], v[faces[f, 1]], v[faces[f, 2]]
        m, _ = _steps(a, b, c)
        for i in range(m):
            for j in range(2 * (m - i) - 1):
                _, _, _, x, y, z = _sample(a, b, c, i, j, m)
                if 0 <= x < n and 0 <= y < n and 0 <= z < n:
                    bricks[((z // BRICK) * per_side + y // BRICK) * per_side + x // BRICK] = 0


@numba.njit(cache=True, nogil=True)
def _accumulate(
    v, faces, normals, look: _Material, n, per_side, bricks, sums
):  # pragma: no cover - compiled
    """sums (b, 64, 11) += area, and times the area: albedo (3), emission (3), normal (3), alpha."""
    colours, uv, base, glow, emission, reflectance, cutoff = look
    rows, columns, grows, gcolumns = base.shape[0], base.shape[1], glow.shape[0], glow.shape[1]
    for f in range(faces.shape[0]):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        a, b, c = v[i0], v[i1], v[i2]
        m, area = _steps(a, b, c)
        if m == 0:
            continue
        each = area / np.float32(m * m)
        for i in range(m):
            for j in range(2 * (m - i) - 1):
                w, p, q, x, y, z = _sample(a, b, c, i, j, m)
                if not (0 <= x < n and 0 <= y < n and 0 <= z < n):
                    continue
                s = uv[i0, 0] * w + uv[i1, 0] * p + uv[i2, 0] * q
                t = uv[i0, 1] * w + uv[i1, 1] * p + uv[i2, 1] * q
                s, t = s - np.floor(s), t - np.floor(t)
                texel = base[min(int(t * rows), rows - 1), min(int(s * columns), columns - 1)]
                alpha = (colours[i0, 3] * w + colours[i1, 3] * p + colours[i2, 3] * q) * texel[3]
                if cutoff >= 0:
                    if alpha < cutoff:
                        continue
                    alpha = np.float32(1)
                to = sums[bricks[((z // BRICK) * per_side + y // BRICK) * per_side + x // BRICK]]
                to = to[((z % BRICK) * BRICK + y % BRICK) * BRICK + x % BRICK]
                to[0] += each
                lit = glow[min(int(t * grows), grows - 1), min(int(s * gcolumns), gcolumns - 1)]
                for k in range(3):
                    colour = (colours[i0, k] * w + colours[i1, k] * p + colours[i2, k] * q) * texel[
                        k
                    ]
                    to[1 + k] += each * (colour * reflectance[0] + reflectance[1])
                    to[4 + k] += each * emission[k] * lit[k]
                    to[7 + k] += each * (
                        normals[i0, k] * w + normals[i1, k] * p + normals[i2, k] * q
                    )
                to[10] += each * alpha
