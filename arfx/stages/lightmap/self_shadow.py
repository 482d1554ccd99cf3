"""Self-shadow under a directional light: a depth map along the light, sampled around each
pixel's position.

The blockers found within the light's cone give the width of the penumbra there, and so the
radius of a second filtering (Fernando 2005, "Percentage-closer soft shadows"). Every answer
is compared with the depth of the receiver's own tangent plane at that very texel, from a
place lifted off the surface by more than the texels and facets are coarse: no acne, and
nothing comes loose that is farther apart than that. Cost: O(covered pixels x taps).
`reference` sends rays instead."""

# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel
from arfx.core.layers import packed
from arfx.core.pose import Pose
from arfx.core.sampling import disc, frame_about
from arfx.core.vectors import placed, shifted, turned
from arfx.stages.light.beams import Beam, disc_directions
from arfx.stages.light.caster import Caster
from arfx.stages.light.silhouette import height_map
from arfx.stages.triangles import Triangles

_F = np.float32
_EMPTY = -1e9
_LIFT_TEXELS = 1.5
_LIFT_SAGS = 2.0
_LIFT_RAYS = 1e-3  # of the extent
# of the distance: embree's hit points, and so the rays raster's places, are 1.5e-4 of it
# wrong
_LIFT_FAR = 4e-4
# texels, radius in which the map is sampled: under it the texels' steps show
_NARROWEST, _WIDEST = 1.7, 40.0
MAP_TEXELS = 384  # a side of the depth map
BLOCKER_TAPS, LIGHT_TAPS = (
    16,
    64,
)  # questions to it: for blockers, and where they disagree
RAYS = 400  # over the light's disc
FIRST_EVERY = 8  # every so manieth ray is sent first, the rest where those disagree


class DepthMap(NamedTuple):
    """depth (n, n) float32 : nearest to the light, in texels along it;  matrix (3, 4) :
    column, row and depth of a position in
    metres, unit (3, 3) : their directions;  spread : penumbra radius per depth
    lift, slope : texels, and slope by which facets may deviate;  top : least depth"""

    depth: ndarray
    matrix: ndarray
    unit: ndarray
    spread: np.float32
    lift: np.float32
    slope: np.float32
    top: np.float32


def depth_map(caster: Caster, beam: Beam) -> DepthMap:
    """Of every triangle, over the square around them; positions in anchor axes."""
    w = np.array(beam.direction)
    axes = np.stack([*frame_about(w), w])
    p = caster.vertices @ axes.T
    low, high = p[:, :2].min(0), p[:, :2].max(0)
    pitch = max(float((high - low).max()) / (MAP_TEXELS - 5), 1e-9)
    origin = (low + high) / 2 - pitch * (MAP_TEXELS - 1) / 2
    matrix = np.column_stack([axes, [-origin[0], -origin[1], 0.0]]) / pitch
    u, v, h = np.ascontiguousarray(
        (caster.vertices @ matrix[:, :3].T + matrix[:, 3]).T
    )
    depth = height_map(u, v, h, caster.faces, MAP_TEXELS, MAP_TEXELS, _F(_EMPTY))
    spread = np.tan(np.radians(beam.size_deg / 2))
    lift = _LIFT_TEXELS + _LIFT_SAGS * caster.sag_m / pitch
    return DepthMap(
        depth,
        matrix,
        axes,
        *(_F(a) for a in (spread, lift, caster.facet_slope, depth.max())),
    )


def visibility_by_map(
    coverage: ndarray,
    normal: ndarray,
    position: ndarray,
    shadow_map: DepthMap,
    anchor_from_world: Pose,
) -> ndarray:
    """(h, w) float32, 0..1: the share of the light that is left; 1 where the pixel is not
    covered or turned away.
    """
    matrix = shadow_map.matrix @ anchor_from_world.matrix
    turn = matrix[:, :3]
    seen = shadow_map._replace(
        matrix=matrix.astype(np.float32),
        unit=(turn / np.linalg.norm(turn[0])).astype(np.float32),
    )
    out = np.ones(coverage.shape, np.float32)
    search, taps = (
        packed(disc(n).T.astype(np.float32)) for n in (BLOCKER_TAPS, LIGHT_TAPS)
    )
    layers = packed(coverage), packed(normal), packed(position)
    _percentage_closer(out, *layers, seen, search, taps)
    return out


