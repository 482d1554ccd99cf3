"""Self-shadow under a directional light: a depth map along the light, sampled around each
pixel's position.

The blockers found within the light's cone give the width of the penumbra there, and so the
radius of a second filtering (Fernando 2005, "Percentage-closer soft shadows"). Every answer
is compared with the depth of the receiver's own tangent plane at that very texel, from a
place lifted off the surface by more than the texels and facets are coarse: no acne, and
nothing comes loose that is farther apart than that. Cost: O(covered pixels x taps). `high`
sends rays where the map finds a penumbra, `reference` everywhere."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from arfx.core.layers import packed
from arfx.core.numerics import normalise
from arfx.core.pose import Pose
from arfx.core.sampling import disc
from arfx.stages.light.beams import Beam, disc_directions
from arfx.stages.light.caster import Caster
from arfx.stages.light.silhouette import height_map
from arfx.stages.triangles import Triangles

_EMPTY = -1e9
_LIFT_TEXELS = 1.5
_LIFT_SAGS = 2.0
_LIFT_RAYS = 1e-3  # of the extent
# of the distance: embree's hit points, and so the rays raster's places, are 1.5e-4 of it
# wrong
_LIFT_FAR = 4e-4
_NARROWEST, _WIDEST = (
    1.7,
    40.0,
)  # texels, radius in which the map is sampled: under it the texels' steps show


@dataclass(frozen=True)
class SelfLevel:
    """texels : of the depth map, a side, 0 = none;  search : questions to it for blockers,
    or first rays where there is no map
    taps : questions to it for light where some of these are hidden, 0 = the search is the answer
    rays : sent where the map, or the first of them, do not agree, 0 = none
    soft : penumbrae as wide as the light's disc makes them"""

    texels: int
    search: int
    taps: int
    rays: int
    soft: bool = True


SELF_LEVELS = {
    "draft": SelfLevel(256, 5, 0, 0, False),
    "standard": SelfLevel(384, 14, 64, 0),
    "high": SelfLevel(768, 32, 128, 0),
    "reference": SelfLevel(0, 50, 0, 400),
}


class DepthMap(NamedTuple):
    """depth (n, n) float32 : nearest to the light, in texels along it;  matrix (3, 4) :
    column, row and depth of a position in
    metres, unit (3, 3) : their directions;  spread : penumbra radius per depth
    lift, slope : texels, and slope by which facets may deviate;  top : least depth"""

    depth: np.ndarray
    matrix: np.ndarray
    unit: np.ndarray
    spread: np.float32
    lift: np.float32
    slope: np.float32
    top: np.float32


def depth_map(caster: Caster, beam: Beam, level: SelfLevel) -> DepthMap:
    """Of every triangle, over the square around them; positions in anchor axes."""
    w = np.array(beam.direction)
    s = normalise(np.cross([0.0, 0, 1] if abs(w[2]) < 0.9 else [1.0, 0, 0], w))
    axes = np.stack([s, np.cross(w, s), w])
    p = caster.vertices @ axes.T
    low, high = p[:, :2].min(0), p[:, :2].max(0)
    pitch = max(float((high - low).max()) / (level.texels - 5), 1e-9)
    origin = (low + high) / 2 - pitch * (level.texels - 1) / 2
    matrix = np.column_stack([axes, [-origin[0], -origin[1], 0.0]]) / pitch
    u, v, h = (
        np.ascontiguousarray(a, np.float32)
        for a in (caster.vertices @ matrix[:, :3].T + matrix[:, 3]).T
    )
    depth = height_map(
        u, v, h, caster.faces, level.texels, level.texels, np.float32(_EMPTY)
    )
    spread = float(np.tan(np.radians(beam.size_deg / 2))) if level.soft else 0.0
    lift = _LIFT_TEXELS + _LIFT_SAGS * caster.sag_m / pitch
    return DepthMap(
        depth,
        matrix,
        axes,
        *(np.float32(a) for a in (spread, lift, caster.facet_slope, depth.max())),
    )


def visibility_by_map(
    coverage: np.ndarray,
    normal: np.ndarray,
    position: np.ndarray,
    shadow_map: DepthMap,
    anchor_from_world: Pose,
    level: SelfLevel,
) -> np.ndarray:
    """(h, w) float32, 0..1: the share of the light that is left; 1 where the pixel is not
    covered or turned away.
    """
    turn = shadow_map.matrix[:, :3] @ anchor_from_world.rotation
    shift = (
        shadow_map.matrix[:, :3] @ anchor_from_world.translation_m + shadow_map.matrix[:, 3]
    )
    matrix = np.column_stack([turn, shift]).astype(np.float32)
    seen = shadow_map._replace(
        matrix=matrix, unit=(turn / np.linalg.norm(turn[0])).astype(np.float32)
    )
    search, taps = (
        disc(level.search).astype(np.float32),
        disc(level.taps).astype(np.float32),
    )  # of none: (0, 2)
    return _percentage_closer(
        packed(coverage), packed(normal), packed(position), seen, search, taps
    )


