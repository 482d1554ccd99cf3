"""The reference level: what a thin lens sees, as an integral over its aperture. Shares no kernel
with the other levels, but what lies where before it is blurred (layers.py).

The real scene: every pixel's light onto every pixel that its circle covers, circles as exact
areas, sums in float64. A pixel p sees the point x of a plane through the place o = (x - p) / s of
the lens, s the blur radius with its sign; s is affine on a plane, so a pixel's disc is weighted by
|do/dx| = (1 - o . grad s) / s^2. The virtual object: rays through the lens (lens_rays.py).
Cost: O(pixels x radius). Leaves out: as the other levels, what measured depth does not show.
"""

# mypy: disable-error-code="no-untyped-def"
from functools import lru_cache

import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layers
from arfx.core.numerics import divide
from arfx.core.parallel import parallel_rows
from arfx.core.scene import Scene
from arfx.stages.dof.aperture import SHARP_PX, disc
from arfx.stages.dof.blur import boosted
from arfx.stages.dof.layers import LightLayer, behind_object, real_layers
from arfx.stages.dof.lens_rays import LensView, RayScene
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.planes import Real, direction_grid

# Circles of a radius of n^2 px: n times as many, a hundredth of a radius apart and less.
_SIZES = 128
_LEAST_WEIGHT = 1e-6  # of light in a pixel, below which it has none


def render(
    now: Layers,
    facts: FrameFacts,
    scene: Scene,
    real: Real,
    coc: CircleOfConfusion,
    params: DofParams,
    prepared: RayScene,
) -> ndarray:
    """IMAGE (h, w, 3) of a frame with a pose."""
    grid = direction_grid(scene.camera)
    layers = real_layers(now, facts, real, grid, coc, params)
    sharp = behind_object(now, facts)[..., :3].astype(float)
    blurred = (
        sharp if params.scope != "all" else _blurred(layers, real, sharp, params)
    )
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


def _blurred(
    layers: list[LightLayer], real: Real, sharp: ndarray, params: DofParams
) -> ndarray:
    """(h, w, 3) layers through the lens, one over the other."""
    out, rect = sharp.copy(), layers[0].rect
    for layer in layers:
        part, weight = layer.rect.slices_in(rect), layer.light[..., 3].astype(float)
        colour = divide(layer.light[..., :3], weight[..., None])
        slope = _slope(layer.radius) if real.tiles is None else 0 * colour[..., :2]
        how = layer.radius, slope, params
        spread = _scattered(colour, weight, *how)
        fraction = np.ones((*weight.shape, 1))
        if layer is not layers[0]:
            everything = _scattered(colour, np.ones(weight.shape), *how)
            fraction = divide(spread[..., 3:], everything[..., 3:])
        own = _normal(spread, out[part])
        out[part] += (own - out[part]) * fraction
    return out


def _slope(radius: ndarray) -> ndarray:
    """(h, w, 2) of radii (h, w) px, along y and x, as a fraction of them, 1/px."""
    if min(radius.shape) < 2:
        return np.zeros((*radius.shape, 2))
    slope = divide(np.stack(np.gradient(radius), -1), radius[..., None])
    return np.where(radius[..., None] > SHARP_PX, slope, 0.0)


def _scattered(
    colour: ndarray,
    weight: ndarray,
    radius: ndarray,
    slope: ndarray,
    params: DofParams,
) -> ndarray:
    """(h, w, 4) sums of light and weight. radius (h, w), slope : of `_slope`"""
    light = boosted(np.dstack([colour, np.ones_like(weight)]), params.highlight_boost)
    light *= weight[..., None]
    steps = np.round(np.sqrt(radius, dtype=float) * _SIZES).astype(np.int64)
    sizes, which = np.unique(steps, return_inverse=True)
    lens = params.blades, params.blade_turn_deg
    ends = [_disc_ends((q / _SIZES) ** 2, *lens) for q in sizes]
    first = np.cumsum([0, *(len(e) for e in ends)])
    reach = max(int(np.abs(e[:, :2]).max()) for e in ends) + 2
    (h, w), table = radius.shape, np.concatenate(ends)

    def rows(top: int, bottom: int) -> ndarray:
        marks = np.zeros((bottom - top, w + 2 * reach, 4))
        _scatter(marks, top, light, slope, which.reshape(h, w), table, first, reach)
        return np.cumsum(np.cumsum(marks, 1), 1)[:, reach : reach + w]

    return np.concatenate(parallel_rows(rows, h))


@lru_cache(maxsize=4096)
def _disc_ends(radius: float, blades: int, turn_deg: float) -> ndarray:
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


def _normal(sums: ndarray, otherwise: ndarray) -> ndarray:
    known = sums[..., 3:] > _LEAST_WEIGHT
    return np.where(known, divide(sums[..., :3], sums[..., 3:]), otherwise)
