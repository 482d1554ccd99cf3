"""All explanations of an irradiance by 0, 1 or 2 lights, the choice between them, and what speaks against it.

Beside the lights' directions one exponent of the values is free, within what a wrong transfer function leaves: a power of
an irradiance bends it, and what bends it would else be taken for another light. A second light may be a sky: ambient light
that is brighter from one side, ((n.d + 1) / 2)^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from arfx.analyse.light.search import (
    FOLLOWED_GAIN,
    NO_CONE_DEG,
    SKY,
    SOFT_DEG,
    Model,
    Samples,
    cone_deg,
    pair_in_place,
    refine,
    search,
    search_sky,
    sky_beside,
)  # fmt: skip
from arfx.core.numerics import angle_between

LEAST_CONE_DEG = 0.5
PAIR_DEG = 10.0  # two lights nearer than this to their middle are as good as one
LEAST_EVIDENCE = 10.0  # BIC that one more light must gain
LEAST_LIGHT = 0.015  # share of the light seen below which a directional light counts as none
MODEL_ERROR, MOST_ERROR = 0.002, 0.03  # of irradiance, over its bright level: at least, and beyond which the model is wrong
_WORSE, _WORSE_BY, _MOST_MODELS = 3.0, 50.0, 5  # other minima that are kept: chi squared, times the best's and more; number
_GAMMA_STEPS = (-0.08, 0.08, -0.16, 0.16)  # of ln gamma


@dataclass(frozen=True)
class Params:
    """most_lights : 0 to 2;  limit_deg : widest cone that counts as measured
    gamma_sigma : standard deviation of the exponent's logarithm that a wrong transfer function leaves, 0 = exact"""

    most_lights: int = 2
    limit_deg: float = 15.0
    gamma_sigma: float = 0.08


