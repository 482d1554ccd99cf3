"""Guided filter with a colour guide: a mask's edges moved to those of a picture, for masks from measured depth.

Depth maps end some pixels beside the things that they show; colour tells things of like brightness apart.
Source: He, Sun and Tang 2010, eqs. 14 to 16; each mean weighted by where the mask means anything.
"""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.numerics import divide


def coded(plate: np.ndarray) -> np.ndarray:
    """(h, w, 3) float32, about as the eye grades it: square root of linear light, at most 2."""
    return np.sqrt(np.clip(plate, 0, 4)).astype(np.float32)


def guided(mask: np.ndarray, guide: np.ndarray, radius_px: int, eps: float, weight: np.ndarray | None = None) -> np.ndarray:
    """(h, w) float32, 0..1.

    mask : (h, w) float32 0..1;  guide : (h, w, 3) float32;  eps : variance of the guide from which an edge counts as one
    weight : (h, w) float32, 0 = what mask and guide say there is not asked; None = 1 everywhere
    Depends on pixels within 2 radius_px.
    """
    if weight is None:
        return np.clip(cv2.ximgproc.guidedFilter(np.ascontiguousarray(guide), mask, radius_px, eps), 0, 1)
    side = 2 * radius_px + 1

    def sums(a: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(a, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)

    scale = divide(1.0, sums(weight)).astype(np.float32)

    def mean(a: np.ndarray) -> np.ndarray:
        return sums(a * weight) * scale

    i = [np.ascontiguousarray(guide[..., c]) for c in range(3)]
    m = [mean(c) for c in i]
    mean_mask = mean(mask)
    e = np.float32(eps)
    rr, gg, bb = (mean(i[c] * i[c]) - m[c] * m[c] + e for c in range(3))
    rg, rb, gb = (mean(i[c] * i[d]) - m[c] * m[d] for c, d in ((0, 1), (0, 2), (1, 2)))
    cr, cg, cb = (mean(i[c] * mask) - m[c] * mean_mask for c in range(3))
    # inverse of the symmetric matrix [[rr, rg, rb], [rg, gg, gb], [rb, gb, bb]], by its adjugate
    arr, arg, arb = gg * bb - gb * gb, rb * gb - rg * bb, rg * gb - rb * gg
    agg, agb, abb = rr * bb - rb * rb, rb * rg - rr * gb, rr * gg - rg * rg
    one = divide(1.0, np.maximum(rr * arr + rg * arg + rb * arb, e**3)).astype(np.float32)
    a = [
        (arr * cr + arg * cg + arb * cb) * one,
        (arg * cr + agg * cg + agb * cb) * one,
        (arb * cr + agb * cg + abb * cb) * one,
    ]
    rest = mean_mask - a[0] * m[0] - a[1] * m[1] - a[2] * m[2]
    out = mean(rest)
    for c in range(3):
        out += mean(a[c]) * i[c]
    return np.clip(out, 0, 1)
