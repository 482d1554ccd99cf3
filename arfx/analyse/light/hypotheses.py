"""All explanations of what was seen by 0, 1 or 2 lights: the one that a criterion chooses, and
what explains the data as well.

Explanations are enumerated: directions on a grid, then the nearest minimum of the best; around
each light of the chosen explanation rings of directions, for the light alone, for two lamps of
one colour in its place, and for a lamp beside ambient light that is brighter from one side, all
else refined. What is not worse than the chosen one by the 95 % bound explains the data as well,
and the cone is as wide as its nearest lamps are off. Source: docs/methods/light.md#lamps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.light.model import (
    DOME,
    Group,
    Lights,
    each,
    joined,
    refine,
    solve,
    turns_of,
)
from arfx.analyse.light.search import Samples
from arfx.analyse.light.sphere import DEG_32
from arfx.core.numerics import angle_between, divide
from arfx.core.sampling import sphere

MEASURED, LIKELY, REFUSED = "measured", "likely", "refused"
LIMIT_DEG = 15.0  # widest cone that counts as measured
LEAST_CONE_DEG = 1.0  # what lamps that are near, sizes and gloss may shift it by
LEAST_EVIDENCE = 10.0  # BIC that one more light must gain
MOST_OFF_DEG = 60.0  # cone of a likely light: half of it still comes from where it is thought to be
NO_CONE_DEG = 180.0
LEAST_LIGHT = 0.015  # share of the light seen below which a light counts as none
LEAST_SHADOW = (
    0.1  # share of the light from which a lamp casts a shadow worth the name
)
# of readings and normals, slow over a clip: times the condition it turns the direction, radians
SYSTEMATIC_ERROR = 0.0005
MOST_GROUPS = 30  # of which directions are found; each has amplitudes of its own
SKY_DEG = (
    30.0  # what ambient light alone that is brighter from one side widens a cone to
)
_SOFT = np.sin(np.radians([[10.0], [20.0], [35.0]]))  # of one light's disc
_RATIOS = (1.0, 0.6, 0.35)  # of the weaker of two lamps that pose as one
_RINGS_DEG = np.array(
    [
        0.5,
        1,
        1.5,
        2.5,
        3.5,
        5,
        7.5,
        10,
        15,
        20,
        30,
        40,
        50,
        60,
        75,
        NO_CONE_DEG,
        np.inf,
    ]
)
_AZIMUTHS = np.arange(8)[:, None] * np.pi / 4
_TRIED, _KEPT = 40, 8  # of the pairs on the grid; of the minima
_HELD_PASSES, _ROUGH_PASSES = 12, 8


@dataclass(frozen=True)
class Params:
    """most_lights : 0 to 2;  likely : whether more than what is measured is claimed
    gamma_sigma : standard deviation of the exponent's logarithm that a wrong transfer
    function leaves, 0 = exact
    """

    most_lights: int = 2
    likely: bool = True
    gamma_sigma: float = 0.08


class Assessment(NamedTuple):
    """cone_deg : half-angle that holds a lamp of everything that explains the data as well
    doubt : the widest of it in words, "" if measured
    """

    verdict: str
    cone_deg: float
    doubt: str


class Explanations:
    """Of the samples, by number of lights.

    groups : the samples, of some groups where there are many;  effective : independent
    values in these;  minima : by count, what the search ended in, and its chi squared
    best : the best of them, one set of lights;  best_cost : its chi squared;  count : the chosen
    """

    def __init__(
        self, s: Samples, params: Params, start: Explanations | None = None
    ) -> None:
        """start : of the same observations under other weights; its minima are followed"""
        self.params = params
        most = params.most_lights
        every = s.groups(params.gamma_sigma)
        some = np.linspace(0, len(every) - 1, min(len(every), MOST_GROUPS)).round()
        self.samples, self.groups = s, [every[int(i)] for i in some]
        kept = sum(len(group.root) for group in self.groups)
        self.effective = s.effective * kept / len(s.weight)
        if start is None:
            starts = _starts(self.groups, most)
        else:
            starts = [lights for lights, _ in start.minima]
        self.minima: list[tuple[Lights, ndarray]] = [
            refine(self.groups, lights) for lights in starts
        ]
        self.best: list[Lights] = []
        self.best_cost: list[float] = []
        for lights, chi2 in self.minima:
            # one that hardly any normal sees explains noise and no more
            unseen = (self.shares(lights)[0] < LEAST_LIGHT).any(1)
            k = int(np.lexsort([chi2, unseen])[0])
            self.best.append(lights[k : k + 1])
            self.best_cost.append(float(chi2[k]))
        wide = max(1.0, self.misfit(most))
        bic = [
            c / wide + self._parameters(k) * np.log(max(self.effective, 2.0))
            for k, c in enumerate(self.best_cost)
        ]
        self.count = 0
        for k in range(1, most + 1):
            sound = (self.shares(self.best[k])[0][0] >= LEAST_LIGHT).all()
            if sound and bic[k] < bic[self.count] - LEAST_EVIDENCE:
                self.count = k

    def shares(self, lights: Lights) -> tuple[ndarray, ndarray]:
        """(n, q) share of each direction's light in all that was seen; irradiance of each
        direction."""
        size = solve(self.groups, lights).amplitudes.sum(2)  # (n, g, m + 1)
        seen = np.zeros((len(lights), size.shape[2]))
        for number, group in enumerate(self.groups):
            column = lights.mix @ lights.columns(group)[0]
            every = np.insert(column, 0, 1, 1) @ group.root**2
            seen += size[:, number] * every
        share = divide(seen, seen.sum(1, keepdims=True))[:, None, 1:]
        strength = size.sum(1)[:, None, 1:] @ lights.mix
        return (share @ (lights.mix > 0))[:, 0], strength[:, 0]

    def _parameters(self, count: int) -> int:
        return 3 * len(self.groups) * (1 + count) + 2 * count

    def _freedom(self, count: int) -> float:
        return max(self.effective - self._parameters(count), 1.0)

    def misfit(self, count: int) -> float:
        return self.best_cost[count] / self._freedom(count)

    def bound(self) -> float:
        """Chi squared up to which another explanation is no worse, at 95 % for two parameters."""
        from scipy.special import fdtri

        wider = max(1.0, self.misfit(self.count))
        quantile = fdtri(2, self._freedom(self.count), 0.95)
        return float(self.best_cost[self.count] + 2 * quantile * wider)

    def assess(self, light: int) -> Assessment:
        """Of one light of the chosen explanation. light : its row in best.dirs

        What looks the same has nearly the same light vector (Gershun 1939: sum of the lights'
        rgb times directions): the shadow of the simplest explanation falls the right way under
        all of it."""
        best = self.best[self.count]
        if best.soft[0, light] >= DOME:
            return Assessment(REFUSED, NO_CONE_DEG, "it is a sky")
        direction = best.dirs[0, light]
        slack = float(
            np.degrees(SYSTEMATIC_ERROR * self.samples.condition(direction))
        )
        bound, vector_deg, doubts = self.bound(), 0.0, []
        least = min(LEAST_SHADOW, self.shares(best)[0][0, light] / 2)
        middle = self.samples.normals.mean(0)
        for words, lights, chi2 in self._others(light):
            inside = lights[chi2 <= bound]
            shares, strength = self.shares(inside)
            off = np.degrees(angle_between(inside.dirs, direction))
            lamp = (inside.soft < DOME) & (shares >= least)
            nearest = np.where(lamp, off, np.inf).min(1)
            # what casts no shadow is nowhere, but its middle is where the lamp is thought to be
            farthest = np.where(np.isfinite(nearest), nearest, SKY_DEG).max(
                initial=0.0
            )
            ring = float(_RINGS_DEG[np.searchsorted(_RINGS_DEG, farthest + 1e-6)])
            apart = np.degrees(angle_between(inside.dirs[:, 0], inside.dirs[:, -1]))
            limits = _up_to(ring, ring), _up_to(apart.max(initial=0.0), ring)
            doubts.append((ring, words.format(*limits)))
            # what lies behind all that was seen says nothing of its vector
            front = (inside.dirs @ middle > 0).all(1)
            vector = (strength[:, None] @ inside.dirs)[front, 0]
            turned = np.degrees(angle_between(vector, direction))
            vector_deg = max(vector_deg, float(turned.max(initial=0.0)))
        ring, doubt = max(doubts, key=lambda d: d[0])
        cone = min(max(ring, LEAST_CONE_DEG) + slack, NO_CONE_DEG)
        if cone <= LIMIT_DEG:
            return Assessment(MEASURED, cone, "")
        likely = self.params.likely and vector_deg + slack <= MOST_OFF_DEG
        cone = max(min(cone, MOST_OFF_DEG), vector_deg + slack)
        return Assessment(LIKELY if likely else REFUSED, cone, doubt)

    def _others(self, light: int) -> Iterator[tuple[str, Lights, ndarray]]:
        """(words, sets of lights, their chi squared) that may explain the data as well."""
        best = self.best[self.count]
        first, size = best.dirs[0, light], best.soft[0, light]
        words = "another direction, {} off, explains the data as well"
        yield words, *self.minima[self.count]
        ring, across, sine = _around(first)
        words = "the direction is uncertain by {}"
        yield words, *self._in_place(light, ring[:, None], [size], np.ones((1, 1)))
        if self.params.most_lights < 2:
            return
        words = "two lamps {1} apart would look the same to this print"
        for ratio in _RATIOS:  # the two balance about the light that they replace
            far = np.minimum(sine / ratio, 1)
            second = np.sqrt(1 - far**2) * first - far * across
            pair = np.stack([ring, second], 1), [size, size], np.array([[1, ratio]])
            yield words, *self._in_place(light, *pair)
        if self.count == 1:
            words = "ambient light that is brighter from one side may shift it by {}"
            yield words, *self.minima[2]
            for second in (-ring, 0.5 * first - np.sqrt(0.75) * across):
                sky = np.stack([ring, second], 1), [size, DOME], np.eye(2)
                yield words, *self._in_place(light, *sky)

    def _in_place(
        self, light: int, dirs: ndarray, soft: Sequence[float], mix: ndarray
    ) -> tuple[Lights, ndarray]:
        """dirs (n, p, 3), soft (p,), mix (m, p), of what stands in place of one light, the
        first held, all else refined; chi squared (n,)."""
        n, (m, p) = len(dirs), mix.shape
        best = self.best[self.count][np.zeros(n, int)]
        rest = np.delete(np.arange(self.count), light)
        full = np.eye(m + len(rest), p + len(rest), p - m)
        full[:m, :p] = mix
        lights = Lights(
            np.concatenate([dirs, best.dirs[:, rest]], 1),
            np.concatenate([np.tile(soft, (n, 1)), best.soft[:, rest]], 1),
            np.tile(full, (n, 1, 1)),
        )
        return refine(self.groups, lights, 1, _HELD_PASSES)


def _starts(groups: Sequence[Group], most: int) -> list[Lights]:
    """By count, from a grid over the whole sphere."""
    out, grid = [each(np.zeros((1, 0, 3)))], sphere(DEG_32)
    if most >= 1:
        ones = _best(*refine(groups, each(grid[:, None]), 0, _ROUGH_PASSES), _KEPT)
        large = each(np.repeat(ones.dirs[:1], len(_SOFT), 0), _SOFT)
        out.append(joined([ones, large]))
    if most >= 2:
        i, j = np.triu_indices(len(grid), 1)
        pairs = each(np.stack([grid[i], grid[j]], 1))
        pairs = _best(pairs, solve(groups, pairs).chi2, _TRIED)
        lamp = np.broadcast_to(ones.dirs[0], grid.shape)
        skies = each(np.stack([lamp, grid], 1), np.array([0, DOME]))
        out.append(
            joined(
                [
                    _best(*refine(groups, k, 0, _ROUGH_PASSES), _KEPT)
                    for k in (pairs, skies)
                ]
            )
        )
    return out


def _best(lights: Lights, chi2: ndarray, count: int) -> Lights:
    return lights[np.argsort(chi2, kind="stable")[:count]]


def _around(d: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Directions on rings about the unit vector d: (n, 3); unit vectors across d towards each
    (n, 3); sine of their angle from d (n, 1)."""
    first, second = turns_of(d)
    side = np.cos(_AZIMUTHS) * first + np.sin(_AZIMUTHS) * second
    rings = np.radians(_RINGS_DEG[:-1])
    across, a = np.tile(side, (len(rings), 1)), np.repeat(rings, len(side))[:, None]
    return np.cos(a) * d + np.sin(a) * across, across, np.sin(a)


def _up_to(degrees: float, ring_deg: float) -> str:
    more = ring_deg >= NO_CONE_DEG
    return (
        f"{degrees:.0f} degrees or more" if more else f"up to {degrees:.3g} degrees"
    )