class Explanations:
    """All models of 0 to 2 lights under all exponents; cost = chi squared + the exponent's prior.

    best, best_cost : by number of lights;  count : the number that the criterion chose;  plain : samples as they came
    """

    def __init__(self, s: Samples, params: Params, start: Explanations | None = None) -> None:
        """start : of the same observations under other weights; its minima are followed, none is searched again."""
        self.params, most = params, max(0, min(params.most_lights, 2))
        found = self._search(s, most) if start is None else self._follow(s, start.plain_models, 0.0)
        for _ in range(2):
            calmer = s.damped(found[most][0].amplitudes()[1])
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
                at = _lowest({k: self._prior(k) + m[count][0].chi2 for k, m in curve.items()})
                if min(abs(at - k) for k in curve) > 0.01:
                    curve[at] = self._follow(s, found, at)
        self.nodes = [(self._prior(k), m) for k, m in curve.items()]  # (prior's cost, models by count)
        self.best: list[Model] = []
        self.best_cost: list[float] = []
        for count in range(most + 1):
            costs = [prior + models[count][0].chi2 for prior, models in self.nodes]
            self.best.append(self.nodes[int(np.argmin(costs))][1][count][0])
            self.best_cost.append(min(costs))
        wide = max(1.0, self.best_cost[most] / max(self.effective - self._parameters(most), 1.0))
        bic = [c / wide + self._parameters(k) * np.log(max(self.effective, 2.0)) for k, c in enumerate(self.best_cost)]
        self.count = 0
        for k in range(1, most + 1):
            sound = (self.best[k].shares >= LEAST_LIGHT).all()
            if sound and bic[k] < bic[self.count] - LEAST_EVIDENCE:
                self.count = k

    def _search(self, s: Samples, most: int) -> list[list[Model]]:
        found = [search(s, 0)]
        if most >= 1:
            ones = search(s, 1)
            large = [refine(s, ones[0].dirs, float(np.sin(np.radians(a)))) for a in SOFT_DEG]
            found.append(self._ranked([*ones, *large]))
        if most >= 2:
            found.append(self._ranked([*search(s, 2, ones[0]), *search_sky(s, ones)]))
        return found

    def _ranked(self, models: list[Model]) -> list[Model]:
        """Best first; last those with a light that hardly any normal sees, which explains noise and no more. None far worse."""
        ranked = sorted(models, key=lambda m: (bool((m.shares < LEAST_LIGHT).any()), m.chi2))
        limit = _WORSE * ranked[0].chi2 + _WORSE_BY
        return [m for i, m in enumerate(ranked[:_MOST_MODELS]) if i == 0 or m.chi2 <= limit]

    def _follow(self, s: Samples, found: list[list[Model]], step: float) -> list[list[Model]]:
        t = s.without_gamma(float(np.exp(step)))
        return [self._ranked([refine(t, m.dirs, m.soft, None, 15, FOLLOWED_GAIN) for m in models]) for models in found]

    def _prior(self, step: float) -> float:
        return (step / self.params.gamma_sigma) ** 2 if step else 0.0

    def _parameters(self, count: int) -> int:
        return 3 * self.groups * (1 + count) + 2 * count

    def misfit(self, count: int) -> float:
        return float(self.best_cost[count] / max(self.effective - self._parameters(count), 1.0))

    def bound(self) -> float:
        """Cost up to which another explanation is no worse, at 95 % for two parameters."""
        dof = max(self.effective - self._parameters(self.count), 1.0)
        wider = max(1.0, self.misfit(self.count))
        return float(self.best_cost[self.count] + 2 * fdtri(2, dof, 0.95) * wider)

    def cone(self, light: int) -> float:
        """Of one light of the chosen model, degrees, over all exponents that are within the bound."""
        best, bound = self.best[self.count].dirs[light], self.bound()
        out = 0.0
        for prior, models in self.nodes:
            model = models[self.count][0]
            if prior + model.chi2 <= bound:
                off = np.where(model.soft < SKY, np.degrees(angle_between(model.dirs, best)), np.inf)
                near = int(off.argmin())
                out = max(out, min(float(off[near]) + cone_deg(model, near, bound - prior), NO_CONE_DEG))
        return out

    def judged(self, light: int) -> tuple[float, str]:
        """(cone in degrees, what speaks against one light of the chosen model, or empty). light : its row in best.dirs."""
        if self.best[self.count].soft[light] >= SKY:
            return NO_CONE_DEG, "it is a sky"
        cone, doubt = max(self.cone(light), LEAST_CONE_DEG), self._rival_direction(light)
        if cone > self.params.limit_deg:
            return cone, doubt or f"the direction is uncertain by {cone:.3g} degrees"
        if not doubt:
            doubt = self._rival_pair(light, PAIR_DEG)
            if doubt and self.params.limit_deg > PAIR_DEG:  # a wider cone may hold any such pair
                cone, doubt = self.params.limit_deg, self._rival_pair(light, self.params.limit_deg)
        return cone, doubt

    def _rival_direction(self, light: int) -> str:
        best, bound = self.best[self.count], self.bound()
        for prior, models in self.nodes:
            for m in models[self.count]:
                points = m.dirs[m.soft < SKY]
                off = float(np.degrees(angle_between(points, best.dirs[light]).min())) if len(points) else NO_CONE_DEG
                if prior + m.chi2 <= bound and off > self.params.limit_deg:
                    return f"another direction, {off:.0f} degrees off, explains the data as well"
        return ""

    def _rival_pair(self, light: int, least_deg: float) -> str:
        best, bound = self.best[self.count], self.bound()
        for prior, models in self.nodes if self.params.most_lights >= 2 else ():
            if self.count == 1 and prior + min(m.chi2 for m in models[2]) > bound:
                continue  # not even two free lights
            if self.count == 1 and sky_beside(best, models[1][0].at, least_deg) <= bound - prior:
                return f"ambient light that is brighter from one side may shift it by {least_deg:.0f} degrees or more"
            chi, apart = pair_in_place(best, models[self.count][0].at, light, least_deg, bound - prior)
            if chi <= bound - prior:
                return f"one light may be two, {apart:.0f} degrees apart: too few normals turn away from it"
        return ""


def _lowest(cost: dict[float, float]) -> float:
    """Minimum of the parabola through the lowest of evenly spaced costs and its neighbours, kept between these."""
    steps = sorted(cost)
    i = int(np.argmin([cost[k] for k in steps]))
    if i in (0, len(steps) - 1):
        return steps[i]
    a, b, c = (cost[steps[i + k]] for k in (-1, 0, 1))
    bend = a - 2 * b + c
    return steps[i] + (steps[i + 1] - steps[i]) * (0.5 * (a - c) / bend if bend > 0 else 0.0)
