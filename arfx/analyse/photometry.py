"""The marker as a light meter: robust means of its black and white cells in one frame, in linear light.

Samples lie on a grid inside every cell, away from its edges, placed by the homography of the refined corners and read
bilinearly at exact coordinates (pixel centres at integers). Clipped and non-finite samples are dropped; the others are
grouped by colour and quarter of the marker, and each group's mean leaves out what does not belong to it (a highlight,
a finger). What biases a mean beyond its noise goes into its variance: blur from the neighbouring cells, the truncation
that dropping clipped samples is, and 8-bit steps without noise to dither them.
Source: Tan, Chen, Sun 2010 ("dynamic light map"), section 2.1: the patch's pixel brightness I of eq. (2); SYSTEMS.md S1.
Cost: about .2 ms for a marker of 270 px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numba
import numpy as np
from scipy.special import ndtr, ndtri

from arfx.analyse.detect import cells_per_side, dictionary
from arfx.core.numerics import HALF_GREY

PATCHES = 8  # black top left, top right, bottom left, bottom right, then white in the same order
MARGIN = 0.2  # of a cell that is left out at each side: the inner 60 % remain
MOST_MARGIN = 0.45
# A bilinear sample has 4/9 of a pixel's noise variance, on average; samples nearer than 1.5 px have that noise in common.
SHARED_PX2 = 9 / 4
FEWEST = 4  # samples that make a patch
BLURS = 2.5  # margin in standard deviations of the blur
MOST_SAMPLES = 5  # per cell and axis
OUT = 3.5  # robust standard deviations beyond which a sample is no part of its patch
CLIP_LOW, CLIP_HIGH = 1.5e-4, 0.9955  # half an 8-bit step inside either end, sRGB


@dataclass(frozen=True, eq=False)
class Patches:
    """One marker in one frame. white : (8,) bool, paper cells

    mean : (8, 3) linear RGB, 0 where count is 0;  variance : (8, 3) of that mean, noise and known biases
    count : (8,) samples used;  clipped : (8,) share of all samples that were clipped
    highlight : (8,) share of all samples that were dropped as brighter than their patch;  not_finite : samples dropped
    """

    mean: np.ndarray
    variance: np.ndarray
    white: np.ndarray
    count: np.ndarray
    clipped: np.ndarray
    highlight: np.ndarray
    not_finite: int = 0

    def to_json(self) -> dict:
        return {
            "mean": self.mean.tolist(), "variance": self.variance.tolist(), "count": self.count.tolist(),
            "clipped": self.clipped.tolist(), "highlight": self.highlight.tolist(), "not_finite": self.not_finite,
        }  # fmt: skip

    @staticmethod
    def from_json(d: dict) -> Patches:
        return Patches(
            np.array(d["mean"], float), np.array(d["variance"], float), WHITE.copy(), np.array(d["count"], int),
            np.array(d["clipped"], float), np.array(d["highlight"], float), d["not_finite"],
        )  # fmt: skip


WHITE = np.arange(PATCHES) >= PATCHES // 2


@cache
def cells(family: str, number: int) -> np.ndarray:
    """(n, n) bool, True = paper, border included; row 0 at the top, column 0 at the left of MarkerSpec.corners_m.

    family, number : FAMILIES key and id; as printed, not inverted. The array is read-only.
    """
    n = cells_per_side(family)
    out = cv2.aruco.generateImageMarker(dictionary(family), number, n) > 127
    out.setflags(write=False)
    return out


def measure(
    linear: np.ndarray, origin: tuple[int, int], corners_px: np.ndarray, cells: np.ndarray, inverted: bool = False,
    clip_low: float = CLIP_LOW, clip_high: float = CLIP_HIGH, blur_px: float = 0.7,
) -> Patches:  # fmt: skip
    """Means of the patches of one marker.

    linear : (h, w, 3) float32 linear RGB of the rectangle whose first pixel is `origin` (x, y) of the frame; samples
        outside it are left out without being counted
    corners_px : (4, 2) in the frame, order of MarkerSpec.corners_m;  cells : `cells(family, id)`
    inverted : white on black print;  clip_low, clip_high : linear levels at which any channel is taken for clipped
    blur_px : standard deviation of the edges' blur
    """
    image = np.ascontiguousarray(linear, np.float32)
    quad = np.asarray(corners_px, float) - np.asarray(origin, float)
    n = len(cells)
    raw = np.zeros((PATCHES, 3)), np.zeros((PATCHES, 3)), np.zeros((PATCHES, 5))
    mean, spread, tally = raw
    leak, shared = 0.0, 1.0
    if image.size and np.isfinite(quad).all() and cv2.isContourConvex(quad.astype(np.float32)):
        h = _homography(quad, n)
        middle = h @ [n / 2, n / 2, 1]
        jacobian = (h[:2, :2] - np.outer(middle[:2] / middle[2], h[2, :2])) / middle[2]
        wide_px, cell_px = (float(x) for x in np.linalg.svd(jacobian, compute_uv=False))
        margin = float(np.clip(BLURS * blur_px / max(cell_px, 1e-6), MARGIN, MOST_MARGIN))
        k = int(np.clip(round((1 - 2 * margin) * cell_px), 1, MOST_SAMPLES))
        offsets = margin + (1 - 2 * margin) * (np.arange(k) + 0.5) / k
        area = (1 - 2 * margin) ** 2 * wide_px * cell_px / k**2  # px^2 per sample
        shared = max(1.0, SHARED_PX2 / max(area, 1e-6))
        nearest = float(min(offsets[0], 1 - offsets[-1])) * cell_px
        leak = 2 * float(ndtr(-nearest / blur_px)) if blur_px > 0 else 0.0
        _kernel(image, h, np.asarray(cells, bool) ^ inverted, offsets, clip_low, clip_high, HALF_GREY, *raw)
    used, clipped, bright, bad, every = tally.T
    share = np.maximum(every, 1)
    variance = _variance(mean, spread, used / shared, clipped / share, leak)
    return Patches(mean, variance, WHITE.copy(), used.astype(int), clipped / share, bright / share, int(bad.sum()))


def stack(patches: Sequence[Patches | None]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(intensity (t, 8, 3), variance (t, 8, 3), clipped (t, 8)) for photometry_solve.solve; NaN where nothing was measured."""
    shape = (len(patches), PATCHES, 3)
    intensity, variance, clipped = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape[:2])
    for i, p in enumerate(patches):
        if p is not None:
            seen = p.count > 0
            intensity[i, seen], variance[i, seen], clipped[i] = p.mean[seen], p.variance[seen], p.clipped
    return intensity, variance, clipped


