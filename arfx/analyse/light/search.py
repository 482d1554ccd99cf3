"""Observations of irradiance brought down to what a fit needs: few normals, robust means,
honest weights."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.analyse.light.model import Group
from arfx.analyse.light.sphere import DEG_4, DEG_16, nearest_cell
from arfx.core.numerics import condition, divide, normalise

# apart: what is averaged, and what shares one systematic error
FINE, COARSE = DEG_4, DEG_16
_UNUSABLE = 1e11  # a variance from here on is UNKNOWN_VARIANCE of photometry.py
_LEAST = 1e-5  # noise of a mean, of the brightest light: below it weights say nothing
_DARK = 1e-3  # of the bright level
_OUT = 2.0  # robust deviations within a cell from which an observation counts less


@dataclass(frozen=True, eq=False)
class Samples:
    """k means of observations with nearly one normal, in the order of their groups.

    normals : (k, 3) mean of unit vectors;  value : (k, 3) irradiance over `scale` (3,), the
    channels' bright levels
    weight : (k,) inverse variance;  starts : (g + 1,) rows of the groups;  effective :
    number of independent values
    lit : (k,) share of the lamps that is on, 0..1
    """

    normals: ndarray
    value: ndarray
    weight: ndarray
    starts: ndarray
    scale: ndarray
    effective: float
    lit: ndarray

    def groups(self, gamma_sigma: float = 0.0) -> list[Group]:
        """gamma_sigma : standard deviation of the values' exponent's logarithm"""
        out = []
        root = np.sqrt(self.weight)
        for rows in map(slice, self.starts[:-1], self.starts[1:]):
            value = self.value[rows].T
            size = np.maximum(np.abs(value), _DARK)
            bend = size * np.log(size) * root[rows]
            spread = (bend**2).sum(1)
            weight = gamma_sigma**2 / (1 + gamma_sigma**2 * spread)
            out.append(
                Group(
                    self.normals[rows],
                    root[rows],
                    self.lit[rows],
                    value * root[rows],
                    bend,
                    weight,
                )
            )
        return out

    def condition(self, lamp: ndarray | None = None) -> float:
        """Of [1, n], columns of length 1: how well ambient light is told from a direction.
        lamp : n = 0 where it is not seen
        """
        n = self.normals
        if lamp is not None:
            n = n * (n @ lamp > 0)[:, None]
        rows = np.sqrt(self.weight)[:, None] * np.column_stack([np.ones(len(n)), n])
        return condition(divide(rows, np.linalg.norm(rows, axis=0)))


def gather(
    normals: ndarray,
    irradiance: ndarray,
    variance: ndarray | float,
    group: ndarray | int,
    model_error: float,
    lit: ndarray | None = None,
) -> Samples | None:
    """None where nothing is known. normals (k, 3), irradiance (k, 3), variance (k, 3),
    group (k,) int, or what broadcasts: all finite.

    model_error : systematic error of the irradiance relative to its bright level. It is one
    and the same within a coarse
    cell of normals, so that more observations there add nothing beyond it.
    lit : (g,) share of the lamps that is on in each group; then all groups are one, with
    the same light
    """
    v, g = (
        np.broadcast_to(variance, irradiance.shape),
        np.broadcast_to(group, len(normals)),
    )
    known = (v < _UNUSABLE).all(1)
    if not known.any():
        return None
    n, E, v, g = normalise(normals[known]), irradiance[known], v[known], g[known]
    scale = np.percentile(E, 90, axis=0)
    scale = np.maximum(scale, max(1e-3 * float(scale.max()), 1e-12))
    E, v = E / scale, (v / scale**2).mean(1)
    number = np.unique(g, return_inverse=True)[1]
    key, where = np.unique(number * FINE + nearest_cell(n, FINE), return_inverse=True)
    rows = np.split(
        np.argsort(where, kind="stable"), np.cumsum(np.bincount(where))[:-1]
    )
    N, X, V = (
        np.array(a)
        for a in zip(*(_mean(n[r], E[r], v[r]) for r in rows), strict=True)
    )
    groups = key // FINE
    coarse = np.unique(
        groups * COARSE + nearest_cell(N, COARSE), return_inverse=True
    )[1]
    many, floor = np.bincount(coarse)[coarse], model_error**2
    variance_of_mean = V + many * floor + _LEAST**2
    effective = 3 * float(((V + floor + 1e-300) / (V + many * floor + 1e-300)).sum())
    starts, on = np.searchsorted(groups, np.arange(groups.max() + 2)), np.ones(len(N))
    if lit is not None:
        starts, on = np.array([0, len(N)]), lit[np.unique(g)[groups]]
    return Samples(N, X, 1 / variance_of_mean, starts, scale, effective, on)


def _mean(n: ndarray, E: ndarray, v: ndarray) -> tuple[ndarray, ndarray, float]:
    """Robust mean of one cell's normals and values, and its variance: stated, or the
    scatter's where that is larger.
    """
    p = 1 / (v + _LEAST**2)
    scatter = 0.0
    if len(n) >= 5:
        off = np.abs(E - np.median(E, 0))
        width = 1.4826 * np.median(off, 0) + 1e-3
        p = p * np.minimum(1, _OUT / np.maximum((off / width).max(1), 1e-9))
        scatter = float((width**2).mean()) / len(n)
    p = p / p.sum()
    return p @ n, p @ E, max(float((p * p) @ v), scatter)
