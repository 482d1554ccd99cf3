"""One channel of photometry_solve.py: robust least squares with every frame's light eliminated, and what to do without."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from arfx.core.numerics import divide

UNKNOWN_VARIANCE = 1e12  # of the light of a frame in which nothing was usable
ASSUMED_BIAS = 0.01  # standard deviation of a bias that nothing tells, linear light: about 10 dark grey levels
# Share of the information on b that is left once every y_t is eliminated, below which float64 has none of it.
LEAST_SHARE = 1e-12
WORST_BIAS = 0.1  # of the bright patches' median: a 95 % interval of b that is wider says nothing
LEAST_CONTRAST = 0.05  # of the bright patches' median that has to be light: less is haze, or no print at all
ENOUGH = 100  # frames that tell how much the bias depends on what is not known
_HUBER, _PASSES = 1.345, 25


def robust(
    grey: np.ndarray, w0: np.ndarray, rho: np.ndarray, dark: np.ndarray, known: bool, find_ink: bool, ink_sigma: float
) -> dict:  # fmt: skip
    """Shared bias. grey, w0, rho : (t, p) values, inverse variances (0 = not usable), albedos;  dark : (t, p) bool, ink

    known : the variances are;  find_ink : nothing is known of the ink's albedo
    ink_sigma : deviation of the ink's albedo from that in rho, 0 = exact. The solution takes the stated ink; the interval
        holds what an ink with this prior, solved for beside the bias, makes of the bias too. (Gloss and glare bend dark cells
        as another ink would, so that one found is no better an answer than the stated one.)
    """
    part = solved(grey, w0, rho, dark, known, find_ink, 0.0)
    if find_ink or ink_sigma == 0 or not part["determined"]:
        return part
    some = slice(None, None, max(1, len(grey) // ENOUGH))
    other = solved(grey[some], w0[some], rho[some], dark[some], known, False, ink_sigma)
    (low, high), bright = part["bias_95"], float(np.median(part["y"][part["seen"]]))
    if other["determined"] and other["ink"] != part["ink"]:
        low, high = min(low, other["bias_95"][0]), max(high, other["bias_95"][1])
    else:
        low, high = low - 1.96 * ink_sigma * bright, high + 1.96 * ink_sigma * bright
    return part | {"bias_95": (low, high)}


def solved(
    grey: np.ndarray, w0: np.ndarray, rho: np.ndarray, dark: np.ndarray, known: bool, find_ink: bool, ink_sigma: float
) -> dict:  # fmt: skip
    """As `robust`. ink_sigma : above 0 the ink is an unknown with this prior"""
    seen = (w0 > 0).any(1)
    count = int((w0 > 0).sum())
    both = bool((w0[dark] > 0).any() and (w0[~dark] > 0).any())
    free_ink, known_ink = find_ink and both, not find_ink and both and ink_sigma > 0
    unknowns = int(seen.sum()) + 1 + free_ink
    spare = count - unknowns
    if not count:
        return fallback(grey, w0, rho, "no patch is usable: all are clipped, missing or not finite", 0, 1e12)
    w, scale = w0.copy(), 1.0
    one_ink = free_ink or known_ink
    k = stated = float(rho[dark].mean()) if both else 0.0
    b, joint = 0.0, None
    for i in range(_PASSES):
        r = np.where(dark, k, rho) if one_ink else rho
        A, B, C = (w * r * r).sum(1), (w * r).sum(1), w.sum(1)
        inverse = divide(1.0, A)
        y0, lean = (w * r * grey).sum(1) * inverse, B * inverse  # y = y0 - lean * b
        left = float((C - B * lean).sum())
        share = left / max(float(C.sum()), 1e-300)
        if share < LEAST_SHARE:
            return fallback(grey, w0, rho, "all usable patches have one albedo", unknowns - 1 - free_ink, 1e12)
        before = b
        b = float((w * (grey - r * y0[:, None])).sum()) / left
        y = y0 - lean * b
        # for an ink that is known about, its first pass is one without it: the noise's scale makes the prior's weight
        if free_ink or (known_ink and i):
            prior = (scale / ink_sigma) ** 2 if known_ink else 0.0
            joint = _ink_step(grey, w, r, dark, inverse, b, y, prior, stated - k)
            if joint is None and free_ink:
                why = "albedos unknown and the light constant: bias and ink cannot be told apart"
                return fallback(grey, w0, rho, why, unknowns - 1, 1e12)
            if joint is not None:
                b, k = b + joint[0], k + joint[1]
                r = np.where(dark, k, rho)
                y = divide((w * r * (grey - b)).sum(1), (w * r * r).sum(1))
        z = (grey - r * y[:, None] - b) * np.sqrt(w0)
        size = float(np.median(np.abs(z[w0 > 0]))) / 0.6745 * np.sqrt(count / spare) if spare > 0 else 0.0
        scale = max(1.0, size) if known else size
        last, w = w, w0 * np.minimum(1.0, divide(_HUBER * scale, np.abs(z), where_zero=1.0))
        settled = abs(b - before) <= 1e-6 * max(abs(b), 1e-3 * float(np.abs(grey).max())) if one_ink else True
        if np.abs(w - last).max() <= 1e-6 * w0.max() and settled and i:
            break
    r = np.where(dark, k, rho) if one_ink else rho
    residual = grey - r * y[:, None] - b
    if joint is None:
        influence = w * residual * np.where(w > 0, 1 - r * lean[:, None], 0) / left  # on b, y_t eliminated
        noise_b = scale**2 / left  # if all residuals are independent; or by patch, or by frame
    else:
        slope = np.where(dark, y[:, None], 0.0) - r * ((w * r * np.where(dark, y[:, None], 0.0)).sum(1) * inverse)[:, None]
        inverse_S = joint[2]
        influence = w * residual * (inverse_S[0, 0] * (1 - r * lean[:, None]) + inverse_S[0, 1] * slope)
        noise_b = scale**2 * float(inverse_S[0, 0])
    groups = np.count_nonzero((w > 0).any(0))
    if spare > 0:
        noise_b = max(noise_b, (influence.sum(0) ** 2).sum() * groups / max(groups - 1, 1), (influence.sum(1) ** 2).sum())
    quantile = float(stdtrit(spare, 0.975)) if spare > 0 else 1.96
    top = np.where(w0 > 0, grey, -np.inf).max(1)
    level = float(np.median(top[seen]))
    bright = float(np.median(y[seen]))
    half = quantile * float(np.sqrt(noise_b))
    rank = unknowns if share >= LEAST_SHARE else unknowns - 1
    condition = float(np.sqrt((1 + np.sqrt(1 - min(share, 1.0))) / (1 - np.sqrt(1 - min(share, 1.0 - 1e-16)))))
    own = np.where(seen, scale**2 * inverse, 0)
    why = ""
    if level <= 0 or quantile * np.sqrt(noise_b) > WORST_BIAS * level:
        why = "no light" if level <= 3 * float(np.sqrt(divide(1.0, np.median(w0[w0 > 0])))) * known else "albedos too alike"
        why = f"{why}: the bias would be uncertain by {quantile * np.sqrt(noise_b):.2g} at a level of {max(level, 0):.2g}"
    elif np.median(y[seen]) < -3 * float(np.sqrt(np.median(own[seen]) + lean[seen].max() ** 2 * noise_b)):
        why = "dark cells are brighter than bright ones"
    elif bright * float(np.abs(rho).max()) < LEAST_CONTRAST * level:
        why = "bright and dark cells look alike"
    if why:
        return fallback(grey, w0, rho, why, rank, condition)
    return {
        "y": np.where(seen, y, 0.0), "var_y_own": np.where(seen, own, UNKNOWN_VARIANCE), "seen": seen, "bias": b,
        "var_y": np.where(seen, own + lean**2 * noise_b, UNKNOWN_VARIANCE), "bias_95": (b - half, b + half),
        "ink": k if one_ink else float(rho[dark].mean()) if dark.any() else float(rho.min()), "determined": True, "rank": rank,
        "unknowns": unknowns, "condition": min(condition, 1e12), "misfit": scale, "reason": "",
    }  # fmt: skip


def normalised(
    grey: np.ndarray, w0: np.ndarray, rho: np.ndarray, dark: np.ndarray, known: bool, ink_sigma: float
) -> dict:  # fmt: skip
    """Light of each frame from its own difference of bright and dark patches; the bias is what the dark ones have beside.

    Arguments as for `robust`. Frames with patches of one kind alone are not seen.
    """
    shared = robust(grey, w0, rho, dark, known, False, ink_sigma)
    if not shared["determined"]:
        return shared
    w = w0 / max(shared["misfit"] ** 2, 1e-300) if not known or shared["misfit"] > 1 else w0.copy()
    residual = np.where(w0 > 0, grey - rho * shared["y"][:, None] - shared["bias"], np.nan)
    sums = []
    for kind in (~dark, dark):  # Huber about the median of the kind in its frame
        part = np.where(kind & (w > 0), residual, np.nan)
        some = np.isfinite(part).any(1)
        middle = np.zeros(len(part))
        middle[some] = np.nanmedian(part[some], 1)
        z = np.abs(np.where(np.isfinite(part), part - middle[:, None], 0)) * np.sqrt(w)
        v = np.where(kind, w, 0) * np.minimum(1, divide(2 * _HUBER, z, where_zero=1.0))
        sums.append((v.sum(1), divide((v * grey).sum(1), v.sum(1)), divide((v * rho).sum(1), v.sum(1))))
    (wb, bright, rb), (wd, black, rd) = sums
    seen = (wb > 0) & (wd > 0)
    apart = np.where(seen, rb - rd, 1.0)
    y = np.where(seen, (bright - black) / apart, 0.0)
    own = np.where(seen, divide(divide(1, wb) + divide(1, wd), apart**2), UNKNOWN_VARIANCE)
    return shared | {"y": y, "var_y": own, "var_y_own": own, "seen": seen}


def _ink_step(
    grey: np.ndarray, w: np.ndarray, r: np.ndarray, dark: np.ndarray, inverse: np.ndarray, b: float, y: np.ndarray,
    prior: float, off: float,
) -> tuple[float, float, np.ndarray] | None:  # fmt: skip
    """Gauss-Newton step of (b, ink) with every y_t eliminated, and the inverse of their normal matrix; None where singular.

    prior : weight of the ink's stated albedo;  off : how far that is from the present one
    """
    jac = np.stack([np.ones_like(r), np.where(dark, y[:, None], 0.0)], -1)  # of the model, by b and ink
    cross = np.einsum("tp,tpi->ti", w * r, jac)
    S = np.einsum("tp,tpi,tpj->ij", w, jac, jac) - np.einsum("t,ti,tj->ij", inverse, cross, cross)
    residual = grey - r * y[:, None] - b
    g = np.einsum("tp,tpi->i", w * residual, jac) - cross.T @ ((w * r * residual).sum(1) * inverse)
    S[1, 1] += prior
    g[1] += prior * off
    scale = np.sqrt(np.maximum(np.diag(S), 0))
    if not scale.all() or not np.isfinite(S).all():
        return None
    unit = S / np.outer(scale, scale)
    if np.linalg.eigvalsh(unit)[0] < 1e-10:
        return None
    step = np.linalg.solve(unit, g / scale) / scale
    return float(step[0]), float(np.clip(step[1], -0.05, 0.05)), np.linalg.inv(unit) / np.outer(scale, scale)


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
