"""All explanations of what was seen by 0, 1 or 2 lights: the one that a criterion chooses, and
what explains the data as well.

Explanations are enumerated: directions on a grid, then the nearest minimum of the best; around
each light of the chosen explanation rings of directions, for the light alone, for two lamps of
one colour in its place, and for a lamp beside ambient light that is brighter from one side, all
else refined. What is not worse than the chosen one by the 95 % bound explains the data as well,
and the cone is as wide as its nearest lamps are off. Source: docs/methods/light.md#lamps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from arfx.analyse.light.model import DOME, Group, Lights, each, left_over, refine, solve
from arfx.analyse.light.search import Samples
from arfx.analyse.light.sphere import DEG_8, DEG_16, DEG_32, even_directions
from arfx.core.numerics import angle_between, normalise

MEASURED, LIKELY, REFUSED = "measured", "likely", "refused"
LEAST_CONE_DEG = 1.0  # what lamps that are near, sizes and gloss may shift it by
LEAST_EVIDENCE = 10.0  # BIC that one more light must gain
MOST_OFF_DEG = (
    60.0  # cone of a likely light: half of it still comes from where it is thought to be
)
NO_CONE_DEG = 180.0
LEAST_LIGHT = 0.015  # share of the light seen below which a light counts as none
LEAST_SHADOW = 0.1  # share of the light from which a lamp casts a shadow worth the name
# of readings and normals, slow over a clip: times the condition it turns the direction, radians
SYSTEMATIC_ERROR = 0.0005
SKY_DEG = 30.0  # what ambient light alone that is brighter from one side widens a cone to
_SOFT = np.sin(np.radians([0.0, 10.0, 20.0, 35.0]))  # of one light's disc
_RATIOS = (1.0, 0.6, 0.35)  # of the weaker of two lamps that pose as one
_RINGS_DEG = np.array([0.5, 1, 1.5, 2.5, 3.5, 5, 7.5, 10, 15, 20, 30, 40, 50, 60, 75])
_AZIMUTHS = np.arange(8) * np.pi / 4
_APART = np.cos(np.radians(20.0))  # starts nearer to each other lead to one minimum
_STARTS = 12
_HELD_PASSES = 12


@dataclass(frozen=True)
class Params:
    """most_lights : 0 to 2;  limit_deg : widest cone that counts as measured;  likely :
    whether more is claimed, as likely
    gamma_sigma : standard deviation of the exponent's logarithm that a wrong transfer
    function leaves, 0 = exact
    """

    most_lights: int = 2
    limit_deg: float = 15.0
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

    groups : the samples;  minima, costs : by count, all that the search ended in;  best :
    their best, one set of lights;  best_cost : its chi squared;  count : the chosen
    """

    def __init__(
        self, s: Samples, params: Params, start: Explanations | None = None
    ) -> None:
        """start : of the same observations under other weights; its minima are followed"""
        self.params = params
        most = max(0, min(params.most_lights, 2))
        self._refined(s, start.minima if start else _starts(self._groups(s), most))
        for _ in range(2):
            amplitudes = solve(self.groups, self.best[most]).amplitudes
            calmer = s.downweighted(left_over(self.groups, self.best[most], amplitudes)[0])
            if (calmer.weight >= 0.5 * s.weight).all():
                break
            s = calmer
            self._refined(s, self.minima)
        self.samples = s
        wide = max(1.0, self.misfit(most))
        bic = [
            c / wide + self._parameters(k) * np.log(max(s.effective, 2.0))
            for k, c in enumerate(self.best_cost)
        ]
        self.count = 0
        for k in range(1, most + 1):
            sound = (self.shares(self.best[k])[0][0] >= LEAST_LIGHT).all()
            if sound and bic[k] < bic[self.count] - LEAST_EVIDENCE:
                self.count = k

    def _groups(self, s: Samples) -> list[Group]:
        return s.groups(self.params.gamma_sigma)

    def _refined(self, s: Samples, starts: list[Lights]) -> None:
        self.samples, self.groups = s, self._groups(s)
        found = [refine(self.groups, lights) for lights in starts]
        self.minima, self.costs = [f[0] for f in found], [f[1] for f in found]
        self.best, self.best_cost = [], []
        for lights, chi2 in found:
            # one that hardly any normal sees explains noise and no more
            unseen = (self.shares(lights)[0] < LEAST_LIGHT).any(1)
            k = int(np.lexsort([chi2, unseen])[0])
            self.best.append(lights[k : k + 1])
            self.best_cost.append(float(chi2[k]))

    def shares(self, lights: Lights) -> tuple[np.ndarray, np.ndarray]:
        """(n, q) share of each direction's light in all that was seen; irradiance of each
        direction."""
        amplitudes = solve(self.groups, lights).amplitudes
        total, seen = np.zeros(len(lights)), np.zeros(lights.mix.shape[:2])
        for number, group in enumerate(self.groups):
            size, weight = amplitudes[:, number].sum(1), group.root**2  # (n, m + 1), (k,)
            column = lights.mix @ lights.columns(group.normals)[0]
            seen += size[:, 1:] * (column @ weight)
            total += size[:, 0] * weight.sum()
        share = seen / np.maximum(total + seen.sum(1), 1e-300)[:, None]
        of_direction = (share[:, None] @ (lights.mix > 0))[:, 0]
        strength = (amplitudes.sum((1, 2))[:, None, 1:] @ lights.mix)[:, 0]
        return of_direction, strength

    def _parameters(self, count: int) -> int:
        return 3 * len(self.groups) * (1 + count) + 2 * count

    def misfit(self, count: int) -> float:
        left = max(self.samples.effective - self._parameters(count), 1.0)
        return self.best_cost[count] / left

    def bound(self) -> float:
        """Chi squared up to which another explanation is no worse, at 95 % for two parameters."""
        from scipy.special import fdtri

        dof = max(self.samples.effective - self._parameters(self.count), 1.0)
        wider = max(1.0, self.misfit(self.count))
        return float(self.best_cost[self.count] + 2 * fdtri(2, dof, 0.95) * wider)

    def assess(self, light: int) -> Assessment:
        """Of one light of the chosen explanation. light : its row in best.dirs"""
        best = self.best[self.count]
        if best.soft[0, light] >= DOME:
            return Assessment(REFUSED, NO_CONE_DEG, "it is a sky")
        direction = best.dirs[0, light]
        slack = float(np.degrees(SYSTEMATIC_ERROR * self.samples.condition(direction)))
        bound, vector_deg, doubts = self.bound(), 0.0, []
        least = min(LEAST_SHADOW, self.shares(best)[0][0, light] / 2)
        middle = self.samples.normals.mean(0)
        for words, lights, chi2 in self._others(light):
            inside = lights[chi2 <= bound]
            shares, strength = self.shares(inside)
            off = np.degrees(angle_between(inside.dirs, direction))
            lamp = (inside.soft < DOME) & (shares >= least)
            nearest = np.where(lamp, off, np.inf).min(1, initial=np.inf)
            # what casts no shadow is nowhere, but its middle is where the lamp is thought to be
            farthest = np.where(np.isfinite(nearest), nearest, SKY_DEG).max(initial=0.0)
            wider = _RINGS_DEG[farthest + 1e-6 < _RINGS_DEG]
            ring = float(wider[0]) if len(wider) else NO_CONE_DEG
            apart = np.degrees(angle_between(inside.dirs[:, 0], inside.dirs[:, -1]))
            doubts.append((ring, words.format(_up_to(apart.max(initial=0.0), ring))))
            # what lies behind all that was seen says nothing of its vector
            front = (inside.dirs @ middle > 0).all(1)
            vector = (strength[:, None] @ inside.dirs)[:, 0]
            turned = np.degrees(angle_between(vector[front], direction))
            vector_deg = max(vector_deg, float(turned.max(initial=0.0)))
        ring, doubt = max(doubts, key=lambda d: d[0])
        cone = min(max(ring, LEAST_CONE_DEG) + slack, NO_CONE_DEG)
        if cone <= self.params.limit_deg:
            return Assessment(MEASURED, cone, "")
        likely = self.params.likely and vector_deg + slack <= MOST_OFF_DEG
        cone = max(min(cone, MOST_OFF_DEG), vector_deg + slack)
        return Assessment(LIKELY if likely else REFUSED, cone, doubt)

    def _others(self, light: int) -> list[tuple[str, Lights, np.ndarray]]:
        """(words, sets of lights, their chi squared) that may explain the data as well."""
        best = self.best[self.count]
        first, rest = best.dirs[0, light], np.delete(np.arange(self.count), light)
        ring = around(first, _RINGS_DEG)  # (n, 3)
        n = len(ring)

        def with_rest(dirs: np.ndarray, soft: np.ndarray, mix: np.ndarray) -> Lights:
            """dirs : (n, p, 3), mix : (n, p) of what stands in place of the light"""
            count, p = dirs.shape[:2]
            others = np.broadcast_to(best.dirs[:, rest], (count, len(rest), 3))
            full = np.zeros((count, 1 + len(rest), p + len(rest)))
            full[:, 0, :p] = mix
            full[:, 1:, p:] = np.eye(len(rest))
            return Lights(
                np.concatenate([dirs, others], 1),
                np.concatenate(
                    [soft, np.broadcast_to(best.soft[:, rest], (count, len(rest)))], 1
                ),
                full,
            )

        size = best.soft[0, light]
        out = [
            (
                "another direction explains the data as well",
                self.minima[self.count],
                self.costs[self.count],
            ),
        ]
        alone = with_rest(ring[:, None], np.full((n, 1), size), np.ones((n, 1)))
        out.append(
            ("the direction is uncertain", *refine(self.groups, alone, 0, _HELD_PASSES))
        )
        if self.params.most_lights < 2:
            return out
        pairs = []
        for ratio in _RATIOS:
            sine = np.sin(np.radians(np.repeat(_RINGS_DEG, len(_AZIMUTHS)))) / ratio
            fine = sine < 1
            a, s = ring[fine], sine[fine, None]
            across = normalise(a - (a @ first)[:, None] * first)
            b = np.sqrt(1 - s**2) * first - s * across
            pairs.append(
                with_rest(
                    np.stack([a, b], 1),
                    np.full((len(a), 2), size),
                    np.tile([1.0, ratio], (len(a), 1)),
                )
            )
        words = "two lamps {} apart would look the same to this print"
        out.append((words, *refine(self.groups, joined(pairs), 0, _HELD_PASSES)))
        if self.count == 1:
            across = normalise(ring - (ring @ first)[:, None] * first)
            sky = [
                np.cos(np.pi / 3) * first - np.sin(np.pi / 3) * across,
                -ring,
            ]
            domes = joined(
                [each(np.stack([ring, d], 1), np.array([size, DOME])) for d in sky]
            )
            words = "ambient light that is brighter from one side may shift it"
            out.append((words, *refine(self.groups, domes, 0, _HELD_PASSES)))
            out.append((words, self.minima[2], self.costs[2]))
        return out


