"""Light and camera bias out of the patches of many frames: I = g rho x_t + b per channel,
shared b, one light per frame.

The free scale is fixed (g = 1, so y_t = g x_t), b and y_t by robust least squares (Huber).
What cannot be solved is `degenerate`: then b = 0 is assumed and the light taken from the
bright patches alone. Nothing non-finite leaves.
Source: Tan, Chen, Sun 2009, eq. (2), (4) to (6); docs/methods/light.md#bias. Cost: 10,000
frames about .25 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from arfx.core.numerics import divide

MEASURED, DEGENERATE = "measured", "degenerate"
INK, PAPER = 0.05, 0.88  # albedos of print
INK_SIGMA = 0.01  # of the ink's, beside a paper of .88: .03 to .07
TRANSFER = 0.08  # by so much the exponent of the camera's curve may be another than stated
# Coded steps of 1/255 by which all dark cells of a clip may be off together: half a step of
# chroma is 1 of blue, and a codec leaves smooth chroma where its rounding put it.
STEPS = 1.5
UNKNOWN_VARIANCE = 1e12  # of the light of a frame in which nothing was usable
ASSUMED_BIAS = (
    0.01  # standard deviation of an unknown bias, linear light: about 10 dark grey levels
)
# Share of the information on b that is left once every y_t is eliminated, below which
# float64 has none of it.
LEAST_FRACTION = 1e-12
WORST_BIAS = (
    0.1  # of the bright patches' median: a 95 % interval of b that is wider says nothing
)
# of the bright patches' median that has to be light: less is haze, or no print at all
LEAST_CONTRAST = 0.05
MOST_CONDITION = 1e12  # that is told
TOO_BRIGHT = (
    "dark cells are brighter than the clip's darkest hundredth allows: blur, gloss or ink of"
    " another colour"
)
UNUSABLE = "no patch is usable: all are clipped, missing or not finite"
_HUBER, _PASSES, _INK_STEPS = 1.345, 25, 4


@dataclass(frozen=True, eq=False)
class LightReading:
    """y, variance : (k, 3) radiance of a white surface, and its variance;  fit : (k,) bool,
    readings of one kind, for a fit over normals
    """

    y: np.ndarray
    variance: np.ndarray
    fit: np.ndarray

    def at(self, rows: np.ndarray) -> LightReading:
        return LightReading(self.y[rows], self.variance[rows], self.fit[rows])


@dataclass(frozen=True, eq=False)
class Photometry:
    """Solution over t observations (a marker in a frame). All finite.

    y : (t, 3) light g x_t, in units of the radiance of a white diffuse surface; noise may
    bring it below 0
    var_y_own : (t, 3) its variance without that of the bias, whose error is shared by all frames
    seen : (t,) False where nothing was usable (y 0, variance UNKNOWN_VARIANCE)
    bias : (3,);  bias_95 : (3, 2) interval, the ink's tolerance included;  ink : (3,)
    albedo used or found
    determined : (3,) False where the channel's bias is assumed, not solved
    rank, unknowns : (3,) of the linear system;  condition : (3,) of its columns scaled to
    length 1, at most 1e12
    misfit : (3,) residuals in units of their stated deviations;  clipped : share of
    samples;  ignored : patches not finite
    verdict : "measured" or "degenerate";  reason : in words"""

    verdict: str
    reason: str
    y: np.ndarray
    var_y_own: np.ndarray
    seen: np.ndarray
    bias: np.ndarray
    bias_95: np.ndarray
    ink: np.ndarray
    determined: np.ndarray
    rank: np.ndarray
    unknowns: np.ndarray
    condition: np.ndarray
    misfit: np.ndarray
    clipped: float
    ignored: int

    @property
    def reading(self) -> LightReading:
        return LightReading(self.y, self.var_y_own, self.seen)


class Tolerances(NamedTuple):
    """What is not exactly as stated. ink_sigma : standard deviation of the ink's albedo
    transfer : range by which the exponent of the camera's curve may be off
    steps : of 1/255 by which the coded values of all dark cells may be off together
    blur : of a dark cell's stated deviation by which they may be: what blur brings in from
    beside is the same in all frames"""

    ink_sigma: float = INK_SIGMA
    transfer: float = TRANSFER
    steps: float = STEPS
    blur: float = 0.5


USUAL, EXACT = Tolerances(), Tolerances(0, 0, 0, 0)


class Channel(NamedTuple):
    """One channel of a Photometry, and why its bias is assumed, "" = it is not."""

    y: np.ndarray
    var_y_own: np.ndarray
    seen: np.ndarray
    ink: float
    rank: int
    unknowns: int
    condition: float
    reason: str = ""
    determined: bool = False
    bias: float = 0.0
    bias_95: tuple[float, float] = (-1.96 * ASSUMED_BIAS, 1.96 * ASSUMED_BIAS)
    misfit: float = 1.0


def solve(
    intensity: np.ndarray,
    variance: np.ndarray | None,
    albedo: np.ndarray,
    clipped: np.ndarray | None = None,
    tolerances: Tolerances = USUAL,
    most_bias: np.ndarray | None = None,
) -> Photometry:
    """intensity : (t, p, 3) linear, NaN = not measured;  variance : (t, p, 3) or None =
    equal and unknown
    albedo : (p,), (t, p) or (t, p, 3);  clipped : (t, p) shares, for the report
    tolerances : go into bias_95
    most_bias : (3,) what the clip's darkest pixels show: no black level is above it"""
    channels, ignored = weighted(intensity, variance, albedo)
    known = variance is not None
    most = np.full(3, np.inf) if most_bias is None else most_bias
    parts = [
        _solve_channel(*c, known, tolerances, float(m))
        for c, m in zip(channels, most, strict=True)
    ]
    if any(p.reason == TOO_BRIGHT for p in parts):  # then no channel's is the camera's
        parts = [
            fallback(*c, TOO_BRIGHT, p.rank, p.condition)
            for c, p in zip(channels, parts, strict=True)
        ]
    return assemble(parts, clipped, ignored)


