"""Every epsilon and every guarded operation, each with its derivation.

No other module divides by data, takes an arccos of data or normalises data without going
through here."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

# Shortest vector with a direction: float64 rounding (2.2e-16) of coordinates up to 1e4 m
# leaves 2e-12 m of noise.
EPS_LENGTH = 1e-12
# Nearest projected point: nothing physical is closer, and focal lengths up to 1e5 px stay
# finite in float32.
EPS_DEPTH_M = 1e-4
# Least weight of a mean: below that of one pixel in a picture of 2^20 x 2^20 nothing is known.
EPS_WEIGHT = 1e-12
# Half of one 8-bit step: a change below it cannot alter a stored pixel by more than rounding does.
HALF_GREY = 0.5 / 255.0


def divide(
    a: ndarray | float, b: ndarray | float, where_zero: float = 0.0
) -> ndarray:
    """a / b, with `where_zero` where b is zero or the quotient is not finite. Broadcasts."""
    with np.errstate(all="ignore"):
        q = np.asarray(a, float) / np.asarray(b, float)
    return np.where(
        np.isfinite(q), q, where_zero
    )  # a quotient by zero is never finite


def normalise(v: ndarray) -> ndarray:
    """Unit vectors; vectors shorter than EPS_LENGTH, or not finite, become zero vectors."""
    v = np.asarray(v)
    with np.errstate(all="ignore"):
        n = np.linalg.norm(v, axis=-1, keepdims=True)
        ok = (n > EPS_LENGTH) & np.isfinite(n)
        return np.where(ok, v / np.where(ok, n, 1), 0).astype(
            v.dtype if v.dtype.kind == "f" else float
        )


def arccos(c: ndarray | float) -> ndarray:
    """arccos with the argument clipped to [-1, 1]; rounding there is at most a few 1e-16."""
    return np.arccos(np.clip(c, -1.0, 1.0))


def angle_between(a: ndarray, b: ndarray) -> ndarray:
    """Angle in radians between vectors (..., 3), accurate near 0 and pi (Kahan's atan2 form)."""
    a, b = normalise(np.asarray(a, float)), normalise(np.asarray(b, float))
    return 2.0 * np.arctan2(
        np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
    )


def direction_of(azimuth: ndarray | float, elevation: ndarray | float) -> ndarray:
    """Unit vectors (..., 3) of angles in radians: from x towards y, and from there towards z."""
    flat = np.cos(elevation)
    xyz = flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)
    return np.stack(xyz, -1)


def condition(matrix: ndarray) -> float:
    """2-norm condition number; inf for a singular, empty or non-finite matrix."""
    m = np.asarray(matrix, float)
    known = m.size > 0 and np.isfinite(m).all()
    return float(np.linalg.cond(m)) if known else math.inf


def medians(values: ndarray, kept: ndarray) -> ndarray:
    """(p,) medians of the entries of each row that are kept; NaN of none. values : (n,) or
    (p, n); kept : (p, n) bool. For few entries five times as fast as numpy's own.
    """
    ordered = np.sort(np.where(kept, values, np.inf), 1)
    count = kept.sum(1)
    row, last = np.arange(len(kept)), np.maximum(count - 1, 0)
    middle = (ordered[row, last // 2] + ordered[row, count // 2]) / 2
    return np.where(count > 0, middle, np.nan)


def finite(value: Any) -> Any:
    """A document in plain types, with non-finite numbers as None: JSON has no NaN."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    if hasattr(value, "tolist"):
        return finite(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def smoothstep(t: Any) -> ndarray:
    """From 0 at t = 0 to 1 at t = 1, level at both and beyond."""
    t = np.clip(t, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def same_rows(rows: ndarray) -> tuple[ndarray, ndarray]:
    """Of rows (n, k): (m,) the first of each that differ, in their order, and (n,) which of
    these m each row is. As of np.unique(axis=0), in half its time; and Ctrl-C is heard
    meanwhile: it lets other threads work."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.ones(len(rows), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(1)
    which = np.empty(len(rows), int)
    which[order] = np.cumsum(new) - 1
    return order[new], which