def joined(sets: list[Lights]) -> Lights:
    return Lights(
        *(np.concatenate([getattr(s, k) for s in sets]) for k in ("dirs", "soft", "mix"))
    )


def _starts(groups: list[Group], most: int) -> list[Lights]:
    """By count, from a grid over the whole sphere."""
    out = [each(np.zeros((1, 0, 3)))]
    if most >= 1:
        ones = _apart(groups, each(even_directions(DEG_8)[:, None]), 4)
        ones, chi2 = refine(groups, ones)
        first = ones[np.argsort(chi2)[:1]]
        large = Lights(np.repeat(first.dirs, 3, 0), _SOFT[1:, None], np.ones((3, 1, 1)))
        out.append(joined([ones, large]))
    if most >= 2:
        coarse, fine = even_directions(DEG_32), even_directions(DEG_16)
        i, j = np.triu_indices(len(coarse), 1)
        second = [np.stack([coarse[i], coarse[j]], 1)]
        d = first.dirs[0, 0]
        second.append(np.stack([np.broadcast_to(d, fine.shape), fine], 1))
        sky = np.stack([np.broadcast_to(d, coarse.shape), coarse], 1)
        out.append(
            joined(
                [
                    _apart(groups, each(np.concatenate(second)), _STARTS),
                    _apart(groups, each(sky, np.array([0, DOME])), 4),
                ]
            )
        )
    return out


