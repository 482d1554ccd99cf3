"""A measured real scene in three layers: behind the focus, in it, before it. What a nearer one hides is filled in.

The layer in the focus is sharp, so neither of the others may spread into it; the one before the focus is spread over
both. What lies behind an edge is not in the picture; it is taken from beside the edge, nearest first (push-pull).
Leaves out: edges between things of one layer."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numba
import numpy as np

from arfx.core.numerics import divide
from arfx.core.parallel import parallel_rows
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.pyramid import SHARP_PX


@dataclass(frozen=True, eq=False)
class FrontLayer:
    """Something before the base. radius (h, w) px, -1 = not there;  colour (h, w, 3) premultiplied by coverage (h, w)"""

    radius: np.ndarray
    colour: np.ndarray
    coverage: np.ndarray


@dataclass(frozen=True, eq=False)
class DepthLayers:
    """base : (h, w, 3) colour of what is farthest, all over;  radius : (h, w) px of it;  fronts : farthest first"""

    base: np.ndarray
    radius: np.ndarray
    fronts: tuple[FrontLayer, ...]


def dioptre_of(depth_m: np.ndarray) -> np.ndarray:
    """(h, w) float32, 1/m; 0 where the depth is no distance."""
    with np.errstate(all="ignore"):
        known = np.isfinite(depth_m) & (depth_m > 0)
    return np.where(known, divide(1.0, depth_m), 0.0).astype(np.float32)


def depth_layers(colour: np.ndarray, dioptre: np.ndarray, coc: CircleOfConfusion) -> DepthLayers:
    """colour : (h, w, 3) of the real scene, sharp;  dioptre : (h, w) float32, 1/m"""
    radius = coc.radius_px(dioptre).astype(np.float32)
    blurred = radius > SHARP_PX
    near = blurred & (dioptre > coc.focus)
    far, sharp = blurred & ~near, ~blurred
    if far.all() or not far.any():
        base, base_radius = colour, (radius if far.any() else np.zeros_like(radius))
    else:
        base, base_radius = fill(colour, radius, far)
    fronts = []
    if sharp.any():
        sharp_colour, coverage = cv2.copyTo(colour, sharp.view(np.uint8)), sharp.astype(np.float32)
        if near.any():
            sharp_colour, coverage = fill(sharp_colour, coverage, ~near)
        fronts.append(
            FrontLayer(
                np.where(coverage > 0, np.float32(0), np.float32(-1)), sharp_colour, coverage
            )
        )
    if near.any():
        if not (far.any() or sharp.any()):
            return DepthLayers(colour, radius, ())
        coverage = near.astype(np.float32)
        fronts.append(
            FrontLayer(
                np.where(near, radius, np.float32(-1)),
                cv2.copyTo(colour, near.view(np.uint8)),
                coverage,
            )
        )
    return DepthLayers(base, base_radius, tuple(fronts))


def fill(colour: np.ndarray, more: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """colour (h, w, 3) and more (h, w), float32: where not `known`, the mean of known values around, as near ones as there are.

    Source: push-pull interpolation (Gortler et al. 1996) on halved pictures."""
    h, w = known.shape
    half = -(-h // 2), -(-w // 2)
    sums = [(np.empty((*half, 4), np.float32), np.empty(half, np.float32))]
    parallel_rows(lambda a, b: _halve_known(colour, more, known, a, b, *sums[0]), half[0])
    while min(sums[-1][1].shape) > 1 and not (sums[-1][1] > 0).all():
        size = tuple(-(-n // 2) for n in sums[-1][1].shape[::-1])
        value, weight = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in sums[-1])
        sums.append((value, weight))
    value, weight = sums.pop()
    out = divide(value, weight[..., None]).astype(np.float32)
    for value, weight in reversed(sums):
        out = np.asarray(
            cv2.resize(out, weight.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32
        )
        parallel_rows(partial(_lay_over, out, value, weight), len(weight))
    filled = np.empty((h, w, 3), np.float32), np.empty((h, w), np.float32)
    parallel_rows(lambda a, b: _fill_rows(colour, more, known, out, a, b, *filled), h)
    return filled


@numba.njit(cache=True, nogil=True)
def _halve_known(colour, more, known, ya, yb, value, weight):  # pragma: no cover - compiled
    """Rows ya..yb of sums over 2 x 2 pixels that are known, of four values (h, w, 4) and of how many are, in quarters."""
    h, w = known.shape
    for y in range(ya, yb):
        sums, count = value[y].reshape(-1), weight[y]
        sums[:], count[:] = 0, 0
        for j in range(2 * y, min(2 * y + 2, h)):
            line, fourth, here = colour[j].reshape(-1), more[j], known[j]
            for x in range(w):
                i, to = np.uintp(3) * np.uintp(x), np.uintp(4) * (np.uintp(x) // np.uintp(2))
                s = np.float32(0.25) * np.float32(here[np.uintp(x)])
                for c in range(3):
                    sums[to + np.uintp(c)] += s * line[i + np.uintp(c)]
                sums[to + np.uintp(3)] += s * fourth[np.uintp(x)]
                count[np.uintp(x) // np.uintp(2)] += s


@numba.njit(cache=True, nogil=True)
def _lay_over(out, value, weight, ya, yb):  # pragma: no cover - compiled
    """Rows ya..yb of means over out (h, w, 4), as far as they are known: a quarter of a cell is enough to go by it."""
    one, quarter = np.float32(1), np.float32(0.25)
    for y in range(ya, yb):
        for x in range(weight.shape[1]):
            w = weight[y, np.uintp(x)]
            rest, factor = one - min(w / quarter, one), one / max(w, quarter)
            for c in range(4):
                i, k = np.uintp(x), np.uintp(c)
                out[y, i, k] = out[y, i, k] * rest + value[y, i, k] * factor


@numba.njit(cache=True, nogil=True)
def _fill_rows(colour, more, known, small, ya, yb, out, out_more):  # pragma: no cover - compiled
    """Rows ya..yb: what is known, else linear between small, (ceil(h / 2), ceil(w / 2), 4)."""
    last, end = small.shape[0] - 1, small.shape[1] - 1
    between = np.empty(4 * small.shape[1], np.float32)
    for y in range(ya, yb):
        t = np.float32(0.25) if y % 2 else np.float32(0.75)
        top, bottom = (
            small[max((y - 1) // 2, 0)].reshape(-1),
            small[min((y + 1) // 2, last)].reshape(-1),
        )
        for k in range(between.shape[0]):
            between[k] = top[k] + (bottom[k] - top[k]) * t
        line, to, here = colour[y].reshape(-1), out[y].reshape(-1), known[y]
        for x in range(known.shape[1]):
            n, i = np.uintp(x), np.uintp(3) * np.uintp(x)
            if here[n]:
                to[i], to[i + np.uintp(1)], to[i + np.uintp(2)] = (
                    line[i],
                    line[i + np.uintp(1)],
                    line[i + np.uintp(2)],
                )
                out_more[y, n] = more[y, n]
                continue
            a, b = np.uintp(4 * max((x - 1) // 2, 0)), np.uintp(4 * min((x + 1) // 2, end))
            s = np.float32(0.25) if x % 2 else np.float32(0.75)
            for c in range(3):
                to[i + np.uintp(c)] = (
                    between[a + np.uintp(c)]
                    + (between[b + np.uintp(c)] - between[a + np.uintp(c)]) * s
                )
            out_more[y, n] = (
                between[a + np.uintp(3)] + (between[b + np.uintp(3)] - between[a + np.uintp(3)]) * s
            )
