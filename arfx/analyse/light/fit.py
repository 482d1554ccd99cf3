"""Which lights make the irradiance that was seen: E(n) = a + sum_l Omega_l max(n.d_l, 0),
with 0, 1 or 2 lights.

All hypotheses are compared by a criterion (hypotheses.py). The simplest is `measured` where
nothing else explains the data, `likely` where others do, with a cone that holds the light
vectors of all of them, and `refused`, in words, where that cone says
nothing: then the ambient light is the mean of what was seen.
Source: Tan, Chen, Sun 2009, eq. (1); docs/methods/light.md#lamps. Cost: 20 to 150 ms."""

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from arfx.analyse.light.hypotheses import (
    LEAST_LIGHT,
    LIKELY,
    MEASURED,
    NO_CONE_DEG,
    REFUSED,
    Assessment,
    Explanations,
    Params,
)
from arfx.analyse.light.model import DOME, refine, solve
from arfx.analyse.light.search import gather
from arfx.core.light import DirectionalLight, Light, harmonics, triple
from arfx.core.numerics import arccos, normalise

MODEL_ERROR, MOST_ERROR = (
    0.002,
    0.03,
)  # of irradiance, over its bright level: at least, and beyond which the model is wrong
DEFAULT_SIZE_DEG = 5.0  # of a light whose disc the data do not show: a lamp indoors
MOST_SIZE_DEG = 30.0  # disc of a likely light: beyond, no shadow is seen
LEAST_SPAN_DEG = 3.0  # of the normals: less is one normal
NARROW_DEG, MOST_CONDITION = (
    30.0,
    700.0,
)  # of normals within so few degrees: beyond, errors of their poses pass for light
# Shares of degree 0, 1, 2 of max(c, 0) and of ((c + 1) / 2)^2: their Legendre coefficients
# times 4 pi / (2 l + 1)
_COSINE, _DOME = (
    np.pi * np.repeat(of_degree, (1, 3, 5))
    for of_degree in ([1, 2 / 3, 1 / 4], [4 / 3, 2 / 3, 2 / 15])
)
_HELD = 500  # normals, at most, that are held against all others
_SIZES_DEG = np.array([0.0, 2.5, 5, 7.5, 10, 15, 20, 30])  # half-angles


@dataclass(frozen=True, eq=False)
class FittedLight:
    """direction : (3,) unit, towards it, frame of the normals;  rgb : (g, 3) irradiance on
    a surface that faces it, per group

    confidence_deg : half-angle of the 95 % cone of all that explains the data as well: of
    lamps, if merely likely of light
        vectors (180 = the direction is not known)
    angular_size_deg : full angle of its disc, a default or what the data allow where they
    do not show it; if merely likely as
        wide as lamps in its place may be spread, up to 30
    verdict : of its direction"""

    direction: ndarray
    rgb: ndarray
    confidence_deg: float
    angular_size_deg: float = DEFAULT_SIZE_DEG
    verdict: str = MEASURED

    @property
    def dome(self) -> bool:
        """Ambient light that is brighter from one side, ((n.d + 1) / 2)^2, not a light that
        casts a shadow.
        """
        return self.angular_size_deg >= 180


@dataclass(frozen=True, eq=False)
class LightFit:
    """verdict : of the first light; "refused" = no light

    reason : in words;  ambient_rgb : (g, 3) per group, seen_rgb where refused;  seen_rgb :
    (g, 3) mean of what was seen
    lights : the one that gives most of what was seen first; of two only that must be known
    well: one
        whose direction is not has confidence_deg 180, and is soft light in `light()`
    model_error : systematic, relative
    """

    verdict: str
    reason: str
    ambient_rgb: ndarray
    seen_rgb: ndarray
    lights: tuple[FittedLight, ...] = ()
    model_error: float = 0.0

    def irradiance(self, normals: ndarray, group: int = 0) -> ndarray:
        """(..., 3) at unit normals (..., 3): ambient light and `lights`."""
        n = np.asarray(normals, float)
        out = np.broadcast_to(self.ambient_rgb[group], n.shape).copy()
        for li in self.lights:
            c = n @ li.direction
            out += ((c + 1) ** 2 / 4 if li.dome else np.clip(c, 0, None))[
                ..., None
            ] * li.rgb[group]
        return out

    @property
    def claimed(self) -> bool:
        """Whether the direction of a light is known, surely or likely."""
        return self.verdict != REFUSED

    def verdict_of(self, group: int = 0) -> tuple[str, str]:
        """(verdict, reason) of one group: of the light that gives most there."""
        on = [li for li in self.lights if self._is_on(li, group)]
        if not self.claimed or not on or on[0] is self.lights[0]:
            return self.verdict, self.reason
        return on[0].verdict, self.reason

    def _is_on(self, light: FittedLight, group: int) -> bool:
        shown = self.ambient_rgb[group].sum() + sum(
            li.rgb[group].sum() for li in self.lights
        )
        return bool(light.rgb[group].sum() > LEAST_LIGHT * shown)

    def light(self, group: int = 0) -> Light:
        """As the light that every effect shares: known directions are lights, all else is
        soft (degree 2 harmonics).
        """
        ambient, lamps, shaped = self.ambient_rgb[group], [], False
        soft = np.zeros((9, 3))
        soft[0] = ambient * np.sqrt(4 * np.pi)
        for li in self.lights:
            rgb, cone_deg = li.rgb[group], li.confidence_deg
            if not self._is_on(li, group):
                continue
            if cone_deg < NO_CONE_DEG:
                towards = triple(li.direction), triple(rgb)
                lamps.append(
                    DirectionalLight(*towards, li.angular_size_deg, cone_deg)
                )
                continue
            fraction, shaped = (_DOME if li.dome else _COSINE), True
            soft += (fraction * harmonics(li.direction))[:, None] * rgb
        if shaped:
            return Light.of_soft(soft, tuple(lamps), "marker")
        return Light(triple(ambient), tuple(lamps), "marker")


