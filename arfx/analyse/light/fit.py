"""Which lights make the irradiance that was seen: E(n) = a + sum_l Omega_l max(n.d_l, 0), with 0, 1 or 2 lights.

A direction that is not known for certain is `refused`, in words; then the ambient light is the mean of what was seen.
Source: Tan, Chen, Sun 2009, eq. (1); docs/methods/light.md#lamps. Cost: 20 to 150 ms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from arfx.analyse.light.explain import MODEL_ERROR, MOST_ERROR, Explanations, Params
from arfx.analyse.light.search import NO_CONE_DEG, SKY, Model, Samples, gather, refine
from arfx.core.light import DirectionalLight, Light, harmonics, triple
from arfx.core.numerics import condition

MEASURED, REFUSED = "measured", "refused"
DEFAULT_SIZE_DEG = 5.0  # of a light whose disc the data do not show: a lamp indoors
LEAST_SPAN_DEG = 3.0  # of the normals: less is one normal
# Shares of degree 0, 1, 2 of max(c, 0) and of ((c + 1) / 2)^2: their Legendre coefficients times 4 pi / (2 l + 1)
_COSINE, _SKY = np.pi * np.array([1, 2 / 3, 1 / 4]), np.pi * np.array([4 / 3, 2 / 3, 2 / 15])
_SIZES_DEG = np.array([0.0, 2.5, 5, 7.5, 10, 15, 20, 30])  # half-angles


@dataclass(frozen=True, eq=False)
class FittedLight:
    """direction : (3,) unit, towards it, frame of the normals;  rgb : (g, 3) irradiance on a surface that faces it, per group

    confidence_deg : half-angle of its 95 % cone given the number of lights (180 = none)
    angular_size_deg : full angle of its disc, a default or what the data allow where they do not show it
    """

    direction: np.ndarray
    rgb: np.ndarray
    confidence_deg: float
    angular_size_deg: float = DEFAULT_SIZE_DEG

    @property
    def sky(self) -> bool:
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
    condition : of [1, n], columns of length 1, at most 1e12;  span_deg : of the normals;  ignored : observations
    """

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
            out += ((c + 1) ** 2 / 4 if li.sky else np.clip(c, 0, None))[..., None] * li.rgb[group]
        return out

    def light(self, group: int = 0, source: str = "marker") -> Light:
        """As the light that every effect shares: known directions are lights, all else is soft (degree 2 harmonics)."""
        hard = [li for li in self.lights if li.confidence_deg < NO_CONE_DEG]
        rest = [li for li in self.lights if li.confidence_deg >= NO_CONE_DEG]
        soft, ambient = np.zeros((9, 3)), np.array(self.ambient_rgb[group])
        soft[0] = ambient * np.sqrt(4 * np.pi)
        for li in rest:
            share = np.repeat((_SKY if li.sky else _COSINE), (1, 3, 5))
            soft += (share * harmonics(li.direction))[:, None] * li.rgb[group]
            ambient = ambient + li.rgb[group] * (1 / 3 if li.sky else 1 / 4)
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
    params: Params = Params(), lit: np.ndarray | None = None,  # noqa: B008 - frozen
) -> LightFit:  # fmt: skip
    """normals : (k, 3) in the frame that the lights are fixed in;  irradiance : (k, 3);  variance : (k, 3), of noise alone
    (an error that all share, as the bias has, is ambient light here);  group : (k,) int: directions are shared by all
    groups, amplitudes are each group's own. What is not finite is left out and counted. Nothing non-finite leaves.
    lit : (g,) by the number of the group, share of the lamps that is on: then amplitudes are shared by all groups too"""
    s = gather(normals, irradiance, variance, group, MODEL_ERROR, lit)
    if s is None:
        count = int(np.size(normals) // 3)
        return LightFit(REFUSED, "no usable observation", np.zeros((1, 3)), np.zeros((1, 3)), ignored=count)
    about: dict[str, Any] = {"condition": min(condition(s.design()), 1e12), "span_deg": s.span_deg(), "ignored": s.ignored}
    seen = _mean_rgb(s)
    if about["span_deg"] < LEAST_SPAN_DEG:
        return LightFit(REFUSED, f"one normal only: all lie within {about['span_deg']:.2g} degrees", seen, seen, **about)
    if len(s.normals) < 4:
        return LightFit(REFUSED, f"{len(s.normals)} normals only: a direction beside ambient light takes 4", seen, seen, **about)
    error, found = MODEL_ERROR, Explanations(s, params)
    for _ in range(4):  # what no lights explain is an error of the model, and not one that averages out
        misfit = min(found.misfit(k) for k in range(len(found.best)))
        if misfit <= 1.5:
            break
        error = max(error, 1e-4) * float(np.sqrt(misfit))
        if error > MOST_ERROR:
            break
        s = gather(normals, irradiance, variance, group, error, lit) or s
        found = Explanations(s, params, found)
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
    sky = model.soft >= SKY
    order = np.lexsort([-model.shares, sky])
    lights = tuple(
        FittedLight(model.dirs[i], amp[:, :, 1 + i], NO_CONE_DEG, 180.0 if sky[i] else DEFAULT_SIZE_DEG) for i in order
    )
    cone, doubt = found.judged(int(order[0]))
    lights = (replace(lights[0], confidence_deg=cone), *lights[1:])
    if doubt:
        return LightFit(REFUSED, doubt, seen, seen, **about)
    told = f"{count} light{'s' * (count > 1)}, within {cone:.2g} degrees"
    if count == 2:
        other, doubt = found.judged(int(order[1]))
        lights = (lights[0], replace(lights[1], confidence_deg=NO_CONE_DEG if doubt else other))
        told += f"; the second's direction is not known: {doubt}" if doubt else f" and {other:.2g} degrees"
    told += f"; normals over {about['span_deg']:.0f} degrees"
    size = _angular_size(model, found.bound() - found.best_cost[count] + model.chi2)
    lights = tuple(li if li.sky else replace(li, angular_size_deg=size) for li in lights)
    return LightFit(MEASURED, told, amp[:, :, 0], seen, lights, **about)


def _mean_rgb(s: Samples) -> np.ndarray:
    """(g, 3) mean irradiance of each group."""
    pairs = zip(s.starts[:-1], s.starts[1:], strict=True)
    return np.array([np.average(s.value[a:b], axis=0, weights=s.weight[a:b]) for a, b in pairs]) * s.scale


def _angular_size(model: Model, bound: float) -> float:
    """Full angle in degrees. bound : chi squared that is no worse than the best."""
    tried = [np.where(model.soft < SKY, np.sin(np.radians(a)), model.soft) for a in _SIZES_DEG]
    chi = np.array([refine(model.at, model.dirs, soft, passes=6).chi2 for soft in tried])
    inside = np.flatnonzero(chi <= max(bound, chi.min()))
    best = float(_SIZES_DEG[chi.argmin()])
    most = 2 * float(_SIZES_DEG[min(inside[-1] + 1, len(chi) - 1)])
    return min(DEFAULT_SIZE_DEG, most) if inside[0] == 0 else 2 * best
