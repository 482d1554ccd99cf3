"""Light and camera bias out of the patches of many frames: I = g rho x_t + b per channel, shared b, one light per frame.

`corrected`: the free scale is fixed (g = 1, so y_t = g x_t), b and y_t by robust least squares (Huber). The normal
matrix is an arrow: every y_t is eliminated and a 1 x 1 Schur complement remains (2 x 2 where the ink's albedo is
unknown too), O(frames x patches). `paper`: the smallest singular vector of the homogeneous system (photometry_paper).
What cannot be solved is told by its rank and by the uncertainty that it would have, and reported as `degenerate`; then
b = 0 is assumed and the light taken from the bright patches alone. Nothing non-finite leaves.
Source: Tan, Chen, Sun 2010, eq. (2), (4) to (6); corrections: SYSTEMS.md S1.
Cost: 10,000 frames x 8 patches x 3 channels about .25 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from arfx.core.numerics import divide

MEASURED, DEGENERATE = "measured", "degenerate"
INK, PAPER, INK_SIGMA = 0.05, 0.88, 0.006  # albedos of print: ink .04 to .06 (its uniform deviation), paper .85 to .9
UNKNOWN_VARIANCE = 1e12  # of the light of a frame in which nothing was usable
ASSUMED_BIAS = 0.01  # standard deviation of a bias that nothing tells, linear light: about 10 dark grey levels
# Share of the information on b that is left once every y_t is eliminated, below which float64 has none of it.
LEAST_SHARE = 1e-12
WORST_BIAS = 0.1  # of the bright patches' median: a 95 % interval of b that is wider says nothing
_HUBER, _PASSES = 1.345, 25


@dataclass(frozen=True, eq=False)
class Photometry:
    """Solution over t observations (a marker in a frame). All finite.

    y : (t, 3) light g x_t, in units of the radiance of a white diffuse surface; noise may bring it below 0
    var_y : (t, 3) its variance with that of the bias;  var_y_own : (t, 3) without (errors of b are shared by all frames)
    seen : (t,) False where nothing was usable (y 0, variance UNKNOWN_VARIANCE)
    bias : (3,);  bias_95 : (3, 2) interval, the ink's tolerance included;  ink : (3,) albedo used or found
    determined : (3,) False where the channel's bias is assumed, not solved
    rank, unknowns : (3,) of the linear system;  condition : (3,) of its columns scaled to length 1, at most 1e12
    misfit : (3,) residuals in units of their stated deviations;  clipped : share of samples;  ignored : patches not finite
    verdict : "measured" or "degenerate";  reason : in words
    """

    formula: str
    verdict: str
    reason: str
    y: np.ndarray
    var_y: np.ndarray
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


def solve(
    intensity: np.ndarray, variance: np.ndarray | None = None, white: np.ndarray | None = None,
    albedo: np.ndarray | None = None, clipped: np.ndarray | None = None, albedos: str = "known",
    ink: float = INK, paper: float = PAPER, ink_sigma: float = INK_SIGMA,
) -> Photometry:  # fmt: skip
    """The `corrected` formula.

    intensity : (t, p, 3) linear, NaN = not measured;  variance : (t, p, 3) or None = equal and unknown
    white : (p,) bool, or albedo : (p,) or (t, p) in its place;  clipped : (t, p) shares, for the report
    albedos : "known" (ink, paper); "normalised" (0 and 1: y is the light of paper above ink, and b holds what the ink
        gives back: use it where the print is unknown and only ratios count); "unknown" (the ink's albedo is solved per
        channel beside b, which takes light that changes)
    ink_sigma : standard deviation of the ink's albedo, goes into bias_95
    Raises ValueError for wrong shapes.
    """
    value = np.asarray(intensity, float)
    frames, patches, _ = value.shape
    if albedos == "normalised":
        ink, paper, ink_sigma = 0.0, 1.0, 0.0
    if albedo is None:
        if white is None or np.shape(white) != (patches,):
            raise ValueError("white (p,) or albedo is needed")
        albedo = np.where(white, paper, ink)
    rho = np.broadcast_to(np.asarray(albedo, float), (frames, patches))
    weight, known_noise, ignored = weights(value, variance, rho)
    share = float(np.mean(clipped)) if clipped is not None and np.size(clipped) else 0.0
    dark = rho < (rho.min() + rho.max()) / 2 if rho.size else np.zeros(rho.shape, bool)
    parts = [
        _channel(np.where(weight[..., c] > 0, value[..., c], 0.0), weight[..., c], rho, dark, known_noise, albedos, ink_sigma)
        for c in range(3)
    ]
    return assemble("corrected", parts, share, ignored)


def weights(value: np.ndarray, variance: np.ndarray | None, rho: np.ndarray) -> tuple[np.ndarray, bool, int]:
    """((t, p, 3) inverse variances, 0 = not usable; whether variances are known; number of patches that are not finite)."""
    fine = np.isfinite(value) & np.isfinite(rho)[..., None]
    ignored = int((~np.isfinite(value)).any(-1).sum())
    if variance is None:
        return fine.astype(float), False, ignored
    v = np.asarray(variance, float)
    fine &= np.isfinite(v) & (v >= 0)
    usual = float(np.median(v[fine])) if fine.any() else 1.0
    floor = max(1e-4 * usual, 1e-18)  # no patch outweighs the usual one by more than 10,000
    return np.where(fine, 1 / np.maximum(np.where(fine, v, 1), floor), 0.0), True, ignored


def assemble(formula: str, parts: list[dict], clipped: float, ignored: int) -> Photometry:
    """A Photometry of the channels' results."""
    reasons = {p["reason"] for p in parts}
    fine = all(p["determined"] for p in parts)
    text = "; ".join(sorted(r for r in reasons if r)) or "two albedos, bias and light determined"
    if not fine:
        channels = "".join(name for name, p in zip("RGB", parts, strict=True) if not p["determined"])
        text = f"{channels}: {text}; bias 0 assumed, light from the bright patches alone"
    columns = {k: np.stack([p[k] for p in parts], -1) for k in ("y", "var_y", "var_y_own")}
    rows = {k: np.array([p[k] for p in parts]) for k in ("bias", "ink", "determined", "rank", "unknowns", "condition", "misfit")}
    return Photometry(
        formula, MEASURED if fine else DEGENERATE, text, seen=np.any([p["seen"] for p in parts], 0), **columns, **rows,
        bias_95=np.array([p["bias_95"] for p in parts]), clipped=clipped, ignored=ignored,
    )  # fmt: skip