def span_deg(normals: ndarray) -> float:
    """Widest angle between unit normals (k, 3)."""
    few = normals[:: len(normals) // _HELD + 1]
    return float(
        np.degrees(
            arccos(min((float((normals @ n).min()) for n in few), default=1.0))
        )
    )


def fit(
    normals: ndarray,
    irradiance: ndarray,
    variance: ndarray | float = 0.0,
    group: ndarray | int = 0,
    params: Params = Params(),  # noqa: B008 - frozen
    lit: ndarray | None = None,
) -> LightFit:
    """normals : (k, 3) in the frame that the lights are fixed in;  irradiance : (k, 3);
    variance : (k, 3), of noise alone
    (an error that all share, as the bias has, is ambient light here);  group : (k,) int:
    directions are shared by all
    groups, amplitudes are each group's own. All finite.
    lit : (g,) by the number of the group, share of the lamps that is on: then amplitudes
    are shared by all groups too
    """
    s = gather(normals, irradiance, variance, group, MODEL_ERROR, lit)
    if s is None:
        none = np.zeros((1, 3))
        return LightFit(REFUSED, "no usable observation", none, none)
    span = span_deg(normalise(s.normals))
    groups, error = s.groups(), 0.0
    seen = np.array([g.value @ g.root / (g.root @ g.root) for g in groups]) * s.scale

    def refused(why: str) -> LightFit:
        return LightFit(REFUSED, why, seen, seen, model_error=error)

    narrow = span < NARROW_DEG and s.condition() > MOST_CONDITION
    if span < LEAST_SPAN_DEG or narrow:
        return refused(
            f"one normal only, as far as poses are known: all lie within {span:.2g} degrees"
            " (turn the print, add a cube of prints, or give `--light`)"
        )
    if len(s.normals) < 4:
        return refused(
            f"{len(s.normals)} normals only: a direction beside ambient light takes 4"
        )
    error, found = MODEL_ERROR, Explanations(s, params)
    for _ in range(
        4
    ):  # what no lights explain is an error of the model, and not one that averages out
        misfit = min(found.misfit(k) for k in range(len(found.best)))
        if misfit <= 1.5:
            break
        error = max(error, 1e-4) * float(np.sqrt(misfit))
        if error > MOST_ERROR:
            break
        s = gather(normals, irradiance, variance, group, error, lit) or s
        found = Explanations(s, params, found)
    if error > MOST_ERROR:
        return refused(
            f"no lights explain what was seen to better than {error:.1%}: exposure or light"
            " changed, or the surface is glossy",
        )
    model, count = found.best[found.count], found.count
    if count == 0:
        return refused(
            "the light is even: no direction stands out, or it comes from behind all"
            " normals"
        )
    # directions are the exponent's, amplitudes those of the values as they came: what is
    # shown beside them has to match
    amp = solve(s.groups(), model).amplitudes[0] * s.scale[:, None]  # (g, 3, q + 1)
    shares, domes = found.shares(model)[0][0], model.soft[0] >= DOME
    order = np.lexsort([-shares, domes])
    known = [found.assess(int(i)) for i in order]
    first = known[0]
    if first.verdict == REFUSED:
        return refused(first.doubt)
    size_deg = _size_deg(found, domes)
    lights = []
    for i, (verdict, cone, _) in zip(order, known, strict=True):
        size = 180.0 if domes[i] else size_deg
        one = FittedLight(
            model.dirs[0, i],
            amp[:, :, 1 + i],
            NO_CONE_DEG if verdict == REFUSED else cone,
            size,
            verdict,
        )
        if verdict == LIKELY:
            one = doubted(one, cone)
        lights.append(one)
    reason = f"{count} light{'s' * (count > 1)}, {_words(first)}"
    if count == 2:
        reason += f"; the second {_words(known[1])}"
    reason += f"; normals over {span:.0f} degrees"
    return LightFit(first.verdict, reason, amp[:, :, 0], seen, tuple(lights), error)


def doubted(light: FittedLight, cone_deg: float) -> FittedLight:
    """The light as a likely one, its disc as wide as lamps in its place may be spread."""
    size_deg = max(light.angular_size_deg, min(cone_deg, MOST_SIZE_DEG))
    return replace(
        light,
        confidence_deg=cone_deg,
        angular_size_deg=size_deg,
        verdict=LIKELY,
    )


def _words(known: Assessment) -> str:
    if known.verdict == MEASURED:
        return f"within {known.cone_deg:.2g} degrees"
    return (
        f"likely, but {known.doubt}"
        if known.verdict == LIKELY
        else f"in a direction that is not known: {known.doubt}"
    )


def _size_deg(found: Explanations, domes: ndarray) -> float:
    """Full angle of the lights' discs: what the data show, or else a default that they allow."""
    model = found.best[found.count]
    n = len(_SIZES_DEG)
    soft = np.where(domes, model.soft, np.sin(np.radians(_SIZES_DEG))[:, None])
    tried = replace(model[np.zeros(n, int)], soft=soft)
    chi2 = refine(found.groups, tried, passes=6)[1]
    bound = found.bound()
    inside = np.flatnonzero(chi2 <= max(bound, chi2.min()))
    if inside[0] > 0:
        return 2 * float(_SIZES_DEG[chi2.argmin()])
    most = 2 * float(_SIZES_DEG[min(inside[-1] + 1, n - 1)])
    return min(DEFAULT_SIZE_DEG, most)
