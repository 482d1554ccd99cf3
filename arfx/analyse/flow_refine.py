"""A step of Gauss and Newton on the nodes of a flow: the small picture and its reference are laid on each other to some
hundredths of a pixel, where dense flow is good to a tenth.

The flow is that of the nodes, bilinear between them. Each pixel says along its slope how far the two are still apart; a node
hears those around it, weighted by how near they lie and how well they fit. What all ask for together (an affine motion) is
taken first, what is left node by node, drawn towards nothing where there is little to see. That one of the two is brighter
around a node does not count. Cost: O(pixels of the small picture), some 2 ms.
Source: Lucas and Kanade 1981. Leaves out: motion of more than _MOST_PX beyond what was found, which is the flow's work.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np

from arfx.core.numerics import divide

_FINE_PX = 1.0  # what is finer is not compared, px of the small picture
_MISFIT = 6.0  # grey levels at which a pixel counts half
_PRIOR = 100.0  # a pixel's noise, grey levels, over what a node may differ from the affine motion, px, squared
_NEIGHBOURS, _SPREAD_NODES = 0.3, 1.5
_MOST_PX = 0.3  # of the small picture
_RIM_PX = 3  # the interpolation and the band need that much around a pixel


def refined(
    back: np.ndarray, small: np.ndarray, reference: np.ndarray, trust: np.ndarray, first: np.ndarray, pitch: np.ndarray
) -> np.ndarray:
    """(gh, gw, 2) float64 px of the small picture: `back`, a step nearer to where the reference has what the nodes show.

    back (gh, gw, 2) : px of the small picture: what is at a place there is at place + back in the reference
    small, reference (h, w) uint8;  trust (h, w) : pixels with 0 are left out
    first, pitch (2,) : place of the first node and distance from one to the next along x and y, px of the small picture
    """
    back = np.asarray(back, float)
    sums = np.zeros((*back.shape[:2], 9))
    _hear(_smooth(small), _smooth(reference), trust > 0, back, first, pitch, sums)
    heard = _centred(sums)
    affine = _affine(heard)
    spread = cv2.GaussianBlur(heard, (0, 0), _SPREAD_NODES, borderType=cv2.BORDER_REPLICATE)
    xx, xy, yy, xe, ye = np.moveaxis(heard + _NEIGHBOURS * spread, -1, 0)
    ex, ey = xe - xx * affine[..., 0] - xy * affine[..., 1], ye - xy * affine[..., 0] - yy * affine[..., 1]
    xx, yy = xx + _PRIOR, yy + _PRIOR
    det = xx * yy - xy * xy  # _PRIOR^2 at least: without it a sum of squares
    step = affine + np.stack([yy * ex - xy * ey, xx * ey - xy * ex], -1) / det[..., None]
    out: np.ndarray = back + np.clip(step, -_MOST_PX, _MOST_PX)
    return out


def _smooth(a: np.ndarray) -> np.ndarray:
    out: np.ndarray = cv2.GaussianBlur(a.astype(np.float32), (0, 0), _FINE_PX)
    return out


def _centred(sums: np.ndarray) -> np.ndarray:
    """(gh, gw, 5) sums of xx, xy, yy, xe, ye without the means around each node. sums : of `_hear`"""
    x, y, e = (divide(sums[..., k], sums[..., 8]) for k in (5, 6, 7))
    of_x, of_y = sums[..., 5], sums[..., 6]
    out: np.ndarray = sums[..., :5] - np.stack([of_x * x, of_x * y, of_y * y, of_x * e, of_y * e], -1)
    return out


def _affine(heard: np.ndarray) -> np.ndarray:
    """(gh, gw, 2) px: the affine motion that the nodes ask for together, at each of them."""
    gh, gw = heard.shape[:2]
    y, x = np.mgrid[0:gh, 0:gw] / np.array([gh, gw]).reshape(2, 1, 1) - 0.5
    terms = np.stack([np.ones((gh, gw)), x, y], -1).reshape(-1, 3)
    xx, xy, yy, xe, ye = heard.reshape(-1, 5).T
    of = lambda weight: (terms * weight[:, None]).T @ terms  # noqa: E731
    normal = np.block([[of(xx), of(xy)], [of(xy), of(yy)]]) + _PRIOR * np.eye(6)
    motion = np.linalg.solve(normal, np.concatenate([terms.T @ xe, terms.T @ ye]))
    out: np.ndarray = (terms @ motion.reshape(2, 3).T).reshape(gh, gw, 2)
    return out


@numba.njit(cache=True, nogil=True)
def _hear(small, reference, trusted, back, first, pitch, total):  # pragma: no cover - compiled
    """total (gh, gw, 9) : at each node the sums of xx, xy, yy, xe, ye, x, y, e and 1: slopes, and what is missing (e)."""
    h, w = small.shape
    gh, gw = back.shape[:2]
    lines = np.empty((gw, 2))
    sums = np.empty((gw, 9))
    for y in range(_RIM_PX, h - _RIM_PX):
        i = (y - first[1]) / pitch[1]
        m = min(max(int(np.floor(i)), 0), gh - 2)
        t = i - m
        for k in range(gw):
            for c in range(2):
                lines[k, c] = back[m, k, c] + t * (back[m + 1, k, c] - back[m, k, c])
        sums[:] = 0
        for x in range(_RIM_PX, w - _RIM_PX):
            if not trusted[y, x]:
                continue
            j = (x - first[0]) / pitch[0]
            n = min(max(int(np.floor(j)), 0), gw - 2)
            s = j - n
            px, py = x + lines[n, 0] + s * (lines[n + 1, 0] - lines[n, 0]), y + lines[n, 1] + s * (lines[n + 1, 1] - lines[n, 1])
            if not (px >= _RIM_PX and py >= _RIM_PX and px < w - _RIM_PX and py < h - _RIM_PX):
                continue
            e = np.float64(small[y, x]) - _cubic(reference, px, py)
            gx, gy = 0.5 * (small[y, x + 1] - small[y, x - 1]), 0.5 * (small[y + 1, x] - small[y - 1, x])
            weight = 1.0 / (1.0 + (e / _MISFIT) ** 2)
            for k in range(2):
                share = weight * (s if k else 1.0 - s)
                sums[n + k, 0] += share * gx * gx
                sums[n + k, 1] += share * gx * gy
                sums[n + k, 2] += share * gy * gy
                sums[n + k, 3] += share * gx * e
                sums[n + k, 4] += share * gy * e
                sums[n + k, 5] += share * gx
                sums[n + k, 6] += share * gy
                sums[n + k, 7] += share * e
                sums[n + k, 8] += share
        for k in range(gw):
            for c in range(9):
                total[m, k, c] += (1.0 - t) * sums[k, c]
                total[m + 1, k, c] += t * sums[k, c]


@numba.njit(cache=True, nogil=True, inline="always")
def _weights(t):  # pragma: no cover - compiled
    """Of the four samples around a place (Catmull and Rom)."""
    return (
        ((2.0 - t) * t - 1.0) * t * 0.5, ((3.0 * t - 5.0) * t * t + 2.0) * 0.5, ((4.0 - 3.0 * t) * t + 1.0) * t * 0.5,
        (t - 1.0) * t * t * 0.5,
    )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _cubic(a, x, y):  # pragma: no cover - compiled
    """`a` at (x, y), at least two samples inside its border."""
    i, j = int(y), int(x)
    c0, c1, c2, c3 = _weights(x - j)
    r0, r1, r2, r3 = _weights(y - i)
    p0, p1 = i - 1, i
    v = r0 * (c0 * a[p0, j - 1] + c1 * a[p0, j] + c2 * a[p0, j + 1] + c3 * a[p0, j + 2])
    v += r1 * (c0 * a[p1, j - 1] + c1 * a[p1, j] + c2 * a[p1, j + 1] + c3 * a[p1, j + 2])
    p0, p1 = i + 1, i + 2
    v += r2 * (c0 * a[p0, j - 1] + c1 * a[p0, j] + c2 * a[p0, j + 1] + c3 * a[p0, j + 2])
    return v + r3 * (c0 * a[p1, j - 1] + c1 * a[p1, j] + c2 * a[p1, j + 1] + c3 * a[p1, j + 2])
