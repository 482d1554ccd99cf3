"""All explanations of what was seen by 0, 1 or 2 lights: the one that a criterion chooses,
and what explains the data as well.

Beside the lights' directions one exponent of the values is free, within what a wrong
transfer function leaves: a power of an irradiance bends it, and what bends it would else be
taken for another light. A second light may be a dome: ambient light that is brighter from
one side, ((n.d + 1) / 2)^2. Source: docs/methods/light.md#lamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from arfx.analyse.light import search
from arfx.analyse.light.search import DOME, LEAST_LIGHT, NO_CONE_DEG, Model, Samples
from arfx.core.numerics import angle_between, divide

MEASURED, LIKELY, REFUSED = "measured", "likely", "refused"
LEAST_CONE_DEG = 1.0  # what lamps that are near, sizes and gloss may shift it by
LEAST_EVIDENCE = 10.0  # BIC that one more light must gain
MOST_OFF_DEG = (
    60.0  # cone of a likely light: half of it still comes from where it is thought to be
)
LEAST_SHADOW = 0.1  # share of the light from which a lamp casts a shadow worth the name
# of readings and normals, slow over a clip: times the condition it turns the direction,
# radians
SYSTEMATIC_ERROR = 0.0005
SKY_DEG = 30.0  # what ambient light alone that is brighter from one side widens a cone to
_WORSE, _WORSE_BY, _MOST_MODELS = (
    3.0,
    50.0,
    5,
)  # other minima that are kept: chi squared, times the best's and more; number
_GAMMA_STEPS = (-0.08, 0.08, -0.16, 0.16)  # of ln gamma
# where others in its place are tried
_RINGS_DEG = (
    1.5,
    2.5,
    3.5,
    5.0,
    7.5,
    10.0,
    15.0,
    20.0,
    30.0,
    40.0,
    50.0,
    60.0,
    75.0,
    NO_CONE_DEG,
)


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
    """cone_deg : half-angle that holds the lamps, or if merely likely the light vectors, of
    all that explains the data as well
    spread_deg : how far lamps in its place may be;  doubt : the widest of it in words, ""
    if measured
    """

    verdict: str
    cone_deg: float
    spread_deg: float
    doubt: str


class LightHypotheses:
    """All models of 0 to 2 lights under all exponents; cost = chi squared + the exponent's prior.

    best, best_cost : by number of lights;  count : the number that the criterion chose;
    plain : samples as they came
    """

    def __init__(
        self, s: Samples, params: Params, start: LightHypotheses | None = None
    ) -> None:
        """start : of the same observations under other weights; its minima are followed,
        none is searched again.
        """
        self.params, most = params, max(0, min(params.most_lights, 2))
        if start is not None:
            found = self._follow(s, start.plain_models, 0.0)
        else:
            found = [search.minima(s, 0)]
            if most >= 1:
                ones = search.minima(s, 1)
                large = [
                    search.refine(s, ones[0].dirs, float(np.sin(np.radians(a))))
                    for a in search.SOFT_DEG
                ]
                found.append(self._ranked([*ones, *large]))
            if most >= 2:
                found.append(
                    self._ranked(
                        [*search.minima(s, 2, ones[0]), *search.search_dome(s, ones)]
                    )
                )
        for _ in range(2):
            calmer = s.downweighted(found[most][0].amplitudes()[1])
            if (calmer.weight >= 0.5 * s.weight).all():
                break
            s = calmer
            found = self._follow(s, found, 0.0)
        self.plain_models: list[list[Model]] = found
        self.plain, self.groups, self.effective = s, s.groups, s.effective
        curve = {0.0: found}
        if params.gamma_sigma > 0:
            curve |= {step: self._follow(s, found, step) for step in _GAMMA_STEPS}
            for count in range(most + 1):  # where the costs of three steps have their least
                at = _lowest(
                    {k: self._prior(k) + m[count][0].chi2 for k, m in curve.items()}
                )
                if min(abs(at - k) for k in curve) > 0.01:
                    curve[at] = self._follow(s, found, at)
        self.nodes = [
            (self._prior(k), m) for k, m in curve.items()
        ]  # (prior's cost, models by count)
        self.best: list[Model] = []
        self.best_cost: list[float] = []
        for count in range(most + 1):
            costs = [prior + models[count][0].chi2 for prior, models in self.nodes]
            self.best.append(self.nodes[int(np.argmin(costs))][1][count][0])
            self.best_cost.append(min(costs))
        wide = max(
            1.0, self.best_cost[most] / max(self.effective - self._parameters(most), 1.0)
        )
        bic = [
            c / wide + self._parameters(k) * np.log(max(self.effective, 2.0))
            for k, c in enumerate(self.best_cost)
        ]
        self.count = 0
        for k in range(1, most + 1):
            sound = (self.best[k].fractions >= LEAST_LIGHT).all()
            if sound and bic[k] < bic[self.count] - LEAST_EVIDENCE:
                self.count = k

    def _ranked(self, models: list[Model]) -> list[Model]:
        """Best first; last those with a light that hardly any normal sees, which explains
        noise and no more. None far worse.
        """
        ranked = sorted(
            models, key=lambda m: (bool((m.fractions < LEAST_LIGHT).any()), m.chi2)
        )
        limit = _WORSE * ranked[0].chi2 + _WORSE_BY
        return [m for i, m in enumerate(ranked[:_MOST_MODELS]) if i == 0 or m.chi2 <= limit]

    def _follow(
        self, s: Samples, found: list[list[Model]], step: float
    ) -> list[list[Model]]:
        t = s.without_gamma(float(np.exp(step)))
        return [
            self._ranked(
                [
                    search.refine(t, m.dirs, m.soft, None, 15, search.FOLLOWED_GAIN)
                    for m in models
                ]
            )
            for models in found
        ]

    def _prior(self, step: float) -> float:
        return (step / self.params.gamma_sigma) ** 2 if step else 0.0

    def _parameters(self, count: int) -> int:
        return 3 * self.groups * (1 + count) + 2 * count

    def misfit(self, count: int) -> float:
        return float(
            self.best_cost[count] / max(self.effective - self._parameters(count), 1.0)
        )

    def bound(self) -> float:
        """Cost up to which another explanation is no worse, at 95 % for two parameters."""
        from scipy.special import fdtri

        dof = max(self.effective - self._parameters(self.count), 1.0)
        wider = max(1.0, self.misfit(self.count))
        return float(self.best_cost[self.count] + 2 * fdtri(2, dof, 0.95) * wider)

    def cone(self, light: int) -> float:
        """Of one light of the chosen model, degrees, over all exponents that are within the
        bound.
        """
        out = 0.0
        for bound, models in self._within():
            model = models[self.count][0]
            if model.chi2 <= bound:
                off = self._off_deg(model, light)
                near = int(off.argmin())
                beyond = search.cone_deg(model, near, bound)
                out = max(out, min(float(off[near]) + beyond, NO_CONE_DEG))
        return out

    def _within(self) -> Iterator[tuple[float, list[list[Model]]]]:
        """(chi squared that is no worse, models by count) of each exponent."""
        bound = self.bound()
        for prior, models in self.nodes:
            yield bound - prior, models

    def _off_deg(self, model: Model, light: int) -> np.ndarray:
        """(q,) of the model's lights from one of the chosen model's; a dome's is inf."""
        off = angle_between(model.dirs, self.best[self.count].dirs[light])
        return np.where(model.soft < DOME, np.degrees(off), np.inf)

    def assess(self, light: int) -> Assessment:
        """Of one light of the chosen model. light : its row in best.dirs

        What looks the same has nearly the same light vector (Gershun 1939: sum of the
        lights' rgb times directions): the shadow of the simplest explanation falls the
        right way under all of it, and is as sharp as the lamp is known."""
        best = self.best[self.count]
        if best.soft[light] >= DOME:
            return Assessment(REFUSED, NO_CONE_DEG, NO_CONE_DEG, "it is a sky")
        cone, off = max(self.cone(light), LEAST_CONE_DEG), self._farthest_minimum(light)
        slack = float(np.degrees(SYSTEMATIC_ERROR * best.at.condition(best.dirs[light])))
        uncertain = min(cone + slack, NO_CONE_DEG)
        doubts = [
            (uncertain, f"the direction is uncertain by {uncertain:.3g} degrees"),
            (off, f"another direction, {off:.0f} degrees off, explains the data as well"),
        ]
        vector = off
        if max(cone, off) <= MOST_OFF_DEG and self.params.most_lights >= 2:
            ring, apart = self._farthest_pair(light)
            doubts.append(
                (
                    ring,
                    (
                        f"two lamps {_up_to(apart, ring)} apart would look the same to this"
                        " print"
                    ),
                )
            )
            if self.count == 1:
                ring, words, sky_vector = self._sky()
                doubts.append((ring, words))
                vector = max(off, sky_vector)
        spread, doubt = max(doubts, key=lambda d: d[0])
        if spread <= self.params.limit_deg:
            return Assessment(MEASURED, spread, spread, "")
        if self.count == 2:  # one that is hardly a light is what the model lacks
            weak = best.fractions.min() < LEAST_SHADOW
            vector = max(
                off, spread if weak else search.vector_off_deg(best, best.dirs[light])
            )
        cone = min(float(np.hypot(cone, vector)) + slack, NO_CONE_DEG)
        return Assessment(
            LIKELY if self.params.likely and cone <= MOST_OFF_DEG else REFUSED,
            cone,
            spread,
            doubt,
        )

    def _two_lights(self) -> Iterator[tuple[Samples, float]]:
        """(samples, chi squared that is no worse) of the exponents under which two free
        lights may do in place of one.
        """
        for bound, models in self._within():
            if self.count == 2 or min(m.chi2 for m in models[2]) <= bound:
                yield models[self.count][0].at, bound

    def _farthest_pair(self, light: int) -> tuple[float, float]:
        """(ring beyond the farthest on which two lamps in its place explain the data as
        well, degrees between them)
        """
        out, apart = 0.0, 0.0
        for s, bound in self._two_lights():
            for beyond, ring in pairwise(_RINGS_DEG[::-1]):
                if beyond <= out:
                    break
                chi2, between = search.two_in_place(
                    self.best[self.count], s, light, ring, bound
                )
                if chi2 <= bound:
                    out, apart = beyond, between
                    break
        return out, apart

    def _sky(self) -> tuple[float, str, float]:
        """(degrees, words, degrees of the light vector) of ambient light that is brighter
        from one side, beside the lamp or in its place."""
        best, ring, shift, sky, vector = self.best[1], 0.0, 0.0, 0.0, 0.0
        for s, bound in self._two_lights():
            for radius, beyond in pairwise(_RINGS_DEG):
                for m in search.domes_beside(best, s, radius, bound):
                    sky = max(sky, beyond)
                    if (
                        m.dirs[1] @ s.normals.mean(0) > 0
                    ):  # what lies behind all that was seen says nothing of its vector
                        vector = max(vector, search.vector_off_deg(m, best.dirs[0]))
                    if m.fractions[0] >= LEAST_SHADOW and beyond > ring:
                        ring, shift = beyond, radius
        if (
            ring < min(sky, SKY_DEG)
        ):  # what casts no shadow is nowhere, but its middle is where the lamp is thought to be
            words = (
                "ambient light that is brighter from one side, without a lamp, would look"
                " the same"
            )
            return min(sky, SKY_DEG), words, vector
        return (
            ring,
            (
                "ambient light that is brighter from one side may shift it by"
                f" {_up_to(shift, ring)}"
            ),
            vector,
        )

    def _farthest_minimum(self, light: int) -> float:
        """Degrees from the light to the farthest minimum that is no worse."""
        return max(
            (
                min(float(self._off_deg(m, light).min()), NO_CONE_DEG)
                for bound, models in self._within()
                for m in models[self.count]
                if m.chi2 <= bound
            ),
            default=0.0,
        )


def _up_to(degrees: float, ring_deg: float) -> str:
    return (
        f"{degrees:.0f} degrees or more"
        if ring_deg >= NO_CONE_DEG
        else f"up to {degrees:.0f} degrees"
    )


def _lowest(cost: dict[float, float]) -> float:
    """Minimum of the parabola through the lowest of evenly spaced costs and its neighbours,
    kept between these.
    """
    steps, costs = np.array(sorted(cost.items())).T
    i = int(costs.argmin())
    if i in (0, len(steps) - 1):
        return float(steps[i])
    a, b, c = costs[i - 1 : i + 2]
    return float(
        steps[i] + (steps[i + 1] - steps[i]) * divide(0.5 * (a - c), a - 2 * b + c)
    )