def _channel(
    grey: np.ndarray, w0: np.ndarray, rho: np.ndarray, dark: np.ndarray, known: bool, albedos: str, ink_sigma: float
) -> dict:  # fmt: skip
    """One channel. grey, w0, rho, dark : (t, p). See Photometry for what comes back."""
    seen = (w0 > 0).any(1)
    count = int((w0 > 0).sum())
    free_ink = albedos == "unknown" and bool((w0[dark] > 0).any() and (w0[~dark] > 0).any())
    unknowns = int(seen.sum()) + 1 + free_ink
    spare = count - unknowns
    if not count:
        return fallback(grey, w0, rho, "no patch is usable: all are clipped, missing or not finite", 0, 1e12)
    w, scale = w0.copy(), 1.0
    k = float(rho[dark].mean()) if free_ink else 0.0
    for _ in range(_PASSES):
        r = np.where(dark, k, rho) if free_ink else rho
        A, B, C = (w * r * r).sum(1), (w * r).sum(1), w.sum(1)
        inverse = divide(1.0, A)
        y0, lean = (w * r * grey).sum(1) * inverse, B * inverse  # y = y0 - lean * b
        left = float((C - B * lean).sum())
        share = left / max(float(C.sum()), 1e-300)
        if share < LEAST_SHARE:
            return fallback(grey, w0, rho, "all usable patches have one albedo", unknowns - 1 - free_ink, 1e12)
        b = float((w * (grey - r * y0[:, None])).sum()) / left
        y = y0 - lean * b
        spread_b = 1 / left
        if free_ink:
            joint = _ink_step(grey, w, r, dark, inverse, b, y)
            if joint is None:
                why = "albedos unknown and the light constant: bias and ink cannot be told apart"
                return fallback(grey, w0, rho, why, unknowns - 1, 1e12)
            db, dk, spread_b = joint
            b, k = b + db, k + dk
            r = np.where(dark, k, rho)
            y = divide((w * r * (grey - b)).sum(1), (w * r * r).sum(1))
        z = (grey - r * y[:, None] - b) * np.sqrt(w0)
        size = float(np.median(np.abs(z[w0 > 0]))) / 0.6745 * np.sqrt(count / spare) if spare > 0 else 0.0
        scale = max(1.0, size) if known else size
        last, w = w, w0 * np.minimum(1.0, divide(_HUBER * scale, np.abs(z), where_zero=1.0))
        if np.abs(w - last).max() <= 1e-6 * w0.max() and not free_ink:
            break
    r = np.where(dark, k, rho) if free_ink else rho
    score = w * (grey - r * y[:, None] - b) * np.where(w > 0, 1 - r * lean[:, None], 0)  # of b, y_t eliminated
    groups = np.count_nonzero((w > 0).any(0))
    noise_b = scale**2 * spread_b  # if all residuals are independent; or by patch, or by frame
    if spare > 0:
        noise_b = max(noise_b, ((score.sum(0) * spread_b) ** 2).sum() * groups / max(groups - 1, 1))
        noise_b = max(noise_b, ((score.sum(1) * spread_b) ** 2).sum())
    quantile = float(student.ppf(0.975, spare)) if spare > 0 else 1.96
    top = np.where(w0 > 0, grey, -np.inf).max(1)
    level = float(np.median(top[seen]))
    bright = float(np.median(y[seen]))
    half = quantile * float(np.sqrt(noise_b + (0 if free_ink else ink_sigma * bright) ** 2))
    rank = unknowns if share >= LEAST_SHARE else unknowns - 1
    condition = float(np.sqrt((1 + np.sqrt(1 - min(share, 1.0))) / (1 - np.sqrt(1 - min(share, 1.0 - 1e-16)))))
    own = np.where(seen, scale**2 * inverse, 0)
    why = ""
    if level <= 0 or quantile * np.sqrt(noise_b) > WORST_BIAS * level:
        why = "no light" if level <= 3 * float(np.sqrt(divide(1.0, np.median(w0[w0 > 0])))) * known else "albedos too alike"
        why = f"{why}: the bias would be uncertain by {quantile * np.sqrt(noise_b):.2g} at a level of {max(level, 0):.2g}"
    elif np.median(y[seen]) < -3 * float(np.sqrt(np.median(own[seen]) + lean[seen].max() ** 2 * noise_b)):
        why = "dark cells are brighter than bright ones"
    if why:
        return fallback(grey, w0, rho, why, rank, condition)
    return {
        "y": np.where(seen, y, 0.0), "var_y_own": np.where(seen, own, UNKNOWN_VARIANCE), "seen": seen, "bias": b,
        "var_y": np.where(seen, own + lean**2 * noise_b, UNKNOWN_VARIANCE), "bias_95": (b - half, b + half),
        "ink": k if free_ink else float(rho[dark].mean()) if dark.any() else float(rho.min()), "determined": True, "rank": rank,
        "unknowns": unknowns, "condition": min(condition, 1e12), "misfit": scale, "reason": "",
    }  # fmt: skip


