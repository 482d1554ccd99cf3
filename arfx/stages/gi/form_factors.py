"""What each texel of the real planes sees of the object, by rays (embree), once per clip: form factors.

Voxels are a bad judge of it: a wall one voxel thick lets 5 to 15 % of a narrow cone through, a curved one is fatter by up to
a voxel than the surface is; on a plane beside the object these are up to 4 % of the light too much, or 10 % too little, and
finer voxels exchange one for the other. Rays are exact, and say which voxel's light arrives, so that a new light is a
weighted sum. Metal sends on what lies in the mirrored direction. Directions are a Fibonacci lattice, cosine-weighted, shifted
from texel to texel. Source: form factors of radiosity (Goral et al. 1984), Monte Carlo.
Cost: O(rays that meet the object's box), none per frame. Leaves out: parts that can be seen through (those keep their cones);
lamps mirrored by metal (caustics)."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from arfx.core.model import OPAQUE
from arfx.core.numerics import normalise
from arfx.core.scene import Scene
from arfx.stages.gi.cones import around_normals, mirror_tangent
from arfx.stages.gi.voxelise import Voxels
from arfx.stages.triangles import Triangles, model_triangles

METAL = 0.5  # metalness from which a part mirrors instead of scattering
SHIFTS = 64  # different lattices
_BATCH = 1 << 20  # rays at once: bounds memory
_LIFT = 1e-4  # of the object's size: rays start off the plane by this
_INSIDE = (
    0.5  # share of rays that leave the object from within: such a texel lies under it, in its solid
)


@dataclass(frozen=True, eq=False)
class Mirrored:
    """Rays that meet one metal part. rows (k,) of Factors;  place, direction (k, 3) float32 : mirrored there, metres, anchor
    axes;  tangent : of its lobe's half-angle"""

    rows: np.ndarray
    position: np.ndarray
    direction: np.ndarray
    tangent: float


@dataclass(frozen=True, eq=False)
class Factors:
    """Of one plane. texel, voxel (m,) int32, one entry per ray that meets the object: the voxel it meets;  fraction : of each ray
    diffuse_voxel (m,) : voxel, -1 where a ray meets metal
    covered (texels, cones) float32 : share of a texel's hemisphere in which a cone is blocked
    source (texels,) int32 : texel whose values count, another where one lies in the object itself
    mirrored : those on metal"""

    texel: np.ndarray
    voxel: np.ndarray
    fraction: float
    covered: np.ndarray
    source: np.ndarray
    mirrored: tuple[Mirrored, ...]
    diffuse_voxel: np.ndarray


def solid(scene: Scene) -> bool:
    """Whether rays suffice: no part can be seen through."""
    return all(p.material.alpha_mode == OPAQUE for p in scene.model.parts)


