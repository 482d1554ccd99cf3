"""Gain and bias of the camera, as printed: Tan, Chen, Sun 2009, equations (2) and (4) to (6).

A patch of albedo rho in light x shows I = g rho x + b (2). With g' = 1/g and b' every patch
and frame is a row of a homogeneous system (4) to (6), solved by the singular vector of the
smallest singular value.

rho of a patch is its mean brightness, in linear light, in the first picture that shows the
whole print, so that x is 1 in the light of that picture. Ink and paper whose albedos are
known are given in its place (`light.albedos = "known"`), and so is the map of albedos of a
print whose picture is known where it has colours, or stands beside other prints.

b is b'/g', what (2) gives. As printed it is 1/b', but (6) leaves the length of its vector
free, and 1/b' changes with it: for the vector of length 1 it grows with the number of
frames, in no unit of grey. So it is not well defined; `light.printed_bias` takes it all the
same. Its errors: docs/methods/light.md#errata."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.light.photometry import (
    UNUSABLE,
    Photometry,
    assemble,
    bright_patches,
    weighted,
)
from arfx.core.numerics import divide

DENSE = 300  # frames
LEAST_GAP = 3.0  # of the two smallest singular values: less is nullity 2 beside noise
# of the largest singular value: below it one counts as zero (1e-7 by the normal matrix)
NULL = 1e-10


class SmallestVector(NamedTuple):
    """gain, bias : of the solution, g = 1/g' (free scale: the vector has length 1, g' > 0)

    bias : b'/g', in units of grey (what dividing (2) by g gives);  bias_printed : 1/b' (as printed)
    y : (t,) x_t / g', so that grey = rho y + bias;  nullity, rank : of the system;
    smallest : its singular value
    condition : largest singular value over the smallest but one, the smallest being the
    solution's; at most 1e12
    gap : the smallest but one over the smallest, at most 1e12: near 1 where noise alone
    singles out the solution
    """

    gain: float
    bias: float
    bias_printed: float
    y: ndarray
    nullity: int
    rank: int
    smallest: float
    condition: float
    gap: float


def eq6_smallest_vector(
    intensity: ndarray, albedo: ndarray, dense: int = DENSE
) -> SmallestVector:
    """One channel. intensity : (t, p), NaN = not measured;  albedo : (p,) or (t, p). Frames
    without any patch get y = 0.

    Up to `dense` frames by singular value decomposition; beyond, by the normal matrix, which
    is sparse: O(frames x patches), and good to half as many digits. The
    vector is biased where I is noisy, and depends on the units of I.

    Raises ValueError where no patch is finite."""
    value = np.asarray(intensity, float)
    rho = np.broadcast_to(np.asarray(albedo, float), value.shape)
    valid = np.isfinite(value) & np.isfinite(rho)
    seen = valid.any(1)
    if not seen.any():
        raise ValueError("no finite intensity")
    grey, r, m = (np.where(valid, a, 0)[seen] for a in (value, rho, 1.0))
    frames = len(grey)
    null = NULL
    if frames <= dense:
        rows = np.zeros((max(grey.size, frames + 2), frames + 2))
        k = np.arange(grey.size)
        rows[k, 0] = -grey.ravel()
        rows[k, 1] = m.ravel()
        rows[k, 2 + k // r.shape[1]] = r.ravel()
        _, s, vt = np.linalg.svd(rows, full_matrices=False)
        v = vt[-1]
    else:
        v, s = _sparse(grey, r, m)
        null *= 1e3
    nullity = int((s <= null * s[0]).sum())
    v = v * (np.sign(v[0]) or 1.0)
    y = np.zeros(len(value))
    y[seen] = divide(v[2:], v[0])
    condition, gap = divide(s[[0, -2]], s[[-2, -1]], where_zero=1e12)
    return SmallestVector(
        float(divide(1, v[0])),
        float(divide(v[1], v[0])),
        float(divide(1, v[1])),
        y,
        nullity,
        frames + 2 - nullity,
        float(s[-1]),
        min(float(condition), 1e12),
        min(float(gap), 1e12),
    )


def brightness(intensity: ndarray) -> ndarray:
    """(p,) rho of (2) as printed: each patch's mean brightness in one picture by the same
    camera, the first that shows all of the print; of the patches that it lacks NaN.
    intensity : (t, p, 3), NaN = not measured"""
    if not len(intensity):
        return np.full(intensity.shape[1], np.nan)
    shown = np.isfinite(intensity).all(-1).sum(1)
    return np.asarray(intensity[shown.argmax()].mean(-1), float)


def gain_and_bias(
    intensity: ndarray, albedo: ndarray, printed_bias: bool = False
) -> Photometry:
    """(4) to (6) for all channels, arguments as in photometry.solve. No variances: the
    paper has none; those reported are of the residuals. printed_bias : b = 1/b' in place of
    b'/g' (y stays as solved)."""
    parts = []
    for grey, weight, rho in weighted(intensity, None, albedo):
        seen = weight.any(1)
        part = bright_patches(grey, weight, rho, UNUSABLE)
        if seen.any():
            found = eq6_smallest_vector(np.where(weight > 0, grey, np.nan), rho)
            why = f"the system has nullity {found.nullity}, not 1"
            if found.nullity < 2:
                why = "only noise singles out the solution"
            # g' = 0: b' and x alone, of one albedo
            blank = found.gain == 0 or abs(found.gain) > 1e8 * np.abs(grey).max()
            if found.nullity < 2 and not blank and found.gap > LEAST_GAP:
                b = found.bias_printed if printed_bias else found.bias
                residual = (grey - rho * found.y[:, None] - found.bias) * weight
                spare = max(weight.sum() - seen.sum() - 1, 1)
                spread = float((residual**2).sum() / spare)
                own = divide(spread, (weight * rho * rho).sum(1))
                part = part._replace(
                    y=found.y,
                    var_y_own=np.where(seen, own, part.var_y_own),
                    bias=b,
                    bias_95=(b, b),
                    misfit=float(np.sqrt(spread)),
                )
                why = ""
            part = part._replace(why=why, condition=found.condition)
        parts.append(part)
    return assemble(parts)


def _sparse(grey: ndarray, r: ndarray, m: ndarray) -> tuple[ndarray, ndarray]:
    """(smallest singular vector (t + 2,), singular values: an upper bound of the largest, and
    the two smallest, largest first), by the two smallest eigenvalues of the normal matrix,
    whose x part is diagonal."""
    from scipy.sparse import block_array, diags_array
    from scipy.sparse.linalg import eigsh

    head = np.array([[(grey * grey).sum(), -grey.sum()], [-grey.sum(), m.sum()]])
    cross = np.stack([-(r * grey).sum(1), (r * m).sum(1)])
    normal = block_array(
        [[head, cross], [cross.T, diags_array((r * r).sum(1))]], format="csc"
    )
    largest = float(normal.trace())
    values, vectors = eigsh(
        normal, 2, sigma=-1e-12 * largest, v0=np.ones(len(grey) + 2)
    )
    order = np.argsort(values)
    return vectors[:, order[0]], np.sqrt(
        np.maximum([largest, *values[order[::-1]]], 0)
    )