def _ink_step(
    grey: np.ndarray, w: np.ndarray, r: np.ndarray, dark: np.ndarray, inverse: np.ndarray, b: float, y: np.ndarray
) -> tuple[float, float, float] | None:
    """Gauss-Newton step of (b, ink) with every y_t eliminated, and the variance of b; None where singular."""
    jac = np.stack([np.ones_like(r), np.where(dark, y[:, None], 0.0)], -1)  # of the model, by b and ink
    cross = np.einsum("tp,tpi->ti", w * r, jac)
    S = np.einsum("tp,tpi,tpj->ij", w, jac, jac) - np.einsum("t,ti,tj->ij", inverse, cross, cross)
    residual = grey - r * y[:, None] - b
    g = np.einsum("tp,tpi->i", w * residual, jac) - cross.T @ ((w * r * residual).sum(1) * inverse)
    scale = np.sqrt(np.maximum(np.diag(S), 0))
    if not scale.all() or not np.isfinite(S).all():
        return None
    unit = S / np.outer(scale, scale)
    if np.linalg.eigvalsh(unit)[0] < 1e-10:
        return None
    step = np.linalg.solve(unit, g / scale) / scale
    return float(step[0]), float(np.clip(step[1], -0.05, 0.05)), float(np.linalg.inv(unit)[0, 0] / scale[0] ** 2)


def fallback(grey: np.ndarray, w: np.ndarray, rho: np.ndarray, why: str, rank: int, condition: float) -> dict:
    """Bias 0 assumed; light from the brightest albedo's patches, of a frame's others where it has none of them."""
    seen = (w > 0).any(1)
    usable = np.where(w > 0, rho, -1.0)
    take = w * (usable >= usable.max(1, keepdims=True) * (1 - 1e-2)) if rho.size else w
    information = (take * rho * rho).sum(1)
    y = divide((take * rho * grey).sum(1), information)
    lean = divide((take * rho).sum(1), information)
    own = np.where(seen & (information > 0), divide(1.0, information), UNKNOWN_VARIANCE)
    return {
        "y": y, "var_y_own": own, "var_y": np.minimum(own + (lean * ASSUMED_BIAS) ** 2, UNKNOWN_VARIANCE), "seen": seen,
        "bias": 0.0, "bias_95": (-1.96 * ASSUMED_BIAS, 1.96 * ASSUMED_BIAS), "ink": float(rho.min()) if rho.size else 0.0,
        "determined": False, "rank": rank, "unknowns": int(seen.sum()) + 1, "condition": min(condition, 1e12),
        "misfit": 1.0, "reason": why,
    }  # fmt: skip
