"""Which lights make the irradiance that was seen: E(n) = a + sum_l Omega_l max(n.d_l, 0), with 0, 1 or 2 lights.

All hypotheses are compared by a criterion. A direction that is not known for certain is `refused`, in words; then the ambient
light is the mean of what was seen. Beside the lights' directions one exponent of the values is free, within what a wrong transfer
function leaves: a power of an irradiance bends it, and what bends it would else be taken for another light. A second light may be
a dome: ambient light that is brighter from one side, ((n.d + 1) / 2)^2.
Source: Tan, Chen, Sun 2009, eq. (1); docs/methods/light.md#lamps. Cost: 20 to 150 ms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import fdtri

from arfx.analyse.light import search
from arfx.analyse.light.search import DOME, NO_CONE_DEG, Model, Samples, gather, refine
from arfx.core.light import DirectionalLight, Light, harmonics, triple
from arfx.core.numerics import angle_between, condition, divide

LEAST_CONE_DEG = 0.5
PAIR_DEG = 10.0  # two lights nearer than this to their middle are as good as one
LEAST_EVIDENCE = 10.0  # BIC that one more light must gain
LEAST_LIGHT = 0.015  # share of the light seen below which a directional light counts as none
MODEL_ERROR, MOST_ERROR = 0.002, 0.03  # of irradiance, over its bright level: at least, and beyond which the model is wrong
_WORSE, _WORSE_BY, _MOST_MODELS = 3.0, 50.0, 5  # other minima that are kept: chi squared, times the best's and more; number
_GAMMA_STEPS = (-0.08, 0.08, -0.16, 0.16)  # of ln gamma
MEASURED, REFUSED = "measured", "refused"
DEFAULT_SIZE_DEG = 5.0  # of a light whose disc the data do not show: a lamp indoors
LEAST_SPAN_DEG = 3.0  # of the normals: less is one normal
# Shares of degree 0, 1, 2 of max(c, 0) and of ((c + 1) / 2)^2: their Legendre coefficients times 4 pi / (2 l + 1)
_COSINE, _DOME = np.pi * np.array([1, 2 / 3, 1 / 4]), np.pi * np.array([4 / 3, 2 / 3, 2 / 15])
_SIZES_DEG = np.array([0.0, 2.5, 5, 7.5, 10, 15, 20, 30])  # half-angles


@dataclass(frozen=True)
class Params:
    """most_lights : 0 to 2;  limit_deg : widest cone that counts as measured
    gamma_sigma : standard deviation of the exponent's logarithm that a wrong transfer function leaves, 0 = exact"""

    most_lights: int = 2
    limit_deg: float = 15.0
    gamma_sigma: float = 0.08


class LightHypotheses:
    """All models of 0 to 2 lights under all exponents; cost = chi squared + the exponent's prior.

    best, best_cost : by number of lights;  count : the number that the criterion chose;  plain : samples as they came"""

    def __init__(self, s: Samples, params: Params, start: LightHypotheses | None = None) -> None:
        """start : of the same observations under other weights; its minima are followed, none is searched again."""
        self.params, most = params, max(0, min(params.most_lights, 2))
        if start is not None:
            found = self._follow(s, start.plain_models, 0.0)
        else:
            found = [search.minima(s, 0)]
            if most >= 1:
                ones = search.minima(s, 1)
                large = [search.refine(s, ones[0].dirs, float(np.sin(np.radians(a)))) for a in search.SOFT_DEG]
                found.append(self._ranked([*ones, *large]))
            if most >= 2:
                found.append(self._ranked([*search.minima(s, 2, ones[0]), *search.search_dome(s, ones)]))
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
            sound = (self.best[k].fractions >= LEAST_LIGHT).all()
            if sound and bic[k] < bic[self.count] - LEAST_EVIDENCE:
                self.count = k

    def _ranked(self, models: list[Model]) -> list[Model]:
        """Best first; last those with a light that hardly any normal sees, which explains noise and no more. None far worse."""
        ranked = sorted(models, key=lambda m: (bool((m.fractions < LEAST_LIGHT).any()), m.chi2))
        limit = _WORSE * ranked[0].chi2 + _WORSE_BY
        return [m for i, m in enumerate(ranked[:_MOST_MODELS]) if i == 0 or m.chi2 <= limit]

    def _follow(self, s: Samples, found: list[list[Model]], step: float) -> list[list[Model]]:
        t = s.without_gamma(float(np.exp(step)))
        return [
            self._ranked([search.refine(t, m.dirs, m.soft, None, 15, search.FOLLOWED_GAIN) for m in models]) for models in found
        ]

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
                off = np.where(model.soft < DOME, np.degrees(angle_between(model.dirs, best)), np.inf)
                near = int(off.argmin())
                out = max(out, min(float(off[near]) + search.cone_deg(model, near, bound - prior), NO_CONE_DEG))
        return out

    def assess(self, light: int) -> tuple[float, str]:
        """(cone in degrees, what speaks against one light of the chosen model, or empty). light : its row in best.dirs."""
        if self.best[self.count].soft[light] >= DOME:
            return NO_CONE_DEG, "it is a sky"
        cone, doubt = max(self.cone(light), LEAST_CONE_DEG), self._alternative_direction(light)
        if cone > self.params.limit_deg:
            return cone, doubt or f"the direction is uncertain by {cone:.3g} degrees"
        if not doubt:
            doubt = self._alternative_pair(light, PAIR_DEG)
            if doubt and self.params.limit_deg > PAIR_DEG:  # a wider cone may hold any such pair
                cone, doubt = self.params.limit_deg, self._alternative_pair(light, self.params.limit_deg)
        return cone, doubt

    def _alternative_direction(self, light: int) -> str:
        best, bound = self.best[self.count], self.bound()
        for prior, models in self.nodes:
            for m in models[self.count]:
                points = m.dirs[m.soft < DOME]
                off = float(np.degrees(angle_between(points, best.dirs[light]).min())) if len(points) else NO_CONE_DEG
                if prior + m.chi2 <= bound and off > self.params.limit_deg:
                    return f"another direction, {off:.0f} degrees off, explains the data as well"
        return ""

    def _alternative_pair(self, light: int, least_deg: float) -> str:
        best, bound = self.best[self.count], self.bound()
        for prior, models in self.nodes if self.params.most_lights >= 2 else ():
            if self.count == 1 and prior + min(m.chi2 for m in models[2]) > bound:
                continue  # not even two free lights
            if self.count == 1 and search.dome_beside(best, models[1][0].at, least_deg) <= bound - prior:
                return f"ambient light that is brighter from one side may shift it by {least_deg:.0f} degrees or more"
            chi, apart = search.two_in_place(best, models[self.count][0].at, light, least_deg, bound - prior)
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