def factors_of(
    scene: Scene,
    voxels: Voxels,
    positions: np.ndarray,
    axes: np.ndarray,
    cones: np.ndarray,
    rays: int,
) -> Factors:
    """positions (side, side, 3) : of a plane's texels, anchor axes;  axes (4, 3) : of the plane;  cones (k, 3) : directions about
    its normal, each ray counts for the nearest;  rays : of each texel"""
    side = positions.shape[0]
    corners, normals, part_of, _ = model_triangles(scene)
    corners, normals = np.ascontiguousarray(corners, np.float32), normals.astype(np.float32)
    low, high = corners.reshape(-1, 3).min(0), corners.reshape(-1, 3).max(0)
    lift = _LIFT * max(float((high - low).max()), 1e-9)
    points = (positions.reshape(-1, 3) + lift * axes[3]).astype(np.float32)
    mesh = Triangles(corners, robust=True)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(
        np.float32
    )
    frame = around_normals(axes[3][None].astype(np.float32), np.eye(3, dtype=np.float32))[0]
    lattice, nearest = lattices(rays, frame, cones)
    covered, inside = (
        np.zeros((side * side, len(cones)), np.float32),
        np.zeros(side * side, np.float32),
    )
    metal = np.array([p.material.metallic >= METAL for p in scene.model.parts])
    texels, hits = [np.zeros(0, np.int32)], [np.zeros((0, 3), np.float32)]
    reflections, metals = [np.zeros((0, 3), np.float32)], [np.zeros((0, 2), np.int64)]
    step = max(_BATCH // rays, 1)
    box = np.stack([low, high]).astype(np.float32)
    for first in range(0, side * side, step):
        texel, cone, direction = rays_towards_object(
            points[first : first + step], first, side, lattice, nearest, box
        )
        if not len(texel):
            continue
        result = mesh.first_hits(points[texel], direction)
        prim = np.asarray(result["primID"]).astype(np.int64)
        met = np.flatnonzero(prim >= 0)
        texel, cone, direction, prim = texel[met], cone[met], direction[met], prim[met]
        np.add.at(covered, (texel, cone), np.float32(1 / rays))
        leaving = (normal[prim] * direction).sum(1) > 0
        inside += np.bincount(texel[leaving], minlength=side * side).astype(np.float32) / rays
        texels.append(texel.astype(np.int32))
        hits.append(points[texel] + np.asarray(result["tfar"], np.float32)[met, None] * direction)
        shines = np.flatnonzero(metal[part_of[prim]] & ~leaving)
        u, v = (np.asarray(result[name], np.float32)[met][shines, None] for name in "uv")
        n = normals[prim[shines]]
        n = normalise(n[:, 0] * (1 - u - v) + n[:, 1] * u + n[:, 2] * v)
        d = direction[shines]
        reflections.append(d - 2 * (d * n).sum(1, keepdims=True) * n)
        metals.append(np.stack([shines + sum(map(len, texels[:-1])), part_of[prim[shines]]], -1))
    texel, position, directions = (
        np.concatenate(texels),
        np.concatenate(hits),
        np.concatenate(reflections).astype(np.float32),
    )
    rows, part = np.concatenate(metals).T
    mirrored = []
    for k in np.unique(part):
        of, tangent = part == k, float(mirror_tangent(scene.model.parts[k].material.roughness))
        mirrored.append(Mirrored(rows[of], position[rows[of]], directions[of], tangent))
    source = _sources(inside.reshape(side, side) > _INSIDE)
    voxel = voxel_at(voxels, position)
    diffuse_voxel = voxel.copy()
    diffuse_voxel[rows] = -1
    return Factors(texel, voxel, 1 / rays, covered, source, tuple(mirrored), diffuse_voxel)


@numba.njit(cache=True, nogil=True)
def gather(texel, voxel, radiance, out):  # pragma: no cover - compiled
    """out (texels, 3) float64 += radiance (v, 3) float32 of the voxels (m,) that texels (m,) meet; voxel -1 = none."""
    for i in range(texel.shape[0]):
        v, t = voxel[i], texel[i]
        if v >= 0:
            out[t, 0] += radiance[v, 0]
            out[t, 1] += radiance[v, 1]
            out[t, 2] += radiance[v, 2]


def voxel_at(voxels: Voxels, positions: np.ndarray) -> np.ndarray:
    """(m,) int32 row of the voxel that holds each position (m, 3), metres, anchor axes; of the nearest where none does."""
    n = voxels.volume.n
    row_of = np.full(n**3, -1, np.int32)  # for a moment: 8 MB at 128
    row_of[_keys(voxels.cells, n)] = np.arange(len(voxels.cells), dtype=np.int32)
    cell = (
        (positions - np.asarray(voxels.volume.low_m, np.float32))
        / np.float32(voxels.volume.voxel_m)
    ).astype(np.int32)
    out = row_of[_keys(np.clip(cell, 0, n - 1), n)]
    missing = np.flatnonzero(out < 0)
    if len(missing):
        from scipy.spatial import cKDTree

        out[missing] = cKDTree(voxels.centres_m).query(positions[missing])[1]
    return out


def _keys(cells: np.ndarray, n: int) -> np.ndarray:
    return np.asarray((cells[:, 2] * n + cells[:, 1]) * n + cells[:, 0])


def _sources(inside: np.ndarray) -> np.ndarray:
    """(texels,) int32 : of the nearest texel that is not inside; every texel itself where all are."""
    own = np.arange(inside.size, dtype=np.int32)
    if not inside.any() or inside.all():
        return own
    from scipy.ndimage import (
        distance_transform_edt,
    )  # 30 ms, which a job without this stage need not take

    row, column = distance_transform_edt(inside, return_distances=False, return_indices=True)
    return (row.ravel() * inside.shape[1] + column.ravel()).astype(np.int32)


def lattices(rays: int, frame: np.ndarray, cones: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosine-weighted unit directions (SHIFTS, rays, 3) float32 about a plane's normal, and the nearest cone of each.

    frame (3, 3) : rows are the plane's x, y and normal;  cones (k, 3) : unit, about the normal z"""
    shift, i = np.arange(SHIFTS)[:, None] / SHIFTS, np.arange(rays)
    u, phi = ((i + 0.5) / rays + shift) % 1, 2 * np.pi * ((i * 0.6180339887498949 + 7 * shift) % 1)
    r = np.sqrt(u)
    local = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u)], -1)
    return (local @ frame).astype(np.float32), np.asarray((local @ cones.T).argmax(-1))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def rays_towards_object(points, first, side, lattice, nearest, box):  # pragma: no cover - compiled
    """Rays from texels that can meet the object: (texel (m,), cone (m,), unit direction (m, 3)).

    points (t, 3) float32 : of texels `first` and on, of a plane `side` texels wide;  lattice, nearest : of `lattices`
    box (2, 3) : lowest and highest corner of the object"""
    shifts, rays = lattice.shape[:2]
    most = points.shape[0] * rays
    texel, cone, direction = (
        np.empty(most, np.int64),
        np.empty(most, np.int64),
        np.empty((most, 3), np.float32),
    )
    m = 0
    for t in range(points.shape[0]):
        column, row = (first + t) % side, (first + t) // side
        # interleaved gradient noise (Jimenez 2014): neighbours differ as much as they can
        noise = (52.9829189 * ((0.06711056 * column + 0.00583715 * row) % 1.0)) % 1.0
        which = min(int(noise * shifts), shifts - 1)
        for i in range(rays):
            near, far = np.float32(0), np.float32(np.inf)
            for k in range(3):
                d = lattice[which, i, k]
                if abs(d) < np.float32(1e-9):
                    d = np.float32(1e-9)
                lower, upper = (box[0, k] - points[t, k]) / d, (box[1, k] - points[t, k]) / d
                near, far = max(near, min(lower, upper)), min(far, max(lower, upper))
            if near > far * np.float32(1.0001):
                continue
            for k in range(3):
                direction[m, k] = lattice[which, i, k]
            texel[m], cone[m] = first + t, nearest[which, i]
            m += 1
    return texel[:m], cone[:m], direction[:m]
