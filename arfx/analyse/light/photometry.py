"""Light and camera bias out of the patches of many frames: I = g rho x_t + b per channel,
shared b, one light per frame.

The free scale is fixed (g = 1, so y_t = g x_t), b and y_t by robust least squares (Huber).
What cannot be solved is `degenerate`: then b = 0 is assumed and the light taken from the
bright patches alone. Nothing non-finite leaves.
Source: Tan, Chen, Sun 2009, eq. (2), (4) to (6); docs/methods/light.md#bias. Cost: 10,000
frames about .25 s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide

MEASURED, DEGENERATE = "measured", "degenerate"
INK, PAPER = 0.05, 0.88  # albedos of print
UNKNOWN_VARIANCE = 1e12  # of the light of a frame in which nothing was usable
# standard deviation of an unknown bias, linear light: about 10 dark grey levels
ASSUMED_BIAS = 0.01
# Share of the information on b that is left once every y_t is eliminated, below which
# float64 has none of it.
LEAST_FRACTION = 1e-12
# of the bright patches' median: a 95 % interval of b that is wider says nothing
WORST_BIAS = 0.1
# of the bright patches' median that has to be light: less is haze, or no print at all
LEAST_CONTRAST = 0.05
MOST_CONDITION = 1e12  # that is told
TOO_BRIGHT = (
    "dark cells are brighter than the clip's darkest hundredth allows: blur, gloss or ink of"
    " another colour"
)
UNUSABLE = "no patch is usable: all are clipped, missing or not finite"
# deviations by which a reading's own offset has to differ from the bias, and the share of
# its patches that tell it
GLARE, MOST_SEEN = 3.0, 0.75
_HUBER, _PASSES = 1.345, 25
_NORMAL_95 = 1.96


class Channel(NamedTuple):
    """One channel of a Photometry; why : its bias is assumed, "" = it is not."""

    y: ndarray
    var_y_own: ndarray
    seen: ndarray
    condition: float
    why: str = ""
    bias: float = 0.0
    bias_95: tuple[float, float] = (
        -_NORMAL_95 * ASSUMED_BIAS,
        _NORMAL_95 * ASSUMED_BIAS,
    )
    misfit: float = 1.0


@dataclass(frozen=True, eq=False)
class Photometry:
    """Solution over t observations (a marker in a frame). All finite.

    y : (t, 3) light g x_t, in units of the radiance of a white diffuse surface; noise may
    bring it below 0
    var_y_own : (t, 3) its variance without that of the bias, whose error is shared by all frames
    seen : (t,) False where nothing was usable (y 0, variance UNKNOWN_VARIANCE)
    condition : (3,) of the linear system, its columns scaled to length 1, at most 1e12
    why : (3,) a channel's bias is assumed
    bias : (3,);  bias_95 : (3, 2) interval, the
    tolerances included
    misfit : (3,) residuals in units of their stated deviations
    """

    y: ndarray
    var_y_own: ndarray
    seen: ndarray
    condition: ndarray
    why: ndarray
    bias: ndarray
    bias_95: ndarray
    misfit: ndarray

    @property
    def determined(self) -> ndarray:
        """(3,) False where the channel's bias is assumed."""
        return self.why == ""

    @property
    def verdict(self) -> str:
        return MEASURED if self.determined.all() else DEGENERATE

    @property
    def reason(self) -> str:
        if self.determined.all():
            return "two albedos, bias and light determined"
        channels = "".join(np.array([*"RGB"])[~self.determined])
        why = "; ".join(sorted({*self.why[~self.determined]}))
        return (
            f"{channels}: {why}; bias 0 assumed, light from the bright patches alone"
        )


class Tolerances(NamedTuple):
    """What is not exactly as stated.

    ink_sigma : standard deviation of the ink's albedo: .03 to .07 beside a paper of .88
    transfer : range by which the exponent of the camera's curve may be off
    steps : of 1/255 by which the coded values of all dark cells may be off together: half a
    step of chroma is 1 of blue, and a codec leaves smooth chroma where its rounding put it
    blur : of a dark cell's stated deviation by which they may be: what blur brings in from
    beside is the same in all frames"""

    ink_sigma: float = 0.01
    transfer: float = 0.08
    steps: float = 1.5
    blur: float = 0.5


USUAL, EXACT = Tolerances(), Tolerances(0, 0, 0, 0)