def weighted(
    intensity: np.ndarray, variance: np.ndarray | None, albedo: np.ndarray
) -> tuple[list[tuple[np.ndarray, np.ndarray, np.ndarray]], int]:
    """([values, 0 where not usable; inverse variances, 0 = not usable, else 1 if unknown;
    albedos: each (t, p)] by channel, number of patches that are not finite). Arguments as
    for `solve`.
    """
    value, rho = np.asarray(intensity, float), np.asarray(albedo, float)
    rho = np.broadcast_to(rho if rho.ndim == 3 else rho[..., None], value.shape)
    fine = np.isfinite(value) & np.isfinite(rho)
    ignored = int((~np.isfinite(value)).any(-1).sum())
    weight = np.ones(value.shape)
    if variance is not None:
        v = np.asarray(variance, float)
        fine &= np.isfinite(v) & (v >= 0)
        usual = float(np.median(v[fine])) if fine.any() else 1.0
        # no patch outweighs the usual one by more than 10,000
        weight = divide(1.0, np.maximum(v, max(1e-4 * usual, 1e-18)))
    arrays = np.where(fine, value, 0.0), np.where(fine, weight, 0.0), rho
    by_channel = (np.moveaxis(a, -1, 0) for a in arrays)
    return list(zip(*by_channel, strict=True)), ignored


