"""The reference level: what a thin lens sees, as an integral over its aperture. Shares no kernel
with the other levels.

The real scene: every pixel's light onto every pixel that its circle covers, circles as exact
areas, sums in float64. A pixel p sees the point x of a plane through the place o = (x - p) / s of
the lens, s the blur radius with its sign; s is affine on a plane, so a pixel's disc is weighted by
|do/dx| = (1 - o . grad s) / s^2. The virtual object: rays through the lens (lens_rays.py).
Cost: O(pixels x radius). Leaves out: as the other levels, what measured depth does not show.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import distance_transform_edt

from arfx.core.camera import Camera
from arfx.core.compiled import kernel
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide
from arfx.core.parallel import parallel_rows
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.dof.aperture import SHARP_PX, disc
from arfx.stages.dof.depth_layers import depth_layers, dioptre_of
from arfx.stages.dof.layers import behind_object
from arfx.stages.dof.lens_rays import LensView, RayScene, lens_points
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.planes import Plane, Real, seen_or_axis

# Circles of a radius of n^2 px: n times as many, a hundredth of a radius apart and less.
_SIZES = 128
_PLANE_POINTS = 256  # of the lens, for what it sees of a plane of limited size
_LEAST_WEIGHT = 1e-6  # of light in a pixel, below which it has none


def render(
    now: Layers,
    facts: FrameFacts,
    scene: Scene,
    real: Real,
    coc: CircleOfConfusion,
    params: DofParams,
    prepared: RayScene,
) -> np.ndarray:
    """IMAGE (h, w, 3) of a frame with a pose."""
    behind = behind_object(now, facts)
    blurred = sharp = behind[..., :3].astype(float)
    if params.scope == "all" and real.tiles is not None:
        blurred = _measured(behind, dioptre_of(now[Layer.REAL_DEPTH]), coc, params)
    elif params.scope == "all":
        directions = _directions(scene.camera, now.rect)
        blurred = _planes(sharp, directions, real, coc, params, scene.camera)
    endless = real.tiles is None and not real.finite_planes
    view = LensView(
        now,
        facts,
        scene.camera,
        coc,
        params,
        prepared,
        sharp,
        blurred,
        real if params.scope == "all" and endless else None,
    )
    fraction, colour = view.seen()
    image = blurred + float(facts.opacity) * (colour - blurred * fraction)
    return image.astype(np.float32)


def _directions(camera: Camera, rect: Rect) -> np.ndarray:
    """(h, w, 3) of the pixels of `rect`, z = 1; the axis where there is none."""
    pixels = np.meshgrid(np.arange(rect.x0, rect.x1), np.arange(rect.y0, rect.y1))
    return seen_or_axis(camera.directions(np.stack(pixels, -1).astype(float)))


def _planes(
    behind: np.ndarray,
    directions: np.ndarray,
    real: Real,
    coc: CircleOfConfusion,
    params: DofParams,
    camera: Camera,
) -> np.ndarray:
    """(h, w, 3) real planes through the lens, farthest first."""
    free = np.ones(behind.shape[:2])
    fronts = []
    for plane in reversed(real.finite_planes):  # nearest first
        seen = free * _met(plane, directions, np.zeros((1, 2)), 0.0)
        free = free - seen
        fronts.append((plane, seen))
    dioptre = np.maximum(directions @ real.base.forms[2], real.background)
    out = _normal(_scattered(behind, free, *_circles(dioptre, coc), params), behind)
    lens = lens_points(_PLANE_POINTS, params.blades, params.blade_turn_deg)[:, :2]
    lens_m = lens * coc.px_per_dioptre / camera.fx
    for plane, seen in reversed(fronts):
        circles = _circles(np.maximum(directions @ plane.forms[2], 0), coc)
        front = _normal(_scattered(behind, seen, *circles, params), behind)
        out = (
            out
            + (front - out) * _met(plane, directions, lens_m, coc.focus)[..., None]
        )
    return out


def _circles(
    dioptre: np.ndarray, coc: CircleOfConfusion
) -> tuple[np.ndarray, np.ndarray]:
    """Blur radius (h, w) px, and its gradient with its sign, as a fraction of it, (h, w, 2) along
    y and x, 1/px."""
    signed = coc.px_per_dioptre * (dioptre - coc.focus)
    radius = coc.radius_px(dioptre)
    slope = np.zeros((*signed.shape, 2))
    if min(signed.shape) > 1:
        slope = np.stack([*np.gradient(signed)], -1)
    free = (np.abs(signed) <= radius) & (radius > SHARP_PX)
    return radius, np.where(free[..., None], divide(slope, signed[..., None]), 0.0)


def _measured(
    behind: np.ndarray, dioptre: np.ndarray, coc: CircleOfConfusion, params: DofParams
) -> np.ndarray:
    """By measured depth: layers as in `depth_layers`, each spread by exact discs."""
    (light, radius), *fronts = depth_layers(behind, dioptre, coc)
    flat, sharp = np.zeros((*radius.shape, 2)), behind[..., :3].astype(float)
    base, whole = light[..., :3].astype(float), np.ones(radius.shape)
    out = _normal(_scattered(base, whole, radius, flat, params), sharp)
    for light, radius in fronts:
        coverage = light[..., 3].astype(float)
        _, nearest = distance_transform_edt(coverage <= 0, return_indices=True)
        around = radius[tuple(nearest)]
        colour = divide(light[..., :3], coverage[..., None])
        spread = _scattered(colour, coverage, around, flat, params)
        everything = _scattered(colour, whole, around, flat, params)
        fraction = divide(spread[..., 3:], everything[..., 3:])
        out = out + (_normal(spread, out) - out) * fraction
    return out


def _met(
    plane: Plane, directions: np.ndarray, lens_m: np.ndarray, focus: float
) -> np.ndarray:
    """(h, w) fraction of the places on the lens (n, 2) from which the plane's square is met in the
    pixel's direction.

    focus : 1/m, where rays of one pixel meet
    From o = (a, b, 0) along d - focus o: the point of dioptre v on the plane lies in the direction
    d - focus o + v o."""
    along = directions @ plane.forms.T
    met = np.zeros(along.shape[:2])
    for shift in lens_m @ plane.forms[:, :2].T:
        dioptre = divide(along[..., 2] - focus * shift[2], 1 - shift[2])
        moved = along[..., :2] + (dioptre - focus)[..., None] * shift[:2]
        met += plane.within(np.dstack([moved, dioptre]))
    return met / len(lens_m)


def _scattered(
    colour: np.ndarray,
    weight: np.ndarray,
    radius: np.ndarray,
    slope: np.ndarray,
    params: DofParams,
) -> np.ndarray:
    """(h, w, 4) sums of light and weight. radius, slope : of `_circles`"""
    boost = 1 + params.highlight_boost * np.clip((colour.max(-1) - 0.9) / 0.1, 0, 1)
    light = (
        np.dstack([colour * boost[..., None], np.ones_like(weight)])
        * weight[..., None]
    )
    steps = np.round(np.sqrt(radius, dtype=float) * _SIZES).astype(np.int64)
    sizes, which = np.unique(steps, return_inverse=True)
    lens = params.blades, params.blade_turn_deg
    ends = [_disc_ends((q / _SIZES) ** 2, *lens) for q in sizes]
    first = np.cumsum([0, *(len(e) for e in ends)])
    reach = max(int(np.abs(e[:, :2]).max()) for e in ends) + 2
    (h, w), table = radius.shape, np.concatenate(ends)

    def rows(top: int, bottom: int) -> np.ndarray:
        marks = np.zeros((bottom - top, w + 2 * reach, 4))
        _scatter(marks, top, light, slope, which.reshape(h, w), table, first, reach)
        return np.cumsum(np.cumsum(marks, 1), 1)[:, reach : reach + w]

    return np.concatenate(parallel_rows(rows, h))


@lru_cache(maxsize=4096)
def _disc_ends(radius: float, blades: int, turn_deg: float) -> np.ndarray:
    """(n, 4), each dy, dx, f, m: f summed twice along a row is the fraction of the shape in a
    pixel, m that times dx."""
    area = disc(radius, blades, turn_deg).astype(float)
    half = len(area) // 2
    px = np.arange(-half, half + 1.0)
    ends = [
        np.diff(np.pad(a, ((0, 0), (2, 2))), 2, axis=1) for a in (area, area * px)
    ]
    j, i = np.nonzero((ends[0] != 0) | (np.abs(ends[1]) > 1e-15))
    return np.column_stack([px[j], i - half, ends[0][j, i], ends[1][j, i]])


@kernel()
def _scatter(
    marks, top, light, slope, which, table, first, reach
):  # pragma: no cover - compiled
    """Light (h, w, 4) onto rows of marks from row `top`, column -reach on. table, first : rows of
    `_disc_ends` of each size"""
    h, w = which.shape
    for y in range(max(top - reach, 0), min(top + len(marks) + reach, h)):
        for x in range(w):
            if light[y, x, 3] <= 0:
                continue
            a, b = slope[y, x, 0], slope[y, x, 1]
            for e in range(first[which[y, x]], first[which[y, x] + 1]):
                dy, i = table[e, 0], x + reach + int(table[e, 1])
                j = y + int(dy) - top
                if 0 <= j < len(marks):
                    fraction = table[e, 2] * (1 + a * dy) + table[e, 3] * b
                    for c in range(4):
                        marks[j, i, c] += fraction * light[y, x, c]


def _normal(sums: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    known = sums[..., 3:] > _LEAST_WEIGHT
    return np.where(known, divide(sums[..., :3], sums[..., 3:]), otherwise)