def visibility_by_rays(
    coverage: np.ndarray,
    normal: np.ndarray,
    position: np.ndarray,
    rays: Triangles,
    caster: Caster,
    beam: Beam,
    anchor_from_world: Pose,
    level: SelfLevel,
    eye: np.ndarray,
    by_map: np.ndarray | None,
) -> np.ndarray:
    """The same with rays over the light's disc, weighted by their cosine to the normal. eye
    (3,) : the camera, WORLD frame

    by_map : (h, w), kept where it is 0 or 1;  None = rays decide everywhere, `level.search`
    of them first
    """
    mixed = coverage > 0 if by_map is None else (by_map > 0) & (by_map < 1)
    out = np.ones(coverage.shape, np.float32) if by_map is None else by_map.copy()
    directions = disc_directions(
        beam, disc(level.rays if beam.size_deg > 0 else 1), over_plane=False
    )
    n = normal.astype(float) @ anchor_from_world.rotation.T
    y, x = np.nonzero(mixed & (n @ np.array(beam.direction) > 0))
    n, seen = n[y, x], position[y, x].astype(float)
    lift = np.maximum(
        max(_LIFT_SAGS * caster.sag_m, _LIFT_RAYS * caster.extent_m),
        _LIFT_FAR * np.linalg.norm(seen - eye, axis=1),
    )
    points = anchor_from_world.apply(seen) + lift[:, None] * n
    first = len(directions) // level.search if by_map is None else 1
    out[y, x] = rays.visible_fraction(points, directions, n, first)
    return out


@numba.njit(
    cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy"
)
def _percentage_closer(
    coverage, normal, position, seen: DepthMap, search, taps
):  # pragma: no cover - compiled
    depth, matrix, unit, spread, lift, slope, top = seen
    rows, columns = coverage.shape
    out = np.ones((rows, columns), np.float32)
    size = depth.shape[0]
    texels = depth.reshape(-1)
    zero, one, half, far = (
        np.float32(0),
        np.float32(1),
        np.float32(0.5),
        np.float32(size - 1),
    )
    least = np.float32(_NARROWEST)
    at = np.empty(columns, np.uintp)
    s, t, z = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    gs, gt, radius = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    blockers, total = np.empty(columns, np.float32), np.empty(columns, np.float32)
    cell = np.empty(columns, np.int32)
    edge = np.empty(columns, np.float32)
    across = np.int32(size)
    for y in range(rows):
        n = 0
        for x in range(columns):
            facing = (
                unit[2, 0] * normal[y, x, 0]
                + unit[2, 1] * normal[y, x, 1]
                + unit[2, 2] * normal[y, x, 2]
            )
            at[n] = x
            n += (coverage[y, x] > zero) & (facing > zero)
        if n == 0:
            continue
        for i in range(n):
            x = at[i]
            a, b, c = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
            px, py, pz = position[y, x, 0], position[y, x, 1], position[y, x, 2]
            ns = unit[0, 0] * a + unit[0, 1] * b + unit[0, 2] * c
            nt = unit[1, 0] * a + unit[1, 1] * b + unit[1, 2] * c
            nw = max(unit[2, 0] * a + unit[2, 1] * b + unit[2, 2] * c, np.float32(0.15))
            s[i] = (
                matrix[0, 0] * px
                + matrix[0, 1] * py
                + matrix[0, 2] * pz
                + matrix[0, 3]
                + lift * ns
            )
            t[i] = (
                matrix[1, 0] * px
                + matrix[1, 1] * py
                + matrix[1, 2] * pz
                + matrix[1, 3]
                + lift * nt
            )
            z[i] = (
                matrix[2, 0] * px
                + matrix[2, 1] * py
                + matrix[2, 2] * pz
                + matrix[2, 3]
                + lift * nw
            )
            gs[i], gt[i] = -ns / nw, -nt / nw
        for i in range(n):
            radius[i] = min(max(spread * (top - z[i]), least), np.float32(_WIDEST))
            blockers[i], total[i] = zero, zero
        for k in range(search.shape[0]):
            ox, oy = search[k, 0], search[k, 1]
            for i in range(n):
                u, v = (
                    min(max(s[i] + ox * radius[i], zero), far),
                    min(max(t[i] + oy * radius[i], zero), far),
                )
                iu, iv = np.int32(u + half), np.int32(v + half)
                du, dv = np.float32(iu) - s[i], np.float32(iv) - t[i]
                cell[i] = iv * across + iu
                edge[i] = z[i] + gs[i] * du + gt[i] * dv + slope * (abs(du) + abs(dv))
            for i in range(n):
                d = texels[np.uintp(cell[i])]
                hit = one if d > edge[i] else zero
                blockers[i] += hit
                total[i] += hit * d
        # only where some of them are hidden is there more to ask
        every, m = np.float32(search.shape[0]), 0
        for i in range(n):
            out[y, at[i]] = one - blockers[i] / every
            if (taps.shape[0] > 0) & (blockers[i] > zero) & (blockers[i] < every):
                mean = total[i] / blockers[i]
                radius[m] = min(max(spread * (mean - z[i]), least), radius[i])
                s[m], t[m], z[m], gs[m], gt[m], at[m], total[m] = (
                    s[i],
                    t[i],
                    z[i],
                    gs[i],
                    gt[i],
                    at[i],
                    zero,
                )
                m += 1
        for k in range(taps.shape[0]):
            ox, oy = taps[k, 0], taps[k, 1]
            for i in range(m):
                u, v = (
                    min(max(s[i] + ox * radius[i], zero), far),
                    min(max(t[i] + oy * radius[i], zero), far),
                )
                iu, iv = np.int32(u + half), np.int32(v + half)
                du, dv = np.float32(iu) - s[i], np.float32(iv) - t[i]
                cell[i] = iv * across + iu
                edge[i] = z[i] + gs[i] * du + gt[i] * dv + slope * (abs(du) + abs(dv))
            for i in range(m):
                total[i] += one if texels[np.uintp(cell[i])] > edge[i] else zero
        fraction = one / np.float32(taps.shape[0])
        for i in range(m):
            out[y, at[i]] = one - fraction * total[i]
    return out
