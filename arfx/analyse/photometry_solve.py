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

from arfx.analyse.photometry_channel import ENOUGH, normalised, robust, solved

MEASURED, DEGENERATE = "measured", "degenerate"
INK, PAPER = 0.05, 0.88  # albedos of print
INK_SIGMA = 0.01  # of the ink's, beside a paper of .88: .03 to .07
TRANSFER = 0.08  # by so much the exponent of the camera's curve may be another than stated
# Coded steps of 1/255 by which all dark cells of a clip may be off together: half a step of chroma is 1 of blue, and a codec
# leaves smooth chroma where its rounding put it.
STEPS = 1.5


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
    ink: float = INK, paper: float = PAPER, ink_sigma: float = INK_SIGMA, transfer: float = TRANSFER,
    steps: float = STEPS,
) -> Photometry:  # fmt: skip
    """The `corrected` formula.

    intensity : (t, p, 3) linear, NaN = not measured;  variance : (t, p, 3) or None = equal and unknown
    white : (p,) bool, or albedo : (p,) or (t, p) in its place;  clipped : (t, p) shares, for the report
    albedos : "known" (ink, paper); "normalised" (light from each frame's own difference of paper and ink, so that its
        ratios are right whatever the ink and the bias are; noisier; the bias still takes the ink's albedo); "unknown" (the
        ink's albedo is solved per channel beside b, which takes light that changes)
    ink_sigma : standard deviation of the ink's albedo, goes into bias_95; 0 with `albedo` given
    transfer : range by which the exponent of the camera's curve may be off, goes into bias_95
    steps : of 1/255 by which the coded values of all dark cells may be off together; goes there too
    Raises ValueError for wrong shapes.
    """
    value = np.asarray(intensity, float)
    frames, patches, _ = value.shape
    if albedos not in ("known", "normalised", "unknown"):
        raise ValueError(f"albedos {albedos!r} is not known, normalised or unknown")
    if albedo is None:
        if white is None or np.shape(white) != (patches,):
            raise ValueError("white (p,) or albedo is needed")
        albedo = np.where(white, paper, ink)
    else:
        ink_sigma = transfer = steps = 0.0
    rho = np.broadcast_to(np.asarray(albedo, float), (frames, patches))
    weight, known_noise, ignored = weights(value, variance, rho)
    share = float(np.mean(clipped)) if clipped is not None and np.size(clipped) else 0.0
    dark = rho < (rho.min() + rho.max()) / 2 if rho.size else np.zeros(rho.shape, bool)
    parts = []
    for c in range(3):
        grey, w = np.where(weight[..., c] > 0, value[..., c], 0.0), weight[..., c]
        if albedos == "normalised":
            part = normalised(grey, w, rho, dark, known_noise, ink_sigma)
        else:
            part = robust(grey, w, rho, dark, known_noise, albedos == "unknown", ink_sigma)
        if part["determined"] and transfer > 0:
            part["bias_95"] = _with_other_curves(part, grey, w, rho, dark, known_noise, albedos == "unknown", transfer)
        if part["determined"] and steps > 0:
            level = float(np.median(grey[dark & (w > 0)]))
            part["bias_95"] = _widened(part["bias_95"], part["bias"], steps / 255 * slope_of_code(level))
        parts.append(part)
    return assemble("corrected", parts, share, ignored)


def _with_other_curves(
    part: dict, grey: np.ndarray, w: np.ndarray, rho: np.ndarray, dark: np.ndarray, known: bool, find_ink: bool,
    transfer: float,
) -> tuple[float, float]:  # fmt: skip
    """The bias's interval, moved to what the bias is under other exponents of the camera's curve. Arguments as for `robust`."""
    low, high = part["bias_95"]
    some = slice(None, None, max(1, len(grey) // ENOUGH))
    grey, w, rho, dark = grey[some], w[some], rho[some], dark[some]
    size = np.maximum(np.abs(grey), 1e-4)
    found = []
    for exponent in (1.0, 1 / (1 - transfer), 1 / (1 + transfer)):
        slope = exponent * size ** (exponent - 1)
        value = np.sign(grey) * np.abs(grey) ** exponent
        found.append(solved(value, w / slope**2, rho, dark, known, find_ink, 0.0))
    off = [f["bias"] - found[0]["bias"] for f in found if f["determined"] and found[0]["determined"]] or [0.0]
    return low + min(off), high + max(off)


def _widened(interval: tuple[float, float], middle: float, by: float) -> tuple[float, float]:
    low, high = middle - interval[0], interval[1] - middle
    return middle - float(np.hypot(low, by)), middle + float(np.hypot(high, by))


def slope_of_code(level: float) -> float:
    """Linear light per coded value at a linear level: sRGB's, of which all curves are near enough."""
    return float(2.4 / 1.055 * max(level, 0.0) ** (1 - 1 / 2.4)) if level > 0.0031 else 1 / 12.92


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
