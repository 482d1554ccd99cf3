"""Holes of a measured depth map, filled along the picture's edges.

What is known spreads into a hole through what looks alike: the smoothed product of known values and their mask, over the
smoothed mask, both by the weighted least squares that follow the picture's edges (fast global smoother). Measured pixels
keep their value. In dioptres, so that a far wall weighs no more than a near table.
Source: Min et al. 2014 (the smoother); the quotient as in normalised convolution (Knutsson and Westin 1993).
"""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.numerics import divide

LAMBDA = 3000.0  # reach of the smoother: about sqrt of it, px, where the picture is even
SIGMA = 6.0  # grey levels that count as an edge
_FAINT = 1e-4  # a mask smoothed to less than this tells nothing: the nearest known value is taken


def filled(depth_m: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """(H, W) float32 metres at the guide's size, > 0 everywhere.

    depth_m : (h, w) metres, 0 = unknown, at least one known;  guide : (H, W) uint8, the picture
    """
    h, w = guide.shape
    if depth_m.shape != guide.shape:
        depth_m = cv2.resize(depth_m, (w, h), interpolation=cv2.INTER_NEAREST)
    known = depth_m > 0
    if known.all():
        return np.ascontiguousarray(depth_m, np.float32)
    mask = known.astype(np.float32)
    dioptre = divide(1.0, depth_m).astype(np.float32)
    smooth = cv2.ximgproc.createFastGlobalSmootherFilter(np.ascontiguousarray(guide), LAMBDA, SIGMA)
    total, value = smooth.filter(mask), smooth.filter(dioptre * mask)
    near = _nearest(dioptre, known)
    least, most = dioptre[known].min(), dioptre[known].max()
    spread = np.clip(divide(value, total), least, most)
    out = np.where(known, dioptre, np.where(total > _FAINT, spread, near))
    return divide(1.0, out).astype(np.float32)


def _nearest(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Of every pixel the value of the nearest known one."""
    _, label = cv2.distanceTransformWithLabels((~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(int(label.max()) + 1, values.dtype)
    of_label[label[known]] = values[known]
    return of_label[label]