def _apart(groups: list[Group], lights: Lights, most: int) -> Lights:
    """The best, none near another."""
    chi2, chosen = solve(groups, lights).chi2, []
    while len(chosen) < most and np.isfinite(chi2).any():
        k = int(chi2.argmin())
        chosen.append(k)
        for same in (lights.dirs[k], lights.dirs[k, ::-1]):
            near = (lights.dirs * same).sum(-1).min(-1) > _APART
            chi2 = np.where(near, np.inf, chi2)
        chi2[k] = np.inf
    return lights[np.array(chosen)]


def around(d: np.ndarray, radii_deg: np.ndarray) -> np.ndarray:
    """(radii x 8, 3) directions about the unit vector d."""
    across = normalise(np.cross(d, np.eye(3)[np.abs(d).argmin()]))
    a = np.radians(radii_deg)[:, None, None]
    side = np.cos(_AZIMUTHS)[:, None] * across + np.sin(_AZIMUTHS)[:, None] * np.cross(
        d, across
    )
    return (np.cos(a) * d + np.sin(a) * side).reshape(-1, 3)


def _up_to(degrees: float, ring_deg: float) -> str:
    more = ring_deg >= NO_CONE_DEG
    return f"{degrees:.0f} degrees or more" if more else f"up to {degrees:.0f} degrees"