@dataclass(frozen=True, eq=False)
class FittedLight:
    """direction : (3,) unit, towards it, frame of the normals;  rgb : (g, 3) irradiance on a surface that faces it, per group

    confidence_deg : half-angle of its 95 % cone given the number of lights (180 = none)
    angular_size_deg : full angle of its disc, a default or what the data allow where they do not show it"""

    direction: np.ndarray
    rgb: np.ndarray
    confidence_deg: float
    angular_size_deg: float = DEFAULT_SIZE_DEG

    @property
    def dome(self) -> bool:
        """Ambient light that is brighter from one side, ((n.d + 1) / 2)^2, not a light that casts a shadow."""
        return self.angular_size_deg >= 180


@dataclass(frozen=True, eq=False)
class LightFit:
    """verdict : "measured" (lights) or "refused" (no light)

    reason : in words;  ambient_rgb : (g, 3) per group, seen_rgb where refused;  seen_rgb : (g, 3) mean of what was seen
    lights : the one that gives most of what was seen first; of two only that must be known well: one
        whose direction is not has confidence_deg 180, and is soft light in `light()`
    misfit : chi squared over its degrees of freedom, under a systematic error of model_error
    gamma : exponent found in the values
    condition : of [1, n], columns of length 1, at most 1e12;  span_deg : of the normals;  ignored : observations"""

    verdict: str
    reason: str
    ambient_rgb: np.ndarray
    seen_rgb: np.ndarray
    lights: tuple[FittedLight, ...] = ()
    misfit: float = 0.0
    model_error: float = 0.0
    gamma: float = 1.0
    condition: float = 1e12
    span_deg: float = 0.0
    ignored: int = 0

    def irradiance(self, normals: np.ndarray, group: int = 0) -> np.ndarray:
        """(..., 3) at unit normals (..., 3): ambient light and `lights`."""
        n = np.asarray(normals, float)
        out = np.broadcast_to(self.ambient_rgb[group], n.shape).copy()
        for li in self.lights:
            c = n @ li.direction
            out += ((c + 1) ** 2 / 4 if li.dome else np.clip(c, 0, None))[..., None] * li.rgb[group]
        return out

    def light(self, group: int = 0, source: str = "marker") -> Light:
        """As the light that every effect shares: known directions are lights, all else is soft (degree 2 harmonics)."""
        hard = [li for li in self.lights if li.confidence_deg < NO_CONE_DEG]
        rest = [li for li in self.lights if li.confidence_deg >= NO_CONE_DEG]
        soft, ambient = np.zeros((9, 3)), np.array(self.ambient_rgb[group])
        soft[0] = ambient * np.sqrt(4 * np.pi)
        for li in rest:
            fraction = np.repeat((_DOME if li.dome else _COSINE), (1, 3, 5))
            soft += (fraction * harmonics(li.direction))[:, None] * li.rgb[group]
            ambient = ambient + li.rgb[group] * (1 / 3 if li.dome else 1 / 4)
        return Light(
            triple(ambient),
            tuple(
                DirectionalLight(
                    triple(li.direction), triple(li.rgb[group]), li.angular_size_deg, li.confidence_deg
                )
                for li in hard
            ),
            source, tuple(triple(row) for row in soft) if rest else (),
        )  # fmt: skip


