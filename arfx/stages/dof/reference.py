"""The reference level: what a thin lens sees, as an integral over its aperture. Shares no kernel with the other levels.

The real scene: every pixel's light onto every pixel that its circle covers, circles as exact areas, sums in float64. A pixel p
sees the point x of a plane through the place o = (x - p) / s of the lens, s the blur radius with its sign; s is affine on a
plane, so a pixel's disc is weighted by |do/dx| = (1 - o . grad s) / s^2. The virtual object: rays through the lens
(lens_rays.py). Cost: O(pixels x radius). Leaves out: as the other levels, what measured depth does not show."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np
from scipy.ndimage import distance_transform_edt

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide
from arfx.core.parallel import parallel_rows
from arfx.core.scene import Scene
from arfx.stages.dof.aperture import chords, circumradius
from arfx.stages.dof.depth_layers import depth_layers, dioptre_of
from arfx.stages.dof.lens_rays import RayScene, lens_points, seen_object
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.aperture import SHARP_PX
from arfx.stages.dof.planes import Plane, Real

_SIZES = (
    128  # circles of a radius of n^2 px: n times as many, a hundredth of a radius apart and less
)
_PLANE_POINTS = 256  # of the lens, for what it sees of a plane of limited size


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
    rect, opacity = now.rect, float(facts.opacity)
    plate, shadow = now[Layer.PLATE].astype(float), now[Layer.SHADOW].astype(float)
    change = opacity * (plate * (shadow - 1) + np.asarray(facts.bias_rgb) * (1 - shadow))
    if opacity < 1:  # as in `RealPixels`
        covered = now[Layer.COVERAGE].astype(float)[..., None]
        change *= (1 - covered) / (1 - opacity * covered)
    out = behind = plate + change
    if params.scope == "all":
        pixels = np.meshgrid(np.arange(rect.x0, rect.x1), np.arange(rect.y0, rect.y1))
        ideal = scene.camera.normalised(np.stack(pixels, -1).astype(float))
        directions = np.concatenate(
            [np.where(np.isfinite(ideal), ideal, 0.0), np.ones((*ideal.shape[:2], 1))], -1
        )
        depth = now[Layer.REAL_DEPTH] if real.tiles is not None else None
        out = _real(behind, directions, real, coc, params, scene.camera, depth)
    fraction, colour = seen_object(
        now, facts, scene.camera, coc, params, prepared, behind, out, real
    )
    return (out * (1 - opacity * fraction[..., None]) + opacity * colour).astype(np.float32)


def _real(
    behind: np.ndarray,
    directions: np.ndarray,
    real: Real,
    coc: CircleOfConfusion,
    params: DofParams,
    camera: Camera,
    depth_m: np.ndarray | None,
) -> np.ndarray:
    """The real scene through the lens, (h, w, 3)."""
    if depth_m is not None:
        return _measured(behind, depth_m, coc, params)
    dioptre = np.full(behind.shape[:2], real.background)
    if real.base is not None:
        dioptre = np.maximum(directions @ real.base.forms[2], dioptre)
    free = np.ones(behind.shape[:2])
    layers = []
    for plane in reversed(real.finite_planes):  # nearest first
        shown = free * _shown(plane, directions, np.zeros((1, 2)), 0.0)
        free = free - shown
        layers.append((plane, shown))
    out = _normal(_scattered(behind, free, *_circles(dioptre, coc), params), behind)
    lens = (
        lens_points(_PLANE_POINTS, params.blades, params.blade_turn_deg)[:, :2]
        * coc.px_per_dioptre
        / camera.fx
    )
    for plane, shown in reversed(layers):
        circles = _circles(np.maximum(directions @ plane.forms[2], 0), coc)
        front = _normal(_scattered(behind, shown, *circles, params), behind)
        out = out + (front - out) * _shown(plane, directions, lens, coc.focus)[..., None]
    return out


def _circles(dioptre: np.ndarray, coc: CircleOfConfusion) -> tuple[np.ndarray, np.ndarray]:
    """Blur radius (h, w) px, and its gradient with its sign, as a fraction of it, (h, w, 2) along y and x, 1/px."""
    signed = coc.px_per_dioptre * (dioptre - coc.focus)
    radius = coc.radius_px(dioptre)
    slope = (
        np.stack([*np.gradient(signed)], -1)
        if min(signed.shape) > 1
        else np.zeros((*signed.shape, 2))
    )
    free = (np.abs(signed) <= radius) & (radius > SHARP_PX)
    return radius, np.where(free[..., None], divide(slope, signed[..., None]), 0.0)


def _measured(
    behind: np.ndarray, depth_m: np.ndarray, coc: CircleOfConfusion, params: DofParams
) -> np.ndarray:
    """By measured depth: layers as in `depth_layers`, each spread by exact discs."""
    prepared = depth_layers(behind.astype(np.float32), dioptre_of(depth_m), coc)
    whole, level = np.ones(behind.shape[:2]), np.zeros((*behind.shape[:2], 2))
    out = _normal(
        _scattered(
            prepared.base.astype(float), whole, prepared.radius.astype(float), level, params
        ),
        behind,
    )
    for front in prepared.fronts:
        _, nearest = distance_transform_edt(
            front.radius < 0, return_indices=True
        )  # of the nearest pixel that has one
        radius = front.radius[tuple(nearest)].astype(float)
        coverage = front.coverage.astype(float)
        light = _scattered(
            divide(front.colour, coverage[..., None]), coverage, radius, level, params
        )
        through = _scattered(np.zeros_like(behind), 1 - coverage, radius, level, params)[..., 3]
        fraction = divide(light[..., 3], light[..., 3] + through)[..., None]
        out = out + (_normal(light, out) - out) * fraction
    return out


def _shown(plane: Plane, directions: np.ndarray, lens_m: np.ndarray, focus: float) -> np.ndarray:
    """(h, w) fraction of the places on the lens (n, 2) from which the plane's square is met in the pixel's direction.

    focus : 1/m, where rays of one pixel meet"""
    out, along = np.empty(directions.shape[:2]), directions @ plane.forms.T
    shift = lens_m @ plane.forms[:, :2].T
    parallel_rows(lambda a, b: _square(out[a:b], along[a:b], shift, focus, plane.half_m), len(out))
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _square(out, along, shift, focus, half_m):  # pragma: no cover - compiled
    """From o = (a, b, 0) along d - focus o: the point of dioptre v on the plane lies in the direction d - focus o + v o.

    along (h, w, 3), shift (n, 3) : the plane's forms of d and of o"""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            met = 0
            for k in range(len(shift)):
                v = (along[y, x, 2] - focus * shift[k, 2]) / (1 - shift[k, 2])
                right = along[y, x, 0] + (v - focus) * shift[k, 0]
                down = along[y, x, 1] + (v - focus) * shift[k, 1]
                if v > 0 and max(abs(right), abs(down)) <= half_m * v:
                    met += 1
            out[y, x] = met / len(shift)


