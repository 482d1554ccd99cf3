"""Guided filter with a colour guide: a mask's edges moved to those of a picture, for masks
from measured depth.

Depth maps end some pixels beside the things that they show; colour separates things of
similar brightness.
Source: He, Sun and Tang 2010, eqs. 14 to 16; each mean weighted by where the mask means anything.
Cost: O(pixels of the box around what is mixed)."""

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide
from arfx.core.rect import Rect
from arfx.core.scene import Scene

_WINDOW_SHARE = 1 / 160  # radius of the filter's window over the picture's width
_PASSES = 2  # each draws the edge nearer to the picture's
_FAINT = 0.06  # a share below this, and above 1 less this, is the filter's own spill
_EPS = (
    0.05**2
)  # variance of the picture, coded 0..1, from which an edge counts as one


def window_px(scene: Scene) -> int:
    """Radius of the filter's window."""
    return max(round(scene.camera.width * _WINDOW_SHARE), 3)


def reach_px(scene: Scene) -> int:
    """How far a pixel of the mask is decided from."""
    return 2 * _PASSES * window_px(scene)


def refined(mask: ndarray, valid: ndarray, plate: ndarray, radius_px: int) -> ndarray:
    """mask (h, w) float32 0..1, its edges moved to those of plate; the same bits where it
    is even all around.

    valid : (h, w) float32, 1 where the mask means anything, else 0;  plate : (h, w, 3) linear light
    """
    reach = 2 * _PASSES * radius_px
    around = np.ones((2 * reach + 1,) * 2, np.uint8)
    least = cv2.erode(np.where(valid > 0, mask, 1).astype(np.float32), around)
    mixed = (
        cv2.dilate(np.where(valid > 0, mask, 0).astype(np.float32), around) > least
    ) & (valid > 0)
    x, y, width, height = cv2.boundingRect(mixed.view(np.uint8))
    if not width:
        return mask
    whole = Rect(0, 0, *mask.shape[::-1])
    box = Rect(x, y, x + width, y + height).pad(reach).clip(whole).slices
    # about as the eye grades it: square root of linear light, at most 2
    guide = [
        np.sqrt(np.clip(plate[box][..., c], 0, 4)).astype(np.float32)
        for c in range(3)
    ]
    moved = _guided(
        mask[box], guide, radius_px, np.ascontiguousarray(valid[box], np.float32)
    )
    moved = np.clip((moved - _FAINT) / (1 - 2 * _FAINT), 0, 1)
    out = mask.copy()
    out[box] = np.where(mixed[box], moved, mask[box])
    return out


def _guided(
    mask: ndarray, i: list[ndarray], radius_px: int, weight: ndarray
) -> ndarray:
    """(h, w) float32, 0..1, after _PASSES.

    i : three channels (h, w);  weight : (h, w), of each pixel in the means
    """
    side = 2 * radius_px + 1

    def sums(a: ndarray) -> ndarray:
        return cv2.boxFilter(
            a, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT
        )

    scale = divide(1.0, sums(weight)).astype(np.float32)

    def mean(a: ndarray) -> ndarray:
        return sums(a * weight) * scale

    m = [mean(c) for c in i]
    e = np.float32(_EPS)
    rr, gg, bb = (mean(i[c] * i[c]) - m[c] * m[c] + e for c in range(3))
    rg, rb, gb = (
        mean(i[c] * i[d]) - m[c] * m[d] for c, d in ((0, 1), (0, 2), (1, 2))
    )
    # inverse of the symmetric matrix [[rr, rg, rb], [rg, gg, gb], [rb, gb, bb]], by its adjugate
    arr, arg, arb = gg * bb - gb * gb, rb * gb - rg * bb, rg * gb - rb * gg
    agg, agb, abb = rr * bb - rb * rb, rb * rg - rr * gb, rr * gg - rg * rg
    one = divide(1.0, np.maximum(rr * arr + rg * arg + rb * arb, e**3)).astype(
        np.float32
    )
    for _ in range(_PASSES):
        mean_mask = mean(mask)
        cr, cg, cb = (mean(i[c] * mask) - m[c] * mean_mask for c in range(3))
        slope = [
            (arr * cr + arg * cg + arb * cb) * one,
            (arg * cr + agg * cg + agb * cb) * one,
            (arb * cr + agb * cg + abb * cb) * one,
        ]
        out = mean(mean_mask - slope[0] * m[0] - slope[1] * m[1] - slope[2] * m[2])
        for c in range(3):
            out += mean(slope[c]) * i[c]
        mask = np.clip(out, 0, 1)
    return mask
