"""Smoothing of a penumbra that was made from few directions: by the pitch of the directions where the caster is high.

K silhouettes leave K steps across a penumbra. Their distance grows with the height of what casts them, so a box of that
width, its height read from a coarse map of the highest caster, turns the steps into a ramp and leaves the contact sharp.
Cost: O(texels).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import cv2
import numba
import numpy as np

from arfx.stages.lightmap.silhouette import highest

COARSE = 8  # texels a side of a cell of the height map
# Width of the box in radii of the penumbra, for K directions: the mean distance of K points on a unit disc is
# sqrt(pi / K); less than that leaves steps, more blurs beyond the true penumbra.
_PITCHES = 1.0


def smoothed(
    share: np.ndarray, points: np.ndarray, faces: np.ndarray, slope: np.ndarray, radii: tuple[float, float], count: int
) -> np.ndarray:
    """`share` (rows, columns) float32 after the boxes.

    points (n, 3) float32, faces, as for `hidden_share`;  slope (2,) of the light's middle
    radii : columns and rows by which one texel of height opens the penumbra, half its width;  count : directions used
    """
    pitch = _PITCHES * np.sqrt(np.pi / count)
    half = np.array(radii) * pitch / 2
    top = float(points[:, 2].max(initial=0.0))
    if top * float(half.max()) <= 0.5:
        return share
    height = _caster_height(points, faces, slope, share.shape)
    return _boxes(share, height, np.float32(half[0]), np.float32(half[1]))


def _caster_height(points: np.ndarray, faces: np.ndarray, slope: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(rows, columns) float32 texels: height of the highest caster over each texel, of the nearest one beside them."""
    rows, columns = -(-shape[0] // COARSE), -(-shape[1] // COARSE)
    h = np.ascontiguousarray(points[:, 2])
    u = ((points[:, 0] + np.float32(slope[0]) * h + 0.5) / COARSE - 0.5).astype(np.float32)
    v = ((points[:, 1] + np.float32(slope[1]) * h + 0.5) / COARSE - 0.5).astype(np.float32)
    height = highest(u, v, h, faces, rows, columns, np.float32(-1))
    empty = height < 0
    if empty.all():
        return np.zeros(shape, np.float32)
    _, label = cv2.distanceTransformWithLabels(empty.astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    table = np.zeros(int(label.max()) + 1, np.float32)
    table[label[~empty]] = height[~empty]
    grown = cv2.blur(table[label], (3, 3), borderType=cv2.BORDER_REPLICATE)
    return cv2.resize(grown, (columns * COARSE, rows * COARSE), interpolation=cv2.INTER_LINEAR)[: shape[0], : shape[1]]


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _boxes(share, height, across, down):  # pragma: no cover - compiled
    """A box of half-width across x height along the rows, then down x height along the columns, exact for parts of texels."""
    rows, columns = share.shape
    half, one = np.float32(0.5), np.float32(1)
    middle = np.empty((rows, columns), np.float32)
    total = np.zeros(columns + 1, np.float32)
    last = np.float32(columns)
    for y in range(rows):
        for x in range(columns):
            total[x + 1] = total[x] + share[y, x]
        for x in range(columns):
            r = max(across * height[y, x], half)
            centre = np.float32(x) + half
            a, b = max(centre - r, np.float32(0)), min(centre + r, last)
            ia, ib = np.int32(a), min(np.int32(b), np.int32(columns - 1))
            ka, kb = np.uintp(ia), np.uintp(ib)
            low = total[ka] + (a - np.float32(ia)) * share[y, ka]
            high = total[kb] + (b - np.float32(ib)) * share[y, kb]
            middle[y, x] = (high - low) / (b - a)
    sums = np.zeros((rows + 1, columns), np.float32)
    for y in range(rows):
        for x in range(columns):
            sums[y + 1, x] = sums[y, x] + middle[y, x]
    out = np.empty((rows, columns), np.float32)
    last = np.float32(rows)
    for y in range(rows):
        centre = np.float32(y) + half
        for x in range(columns):
            r = max(down * height[y, x], half)
            a, b = max(centre - r, np.float32(0)), min(centre + r, last)
            ia, ib = np.int32(a), min(np.int32(b), np.int32(rows - 1))
            ka, kb = np.uintp(ia), np.uintp(ib)
            low = sums[ka, x] + (a - np.float32(ia)) * middle[ka, x]
            high = sums[kb, x] + (b - np.float32(ib)) * middle[kb, x]
            out[y, x] = min(max((high - low) / (b - a), np.float32(0)), one)
    return out