def assemble(
    parts: Sequence[Channel], clipped: np.ndarray | None, ignored: int
) -> Photometry:
    """A Photometry of the channels' results."""
    fine = all(p.determined for p in parts)
    text = "two albedos, bias and light determined"
    if not fine:
        channels = "".join(
            name for name, p in zip("RGB", parts, strict=True) if not p.determined
        )
        reasons = "; ".join(sorted({p.reason for p in parts if p.reason}))
        text = f"{channels}: {reasons}; bias 0 assumed, light from the bright patches alone"
    y, own, seen, ink, rank, unknowns, condition, _, determined, bias, bias_95, misfit = (
        map(np.array, zip(*parts, strict=True))
    )
    return Photometry(
        MEASURED if fine else DEGENERATE,
        text,
        y.T,
        own.T,
        np.asarray(seen.any(0)),
        bias,
        bias_95,
        ink,
        determined,
        rank,
        unknowns,
        condition,
        misfit,
        float(np.mean(clipped)) if clipped is not None and np.size(clipped) else 0.0,
        ignored,
    )


def _solve_channel(
    grey: np.ndarray,
    w0: np.ndarray,
    rho: np.ndarray,
    known: bool,
    tolerances: Tolerances,
    most_bias: float,
) -> Channel:
    """Shared bias. grey, w0, rho : as of `weighted`;  known : the variances are
    most_bias : above it is what ink and gloss show, not the camera's bias

    The solution takes the stated ink; the interval holds what an ink with its tolerance as
    prior, solved for beside the bias, makes of the bias too. (Gloss and glare bend dark
    cells as another ink would, so that one found is no better an answer than the stated one.)
    """
    usable = w0 > 0
    seen = np.asarray(usable.any(1))
    count, unknowns = int(usable.sum()), int(seen.sum()) + 1
    spare = count - unknowns
    if not count:
        return fallback(grey, w0, rho, UNUSABLE, 0)

    def misfit(z: np.ndarray) -> float:
        """z : sizes of residuals, in their stated deviations"""
        usual = float(np.median(z[usable])) / 0.6745
        return max(float(known), usual * np.sqrt(count / spare) if spare > 0 else 0.0)

    w = w0
    for i in range(_PASSES):
        inverse = divide(1.0, (w * rho * rho).sum(1))
        lean = (w * rho).sum(1) * inverse
        apart = 1 - rho * lean[:, None]  # of the bias, every y_t eliminated
        remaining = float((w * apart).sum())
        fraction = remaining / max(float(w.sum()), 1e-300)
        if fraction < LEAST_FRACTION:
            why = "all usable patches have one albedo"
            return fallback(grey, w0, rho, why, unknowns - 1)
        b = float((w * apart * grey).sum()) / remaining
        y = (w * rho * (grey - b)).sum(1) * inverse
        residual = grey - rho * y[:, None] - b
        z = np.abs(residual) * np.sqrt(w0)
        scale = misfit(z)
        last, w = w, w0 * np.minimum(1.0, divide(_HUBER * scale, z, where_zero=1.0))
        if i and np.abs(w - last).max() <= 1e-6 * w0.max():
            break
    groups = np.count_nonzero((w > 0).any(0))

    def deviation(residual: np.ndarray, column: np.ndarray, factor: float) -> float:
        """Of b: the residuals are independent, or by patch, or by frame."""
        influence = w * residual * column
        variance = misfit(np.abs(residual) * np.sqrt(w0)) ** 2 * factor
        if spare > 0:
            by_patch = (influence.sum(0) ** 2).sum() * groups / max(groups - 1, 1)
            variance = max(variance, by_patch, (influence.sum(1) ** 2).sum())
        return float(np.sqrt(variance))

    from scipy.special import stdtrit

    quantile = float(stdtrit(spare, 0.975)) if spare > 0 else 1.96
    noise_b = deviation(residual, apart / remaining, 1 / remaining)
    half = quantile * noise_b
    level = float(np.median(np.where(usable, grey, -np.inf).max(1)[seen]))
    bright = float(np.median(y[seen]))
    root = np.sqrt(1 - min(fraction, 1.0 - 1e-16))
    condition = float(np.sqrt((1 + root) / (1 - root)))
    own = np.where(seen, scale**2 * inverse, UNKNOWN_VARIANCE)
    noise = 3 * float(np.sqrt(divide(1.0, np.median(w0[usable])))) * known
    doubt = 3 * float(np.hypot(np.sqrt(np.median(own[seen])), lean[seen].max() * noise_b))
    why = ""
    if level <= 0 or half > WORST_BIAS * level:
        why = "no light" if level <= noise else "albedos too alike"
        why += (
            f": the bias would be uncertain by {half:.2g} at a level of {max(level, 0):.2g}"
        )
    elif b > most_bias:
        why = TOO_BRIGHT
    elif bright < -doubt:
        why = "dark cells are brighter than bright ones"
    elif bright * float(np.abs(rho).max()) < LEAST_CONTRAST * level:
        why = "bright and dark cells look alike"
    if why:
        return fallback(grey, w0, rho, why, unknowns, condition)
    dark = rho < (rho.min(1, keepdims=True) + rho.max(1, keepdims=True)) / 2
    ink_sigma, transfer, steps, blur = tolerances
    low, high = b - half, b + half
    if ink_sigma > 0:
        off, wide, light = 0.0, half + 1.96 * ink_sigma * bright, y
        prior = (scale / ink_sigma) ** 2
        for _ in range(_INK_STEPS):
            of_light = np.where(dark, light[:, None], 0.0)
            column = of_light - rho * ((w * rho * of_light).sum(1) * inverse)[:, None]
            both = float((w * column).sum())
            of_ink = float((w * column * column).sum()) + prior
            left = 1 - float(divide(both * both, remaining * of_ink, where_zero=1.0))
            if (
                left < 1e-10
            ):  # neither does the light change nor does noise make the prior weigh
                break
            change = float((w * column * residual).sum()) / (of_ink * left)  # of the ink
            off = -both * change / remaining
            light = y - (w * rho * (off + change * of_light)).sum(1) * inverse
            rest = residual - off * apart - change * column
            bent = (apart - column * (both / of_ink)) / (remaining * left)
            wide = quantile * deviation(rest, bent, 1 / (remaining * left))
        low, high = min(low, b + off - wide), max(high, b + off + wide)
    # the interval is moved to what the bias is under other exponents of the camera's curve
    moved = [0.0]
    for exponent in (1 / (1 - transfer), 1 / (1 + transfer)):
        curved = np.sign(grey) * np.abs(grey) ** exponent
        moved.append(float((w * apart * (curved - grey)).sum()) / remaining)
    # linear light per coded value: sRGB's slope, of which all curves are near enough
    ink_level = max(float(np.median(grey[dark & usable])), 0.0031)
    step = steps / 255 * 2.4 / 1.055 * ink_level ** (1 - 1 / 2.4)
    beside = 1.96 * blur * known * float(np.median(1 / np.sqrt(w0[dark & usable])))
    low, high = (
        b + sign * float(np.linalg.norm([away, step, beside]))
        for sign, away in ((-1, b - low - min(moved)), (1, high + max(moved) - b))
    )
    return Channel(
        np.where(seen, y, 0.0),
        own,
        seen,
        float(rho[dark].mean()),
        unknowns,
        unknowns,
        min(condition, MOST_CONDITION),
        "",
        True,
        b,
        (low, high),
        scale,
    )


def fallback(
    grey: np.ndarray,
    w: np.ndarray,
    rho: np.ndarray,
    why: str,
    rank: int,
    condition: float = MOST_CONDITION,
) -> Channel:
    """Bias 0 assumed; light from the brightest albedo's patches, of a frame's others where
    it has none of them.
    """
    seen = np.asarray((w > 0).any(1))
    usable = np.where(w > 0, rho, -1.0)
    take = w * (usable >= usable.max(1, keepdims=True) * (1 - 1e-2))
    information = (take * rho * rho).sum(1)
    y = divide((take * rho * grey).sum(1), information)
    own = divide(1.0, information, where_zero=UNKNOWN_VARIANCE)
    condition, unknowns = min(condition, MOST_CONDITION), int(seen.sum()) + 1
    ink = float(rho.min(initial=INK))
    return Channel(y, own, seen, ink, rank, unknowns, condition, why)
