"""What the object, and its own shadow on the plane, hide of the soft light from each place of the object.

The soft light's radiance rises evenly towards one side, 1 + shape . d (`beams.FrameLight`), so what is hidden is the sum of four
parts, of 1 and of the three coordinates of d. Rays from points all over the surface find them once per clip, and the nodes of a
grid keep the means of what is near. Points and pixels meet the grid one cell off the surface, along their normal: so what is on
the two sides of a wall does not mix, nor what is on the two sides of an edge. A light sums the parts, a pixel reads between eight
nodes. Cost: O(points x rays) a clip, O(covered pixels) a frame. Leaves out: light from the object onto itself. `reference` sends
rays from every pixel. Source: docs/methods/light.md#shading; irradiance volumes (Greger et al. 1998)."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from arfx.core.layers import packed
from arfx.core.numerics import divide, normalise
from arfx.core.parallel import parallel_map
from arfx.core.pose import Pose
from arfx.stages.lightmap.caster import Caster
from arfx.stages.lightmap.plane import SoftPicture
from arfx.stages.lightmap.shading import covered_span
from arfx.stages.triangles import Triangles, hemisphere

_DIFFUSE = 2 / 3  # of the shape's rise that is left in the light on a surface
_POINTS = 6.0  # for an area of a cell's face
_LEAST_SEEN = 1e-3  # of the hemisphere: a point counts by what it sees, as cameras see it, and one inside does not
_LIFT = 1e-3  # of the extent, as rays of self_shadow.py
_LIFT_SAGS = 2.0
_GOLDEN = np.pi * (3 - np.sqrt(5))
_BATCH = 1 << 19  # rays in flight
_FIRST = 4  # one in so many of a pixel's rays is asked first


@dataclass(frozen=True)
class OcclusionLevel:
    """cells : of the grid, along the object's largest side, 0 = rays from every pixel;  rays : from a point
    most_points : of the surface, that rays go out from"""

    cells: int
    rays: int
    most_points: int = 30_000


OCCLUSION_LEVELS = {
    "draft": OcclusionLevel(16, 32),
    "standard": OcclusionLevel(32, 64),
    "high": OcclusionLevel(96, 96, 60_000),
    "reference": OcclusionLevel(0, 400),
}


@dataclass(frozen=True, eq=False)
class OcclusionGrid:
    """parts (z, y, x, 4) float32 : hidden light of 1 and of the three coordinates;  low_m (3,) : the first node;  pitch_m.
    Anchor axes"""

    parts: np.ndarray
    low_m: np.ndarray
    pitch_m: float

    def under(self, shape: tuple[float, float, float]) -> np.ndarray:
        """(z, y, x) float32: what is hidden of a soft light of this shape."""
        return np.ascontiguousarray(self.parts @ np.array([1.0, *shape], np.float32))


class _Grid(NamedTuple):
    """nodes (z, y, x) : hidden light;  matrix (3, 7) : node of a WORLD place, and from it for a normal;  rise (3,) : of the
    light over normals"""

    nodes: np.ndarray
    matrix: np.ndarray
    rise: np.ndarray


def hidden_parts(
    rays: Triangles,
    plane: SoftPicture,
    points: np.ndarray,
    normals: np.ndarray,
    count: int,
    angles: np.ndarray | None = None,
) -> np.ndarray:
    """(n, 4) of the light on a surface that is hidden: of 1 and of the three coordinates. Anchor axes.

    plane : what the plane is darkened by;  count : rays each;  angles (n,) : that the rays' pattern is turned by"""
    return _hidden(rays, plane, points, normals, count, angles)[:, :4]