def visibility_by_rays(
    coverage: ndarray,
    normal: ndarray,
    position: ndarray,
    rays: Triangles,
    caster: Caster,
    beam: Beam,
    anchor_from_world: Pose,
    eye: ndarray,
) -> ndarray:
    """The same with rays over the light's disc, weighted by their cosine to the normal. eye
    (3,) : the camera, WORLD frame
    """
    out = np.ones(coverage.shape, np.float32)
    points_of_disc = disc(RAYS if beam.size_deg > 0 else 1)
    directions = disc_directions(beam, points_of_disc, over_plane=False)
    n = normal.astype(float) @ anchor_from_world.rotation.T
    y, x = np.nonzero((coverage > 0) & (n @ np.array(beam.direction) > 0))
    n, seen = n[y, x], position[y, x].astype(float)
    lift = np.maximum(
        max(_LIFT_SAGS * caster.sag_m, _LIFT_RAYS * caster.extent_m),
        _LIFT_FAR * np.linalg.norm(seen - eye, axis=1),
    )
    points = anchor_from_world.apply(seen) + lift[:, None] * n
    first = min(FIRST_EVERY, len(directions))
    out[y, x] = rays.visible_fraction(points, directions, n, first)
    return out


@line_kernel(fastmath=FAST, error_model="numpy")
def _percentage_closer(
    out, coverage, normal, position, seen: DepthMap, search, taps
):  # pragma: no cover - compiled
    """out (h, w) : of the pixels that are covered and face the light"""
    zero, one = _F(0), _F(1)
    least = _F(_NARROWEST)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            if not coverage[y, x] > zero:
                continue
            across, down, facing = turned(seen.unit, normal[y, x])
            if not facing > zero:
                continue
            facing = max(facing, _F(0.15))
            tilt = across / facing, down / facing
            place = placed(seen.matrix, position[y, x])
            place = shifted(place, seen.lift, (across, down, facing))
            widest = seen.spread * (seen.top - place[2])
            radius = min(max(widest, least), _F(_WIDEST))
            blockers, depths = _blockers(seen, place, tilt, search, radius)
            share = blockers / _F(search.shape[1])
            if share > zero and share < one:
                penumbra = seen.spread * (depths / blockers - place[2])
                radius = min(max(penumbra, least), radius)
                blockers, _ = _blockers(seen, place, tilt, taps, radius)
                share = blockers / _F(taps.shape[1])
            out[y, x] = one - share


@line_kernel(fastmath=FAST | {"reassoc"}, error_model="numpy")
def _blockers(
    seen: DepthMap, place, tilt, points, radius
):  # pragma: no cover - compiled
    """(how many, sum of their depths) of the map's texels at `points` (2, k) of a disc that
    are nearer to the light than the plane through `place` whose depth falls by `tilt`."""
    texels, side = seen.depth.reshape(-1), np.int32(seen.depth.shape[0])
    half, last = _F(0.5), _F(side - 1)
    count, total = _F(0), _F(0)
    for k in range(points.shape[1]):
        u = min(max(place[0] + points[0, k] * radius, _F(0)), last)
        v = min(max(place[1] + points[1, k] * radius, _F(0)), last)
        column, row = np.int32(u + half), np.int32(v + half)
        du, dv = _F(column) - place[0], _F(row) - place[1]
        edge = (
            place[2] - tilt[0] * du - tilt[1] * dv + seen.slope * (abs(du) + abs(dv))
        )
        depth = texels[np.uintp(row * side + column)]
        hit = _F(depth > edge)
        count += hit
        total += hit * depth
    return count, total
