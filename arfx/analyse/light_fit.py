"""Which lights make the irradiance that was seen: E(n) = a + sum_l Omega_l max(n.d_l, 0), with 0, 1 or 2 lights.

`fit` searches the whole sphere (no local minimum is missed), chooses the number of lights by the Bayesian information
criterion (not AICc: a light too many throws a shadow that is not there, so the dearer criterion is right), and calls the
result `measured` only if
* the direction's 95 % cone (profile likelihood, widened by the fit's own misfit) is narrow, over all exponents that a
  wrong transfer function may have left in the values, and no other direction explains the data as well;
* two lights of one colour in the place of any one light are ruled out. Where every seen normal faces both, their sum is
  exactly one light's: E is affine in n whatever the number of lights. Only normals that turn away from the light show
  that it is one (its terminator). `most_lights = 1` is for a user who knows that there is one lamp.
Everything else is `refused`, in words; then `guess` is the best explanation all the same, and the ambient light the
mean of what was seen. Light that is the same for every normal is refused too: there is no direction to be had.
Source: Tan, Chen, Sun 2010, eq. (1); (9) is `paper_lights`; SYSTEMS.md S1.
Cost: 20 to 150 ms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from arfx.analyse.icosphere import icosphere
from arfx.analyse.light_samples import Samples, gather
from arfx.analyse.light_search import NO_CONE_DEG, SOFT_DEG, Model, apart_deg, cone_deg, pair_in_place, refine, search
from arfx.core.numerics import angle_between, condition

MEASURED, REFUSED = "measured", "refused"
DEFAULT_SIZE_DEG = 5.0  # of a light whose disc the data do not show: a lamp indoors
LEAST_SPAN_DEG = 3.0  # of the normals: less is one normal
_GAMMA_STEPS = (0.0, -0.08, 0.08, -0.16, 0.16)  # of ln gamma
_SIZES_DEG = np.array([0.0, 2.5, 5, 7.5, 10, 15, 20, 30])  # half-angles


@dataclass(frozen=True)
class Params:
    """most_lights : 0 to 2;  limit_deg : widest cone that counts as measured, and least displacement of a pair that is
    ruled out;  model_error : systematic error of irradiance over its bright level;  gamma_sigma : standard deviation of
    the exponent's logarithm that a wrong transfer function leaves, 0 = exact;  least_evidence : BIC that one more light
    must gain;  least_light : share of the light below which a directional light counts as none"""

    most_lights: int = 2
    limit_deg: float = 10.0
    model_error: float = 0.002
    gamma_sigma: float = 0.08
    least_evidence: float = 10.0
    least_light: float = 0.03


@dataclass(frozen=True, eq=False)
class FittedLight:
    """direction : (3,) unit, towards it, frame of the normals;  rgb : (g, 3) irradiance on a surface that faces it, per group

    confidence_deg : half-angle of its 95 % cone given the number of lights (180 = none)
    angular_size_deg : full angle of its disc;  size_known : False = a default, or what the data allow if that is smaller
    """

    direction: np.ndarray
    rgb: np.ndarray
    confidence_deg: float
    angular_size_deg: float = DEFAULT_SIZE_DEG
    size_known: bool = False


@dataclass(frozen=True, eq=False)
class LightFit:
    """verdict : "measured" (lights) or "refused" (no light; `guess` holds the best explanation, for reports)

    reason : in words;  ambient_rgb : (g, 3) per group (refused: mean of what was seen)
    lights, guess : strongest first;  count : of the model that the criterion chose
    bic : (3,) for 0, 1, 2 lights;  misfit : chi squared over its degrees of freedom;  gamma : exponent found in the values
    condition : of [1, n], columns of length 1, at most 1e12;  span_deg : of the normals;  used, ignored : observations
    """

    verdict: str
    reason: str
    ambient_rgb: np.ndarray
    lights: tuple[FittedLight, ...] = ()
    guess: tuple[FittedLight, ...] = ()
    count: int = 0
    bic: tuple[float, ...] = (0.0, 0.0, 0.0)
    misfit: float = 0.0
    gamma: float = 1.0
    condition: float = 1e12
    span_deg: float = 0.0
    used: int = 0
    ignored: int = 0

    def irradiance(self, normals: np.ndarray, group: int = 0) -> np.ndarray:
        """(..., 3) at unit normals (..., 3): ambient light and `lights`."""
        n = np.asarray(normals, float)
        out = np.broadcast_to(self.ambient_rgb[group], n.shape).copy()
        for li in self.lights:
            out += np.clip(n @ li.direction, 0, None)[..., None] * li.rgb[group]
        return out


def fit(
    normals: np.ndarray, irradiance: np.ndarray, variance: np.ndarray | None = None, group: np.ndarray | None = None,
    params: Params = Params(),  # noqa: B008 - frozen
) -> LightFit:  # fmt: skip
    """normals : (k, 3) in the frame that the lights are fixed in;  irradiance : (k, 3);  variance : (k, 3), of noise alone
    (an error that all share, as the bias has, is ambient light here);  group : (k,) int: directions are shared by all
    groups, amplitudes are each group's own. What is not finite is left out and counted. Nothing non-finite leaves."""
    s = gather(normals, irradiance, variance, group, params.model_error)
    if s is None:
        count = int(np.size(normals) // 3)
        return LightFit(REFUSED, "no usable observation", np.zeros((1, 3)), ignored=count)
    about = {"condition": min(condition(s.design()), 1e12), "span_deg": s.span_deg(), "used": s.used, "ignored": s.ignored}
    seen = _mean_rgb(s)
    if about["span_deg"] < LEAST_SPAN_DEG:
        return LightFit(REFUSED, f"one normal only: all lie within {about['span_deg']:.2g} degrees", seen, **about)
    if len(s.normals) < 4:
        return LightFit(REFUSED, f"{len(s.normals)} normals only: a direction beside ambient light takes 4", seen, **about)
    found = _Explanations(s, params)
    model, count = found.best[found.count], found.count
    s = model.at
    about |= {"bic": found.bic, "misfit": found.misfit(count), "gamma": s.gamma, "count": count}
    if count == 0:
        return LightFit(REFUSED, "the light is even: no direction stands out (or it comes from behind all normals)", seen, **about)
    amp = model.amplitudes()[0] * s.scale[:, None]  # (g, 3, q + 1)
    order = np.argsort(-amp[..., 1:].sum((0, 1)), kind="stable")
    cones = found.cones()
    guess = tuple(FittedLight(model.dirs[i], amp[:, :, 1 + i], cones[i]) for i in order)
    reason = ""
    if amp[..., 1:].sum() < params.least_light * amp.sum():
        reason = "the light is even: its directional part is too weak"
    elif max(cones) > params.limit_deg:
        reason = f"the direction is uncertain by {max(cones):.3g} degrees (conditioning {about['condition']:.3g})"
    else:
        reason = found.objection()
    if reason:
        return LightFit(REFUSED, reason, seen, guess=guess, **about)
    size, known = _angular_size(model, found.bound() - found.best_cost[count] + model.chi2)
    lights = tuple(FittedLight(g.direction, g.rgb, max(g.confidence_deg, 0.5), size, known) for g in guess)
    spread = f"normals over {about['span_deg']:.0f} degrees"
    told = f"{count} light{'s' * (count > 1)}, within {max(cones):.2g} degrees; {spread}"
    return LightFit(MEASURED, told, amp[:, :, 0], lights, lights, **about)


class _Explanations:
    """All models of 0 to 2 lights under all exponents; cost = chi squared + the exponent's prior."""

    def __init__(self, s: Samples, params: Params) -> None:
        self.params, most = params, max(0, min(params.most_lights, 2))
        for _ in range(2):
            found = self._search(s, most)
            calmer = s.damped(found[most][0].amplitudes()[1])
            if (calmer.weight >= 0.5 * s.weight).all():
                break
            s = calmer
        else:
            found = self._search(s, most)
        self.groups, self.effective = s.groups, s.effective
        self.nodes: list[tuple[float, list[list[Model]]]] = [(0.0, found)]  # (prior's cost, models by count)
        steps = _GAMMA_STEPS[1:] if params.gamma_sigma > 0 else ()
        curve = {0.0: found}
        for step in steps:
            curve[step] = self._follow(s, found, step)
        if steps:
            for count in range(most + 1):  # where the costs of three steps have their least
                at = _lowest({k: self._cost(k, m[count][0]) for k, m in curve.items()})
                if min(abs(at - k) for k in curve) > 0.01:
                    curve[at] = self._follow(s, found, at)
        self.nodes = [(self._prior(k), m) for k, m in curve.items()]
        self.best, self.best_cost = [], []
        for count in range(most + 1):
            prior, models = min(self.nodes, key=lambda n, c=count: n[0] + n[1][c][0].chi2)
            self.best.append(models[count][0])
            self.best_cost.append(prior + models[count][0].chi2)
        wide = max(1.0, self.best_cost[most] / max(self.effective - self._parameters(most), 1.0))
        bic = [c / wide + self._parameters(k) * np.log(max(self.effective, 2.0)) for k, c in enumerate(self.best_cost)]
        self.count = 0
        for k in range(1, most + 1):
            if bic[k] < bic[self.count] - params.least_evidence:
                self.count = k
        self.bic = tuple(float(b) for b in bic)

    def _search(self, s: Samples, most: int) -> list[list[Model]]:
        found = [search(s, 0)]
        if most >= 1:
            ones = search(s, 1)
            large = [refine(s, ones[0].dirs, float(np.sin(np.radians(a)))) for a in SOFT_DEG]
            found.append(sorted([*ones, *large], key=lambda m: m.chi2))
        if most >= 2:
            found.append(search(s, 2, ones[0]))
        return found

    def _follow(self, s: Samples, found: list[list[Model]], step: float) -> list[list[Model]]:
        t = s.without_gamma(float(np.exp(step)))
        return [sorted((refine(t, m.dirs, m.soft) for m in models), key=lambda m: m.chi2) for models in found]

    def _prior(self, step: float) -> float:
        return (step / self.params.gamma_sigma) ** 2 if step else 0.0

    def _cost(self, step: float, model: Model) -> float:
        return self._prior(step) + model.chi2

    def _parameters(self, count: int) -> int:
        return 3 * self.groups * (1 + count) + 2 * count

    def misfit(self, count: int) -> float:
        return float(self.best_cost[count] / max(self.effective - self._parameters(count), 1.0))

    def bound(self) -> float:
        """Cost up to which another explanation is no worse, at 95 % for two parameters."""
        dof = max(self.effective - self._parameters(self.count), 1.0)
        wider = max(1.0, self.misfit(self.count))
        return float(self.best_cost[self.count] + 2 * fisher.ppf(0.95, 2, dof) * wider)

    def cones(self) -> list[float]:
        """Per light of the chosen model, over all exponents that are within the bound."""
        best, bound = self.best[self.count], self.bound()
        out = [0.0] * self.count
        for prior, models in self.nodes:
            model = models[self.count][0]
            if prior + model.chi2 > bound:
                continue
            for i in range(self.count):
                j = int(angle_between(model.dirs, best.dirs[i]).argmin())
                off = float(np.degrees(angle_between(model.dirs[j], best.dirs[i])))
                out[i] = max(out[i], min(off + cone_deg(model, j, bound - prior), NO_CONE_DEG))
        return out

    def objection(self) -> str:
        """Why the chosen model is not the only one, or empty."""
        best, bound, limit = self.best[self.count], self.bound(), self.params.limit_deg
        for prior, models in self.nodes:
            for m in models[self.count]:
                if prior + m.chi2 <= bound and apart_deg(m.dirs, best.dirs) > limit:
                    return f"another direction, {apart_deg(m.dirs, best.dirs):.0f} degrees off, explains the data as well"
        if self.params.most_lights < 2:
            return ""
        for prior, models in self.nodes:
            if self.count == 1 and prior + models[2][0].chi2 > bound:
                continue  # not even two free lights
            for i in range(self.count):
                chi, apart = pair_in_place(best, models[self.count][0].at, i, limit, bound - prior)
                if chi <= bound - prior:
                    one = "the light" if self.count == 1 else "one of the two lights"
                    return f"{one} may be two, {apart:.0f} degrees apart: too few normals turn away from it"
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


def _mean_rgb(s: Samples) -> np.ndarray:
    """(g, 3) mean irradiance of each group."""
    pairs = zip(s.starts[:-1], s.starts[1:], strict=True)
    return np.array([np.average(s.value[a:b], axis=0, weights=s.weight[a:b]) for a, b in pairs]) * s.scale


def _angular_size(model: Model, bound: float) -> tuple[float, bool]:
    """(full angle in degrees, whether the data show it). bound : chi squared that is no worse than the best."""
    chi = np.array([refine(model.at, model.dirs, float(np.sin(np.radians(a))), passes=6).chi2 for a in _SIZES_DEG])
    inside = np.flatnonzero(chi <= max(bound, chi.min()))
    best = float(_SIZES_DEG[chi.argmin()])
    if inside[0] > 0 and inside[-1] < len(chi) - 1:
        return 2 * best, True
    most = 2 * float(_SIZES_DEG[min(inside[-1] + 1, len(chi) - 1)])
    return min(DEFAULT_SIZE_DEG, most) if inside[0] == 0 else 2 * best, False


def paper_lights(light_map: np.ndarray, level: int, threshold: float, epsilon_deg: float) -> np.ndarray:
    """(m, 3) unit directions of the lights as eq. (9) finds them, strongest first.

    light_map : (v, 3) or (v,) values at the vertices of icosphere(level);  threshold : I_c, of the channels' mean
    Candidates are the middles of the triangles of the upper hemisphere (z >= 0); a light stands where M exceeds the
    threshold and every other candidate closer than epsilon_deg.
    """
    values = np.asarray(light_map, float)
    values = values.mean(-1) if values.ndim == 2 else values
    sphere = icosphere(level)
    upper = sphere.centres[:, 2] >= 0
    n, M = sphere.centres[upper], values[sphere.faces[upper]].mean(1)
    near = n @ n.T > np.cos(np.radians(epsilon_deg))
    np.fill_diagonal(near, False)
    rival = np.where(near, M[None], -np.inf).max(1)
    peak = (threshold < M) & (rival < M)
    return n[peak][np.argsort(-M[peak], kind="stable")]