def solve(
    intensity: ndarray,
    variance: ndarray | None,
    albedo: ndarray,
    tolerances: Tolerances = USUAL,
    most_bias: ndarray | None = None,
    print_: ndarray | None = None,
) -> Photometry:
    """intensity : (t, p, 3) linear, NaN = not measured;  variance : (t, p, 3) or None =
    equal and unknown
    albedo : (p,), (t, p) or (t, p, 3);  tolerances : go into bias_95
    most_bias : (3,) what the clip's darkest pixels show: no black level is above it
    print_ : (t,) int, which was seen, None = one: inks differ"""
    channels = weighted(intensity, variance, albedo)
    known = variance is not None
    which = np.zeros(len(intensity), int) if print_ is None else print_
    parts = [_solve_channel(*c, which, known, tolerances) for c in channels]
    bias = np.array([p.bias for p in parts])
    if most_bias is not None and (bias > most_bias).any():
        parts = [  # then no channel's is the camera's
            bright_patches(*c, TOO_BRIGHT, p.condition)
            for c, p in zip(channels, parts, strict=True)
        ]
    return assemble(parts)


def weighted(
    intensity: ndarray, variance: ndarray | None, albedo: ndarray
) -> list[tuple[ndarray, ndarray, ndarray]]:
    """[values, 0 where not usable; inverse variances, 0 = not usable, else 1 if unknown;
    albedos: each (t, p)] by channel. Arguments as for `solve`.
    """
    value, rho = np.asarray(intensity, float), np.asarray(albedo, float)
    rho = np.broadcast_to(rho if rho.ndim == 3 else rho[..., None], value.shape)
    v = np.ones(value.shape) if variance is None else np.asarray(variance, float)
    fine = np.isfinite(value) & np.isfinite(rho) & np.isfinite(v) & (v >= 0)
    # no patch outweighs the usual one by more than 10,000
    usual = float(np.median(v[fine])) if fine.any() else 1.0
    weight = divide(1.0, np.maximum(v, max(1e-4 * usual, 1e-18)))
    arrays = np.where(fine, value, 0.0), np.where(fine, weight, 0.0), rho
    by_channel = (np.moveaxis(a, -1, 0) for a in arrays)
    return list(zip(*by_channel, strict=True))


def assemble(parts: Sequence[Channel]) -> Photometry:
    """A Photometry of the channels' results."""
    y, own, seen, *rest = map(np.array, zip(*parts, strict=True))
    return Photometry(y.T, own.T, np.asarray(seen.any(0)), *rest)