def fit(
    normals: np.ndarray, irradiance: np.ndarray, variance: np.ndarray | None = None, group: np.ndarray | None = None,
    params: Params = Params(), lit: np.ndarray | None = None,
) -> LightFit:  # fmt: skip
    """normals : (k, 3) in the frame that the lights are fixed in;  irradiance : (k, 3);  variance : (k, 3), of noise alone
    (an error that all share, as the bias has, is ambient light here);  group : (k,) int: directions are shared by all
    groups, amplitudes are each group's own. What is not finite is left out and counted. Nothing non-finite leaves.
    lit : (g,) by the number of the group, share of the lamps that is on: then amplitudes are shared by all groups too"""
    s = gather(normals, irradiance, variance, group, MODEL_ERROR, lit)
    if s is None:
        count = int(np.size(normals) // 3)
        return LightFit(REFUSED, "no usable observation", np.zeros((1, 3)), np.zeros((1, 3)), ignored=count)
    unit = s.normals / np.linalg.norm(s.normals, axis=1, keepdims=True)
    span_deg = float(np.degrees(np.arccos(np.clip((unit @ unit.T).min(), -1, 1))))
    rows = np.sqrt(s.weight)[:, None] * np.column_stack([np.ones(len(s.normals)), s.normals])
    design = divide(rows, np.linalg.norm(rows, axis=0))  # what separates ambient light from a direction
    about: dict[str, Any] = {"condition": min(condition(design), 1e12), "span_deg": span_deg, "ignored": s.ignored}
    groups = [slice(a, b) for a, b in pairwise(s.starts)]
    seen = np.array([np.average(s.value[g], axis=0, weights=s.weight[g]) for g in groups]) * s.scale  # (g, 3)
    if span_deg < LEAST_SPAN_DEG:
        return LightFit(REFUSED, f"one normal only: all lie within {span_deg:.2g} degrees", seen, seen, **about)
    if len(s.normals) < 4:
        return LightFit(REFUSED, f"{len(s.normals)} normals only: a direction beside ambient light takes 4", seen, seen, **about)
    error, found = MODEL_ERROR, LightHypotheses(s, params)
    for _ in range(4):  # what no lights explain is an error of the model, and not one that averages out
        misfit = min(found.misfit(k) for k in range(len(found.best)))
        if misfit <= 1.5:
            break
        error = max(error, 1e-4) * float(np.sqrt(misfit))
        if error > MOST_ERROR:
            break
        s = gather(normals, irradiance, variance, group, error, lit) or s
        found = LightHypotheses(s, params, found)
    about["model_error"] = error
    if error > MOST_ERROR:
        why = f"no lights explain what was seen to better than {error:.1%}: exposure or light changed, or the surface is glossy"
        return LightFit(REFUSED, why, seen, seen, misfit=misfit, **about)
    model, count = found.best[found.count], found.count
    s = model.at
    about |= {"misfit": found.misfit(count), "gamma": s.gamma}
    if count == 0:
        why = "the light is even: no direction stands out, or it comes from behind all normals"
        return LightFit(REFUSED, why, seen, seen, **about)
    # directions are the exponent's, amplitudes those of the values as they came: what is shown beside them has to match
    amp = replace(model, at=found.plain).amplitudes()[0] * s.scale[:, None]  # (g, 3, q + 1)
    domes = model.soft >= DOME
    order = np.lexsort([-model.fractions, domes])
    lights = tuple(
        FittedLight(model.dirs[i], amp[:, :, 1 + i], NO_CONE_DEG, 180.0 if domes[i] else DEFAULT_SIZE_DEG) for i in order
    )
    cone, doubt = found.assess(int(order[0]))
    lights = (replace(lights[0], confidence_deg=cone), *lights[1:])
    if doubt:
        return LightFit(REFUSED, doubt, seen, seen, **about)
    reason = f"{count} light{'s' * (count > 1)}, within {cone:.2g} degrees"
    if count == 2:
        other, doubt = found.assess(int(order[1]))
        lights = (lights[0], replace(lights[1], confidence_deg=NO_CONE_DEG if doubt else other))
        reason += f"; the second's direction is not known: {doubt}" if doubt else f" and {other:.2g} degrees"
    reason += f"; normals over {span_deg:.0f} degrees"
    tried = [np.where(domes, model.soft, np.sin(np.radians(a))) for a in _SIZES_DEG]
    chi2 = np.array([refine(model.at, model.dirs, soft, passes=6).chi2 for soft in tried])
    bound = found.bound() - found.best_cost[count] + model.chi2  # chi squared that is no worse than the best
    inside, best = np.flatnonzero(chi2 <= max(bound, chi2.min())), 2 * float(_SIZES_DEG[chi2.argmin()])
    most = 2 * float(_SIZES_DEG[min(inside[-1] + 1, len(chi2) - 1)])
    size = min(DEFAULT_SIZE_DEG, most) if inside[0] == 0 else best
    lights = tuple(li if li.dome else replace(li, angular_size_deg=size) for li in lights)
    return LightFit(MEASURED, reason, amp[:, :, 0], seen, lights, **about)
