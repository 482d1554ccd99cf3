"""The lens that a clip was filmed with, from the blur of edges at known distances; refused
where they do not determine it.

An edge that a disc of radius r blurs has the standard deviation r / 2, and r = k |d - f|
with the dioptre d of its distance, the focus dioptre f and k px a dioptre; what the lens
and the sensor blur in the focus, s0, adds in squares: s^2 = s0^2 + (k / 2)^2 (d - f)^2.
That is a parabola in d: linear least squares, no start value, no pole at infinity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.core.codec import Document, Unbounded
from arfx.core.numerics import condition, divide

MIN_EDGES = 8
MAX_CONDITION = 1e6  # of the normal matrix in scaled dioptres: float64 leaves 10 digits
# residuals beyond this many standard deviations count linearly: motion blurs some frames
_HUBER = 1.5
_ITERATIONS = 20


@dataclass(frozen=True, slots=True)
class LensFit(Document):
    """known : whether the footage determines it;  reason : why not, or how well
    px_per_dioptre : radius of the blur circle by the distance from the focus, 1/m;  focus :
    dioptre, 1/m
    sharp_px : standard deviation of an edge in the focus
    focus_ci95, px_per_dioptre_ci95 : half widths of the 95 % intervals"""

    known: bool
    reason: str
    px_per_dioptre: float = 0.0
    focus: float = 0.0
    sharp_px: float = 0.0
    px_per_dioptre_ci95: Unbounded = float("inf")
    focus_ci95: Unbounded = float("inf")


def lens_from_blur(
    dioptre: np.ndarray, blur_px: np.ndarray, sigma_px: np.ndarray | float = 0.1
) -> LensFit:
    """Fit a lens.
    dioptre : (n,) 1 / distance of edges, 1/m;  blur_px : (n,) standard deviation of each
    sigma_px : of blur_px, one or (n,);  values that are not finite are left out"""
    d, blur, sigma = np.broadcast_arrays(
        np.asarray(dioptre, float), np.asarray(blur_px, float), np.asarray(sigma_px, float)
    )
    ok = (
        np.isfinite(d)
        & np.isfinite(blur)
        & np.isfinite(sigma)
        & (d > 0)
        & (blur > 0)
        & (sigma > 0)
    )
    d, blur, sigma = d[ok], blur[ok], sigma[ok]
    if len(d) < MIN_EDGES:
        return LensFit(
            False,
            f"{len(d)} edges of known distance and blur, at least {MIN_EDGES} are needed",
        )
    middle, spread = float(d.mean()), float(np.percentile(d, 95) - np.percentile(d, 5))
    if spread < 1e-6 * middle:
        return LensFit(
            False, "the markers are all at one distance: any focus explains the blur"
        )
    x = (d - middle) / spread
    a = np.stack([np.ones_like(x), x, x * x], 1)
    error = 2 * blur * sigma  # of s^2
    weight = np.ones_like(x)
    for _ in range(_ITERATIONS):
        w = weight / error**2
        normal = a.T @ (w[:, None] * a)
        if condition(normal / normal[0, 0]) > MAX_CONDITION:
            return LensFit(
                False, "the markers' distances do not separate a parabola from a line"
            )
        p = np.linalg.solve(normal, a.T @ (w * blur * blur))
        residual = np.abs(blur * blur - a @ p) / error
        weight = np.minimum(1.0, divide(_HUBER, residual, where_zero=1.0))
    scatter = max(
        float(np.sqrt((weight * residual**2).sum() / max(weight.sum() - 3, 1.0))), 1.0
    )
    covariance = np.linalg.inv(normal) * scatter**2
    if not p[2] > 3 * np.sqrt(covariance[2, 2]):
        why = "the blur does not grow away from any one distance beyond its noise"
        return LensFit(False, f"{why}: distances differ by {100 * spread / middle:.1f} %")
    focus_x = -p[1] / (2 * p[2])
    slope = np.array([0.0, -1 / (2 * p[2]), p[1] / (2 * p[2] ** 2)])  # of `at` by p
    focus_x_error = float(np.sqrt(slope @ covariance @ slope))
    k = 2 * np.sqrt(p[2]) / spread
    k_error = float(np.sqrt(covariance[2, 2]) / np.sqrt(p[2]) / spread)
    focus = middle + spread * focus_x
    base = p[0] - p[1] ** 2 / (4 * p[2])
    slope = np.array(
        [1.0, -p[1] / (2 * p[2]), p[1] ** 2 / (4 * p[2] ** 2)]
    )  # of `base` by p
    if base < -3 * float(np.sqrt(slope @ covariance @ slope)):
        return LensFit(
            False,
            "the blur grows faster with distance than a lens's: something else blurs some"
            " edges",
        )
    ci = 1.96 * spread * focus_x_error
    if ci > 0.5 * middle or focus < -ci:
        return LensFit(
            False,
            f"the focus is somewhere within {focus - ci:.2g} to {focus + ci:.2g} dioptres:"
            " not known",
        )
    focus = max(float(focus), 0.0)
    words = (
        f"focus at {focus:.3g} +- {ci:.2g} dioptres, {k:.3g} +- {1.96 * k_error:.2g} px a"
        f" dioptre, from {len(d)} edges"
    )
    return LensFit(
        True, words, float(k), focus, float(np.sqrt(max(base, 0.0))), 1.96 * k_error, ci
    )
