"""Searches over the directions of model.py's lights: best ones, how far each may turn, what
else explains the data.

`gather` brings observations of irradiance down to what a fit needs: few normals, robust
means, honest weights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from arfx.analyse.light import model as light_model
from arfx.analyse.light.icosphere import icosphere
from arfx.core.numerics import angle_between, condition, divide, normalise

FINE, COARSE = (
    4,
    2,
    # levels of the cells that are averaged (4 degrees), and that share one systematic error (16
    # degrees)
)
_UNUSABLE = 1e11  # a variance from here on is UNKNOWN_VARIANCE of photometry.py
_LEAST = 1e-5  # noise of a mean, of the brightest light: below it weights say nothing
_OUT = 2.0  # robust deviations within a cell from which an observation counts less
AZIMUTHS = np.arange(12) * np.pi / 6
RINGS_DEG = np.array([0.5, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 30, 45])
NO_CONE_DEG = 180.0
SOFT_DEG = (10.0, 20.0, 35.0)  # half-angles of a large light, tried beside a point
DOME = 1.0
RATIOS = (1.0, 0.6, 0.35)  # of the weaker of two lights that pose as one
PAIR_DEG = (
    10.0  # that the other of two lights stays from the one that they replace, at least
)
FINE_GAIN, FOLLOWED_GAIN, ROUGH_GAIN = (
    1e-6,
    1e-4,
    1e-3,
)  # of chi squared: a pass that gains less is the last
LEAST_LIGHT = (
    0.015  # share of the light seen below which a directional light counts as none
)
_SAME_DEG = 1.0  # minima nearer to each other than that are one
_APART_DEG = 20.0  # starts nearer to each other than that lead to one minimum


@dataclass(frozen=True, eq=False)
class Samples:
    """k means of observations with nearly one normal, in the order of their groups.

    normals : (k, 3) mean of unit vectors;  value : (k, 3) irradiance over `scale` (3,), the
    channels' bright levels
    weight : (k,) inverse variance;  starts : (g + 1,) rows of the groups;  effective :
    number of independent values
    gamma : exponent that has been taken out of the values
    lit : (k,) share of the lamps that is on, 0..1"""

    normals: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    starts: np.ndarray
    scale: np.ndarray
    effective: float
    gamma: float
    lit: np.ndarray

    @cached_property
    def data(self) -> light_model.Observations:
        normals, value = (np.ascontiguousarray(a.T) for a in (self.normals, self.value))
        return light_model.Observations(normals, value, self.weight, self.starts, self.lit)

    @property
    def groups(self) -> int:
        return len(self.starts) - 1

    def condition(self, lamp: np.ndarray | None = None) -> float:
        """Of [1, n], columns of length 1: how well ambient light is told from a direction.
        lamp : n = 0 where it is not seen
        """
        n = (
            self.normals
            if lamp is None
            else self.normals * (self.normals @ lamp > 0)[:, None]
        )
        rows = np.sqrt(self.weight)[:, None] * np.column_stack([np.ones(len(n)), n])
        return condition(divide(rows, np.linalg.norm(rows, axis=0)))

    def without_gamma(self, gamma: float) -> Samples:
        """The same where the values are a power `gamma` of the irradiance (a wrong transfer
        function makes them that).
        """
        if gamma == 1:
            return self
        size = np.maximum(np.abs(self.value), 1e-3)
        slope = (size ** (1 / gamma - 1) / gamma).mean(1)
        value = np.sign(self.value) * np.abs(self.value) ** (1 / gamma)
        return replace(self, value=value, weight=self.weight / slope**2, gamma=gamma)

    def downweighted(self, residual: np.ndarray) -> Samples:
        """Less weight (Huber) on samples whose residual (k, 3), in deviations, is beyond
        what the others have.
        """
        z = np.sqrt((residual**2).mean(1))
        width = 2.5 * max(1.0, float(np.median(z)) / 0.8)
        return replace(
            self, weight=self.weight * np.minimum(1, divide(width, z, where_zero=1.0))
        )


def gather(
    normals: np.ndarray,
    irradiance: np.ndarray,
    variance: np.ndarray | None,
    group: np.ndarray | None,
    model_error: float,
    lit: np.ndarray | None = None,
) -> Samples | None:
    """None where nothing is usable. normals (k, 3), irradiance (k, 3), variance (k, 3) or
    what broadcasts, group (k,) int.

    model_error : systematic error of the irradiance relative to its bright level. It is one
    and the same within a coarse
    cell of normals, so that more observations there add nothing beyond it.
    lit : (g,) share of the lamps that is on in each group; then all groups are one, with
    the same light
    """
    n, E = (
        np.asarray(normals, float).reshape(-1, 3),
        np.asarray(irradiance, float).reshape(-1, 3),
    )
    v = (
        np.zeros(E.shape)
        if variance is None
        else np.broadcast_to(np.asarray(variance, float), E.shape)
    )
    g = np.zeros(len(n), int) if group is None else np.asarray(group).ravel().astype(int)
    fine = np.isfinite(n).all(1) & np.isfinite(E).all(1) & np.isfinite(v).all(1)
    with np.errstate(invalid="ignore"):
        length = np.linalg.norm(np.where(fine[:, None], n, 0), axis=1)
        fine &= (length > 0.5) & (v >= 0).all(1) & (v < _UNUSABLE).all(1)
    if not fine.any():
        return None
    n, E, v, g = n[fine] / length[fine, None], E[fine], v[fine], g[fine]
    scale = np.percentile(E, 90, axis=0)
    scale = np.maximum(scale, max(1e-3 * float(scale.max()), 1e-12))
    E, v = E / scale, (v / scale**2).mean(1)
    number = np.unique(g, return_inverse=True)[1]
    cells = len(icosphere(FINE).vertices)
    key, where = np.unique(number * cells + icosphere(FINE).nearest(n), return_inverse=True)
    rows = np.split(np.argsort(where, kind="stable"), np.cumsum(np.bincount(where))[:-1])
    N, X, V = (
        np.array(a) for a in zip(*(_mean(n[r], E[r], v[r]) for r in rows), strict=True)
    )
    groups = key // cells
    coarse = np.unique(
        np.stack([groups, icosphere(COARSE).nearest(N)]), axis=1, return_inverse=True
    )[1].ravel()
    many, floor = np.bincount(coarse)[coarse], model_error**2
    variance_of_mean = V + many * floor + _LEAST**2
    effective = (
        3 * float(((V + floor) / (V + many * floor + 1e-300)).sum())
        if model_error > 0
        else 3.0 * len(N)
    )
    starts, on = np.searchsorted(groups, np.arange(groups.max() + 2)), np.ones(len(N))
    if lit is not None:
        starts, on = np.array([0, len(N)]), np.asarray(lit, float)[np.unique(g)[groups]]
    return Samples(N, X, 1 / variance_of_mean, starts, scale, effective, 1.0, on)


def _mean(
    n: np.ndarray, E: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
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


@dataclass(frozen=True, eq=False)
class Model:
    """dirs : (q, 3) unit, towards the lights;  chi2;  at : the samples fitted
    soft : (q,) sine of their discs' half-angle; DOME = ambient light that is brighter from one side
    """

    dirs: np.ndarray
    chi2: float
    at: Samples
    soft: np.ndarray

    def amplitudes(self) -> tuple[np.ndarray, np.ndarray]:
        """(ambient and lights (g, 3, q + 1) in units of the samples' scale, residuals (k,
        3) in deviations)
        """
        return self._evaluated[0], self._evaluated[1].T

    @cached_property
    def fractions(self) -> np.ndarray:
        """(q,) of each light in all the light that was seen."""
        amp, _, contribution = self._evaluated
        part = amp.sum(1) * contribution
        return np.asarray(part.sum(0)[1:] / max(float(part.sum()), 1e-300))

    @cached_property
    def _evaluated(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        q, s = len(self.dirs), self.at
        amp, residual = np.empty((s.groups, 3, q + 1)), np.empty((3, len(s.normals)))
        A, B = np.empty((2, q + 1, len(s.normals)))
        light_model.evaluate(s.data, self.dirs, _each(self.soft), A, B, amp, residual)
        return amp, residual, np.add.reduceat(B, s.starts[:-1], axis=1).T


def _each(soft: np.ndarray) -> light_model.Columns:
    """Of lights of one direction each."""
    return light_model.Columns(np.arange(len(soft)), np.ones(len(soft)), soft, len(soft))


def refine(
    s: Samples,
    dirs: np.ndarray,
    soft: np.ndarray | float = 0.0,
    held: int | None = None,
    passes: int = 25,
    gain: float = FINE_GAIN,
) -> Model:
    """Nearest minimum over all directions, the one with number `held` kept.

    passes, gain : see light_model.refine
    """
    d = np.array(dirs, float).reshape(-1, 3)
    q = len(d)
    soft = np.full(q, soft, float) if np.ndim(soft) == 0 else np.array(soft, float)
    body = np.arange(q)
    if held is not None:
        body[held + 1 :] -= 1
        body[held] = -1
    chi = light_model.refine(s.data, d, _each(soft), body, passes, gain)
    return Model(d, float(chi), s, soft)


def minima(s: Samples, count: int, first: Model | None = None) -> list[Model]:
    """Local minima with `count` lights (0 to 2), best first, from a grid over the whole sphere.

    first : the best single light, for pairs that it belongs to"""
    if count == 0:
        return [refine(s, np.zeros((0, 3)))]
    if count == 1:
        many = icosphere(3).vertices[:, None]
    else:
        coarse, fine = icosphere(1).vertices, icosphere(2).vertices
        i, j = np.triu_indices(len(coarse), 1)
        many = np.stack([coarse[i], coarse[j]], 1)
        if first is not None:
            many = np.concatenate(
                [many, np.stack([np.broadcast_to(first.dirs[0], fine.shape), fine], 1)]
            )
    return _minima(s, many, np.zeros(count), 4 * count)


def search_dome(s: Samples, first: list[Model]) -> list[Model]:
    """Local minima of one light beside a dome, started from those of one light alone."""
    v = icosphere(1).vertices
    many = np.concatenate(
        [np.stack([np.broadcast_to(m.dirs[0], v.shape), v], 1) for m in first]
    )
    return _minima(s, many, np.array([0, DOME]), 6)


def _minima(s: Samples, many: np.ndarray, soft: np.ndarray, most: int) -> list[Model]:
    count = len(soft)
    chi = _scan(s, many, _each(soft))
    rough: list[Model] = []
    free, near = np.ones(len(many), bool), np.cos(np.radians(_APART_DEG))
    for i in np.argsort(chi, kind="stable"):
        if not free[i]:
            continue
        for order in ([0], [0, 1], [1, 0]):
            if len(order) == count:
                free &= (many * many[i][order]).sum(-1).min(-1) <= near
        rough.append(refine(s, many[i], soft, None, 12, ROUGH_GAIN))
        if len(rough) == most:
            break
    return _different([refine(s, m.dirs, m.soft) for m in _different(rough)])


def _different(models: list[Model]) -> list[Model]:
    """Best first, each minimum once."""
    found: list[Model] = []
    for m in sorted(models, key=lambda m: m.chi2):
        orders = (
            ([0, 1], [1, 0])
            if len(m.soft) == 2 and m.soft[0] == m.soft[1]
            else ([*range(len(m.soft))],)
        )
        near = np.cos(np.radians(_SAME_DEG))
        if not any(
            ((m.dirs[order] * f.dirs).sum(1) > near).all()
            for f in found
            for order in orders
            if len(order) == len(f.soft)
        ):
            found.append(m)
    return found


def cone_deg(model: Model, light: int, bound: float) -> float:
    """Radius of the cone outside which chi squared, minimised over all else, exceeds
    `bound`; NO_CONE_DEG if it never does.

    Profile likelihood on rings of 12 azimuths: the radius is that of the first ring that is
    wholly outside."""
    for radius in RINGS_DEG:
        for d in cone_directions(model.dirs[light], radius):
            dirs = model.dirs.copy()
            dirs[light] = d
            if refine(model.at, dirs, model.soft, light, 8).chi2 <= bound:
                break
        else:
            return float(radius)
    return NO_CONE_DEG


def domes_beside(model: Model, s: Samples, radius_deg: float, bound: float) -> list[Model]:
    """The single light of `model`, moved by radius_deg, beside a dome: what is not above
    the chi squared `bound`.
    """
    d, soft = cone_directions(model.dirs[0], radius_deg), np.append(model.soft, DOME)
    starts = np.concatenate([cone_directions(model.dirs[0], 60.0, np.pi), -d])
    many = np.stack([np.concatenate([d, d]), starts], 1)
    best = np.argsort(_scan(s, many, _each(soft)), kind="stable")[:4]
    return [m for m in (refine(s, many[i], soft, 0, 12) for i in best) if m.chi2 <= bound]


def vector_off_deg(model: Model, direction: np.ndarray) -> float:
    """Degrees between a direction and the light vector, the sum of rgb times direction, of
    all lights.
    """
    return float(
        np.degrees(
            angle_between(model.amplitudes()[0].sum((0, 1))[1:] @ model.dirs, direction)
        )
    )


def two_in_place(
    model: Model, s: Samples, light: int, radius_deg: float, bound: float
) -> tuple[float, float]:
    """(lowest chi squared with two lights of one colour in the place of one, angle between
    the two in degrees).

    The stronger is held `radius_deg` from the light that they replace; everything else is
    free, but the other stays away too. The search ends at the first that is not above
    `bound`. Normals that are all lit by both can never tell them from one."""
    q, replaced_dir = len(model.dirs), model.dirs[light]
    others = np.delete(model.dirs, light, 0)
    soft = np.concatenate([model.soft[[light, light]], np.delete(model.soft, light)])
    column = np.concatenate([[0, 0], np.arange(1, q)])
    body = np.concatenate([[-1, 0], np.arange(1, q)])
    best, apart = np.inf, 0.0
    a = cone_directions(replaced_dir, radius_deg)
    for ratio in RATIOS:
        sine = (
            np.sin(np.radians(radius_deg)) / ratio
        )  # the two balance about the light that they replace
        if sine >= 1:
            continue
        columns = light_model.Columns(
            column, np.concatenate([[1, ratio], np.ones(q - 1)]), soft, q
        )
        b = cone_directions(replaced_dir, float(np.degrees(np.arcsin(sine))), np.pi)
        many = np.concatenate(
            [a[:, None], b[:, None], np.broadcast_to(others, (len(a), q - 1, 3))], 1
        )
        for i in np.argsort(_scan(s, many, columns), kind="stable")[:2]:
            d = np.array(many[i])
            chi = float(light_model.refine(s.data, d, columns, body, 12, FINE_GAIN))
            # one that has moved to where the light was leaves it in its place, beside one
            # that no normal sees
            if chi < best and np.degrees(angle_between(d[1], replaced_dir)) > 0.9 * min(
                radius_deg, PAIR_DEG
            ):
                best, apart = chi, float(np.degrees(angle_between(d[0], d[1])))
                if best <= bound:
                    return best, apart
    return best, apart


def cone_directions(d: np.ndarray, radius_deg: float, turn: float = 0.0) -> np.ndarray:
    """(12, 3) directions at `radius_deg` from the unit vector d, at AZIMUTHS + turn."""
    across = normalise(np.cross(d, np.eye(3)[np.abs(d).argmin()]))
    basis = np.stack([across, np.cross(d, across)])
    a, azimuth = np.radians(radius_deg), AZIMUTHS + turn
    return np.cos(a) * d + np.sin(a) * (
        np.stack([np.cos(azimuth), np.sin(azimuth)], -1) @ basis
    )


def _scan(s: Samples, many: np.ndarray, columns: light_model.Columns) -> np.ndarray:
    out = np.empty(len(many))
    light_model.scan(s.data, np.array(many, order="C"), columns, out)
    return out