def _hidden(
    rays: Triangles,
    plane: SoftPicture,
    points: np.ndarray,
    normals: np.ndarray,
    count: int,
    angles: np.ndarray | None = None,
) -> np.ndarray:
    """(n, 5) : `hidden_parts`, and the share of the rays that the object stops."""
    local, turned = hemisphere(count), np.zeros(len(points)) if angles is None else angles
    parts = [
        slice(a, a + max(_BATCH // count, 1))
        for a in range(0, len(points), max(_BATCH // count, 1))
    ]

    def of(part: slice) -> np.ndarray:
        starts, towards, met = _rays_over(points[part], normals[part], turned[part], local)
        return np.asarray(
            _sums(
                towards,
                rays.blocked(starts, towards),
                plane.even_at(met.reshape(-1, count, 2)).ravel(),
                count,
            )
        )

    return np.concatenate([np.zeros((0, 5)), *parallel_map(of, parts)])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rays_over(points, normals, angles, local):  # pragma: no cover - compiled
    """Starts and directions (n k, 3) of rays `local` (k, 3) over points with normals (n, 3), turned by angles (n,), and places on
    the plane (n k, 2) where they meet it, far away for those that do not."""
    n, k = len(points), len(local)
    starts, towards, met = (
        np.empty((n * k, 3), np.float32),
        np.empty((n * k, 3), np.float32),
        np.full((n * k, 2), 1e9),
    )
    for i in range(n):
        # an orthonormal basis that depends on the normal alone (Duff et al. 2017)
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        sign = -1.0 if z < 0 else 1.0
        f = -1 / (sign + z)
        g = x * y * f
        s, t = (1 + sign * x * x * f, sign * g, -sign * x), (g, sign + y * y * f, -y)
        c, d = np.cos(angles[i]), np.sin(angles[i])
        height = abs(points[i, 2])  # under the plane, where it is not seen: no seam
        for j in range(k):
            a, b, up = (
                c * local[j, 0] - d * local[j, 1],
                d * local[j, 0] + c * local[j, 1],
                local[j, 2],
            )
            at = i * k + j
            towards[at, 0] = a * s[0] + b * t[0] + up * x
            towards[at, 1] = a * s[1] + b * t[1] + up * y
            towards[at, 2] = a * s[2] + b * t[2] + up * z
            for m in range(3):
                starts[at, m] = points[i, m]
            if towards[at, 2] < 0:
                along = height / max(-towards[at, 2], 1e-6)
                met[at, 0], met[at, 1] = (
                    points[i, 0] + along * towards[at, 0],
                    points[i, 1] + along * towards[at, 1],
                )
    return starts, towards, met


@numba.njit(cache=True, nogil=True)
def _sums(towards, blocked, darkened, count):  # pragma: no cover - compiled
    """(n, 5) means of 1 and of the directions (n count, 3), weighted by 1 where these are blocked, else as the plane is
    darkened; and the share of those that are blocked."""
    out = np.zeros((len(towards) // count, 5))
    for i in range(len(out)):
        for at in range(i * count, (i + 1) * count):
            w = 1.0 if blocked[at] else float(darkened[at])
            out[i, 4] += blocked[at]
            out[i, 0] += w
            for m in range(3):
                out[i, 1 + m] += w * towards[at, m]
        for m in range(5):
            out[i, m] /= count
    return out


def occlusion_grid(
    caster: Caster, rays: Triangles, plane: SoftPicture, level: OcclusionLevel
) -> OcclusionGrid:
    """Of the surface's both sides."""
    from scipy.ndimage import uniform_filter

    pitch = max(caster.extent_m / level.cells, 1e-9)
    used = caster.vertices[np.unique(caster.faces)].astype(float)
    low = used.min(0) - 2 * pitch
    counts = np.ceil((used.max(0) - low) / pitch).astype(int) + 3  # x, y, z
    points, normals = _surface_points(caster, pitch, level.most_points)
    angles = np.arange(len(points)) * _GOLDEN
    sums, lift = np.zeros((int(counts.prod()), 5)), _lift_m(caster)
    for n in (normals, -normals):
        hidden = hidden_parts(rays, plane, points + lift * n, n, level.rays, angles)
        values = np.column_stack([hidden, np.ones(len(hidden))]) * np.maximum(
            1 - hidden[:, :1], _LEAST_SEEN
        )
        at = (points + pitch * n - low) / pitch
        first = at.astype(int)
        for corner in np.ndindex(2, 2, 2):
            i, j, k = (first + corner).T
            weight = np.where(corner, at - first, 1 - at + first).prod(1)
            node = (k * counts[1] + j) * counts[0] + i
            for c in range(5):
                sums[:, c] += np.bincount(node, weight * values[:, c], len(sums))
    nodes = sums.reshape(*counts[::-1], 5)
    for _ in range(2):  # nodes that no point reads have the mean of those beside them
        near = uniform_filter(nodes, (3, 3, 3, 1), mode="constant")
        nodes = np.where(nodes[..., 4:] > 1e-9, nodes, near)
    return OcclusionGrid(divide(nodes[..., :4], nodes[..., 4:]).astype(np.float32), low, pitch)


def _lift_m(caster: Caster) -> float:
    """Where rays begin over the surface."""
    return max(_LIFT_SAGS * caster.sag_m, _LIFT * caster.extent_m)


def _surface_points(caster: Caster, pitch: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """((n, 3), (n, 3) unit normals of their triangles), evenly over all of the surface."""
    corners = caster.vertices[caster.faces].astype(float)
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(ab, ac)
    upto = np.cumsum(np.linalg.norm(across, axis=1) / 2)
    count = int(np.clip(_POINTS * upto[-1] / pitch**2, 64, most))
    i = np.arange(count) + 0.5
    face = np.minimum(np.searchsorted(upto, i / count * upto[-1]), len(upto) - 1)
    u, v = (
        (i * 0.7548776662466927) % 1,
        (i * 0.5698402909980532) % 1,
    )  # powers of the plastic number: low discrepancy
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[face] + u[:, None] * ab[face] + v[:, None] * ac[face], normalise(across[face])


def soft_visibility(
    coverage: np.ndarray,
    normal: np.ndarray,
    position: np.ndarray,
    grid: OcclusionGrid,
    nodes: np.ndarray,
    anchor_from_world: Pose,
    shape: tuple[float, float, float],
) -> np.ndarray:
    """(h, w) float32, 0..1: the share of the soft light that is left; any where the pixel is not covered.

    nodes : of the grid, `under` the light of this shape"""
    turn = anchor_from_world.rotation
    shift = (anchor_from_world.translation_m - grid.low_m) / grid.pitch_m
    matrix = np.column_stack([turn / grid.pitch_m, shift, turn])
    rise = _DIFFUSE * turn.T @ np.array(shape)
    lines = _Grid(nodes, np.asfortranarray(matrix, np.float32), rise.astype(np.float32))
    return _read(packed(coverage), packed(normal), packed(position), lines)


def soft_visibility_by_rays(
    coverage: np.ndarray,
    normal: np.ndarray,
    position: np.ndarray,
    rays: Triangles,
    plane: SoftPicture,
    caster: Caster,
    anchor_from_world: Pose,
    shape: tuple[float, float, float],
    count: int,
) -> np.ndarray:
    """The same, with rays from every pixel: a part of them first, all where the object stops any of these."""
    out = np.ones(coverage.shape, np.float32)
    y, x = np.nonzero((coverage > 0) & (normal != 0).any(-1))
    n = normalise(normal[y, x].astype(float) @ anchor_from_world.rotation.T)
    points = anchor_from_world.apply(position[y, x].astype(float)) + _lift_m(caster) * n
    hidden = _hidden(rays, plane, points, n, max(count // _FIRST, 1))
    uneven = np.flatnonzero(hidden[:, 4] > 0)
    hidden[uneven] = _hidden(rays, plane, points[uneven], n[uneven], count)
    out[y, x] = np.clip(
        1 - hidden[:, :4] @ [1.0, *shape] / (1 + _DIFFUSE * n @ np.array(shape)), 0, 1
    )
    return out


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _read(coverage, normal, position, grid: _Grid):  # pragma: no cover - compiled
    nodes, m, rise = grid
    rows, columns = coverage.shape
    out = np.ones((rows, columns), np.float32)
    zero, one = np.float32(0), np.float32(1)
    nz, ny, nx = nodes.shape
    last_x, last_y, last_z = np.float32(nx - 1.001), np.float32(ny - 1.001), np.float32(nz - 1.001)
    flat, up, far = nodes.reshape(-1), np.int32(nx), np.int32(nx * ny)
    u, v, w = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    hidden, light = np.empty(columns, np.float32), np.empty(columns, np.float32)
    cell = np.empty(columns, np.int32)
    for y in range(rows):
        first, last = covered_span(coverage[y])
        n = last + 1 - first
        if n == 0:
            continue
        normals, positions, line = (
            normal[y, first : last + 1],
            position[y, first : last + 1],
            out[y, first : last + 1],
        )
        for i in range(n):
            a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
            x, r, s = positions[i, 0], positions[i, 1], positions[i, 2]
            u[i] = (
                m[0, 0] * x
                + m[0, 1] * r
                + m[0, 2] * s
                + m[0, 3]
                + m[0, 4] * a
                + m[0, 5] * b
                + m[0, 6] * c
            )
            v[i] = (
                m[1, 0] * x
                + m[1, 1] * r
                + m[1, 2] * s
                + m[1, 3]
                + m[1, 4] * a
                + m[1, 5] * b
                + m[1, 6] * c
            )
            w[i] = (
                m[2, 0] * x
                + m[2, 1] * r
                + m[2, 2] * s
                + m[2, 3]
                + m[2, 4] * a
                + m[2, 5] * b
                + m[2, 6] * c
            )
            light[i] = one + rise[0] * a + rise[1] * b + rise[2] * c
        for i in range(n):
            px, py, pz = (
                min(max(u[i], zero), last_x),
                min(max(v[i], zero), last_y),
                min(max(w[i], zero), last_z),
            )
            ix, iy, iz = np.int32(px), np.int32(py), np.int32(pz)
            u[i], v[i], w[i] = px - np.float32(ix), py - np.float32(iy), pz - np.float32(iz)
            cell[i] = (iz * np.int32(ny) + iy) * np.int32(nx) + ix
        for i in range(n):
            p = cell[i]
            a0, a1, a2, a3 = (
                flat[np.uintp(p)],
                flat[np.uintp(p + up)],
                flat[np.uintp(p + far)],
                flat[np.uintp(p + far + up)],
            )
            p += np.int32(1)
            b0, b1, b2, b3 = (
                flat[np.uintp(p)],
                flat[np.uintp(p + up)],
                flat[np.uintp(p + far)],
                flat[np.uintp(p + far + up)],
            )
            a0 += u[i] * (b0 - a0)
            a1 += u[i] * (b1 - a1)
            a2 += u[i] * (b2 - a2)
            a3 += u[i] * (b3 - a3)
            a0 += v[i] * (a1 - a0)
            a2 += v[i] * (a3 - a2)
            hidden[i] = a0 + w[i] * (a2 - a0)
        for i in range(n):
            line[i] = min(max(one - hidden[i] / light[i], zero), one)
    return out