def _homography(quad: np.ndarray, n: int) -> np.ndarray:
    """(3, 3) float64, pixel from cell units (0..n); quad : (4, 2) top left, top right, bottom right, bottom left."""
    u, v = np.array([0.0, n, n, 0]), np.array([0.0, 0, n, n])
    one, nil, (x, y) = np.ones(4), np.zeros(4), quad.T
    rows = np.concatenate(
        [np.stack([u, v, one, nil, nil, nil, -x * u, -x * v], 1), np.stack([nil, nil, nil, u, v, one, -y * u, -y * v], 1)]
    )
    return np.append(np.linalg.solve(rows, np.concatenate([x, y])), 1.0).reshape(3, 3)


def _variance(mean: np.ndarray, spread: np.ndarray, used: np.ndarray, clipped: np.ndarray, leak: float) -> np.ndarray:
    """(8, 3) of the means. spread : (8, 3) standard deviation of a sample;  clipped : (8,) share;  leak : of the contrast."""
    step = 2 * HALF_GREY * np.maximum(1 / 12.92, 2.2 * np.clip(mean, 0, None) ** (1 - 1 / 2.2))  # slope of sRGB
    # rounding's error is spread over its step, and is dithered away as the noise's characteristic function says
    rounding = step**2 / 12 * np.exp(-4 * np.pi**2 * np.minimum((spread / step) ** 2, 2))
    # mean of a normal distribution whose share `clipped` is cut off at one end
    p = np.clip(clipped, 0, 0.99)
    cut = np.where(p > 0, np.exp(-(ndtri(np.maximum(p, 1e-9)) ** 2) / 2) / np.sqrt(2 * np.pi) / (1 - p), 0)[:, None] * spread
    bright, dark = (mean[w & (used > 0)] for w in (WHITE, ~WHITE))
    contrast = bright.mean(0) - dark.mean(0) if len(bright) and len(dark) else np.abs(mean).max(0)
    out = spread**2 / np.maximum(used, 1e-9)[:, None] + rounding + cut**2 + (leak * contrast) ** 2
    return np.where(used[:, None] > 0, out, 0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _kernel(image, h, white, offsets, low, high, half_grey, mean, spread, tally):  # pragma: no cover - compiled
    """Samples every cell; mean, spread (8, 3) and tally (8, 5: used, clipped, bright, not finite, all) are filled in.

    image : (rows, cols, 3);  h : (3, 3) pixel from cell units;  white : (n, n) as seen;  offsets : (k,) inside a cell
    """
    n, k = len(white), len(offsets)
    rows, cols = image.shape[:2]
    values = np.empty((8, n * n * k * k, 4))
    size = np.zeros(8, np.int64)
    for r in range(n):
        for c in range(n):
            colour = 4 if white[r, c] else 0
            for i in range(k):
                v = r + offsets[i]
                for j in range(k):
                    u = c + offsets[j]
                    d = h[2, 0] * u + h[2, 1] * v + h[2, 2]
                    x = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / d
                    y = (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / d
                    if not (d > 0 and x >= 0 and y >= 0 and x <= cols - 1 and y <= rows - 1):
                        continue
                    g = colour + (2 if 2 * v >= n else 0) + (1 if 2 * u >= n else 0)
                    x0, y0 = min(int(x), max(cols - 2, 0)), min(int(y), max(rows - 2, 0))
                    x1, y1 = min(x0 + 1, cols - 1), min(y0 + 1, rows - 1)
                    fx, fy = x - x0, y - y0
                    finite, clip = True, False
                    total = 0.0
                    for ch in range(3):
                        a, b = image[y0, x0, ch], image[y0, x1, ch]
                        e, f = image[y1, x0, ch], image[y1, x1, ch]
                        finite = finite and np.isfinite(a) and np.isfinite(b) and np.isfinite(e) and np.isfinite(f)
                        clip = clip or min(min(a, b), min(e, f)) <= low or max(max(a, b), max(e, f)) >= high
                        value = (a * (1 - fx) + b * fx) * (1 - fy) + (e * (1 - fx) + f * fx) * fy
                        values[g, size[g], ch] = value
                        total += value
                    tally[g, 4] += 1
                    if not finite:
                        tally[g, 3] += 1
                    elif clip:
                        tally[g, 1] += 1
                    else:
                        values[g, size[g], 3] = total / 3
                        size[g] += 1
    for g in range(8):
        if size[g] == 0:
            continue
        x = values[g, : size[g], 3]
        centre, width = 0.0, np.inf
        keep = x
        for _ in range(4):
            centre = np.median(keep)
            step = half_grey * max(1 / 12.92, 2.2 * max(centre, 0.0) ** (1 - 1 / 2.2))
            width = OUT * max(1.4826 * np.median(np.abs(keep - centre)), step)
            inside = np.abs(x - centre) <= width
            if inside.sum() == len(keep) and len(keep) < len(x):
                break
            keep = x[inside]
        used = 0
        for i in range(size[g]):
            if abs(x[i] - centre) <= width:
                used += 1
                for ch in range(3):
                    mean[g, ch] += values[g, i, ch]
            elif x[i] > centre:
                tally[g, 2] += 1
        if used < FEWEST:
            mean[g] = 0.0
            continue
        tally[g, 0] = used
        for ch in range(3):
            mean[g, ch] /= used
        for i in range(size[g]):
            if abs(x[i] - centre) <= width:
                for ch in range(3):
                    spread[g, ch] += (values[g, i, ch] - mean[g, ch]) ** 2
        for ch in range(3):
            spread[g, ch] = np.sqrt(spread[g, ch] / max(used - 1, 1))
