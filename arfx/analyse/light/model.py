"""How well lights explain what was seen: E(n) = a + sum_l Omega_l max(n.d_l, 0), many sets of
directions at once.

For given directions the amplitudes, at least 0, are linear least squares of a few columns, and
so is what a wrong transfer function leaves of the values: a power of an irradiance bends it.
All of it comes from one Gram matrix of the columns and of their derivatives (variable
projection: Golub and Pereyra 1973; Kaufman 1975)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide, normalise
from arfx.core.sampling import frame_about

DOME = 1.0
_POINT = 1e-6
_RIDGE = 1e-9  # of a column's own square
_LONGEST_STEP = 0.35  # radians
_STALLED = 1e-4  # of chi squared: passes that gain less are the last
_STUCK = 10.0  # damping from which on a minimum counts as found


class Group(NamedTuple):
    """Samples that share amplitudes, times the root of their weight.

    normals : (k, 3);  root : (k,)
    value : (3, k) by channel
    bend : (3, k) what a logarithm of the exponent of 1 adds to value
    bend_weight : (3,) inverse of (1 / its variance + bend.bend): 0 where the exponent is 1"""

    normals: ndarray
    root: ndarray
    value: ndarray
    bend: ndarray
    bend_weight: ndarray

    @property
    def total(self) -> float:
        """Chi squared of no light at all."""
        bent = (self.bend * self.value).sum(1)
        return float((self.value**2).sum() - (self.bend_weight * bent**2).sum())


@dataclass(frozen=True, eq=False)
class Lights:
    """n sets of q lights.

    dirs : (n, q, 3) unit, towards them;  soft : (n, q) sine of their discs' half-angle; DOME
    = ambient light that is brighter from one side, ((n.d + 1) / 2)^2"""

    dirs: ndarray
    soft: ndarray

    @staticmethod
    def of(dirs: ndarray, soft: ndarray | Sequence[float] | float = 0.0) -> Lights:
        """soft : what broadcasts to (n, q)"""
        return Lights(dirs, np.broadcast_to(soft, dirs.shape[:2]))

    def __getitem__(self, rows: ndarray | slice) -> Lights:
        return Lights(self.dirs[rows], self.soft[rows])

    def joined(self, other: Lights, axis: int = 0) -> Lights:
        """More sets, or by axis 1 more lights in each."""
        dirs = np.concatenate([self.dirs, other.dirs], axis)
        return Lights(dirs, np.concatenate([self.soft, other.soft], axis))

    def columns(self, normals: ndarray) -> tuple[ndarray, ndarray]:
        """What ambient light and each direction give k normals, (n, q + 1, k), and its
        slope by n.d, (n, q, k)."""
        c, soft = self.dirs @ normals.T, np.maximum(self.soft, _POINT)[..., None]
        low, full = np.maximum(c + soft, 0), c >= soft
        even = np.ones((len(c), 1, len(normals)))
        shade = np.concatenate([even, np.where(full, c, low**2 / (4 * soft))], 1)
        return shade, np.where(full, 1, low / (2 * soft))


class Solution(NamedTuple):
    """chi2 : (n,);  amplitudes : (n, g, 3, q + 1), ambient first
    gradient : (n, p), curvature : (n, p, p), of half of chi squared by the p turns of the
    directions;  across : (n, q, 2, 3) axes of these turns"""

    chi2: ndarray
    amplitudes: ndarray
    gradient: ndarray
    curvature: ndarray
    across: ndarray


def non_negative(G: ndarray, h: ndarray) -> tuple[ndarray, ndarray]:
    """Least x.G.x - 2 x.h over x >= 0, and the inverse of G over what is above 0: what is
    farthest below is left out, one after another. G : (..., m, m);  h : (..., m)"""
    m = h.shape[-1]
    G = G + np.eye(m) * (_RIDGE * np.einsum("...ii->...i", G) + 1e-30)[..., None, :]
    used = np.ones(h.shape, bool)
    while True:
        block = used[..., None] & used[..., None, :]
        inverse = np.linalg.inv(np.where(block, G, np.eye(m))) * block
        x = (inverse @ h[..., None])[..., 0]
        if (x >= 0).all():
            return x, inverse
        used &= x > np.minimum(x.min(-1, keepdims=True), -1e-300)


def solve(groups: Sequence[Group], lights: Lights, held: int = 0) -> Solution:
    """held : so many of the directions, the first ones, are not turned"""
    (n, q), m = lights.soft.shape, lights.soft.shape[1] + 1
    across = np.stack(frame_about(lights.dirs[:, held:]), -2)
    chi2 = np.full(n, sum(g.total for g in groups))
    amplitudes, p = np.empty((n, len(groups), 3, m)), 2 * (q - held)
    gradient, curvature = np.zeros((n, p)), np.zeros((n, p, p))
    for number, group in enumerate(groups):
        rows, slope = lights.columns(group.normals)
        turned = slope[:, held:, None] * (across @ group.normals.T)
        rows = np.concatenate([rows, turned.reshape(n, p, len(group.root))], 1)
        rows *= group.root
        bent = (rows @ group.bend.T).swapaxes(1, 2)  # (n, 3, m + p)
        kept = group.bend_weight[:, None] * bent
        G = (rows @ rows.swapaxes(1, 2))[:, None] - kept[..., None] * bent[
            ..., None, :
        ]
        h = (rows @ group.value.T).swapaxes(1, 2)
        h = h - kept * (group.bend * group.value).sum(1)[:, None]
        x, inverse = non_negative(G[..., :m, :m], h[..., :m])
        chi2 -= (x * h[..., :m]).sum((1, 2))
        amplitudes[:, number] = x
        size = np.repeat(x[..., 1 + held :], 2, -1)  # (n, 3, p)
        cross = G[..., m:, :m]
        free = G[..., m:, m:] - cross @ inverse @ cross.swapaxes(2, 3)
        left = h[..., m:] - (cross @ x[..., None])[..., 0]
        gradient -= (size * left).sum(1)
        curvature += (size[..., None] * size[..., None, :] * free).sum(1)
    return Solution(np.maximum(chi2, 0), amplitudes, gradient, curvature, across)


def refine(
    groups: Sequence[Group], lights: Lights, held: int = 0, passes: int = 25
) -> tuple[Lights, ndarray]:
    """Nearest minimum over all directions but the first `held`, and its chi squared (n,).
    Levenberg-Marquardt, all sets at once."""
    dirs, now = lights.dirs, solve(groups, lights, held)
    damping, p = np.full(len(dirs), 1e-3), now.gradient.shape[1]
    for _ in range(passes if p else 0):
        diagonal = np.einsum("nii->ni", now.curvature)
        added = (
            damping[:, None] * diagonal
            + 1e-9 * diagonal.max(1, keepdims=True)
            + 1e-12
        )
        damped = now.curvature + added[..., None] * np.eye(p)
        step = -np.linalg.solve(damped, now.gradient[..., None])
        long = np.linalg.norm(step, axis=1, keepdims=True)
        step = step * np.minimum(1, divide(_LONGEST_STEP, long, where_zero=1.0))
        turn = (step.reshape(len(step), -1, 2, 1) * now.across).sum(2)
        trial = dirs.copy()
        trial[:, held:] = normalise(dirs[:, held:] + turn)
        there = solve(groups, Lights(trial, lights.soft), held)
        better = there.chi2 < now.chi2
        gains = now.chi2 - there.chi2 > _STALLED * now.chi2
        dirs, *rest = (
            np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
            for new, old in zip((trial, *there), (dirs, *now), strict=True)
        )
        now = Solution(*rest)
        damping = np.where(better, damping / 5, damping * 6).clip(1e-9, 1e9)
        if not (gains | ~better & (damping < _STUCK)).any():
            break
    return Lights(dirs, lights.soft), now.chi2


def exponent(groups: Sequence[Group], lights: Lights) -> float:
    """Of the values, beside one set of lights."""
    amplitudes, found = solve(groups, lights).amplitudes[0], []
    for group, size in zip(groups, amplitudes, strict=True):
        rest = group.value - size @ lights.columns(group.normals)[0][0] * group.root
        found.append((group.bend_weight * (group.bend * rest).sum(1)).mean())
    return float(np.exp(np.mean(found)))
