"""Light and camera bias out of the patches of many frames: I = g rho x_t + b per channel,
shared b, one light per frame.

The free scale is fixed (g = 1, so y_t = g x_t), b and y_t by robust least squares (Huber).
What cannot be solved is `degenerate`: then b = 0 is assumed and the light taken from the
bright patches alone. Nothing non-finite leaves.
Source: Tan, Chen, Sun 2009, eq. (2), (4) to (6); docs/methods/light.md#bias. Cost: 10,000
frames about .25 s.
"""

from __future__ import annotations

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
ENOUGH = 100  # frames that tell how much the bias depends on what is not known
_HUBER, _PASSES = 1.345, 25


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


class Tolerances(NamedTuple):
    """What is not exactly as stated. ink_sigma : standard deviation of the ink's albedo
    transfer : range by which the exponent of the camera's curve may be off
    steps : of 1/255 by which the coded values of all dark cells may be off together"""

    ink_sigma: float = INK_SIGMA
    transfer: float = TRANSFER
    steps: float = STEPS


def solve(
    intensity: np.ndarray,
    variance: np.ndarray | None = None,
    white: np.ndarray | None = None,
    albedo: np.ndarray | None = None,
    clipped: np.ndarray | None = None,
    tolerances: Tolerances | None = None,
) -> Photometry:
    """intensity : (t, p, 3) linear, NaN = not measured;  variance : (t, p, 3) or None =
    equal and unknown
    white : (p,) bool, or albedo : (p,), (t, p) or (t, p, 3) in its place;  clipped : (t, p)
    shares, for the report
    tolerances : go into bias_95; None = the usual ones, with `albedo` given none
    Raises ValueError for wrong shapes."""
    value = np.asarray(intensity, float)
    frames, patches, _ = value.shape
    if albedo is None:
        if white is None or np.shape(white) != (patches,):
            raise ValueError("white (p,) or albedo is needed")
        albedo, tolerances = np.where(white, PAPER, INK), tolerances or Tolerances()
    ink_sigma, transfer, steps = tolerances or Tolerances(0.0, 0.0, 0.0)
    every = of_channels(albedo, value.shape)
    weight, known_noise, ignored = weights(value, variance, every)
    fraction = float(np.mean(clipped)) if clipped is not None and np.size(clipped) else 0.0
    parts = []
    for c in range(3):
        grey, w, rho = (
            np.where(weight[..., c] > 0, value[..., c], 0.0),
            weight[..., c],
            every[..., c],
        )
        dark = (
            rho < (rho.min(1, keepdims=True) + rho.max(1, keepdims=True)) / 2
            if rho.size
            else np.zeros(rho.shape, bool)
        )
        part = solve_robust(grey, w, rho, dark, known_noise, ink_sigma)
        if part["determined"] and transfer > 0:
            # the interval is moved to what the bias is under other exponents of the camera's curve
            sparse, found = slice(None, None, max(1, frames // ENOUGH)), []
            few, size = grey[sparse], np.maximum(np.abs(grey[sparse]), 1e-4)
            for exponent in (1.0, 1 / (1 - transfer), 1 / (1 + transfer)):
                few_w = w[sparse] / (exponent * size ** (exponent - 1)) ** 2
                bent = np.sign(few) * np.abs(few) ** exponent
                found.append(
                    solve_channel(bent, few_w, rho[sparse], dark[sparse], known_noise, 0.0)
                )
            off = [
                f["bias"] - found[0]["bias"]
                for f in found
                if f["determined"] and found[0]["determined"]
            ] or [0.0]
            part["bias_95"] = part["bias_95"][0] + min(off), part["bias_95"][1] + max(off)
        if part["determined"] and steps > 0:
            level = float(np.median(grey[dark & (w > 0)]))
            # linear light per coded value: sRGB's slope, of which all curves are near enough
            slope = (
                float(2.4 / 1.055 * max(level, 0.0) ** (1 - 1 / 2.4))
                if level > 0.0031
                else 1 / 12.92
            )
            (low, high), middle = part["bias_95"], part["bias"]
            low, high = (
                float(np.hypot(away, steps / 255 * slope))
                for away in (middle - low, high - middle)
            )
            part["bias_95"] = middle - low, middle + high
        parts.append(part)
    return assemble(parts, fraction, ignored)


def of_channels(albedo: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Albedo (p,), (t, p) or (t, p, 3) as (t, p, 3)."""
    a = np.asarray(albedo, float)
    return np.broadcast_to(a if a.ndim == 3 else a[..., None], shape)


def weights(
    value: np.ndarray, variance: np.ndarray | None, rho: np.ndarray
) -> tuple[np.ndarray, bool, int]:
    """((t, p, 3) inverse variances, 0 = not usable; whether variances are known; number of
    patches that are not finite).

    rho : (t, p, 3) albedos"""
    fine = np.isfinite(value) & np.isfinite(rho)
    ignored = int((~np.isfinite(value)).any(-1).sum())
    if variance is None:
        return fine.astype(float), False, ignored
    v = np.asarray(variance, float)
    fine &= np.isfinite(v) & (v >= 0)
    usual = float(np.median(v[fine])) if fine.any() else 1.0
    floor = max(1e-4 * usual, 1e-18)  # no patch outweighs the usual one by more than 10,000
    return np.where(fine, 1 / np.maximum(np.where(fine, v, 1), floor), 0.0), True, ignored


def assemble(parts: list[dict], clipped: float, ignored: int) -> Photometry:
    """A Photometry of the channels' results."""
    reasons = {p["reason"] for p in parts}
    fine = all(p["determined"] for p in parts)
    text = (
        "; ".join(sorted(r for r in reasons if r))
        or "two albedos, bias and light determined"
    )
    if not fine:
        channels = "".join(
            name for name, p in zip("RGB", parts, strict=True) if not p["determined"]
        )
        text = f"{channels}: {text}; bias 0 assumed, light from the bright patches alone"
    columns = {k: np.stack([p[k] for p in parts], -1) for k in ("y", "var_y_own")}
    rows = {
        k: np.array([p[k] for p in parts])
        for k in ("bias", "ink", "determined", "rank", "unknowns", "condition", "misfit")
    }
    return Photometry(
        MEASURED if fine else DEGENERATE,
        text,
        seen=np.any([p["seen"] for p in parts], 0),
        **columns,
        **rows,
        bias_95=np.array([p["bias_95"] for p in parts]),
        clipped=clipped,
        ignored=ignored,
    )


def solve_robust(
    grey: np.ndarray,
    w0: np.ndarray,
    rho: np.ndarray,
    dark: np.ndarray,
    known: bool,
    ink_sigma: float,
) -> dict:
    """Shared bias. grey, w0, rho : (t, p) values, inverse variances (0 = not usable),
    albedos;  dark : (t, p) bool, ink

    known : the variances are
    ink_sigma : deviation of the ink's albedo from that in rho, 0 = exact. The solution
    takes the stated ink; the interval
        holds what an ink with this prior, solved for beside the bias, makes of the bias
        too. (Gloss and glare bend dark cells as another ink would, so that one found is no
        better an answer than the stated one.)
    """
    part = solve_channel(grey, w0, rho, dark, known, 0.0)
    if ink_sigma == 0 or not part["determined"]:
        return part
    sparse = slice(None, None, max(1, len(grey) // ENOUGH))
    other = solve_channel(
        grey[sparse], w0[sparse], rho[sparse], dark[sparse], known, ink_sigma
    )
    (low, high), bright = part["bias_95"], float(np.median(part["y"][part["seen"]]))
    if other["determined"] and other["ink"] != part["ink"]:
        low, high = min(low, other["bias_95"][0]), max(high, other["bias_95"][1])
    else:
        low, high = low - 1.96 * ink_sigma * bright, high + 1.96 * ink_sigma * bright
    return part | {"bias_95": (low, high)}


def _refusal(
    level: float, half: float, noise: float, bright: float, doubt: float, contrast: float
) -> str:
    """Why a solution says nothing, "" = it does. level, noise : of the picture;  half :
    width of the bias's interval
    bright, doubt : irradiance and three deviations of it;  contrast : between a print's cells
    """
    if level <= 0 or half > WORST_BIAS * level:
        why = "no light" if level <= noise else "albedos too alike"
        return (
            f"{why}: the bias would be uncertain by {half:.2g} at a level of"
            f" {max(level, 0):.2g}"
        )
    if bright < -doubt:
        return "dark cells are brighter than bright ones"
    return "bright and dark cells look alike" if contrast < LEAST_CONTRAST * level else ""


def solve_channel(
    grey: np.ndarray,
    w0: np.ndarray,
    rho: np.ndarray,
    dark: np.ndarray,
    known: bool,
    ink_sigma: float,
) -> dict:
    """As `solve_robust`. ink_sigma : above 0 the ink is an unknown with this prior"""
    seen = (w0 > 0).any(1)
    count = int((w0 > 0).sum())
    both = bool((w0[dark] > 0).any() and (w0[~dark] > 0).any())
    one_ink = both and ink_sigma > 0
    unknowns = int(seen.sum()) + 1
    spare = count - unknowns
    if not count:
        return fallback(
            grey,
            w0,
            rho,
            "no patch is usable: all are clipped, missing or not finite",
            0,
            1e12,
        )
    w, scale = w0.copy(), 1.0
    k = stated = float(rho[dark].mean()) if both else 0.0
    b, joint = 0.0, None
    for i in range(_PASSES):
        r = np.where(dark, rho + (k - stated), rho) if one_ink else rho
        A, B, C = (w * r * r).sum(1), (w * r).sum(1), w.sum(1)
        inverse = divide(1.0, A)
        y0, lean = (w * r * grey).sum(1) * inverse, B * inverse  # y = y0 - lean * b
        remaining = float((C - B * lean).sum())
        fraction = remaining / max(float(C.sum()), 1e-300)
        if fraction < LEAST_FRACTION:
            return fallback(
                grey,
                w0,
                rho,
                "all usable patches have one albedo",
                unknowns - 1,
                1e12,
            )
        before = b
        b = float((w * (grey - r * y0[:, None])).sum()) / remaining
        y = y0 - lean * b
        # for an ink that is known about, its first pass is one without it: the noise's
        # scale makes the prior's weight
        if one_ink and i:
            prior = (scale / ink_sigma) ** 2
            joint = _ink_step(grey, w, r, dark, inverse, b, y, prior, stated - k)
            if joint is not None:
                b, k = b + joint[0], k + joint[1]
                r = np.where(dark, rho + (k - stated), rho)
                y = divide((w * r * (grey - b)).sum(1), (w * r * r).sum(1))
        z = (grey - r * y[:, None] - b) * np.sqrt(w0)
        size = (
            float(np.median(np.abs(z[w0 > 0]))) / 0.6745 * np.sqrt(count / spare)
            if spare > 0
            else 0.0
        )
        scale = max(1.0, size) if known else size
        last, w = w, w0 * np.minimum(1.0, divide(_HUBER * scale, np.abs(z), where_zero=1.0))
        settled = (
            abs(b - before) <= 1e-6 * max(abs(b), 1e-3 * float(np.abs(grey).max()))
            if one_ink
            else True
        )
        if np.abs(w - last).max() <= 1e-6 * w0.max() and settled and i:
            break
    r = np.where(dark, rho + (k - stated), rho) if one_ink else rho
    residual = grey - r * y[:, None] - b
    if joint is None:
        influence = (
            w * residual * np.where(w > 0, 1 - r * lean[:, None], 0) / remaining
        )  # on b, y_t eliminated
        noise_b = (
            scale**2 / remaining
        )  # if all residuals are independent; or by patch, or by frame
    else:
        slope = (
            np.where(dark, y[:, None], 0.0)
            - r * ((w * r * np.where(dark, y[:, None], 0.0)).sum(1) * inverse)[:, None]
        )
        inverse_S = joint[2]
        influence = (
            w
            * residual
            * (inverse_S[0, 0] * (1 - r * lean[:, None]) + inverse_S[0, 1] * slope)
        )
        noise_b = scale**2 * float(inverse_S[0, 0])
    groups = np.count_nonzero((w > 0).any(0))
    if spare > 0:
        noise_b = max(
            noise_b,
            (influence.sum(0) ** 2).sum() * groups / max(groups - 1, 1),
            (influence.sum(1) ** 2).sum(),
        )
    quantile = _quantile(spare)
    top = np.where(w0 > 0, grey, -np.inf).max(1)
    level = float(np.median(top[seen]))
    bright = float(np.median(y[seen]))
    half = quantile * float(np.sqrt(noise_b))
    condition = float(
        np.sqrt(
            (1 + np.sqrt(1 - min(fraction, 1.0)))
            / (1 - np.sqrt(1 - min(fraction, 1.0 - 1e-16)))
        )
    )
    own = np.where(seen, scale**2 * inverse, 0)
    noise = 3 * float(np.sqrt(divide(1.0, np.median(w0[w0 > 0])))) * known
    doubt = 3 * float(np.sqrt(np.median(own[seen]) + lean[seen].max() ** 2 * noise_b))
    why = _refusal(level, half, noise, bright, doubt, bright * float(np.abs(rho).max()))
    if why:
        return fallback(grey, w0, rho, why, unknowns, condition)
    return {
        "y": np.where(seen, y, 0.0),
        "var_y_own": np.where(seen, own, UNKNOWN_VARIANCE),
        "seen": seen,
        "bias": b,
        "bias_95": (b - half, b + half),
        "ink": (
            k if one_ink else float(rho[dark].mean()) if dark.any() else float(rho.min())
        ),
        "determined": True,
        "rank": unknowns,
        "unknowns": unknowns,
        "condition": min(condition, 1e12),
        "misfit": scale,
        "reason": "",
    }


def _quantile(spare: float) -> float:
    """Of Student's distribution, two-sided 95 %."""
    from scipy.special import stdtrit

    return float(stdtrit(spare, 0.975)) if spare > 0 else 1.96


def _ink_step(
    grey: np.ndarray,
    w: np.ndarray,
    r: np.ndarray,
    dark: np.ndarray,
    inverse: np.ndarray,
    b: float,
    y: np.ndarray,
    prior: float,
    off: float,
) -> tuple[float, float, np.ndarray] | None:
    """Gauss-Newton step of (b, ink) with every y_t eliminated, and the inverse of their
    normal matrix; None where singular.

    prior : weight of the ink's stated albedo;  off : how far that is from the present one
    """
    jac = np.stack(
        [np.ones_like(r), np.where(dark, y[:, None], 0.0)], -1
    )  # of the model, by b and ink
    cross = np.einsum("tp,tpi->ti", w * r, jac)
    S = np.einsum("tp,tpi,tpj->ij", w, jac, jac) - np.einsum(
        "t,ti,tj->ij", inverse, cross, cross
    )
    residual = grey - r * y[:, None] - b
    g = np.einsum("tp,tpi->i", w * residual, jac) - cross.T @ (
        (w * r * residual).sum(1) * inverse
    )
    S[1, 1] += prior
    g[1] += prior * off
    scale = np.sqrt(np.maximum(np.diag(S), 0))
    if not scale.all() or not np.isfinite(S).all():
        return None
    unit = S / np.outer(scale, scale)
    if np.linalg.eigvalsh(unit)[0] < 1e-10:
        return None
    step = np.linalg.solve(unit, g / scale) / scale
    return (
        float(step[0]),
        float(np.clip(step[1], -0.05, 0.05)),
        np.linalg.inv(unit) / np.outer(scale, scale),
    )


def fallback(
    grey: np.ndarray, w: np.ndarray, rho: np.ndarray, why: str, rank: int, condition: float
) -> dict:
    """Bias 0 assumed; light from the brightest albedo's patches, of a frame's others where
    it has none of them.
    """
    seen = (w > 0).any(1)
    usable = np.where(w > 0, rho, -1.0)
    take = w * (usable >= usable.max(1, keepdims=True) * (1 - 1e-2)) if rho.size else w
    information = (take * rho * rho).sum(1)
    y = divide((take * rho * grey).sum(1), information)
    own = np.where(seen & (information > 0), divide(1.0, information), UNKNOWN_VARIANCE)
    return {
        "y": y,
        "var_y_own": own,
        "seen": seen,
        "bias": 0.0,
        "bias_95": (-1.96 * ASSUMED_BIAS, 1.96 * ASSUMED_BIAS),
        "ink": float(rho.min()) if rho.size else 0.0,
        "determined": False,
        "rank": rank,
        "unknowns": int(seen.sum()) + 1,
        "condition": min(condition, 1e12),
        "misfit": 1.0,
        "reason": why,
    }