def _scattered(
    colour: np.ndarray, weight: np.ndarray, radius: np.ndarray, slope: np.ndarray, params: DofParams
) -> np.ndarray:
    """(h, w, 4) sums of light and weight. radius, slope : of `_circles`"""
    boost = params.highlight_boost * np.clip((colour.max(-1) - 0.9) / 0.1, 0, 1)
    light = (
        np.concatenate([colour * (1 + boost[..., None]), np.ones_like(colour[..., :1])], -1)
        * weight[..., None]
    )
    sizes, which = np.unique(
        np.round(np.sqrt(radius) * _SIZES).astype(np.int64), return_inverse=True
    )
    ends = [_disc_ends((q / _SIZES) ** 2, params.blades, params.blade_turn_deg) for q in sizes]
    first, reach = (
        np.cumsum([0, *(len(e) for e in ends)]),
        max(int(np.abs(e[:, :2]).max()) for e in ends) + 2,
    )
    (h, w), table = radius.shape, np.concatenate(ends)

    def rows(top: int, bottom: int) -> np.ndarray:
        marks = np.zeros((bottom - top, w + 2 * reach, 4))
        _scatter(marks, top, light, slope, which.reshape(h, w), table, first, reach)
        return np.cumsum(np.cumsum(marks, 1), 1)[:, reach : reach + w]

    return np.concatenate(parallel_rows(rows, h))


@lru_cache(maxsize=4096)
def _disc_ends(radius: float, blades: int, turn_deg: float) -> np.ndarray:
    """(n, 4), each dy, dx, f, m: f summed twice along a row is the fraction of the shape in a pixel, m that times dx."""
    if radius <= SHARP_PX:
        return np.array([[0.0, 0, 1, 0], [0, 1, -2, 0], [0, 2, 1, 0]])
    half = int(np.ceil(radius * circumradius(blades) - 0.5))
    px = np.arange(-half, half + 1.0)
    left, right = chords(radius, half, blades, turn_deg)
    within = np.minimum(right[..., None], px + 0.5) - np.maximum(left[..., None], px - 0.5)
    area = within.clip(0).mean(1)
    area /= area.sum()
    ends = [np.diff(np.pad(a, ((0, 0), (2, 2))), 2, axis=1) for a in (area, area * px)]
    j, i = np.nonzero((ends[0] != 0) | (np.abs(ends[1]) > 1e-15))
    return np.column_stack([px[j], i - half, ends[0][j, i], ends[1][j, i]])


@numba.njit(cache=True, nogil=True)
def _scatter(marks, top, light, slope, which, table, first, reach):  # pragma: no cover - compiled
    """Light (h, w, 4) onto rows of marks from row `top`, column -reach on. table, first : rows of `_disc_ends` of each size"""
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
    known = sums[..., 3:] > 1e-6
    return np.where(known, divide(sums[..., :3], sums[..., 3:]), otherwise)
