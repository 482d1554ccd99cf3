"""Light from prints that are partly overexposed: which readings may be compared with each other.

Where the paper is clipped the ink tells the light, and where it is not the paper tells it better. But the two have one scale
only as far as the camera's curve is known: some per cent of difference between frames of either kind would pass for the
shape of the light over its normals. So a fit gets readings of one kind: the paper's, where few are clipped, else the ink's.
(Even where nothing tells the bias: light with a constant added has the same directions.)
"""

from __future__ import annotations

import numpy as np

from arfx.analyse.photometry_solve import Photometry
from arfx.core.numerics import divide

SPOILT = 0.02  # share of a reading's paper samples that are clipped, from which the paper says nothing exact
FEW = 0.15  # of the readings: so many spoilt ones can be left out
_OUT = 2.5  # deviations from the median of a reading's ink patches, beyond which one counts less


def comparable(
    p: Photometry, intensity: np.ndarray, variance: np.ndarray, white: np.ndarray, clipped: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(light y (t, 3), its own variance (t, 3), (t,) readings of one kind, for a fit over normals). Arguments as for `solve`."""
    spoilt = p.seen & (np.where(white, clipped, 0).sum(1) > SPOILT * white.sum())
    share = float(spoilt.sum()) / max(int(p.seen.sum()), 1)
    if not spoilt.any() or (share <= FEW and not p.determined.all()):
        return p.y, p.var_y_own, p.seen
    if share <= FEW:
        return p.y, p.var_y_own, p.seen & ~spoilt
    y, own = _by_ink(p, intensity[:, ~white], variance[:, ~white])
    told = np.isfinite(y).all(1)
    return np.where(told[:, None], y, p.y), np.where(told[:, None], own, p.var_y_own), p.seen & told


def _by_ink(p: Photometry, value: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light (t, 3) by the ink alone, and its variance; NaN where no ink was seen. value, variance : (t, q, 3) of the ink"""
    fine = np.isfinite(value) & np.isfinite(variance) & (variance > 0)
    known = fine.any(1)
    middle = np.where(known, np.nanmedian(np.where(known[:, None], np.where(fine, value, np.nan), 0.0), 1), 0.0)
    off = np.abs(np.where(fine, value - middle[:, None], 0)) / np.sqrt(np.where(fine, variance, 1))
    w = np.where(fine, divide(1.0, np.where(fine, variance, 1)), 0) * np.minimum(1, divide(_OUT, off, where_zero=1.0))
    total = w.sum(1)
    y = (divide((w * np.where(fine, value, 0)).sum(1), total) - p.bias) / p.ink
    return np.where(known, y, np.nan), np.where(known, divide(1.0, total * p.ink**2) * p.misfit**2, np.nan)
