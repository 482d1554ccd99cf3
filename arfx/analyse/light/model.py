"""How well lights explain what was seen: E(n) = a + sum_l Omega_l max(n.d_l, 0), many sets of
directions at once.

For given directions the amplitudes, at least 0, are linear least squares of a few columns, and
so is what a wrong transfer function leaves of the values: a power of an irradiance bends it.
All of it comes from one Gram matrix of the columns and of their derivatives (variable
projection: Golub and Pereyra 1973; Kaufman 1975)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide, normalise

DOME = 1.0
_POINT = 1e-6
_ALL = 3  # directions of a set, at most
_RIDGE = 1e-9  # of a column's own square
_LONGEST_STEP = 0.35  # radians
_STALLED = 1e-4  # of chi squared: passes that gain less are the last
_STUCK = 10.0  # damping from which on a minimum counts as found


class Group(NamedTuple):
    """Samples that share amplitudes, times the root of their weight.

    normals : (k, 3);  root : (k,);  lit : (k,) share of the lamps that is on
    value : (3, k) by channel
    bend : (3, k) what a logarithm of the exponent of 1 adds to value
    bend_weight : (3,) inverse of (1 / its variance + bend.bend): 0 where the exponent is 1"""

    normals: ndarray
    root: ndarray
    lit: ndarray
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
    """n sets of q directions that make m lights.

    dirs : (n, q, 3) unit, towards them;  soft : (n, q) sine of their discs' half-angle; DOME
    = ambient light that is brighter from one side, ((n.d + 1) / 2)^2
    mix : (n, m, q) strength of each direction in each light"""

    dirs: ndarray
    soft: ndarray
    mix: ndarray

    def __getitem__(self, rows: ndarray | slice) -> Lights:
        return Lights(self.dirs[rows], self.soft[rows], self.mix[rows])

    def __len__(self) -> int:
        return len(self.dirs)

    def columns(self, group: Group) -> tuple[ndarray, ndarray]:
        """What each direction gives k normals, and its slope by n.d, both (n, q, k)."""
        c, soft = (
            self.dirs @ group.normals.T,
            np.maximum(self.soft, _POINT)[..., None],
        )
        low, full = np.maximum(c + soft, 0), c >= soft
        shade, slope = np.where(full, c, low**2 / (4 * soft)), low / (2 * soft)
        on = np.where(soft < DOME, group.lit, 1.0)
        return on * shade, on * np.where(full, 1, slope)


def each(dirs: ndarray, soft: ndarray | float = 0.0) -> Lights:
    """Lights of one direction each, (n, q, 3)."""
    n, q = dirs.shape[:2]
    return Lights(
        dirs, np.broadcast_to(soft, (n, q)), np.broadcast_to(np.eye(q), (n, q, q))
    )


def joined(sets: Sequence[Lights]) -> Lights:
    return Lights(
        *(
            np.concatenate([getattr(s, k) for s in sets])
            for k in ("dirs", "soft", "mix")
        )
    )


class Solution(NamedTuple):
    """chi2 : (n,);  amplitudes : (n, g, 3, m + 1), ambient first
    gradient : (n, p), curvature : (n, p, p), of half of chi squared by the p turns of the
    directions;  across : (n, q, 2, 3) axes of these turns"""

    chi2: ndarray
    amplitudes: ndarray
    gradient: ndarray
    curvature: ndarray
    across: ndarray


def non_negative(G: ndarray, h: ndarray) -> tuple[ndarray, ndarray]:
    """Least x.G.x - 2 x.h over x >= 0, and the inverse of G over what is above 0: the best of
    all subsets. G : (..., m, m);  h : (..., m)"""
    m = h.shape[-1]
    G = G + np.eye(m) * (_RIDGE * np.einsum("...ii->...i", G) + 1e-30)[..., None, :]
    inverse = np.linalg.inv(G)
    x = (inverse @ h[..., None])[..., 0]
    below = (x < 0).any(-1)
    if not below.any():
        return x, inverse
    G, h = G[below], h[below]
    used = np.array(list(product((False, True), repeat=m))[:-1])  # (s, m)
    block = used[:, :, None] & used[:, None, :]
    own = np.linalg.inv(np.where(block, G[:, None], np.eye(m))) * block
    trials = (own @ h[:, None, :, None])[..., 0]
    gain = np.where((trials >= 0).all(-1), (trials * h[:, None]).sum(-1), 0.0)
    best = np.arange(len(h)), gain.argmax(-1)
    x[below], inverse[below] = trials[best], own[best]
    return x, inverse


def turns_of(dirs: ndarray) -> ndarray:
    """(..., 2, 3) unit vectors across (..., 3) and each other."""
    first = normalise(np.cross(dirs, np.eye(3)[np.abs(dirs).argmin(-1)]))
    return np.stack([first, np.cross(dirs, first)], -2)


def solve(groups: Sequence[Group], lights: Lights, held: int = _ALL) -> Solution:
    """held : so many of the directions, the first ones, are not turned"""
    n, m = len(lights), lights.mix.shape[1] + 1
    across = turns_of(lights.dirs[:, held:])
    chi2 = np.full(n, sum(g.total for g in groups))
    amplitudes, p = np.empty((n, len(groups), 3, m)), 2 * across.shape[1]
    gradient, curvature = np.zeros((n, p)), np.zeros((n, p, p))
    for number, group in enumerate(groups):
        shade, slope = lights.columns(group)
        turned = slope[:, held:, None] * (across @ group.normals.T)
        rows = np.concatenate(
            [
                np.ones((n, 1, len(group.normals))),
                lights.mix @ shade,
                turned.reshape(n, p, len(group.normals)),
            ],
            1,
        )
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
        strength = (x[..., 1:] @ lights.mix)[..., held:]
        size = np.repeat(strength, 2, -1)  # (n, 3, p)
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
    now = solve(groups, lights, held)
    damping, p = np.full(len(lights), 1e-3), now.gradient.shape[1]
    dirs, chi2 = lights.dirs.copy(), now.chi2.copy()
    moving = np.arange(len(lights))
    for _ in range(passes if p else 0):
        if not len(moving):
            break
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
        turn = (step.reshape(len(moving), -1, 2, 1) * now.across).sum(2)
        trial = replace(lights[moving], dirs=dirs[moving])
        trial.dirs[:, held:] = normalise(trial.dirs[:, held:] + turn)
        there = solve(groups, trial, held)
        better = there.chi2 < now.chi2
        gains = now.chi2 - there.chi2 > _STALLED * now.chi2
        arrived = moving[better]
        dirs[arrived], chi2[arrived] = trial.dirs[better], there.chi2[better]
        damping = np.where(better, damping / 5, damping * 6).clip(1e-9, 1e9)
        on = gains | ~better & (damping < _STUCK)
        now = Solution(
            *(
                np.where(better.reshape(-1, *[1] * (a.ndim - 1)), b, a)[on]
                for a, b in zip(now, there, strict=True)
            )
        )
        moving, damping = moving[on], damping[on]
    return replace(lights, dirs=dirs), chi2