def bright_patches(
    grey: ndarray,
    w: ndarray,
    rho: ndarray,
    why: str,
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
    return Channel(y, own, seen, condition, why)


def _solve_channel(
    grey: ndarray,
    w0: ndarray,
    rho: ndarray,
    print_: ndarray,
    known: bool,
    tolerances: Tolerances,
) -> Channel:
    """Shared bias. grey, w0, rho : as of `weighted`;  known : the variances are;  print_ : (t,)

    The solution takes the stated ink and curve; the interval holds what they make of the
    bias where they are unknowns beside it, with their tolerances as prior. (Gloss and glare
    bend dark cells as another ink would, so that one found is no better an answer.)
    """
    usable = w0 > 0
    seen = np.asarray(usable.any(1))
    count = int(usable.sum())
    spare = count - int(seen.sum()) - 1
    if not count:
        return bright_patches(grey, w0, rho, UNUSABLE)
    w = w0
    for i in range(_PASSES):
        inverse = divide(1.0, (w * rho * rho).sum(1))
        of_bias = _apart(np.ones(grey.shape), w, rho, inverse)
        remaining = float((w * of_bias).sum())
        fraction = remaining / max(float(w.sum()), 1e-300)
        if fraction < LEAST_FRACTION:
            why = "all usable patches have one albedo"
            return bright_patches(grey, w0, rho, why)
        b = float((w * of_bias * grey).sum()) / remaining
        y = (w * rho * (grey - b)).sum(1) * inverse
        residual = grey - rho * y[:, None] - b
        z = np.abs(residual) * np.sqrt(w0)
        usual = float(np.median(z[usable])) / 0.6745
        scale = max(
            float(known), usual * np.sqrt(count / spare) if spare > 0 else 0.0
        )
        last, w = w, w0 * np.minimum(1.0, divide(_HUBER * scale, z, where_zero=1.0))
        if i and np.abs(w - last).max() <= 1e-6 * w0.max():
            break
    from scipy.special import stdtrit

    # residuals are independent, or by frame
    influence = (w * residual * of_bias).sum(1) / remaining * (spare > 0)
    noise = max(scale**2 / remaining, (influence**2).sum())
    quantile = float(stdtrit(spare, 0.975)) if spare > 0 else _NORMAL_95
    half = quantile * float(np.sqrt(noise))
    root = np.sqrt(1 - min(fraction, 1.0 - 1e-16))
    condition = min(float(np.sqrt((1 + root) / (1 - root))), MOST_CONDITION)
    level = float(np.median(np.where(usable, grey, -np.inf).max(1)[seen]))
    if level <= 0 or half > WORST_BIAS * level:
        why = (
            f"no light, or albedos too alike: the bias would be uncertain by {half:.2g} at a"
            f" level of {max(level, 0):.2g}"
        )
        return bright_patches(grey, w0, rho, why, condition)
    if np.median(y[seen]) * np.abs(rho).max() < LEAST_CONTRAST * level:
        why = "bright and dark cells look alike, or dark ones are brighter"
        return bright_patches(grey, w0, rho, why, condition)
    dark = rho < (rho.min(1, keepdims=True) + rho.max(1, keepdims=True)) / 2
    ink_level = max(float(np.median(grey[dark & usable])), 0.0031)
    # of sRGB, of which all curves are near enough
    step = tolerances.steps / 255 * 2.4 / 1.055 * ink_level ** (1 - 1 / 2.4)
    blur = tolerances.blur * known * float(np.median(1 / np.sqrt(w0[dark & usable])))
    # the ink's error over its tolerance: as an unknown beside the bias 0, with deviation 1
    of_ink = _apart(tolerances.ink_sigma * dark * y[:, None], w, rho, inverse)
    left = np.stack([of_bias, of_ink])
    normal = np.einsum("itp,tp,jtp->ij", left, w, left) + scale**2 * np.diag(
        [0.0, 1.0]
    )
    covariance = np.linalg.pinv(normal, hermitian=True)[0]
    off = float(covariance @ (left * w * residual).sum((1, 2)))
    noise += scale**2 * max(float(covariance[0]) - 1 / remaining, 0.0)
    curve = tolerances.transfer * grey * np.log(np.maximum(np.abs(grey), 1e-9))
    bent = abs(float((w * of_bias * curve).sum())) / remaining
    half = quantile * np.sqrt(noise) + bent
    half = float(np.linalg.norm([half, step, _NORMAL_95 * blur]))
    glare = _glare(residual, w0, rho, dark, scale, print_)
    return Channel(
        np.where(seen, y - (w * rho).sum(1) * inverse * glare, 0.0),
        np.where(seen, scale**2 * inverse, UNKNOWN_VARIANCE),
        seen,
        condition,
        "",
        b,
        (b + min(off, 0.0) - half, b + max(off, 0.0) + half),
        scale,
    )


def _apart(column: ndarray, w: ndarray, rho: ndarray, inverse: ndarray) -> ndarray:
    """What is left of a column (t, p) once every y_t is eliminated."""
    return column - rho * ((w * rho * column).sum(1) * inverse)[:, None]


def _glare(
    residual: ndarray,
    w: ndarray,
    rho: ndarray,
    dark: ndarray,
    scale: float,
    print_: ndarray,
) -> ndarray:
    """(t,) by which most dark and most bright patches of a reading are off alike: a highlight
    on a glossy print. Only what is far from the print's usual offset.

    residual, dark : (t, p);  w, rho, scale : of the solution
    """
    values, usable = np.stack([residual, rho]), w > 0
    (ink, ink_rho), (paper, paper_rho) = (
        np.ma.median(np.ma.array(values, mask=[~part] * 2), axis=2).filled(np.nan)
        for part in (usable & dark, usable & ~dark)
    )
    offset = divide(ink * paper_rho - paper * ink_rho, paper_rho - ink_rho)
    sure = usable.mean(1) >= MOST_SEEN
    for one in np.unique(print_[sure]):
        offset[print_ == one] -= np.median(offset[sure & (print_ == one)])
    own = scale * np.sqrt(divide(1.0, (w * dark).sum(1)))
    usual = 1.4826 * np.median(np.abs(offset[sure])) if sure.any() else 0.0
    beyond = np.clip(np.abs(offset) - GLARE * np.hypot(own, usual), 0, None)
    return np.where(sure, np.sign(offset) * beyond, 0.0)
