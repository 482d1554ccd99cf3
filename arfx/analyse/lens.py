"""The lens that a clip was filmed with, from the blur of its markers' sides against their
distance; refused where they do not determine it.

Blur is the standard deviation of a side's mean profile of gradients, under a Gaussian
window whose own narrowing is taken out, in linear light. Sides that move across themselves
count less, or not at all: motion blurs them too. Both halves of the clip have to give the
same lens.

An edge that a disc of radius r blurs has the standard deviation r / 2, and r = k |d - f|
with the dioptre d of its distance, the focus dioptre f and k px a dioptre; what the lens
and the sensor blur in the focus, s0, adds in squares: s^2 = s0^2 + (k / 2)^2 (d - f)^2.
That is a parabola in d: a linear problem, no pole at infinity."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy import ndarray

from arfx.analyse.job import Analysis
from arfx.analyse.markers.edges import FRACTIONS
from arfx.analyse.markers.search import Sighting, refined_in
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.lens import LensFit
from arfx.core.marker import Marker
from arfx.core.numerics import condition, divide, normalise
from arfx.core.pose import Pose

MOST_MOTION_PX = 3.0  # across a side from frame to frame
_SIGMA_PX, _SIGMA_FRACTION = (
    0.06,
    0.04,
)  # of a measured blur: noise, and what is not a disc
MIN_EDGES = 8
MAX_CONDITION = (
    1e6  # of the normal matrix in scaled dioptres: float64 leaves 10 digits
)
# residuals beyond this many standard deviations count linearly: motion blurs some frames
_HUBER = 1.5


def with_lens(
    clip: Analysis, prints: Sequence[Sighting], markers: Sequence[Marker]
) -> Analysis:
    """The clip with `lens` in every frame, and the fit in summary["footage_lens"]."""
    transfer = clip.summary["edge_transfer"]
    seen = refined_in(transfer, prints)
    fit = footage_lens(clip.facts, seen, markers, clip.world_from_marker)
    notice = (
        None
        if fit.known
        else f"the lens cannot be measured from the footage: {fit.reason}"
    )
    return clip.adding(
        (f.with_(lens=fit) for f in clip.facts), notice, footage_lens=fit.to_json()
    )


def footage_lens(
    facts: Sequence[FrameFacts],
    prints: Sequence[Sighting],
    markers: Sequence[Marker],
    world_from_marker: Mapping[str, Pose],
) -> LensFit:
    corners_m = {m.key: m.corners_m for m in markers}
    before = {(s.frame + 1, s.print.key): s.print.corners_px for s in prints}
    rows = []
    for number, _, _, seen in prints:
        key, corners, blurs = seen.key, seen.corners_px, seen.side_blurs_px
        fact = facts[number]
        if fact.status != MEASURED or key not in world_from_marker:
            continue
        shift = corners - before.get((number, key), corners)
        z = (fact.pose @ world_from_marker[key]).apply(corners_m[key])[:, 2]
        for side in np.flatnonzero(np.isfinite(blurs)):
            ends = [side, (side + 1) % 4]
            (a, b), along = z[ends], normalise(corners[ends[1]] - corners[side])
            across = np.abs(shift[ends] @ [-along[1], along[0]]).max()
            if min(a, b) > 0 and across <= MOST_MOTION_PX:
                dioptre = np.mean(1 / (a + (b - a) * FRACTIONS))
                rows.append((number, dioptre, blurs[side], across))
    frame, dioptre, blur, moved = (
        np.array(rows, float).reshape(-1, 4).T
    )  # of every usable side
    # a shutter that is open for up to all of the time adds up to moved^2 / 12 to the variance
    sigma = _SIGMA_PX + _SIGMA_FRACTION * blur + divide(moved**2, 24 * blur)
    fit = lens_from_blur(dioptre, blur, sigma)
    if not fit.known:
        return fit
    middle = np.median(frame)
    early, late = (
        lens_from_blur(dioptre[half], blur[half], sigma[half])
        for half in (frame < middle, frame >= middle)
    )
    # a half that does not tell has an interval without end
    allowed = 1.5 * np.hypot(early.focus_ci95, late.focus_ci95) + 0.05 * fit.focus
    if abs(early.focus - late.focus) <= allowed:
        return fit
    words = (
        f"the focus moves: {early.focus:.3g} and {late.focus:.3g} dioptres in the two halves"
        " of the clip"
    )
    return replace(fit, known=False, reason=words)


def lens_from_blur(
    dioptre: ndarray, blur_px: ndarray, sigma_px: ndarray | float = 0.1
) -> LensFit:
    """Fit a lens.
    dioptre : (n,) 1 / distance of edges, 1/m;  blur_px : (n,) standard deviation of each
    sigma_px : of blur_px, one or (n,);  values that are not finite are left out"""
    from scipy.optimize import least_squares

    rows = np.stack(np.broadcast_arrays(dioptre, blur_px, sigma_px)).astype(float)
    d, blur, sigma = rows[:, (np.isfinite(rows) & (rows > 0)).all(0)]
    if len(d) < MIN_EDGES:
        known = f"{len(d)} edges of known distance and blur"
        return LensFit(False, f"{known}, at least {MIN_EDGES} are needed")
    middle, spread = float(d.mean()), float(np.subtract(*np.percentile(d, (95, 5))))
    error = 2 * blur * sigma  # of blur squared
    a = np.vander(divide(d - middle, spread), 3) / error[:, None]
    if spread < 1e-6 * middle or condition(a.T @ a) > MAX_CONDITION:
        why = "the markers' distances do not separate a parabola from a line"
        return LensFit(False, f"{why}: any focus explains the blur")
    b = blur**2 / error
    p = least_squares(
        lambda p: a @ p - b,
        np.linalg.lstsq(a, b)[0],
        lambda p: a,
        loss="huber",
        f_scale=_HUBER,
        xtol=1e-12,
    ).x
    missed = np.abs(a @ p - b)
    weight = np.minimum(1.0, divide(_HUBER, missed, where_zero=1.0))
    scatter = max((weight * missed**2).sum() / max(weight.sum() - 3, 1.0), 1.0)
    covariance = np.linalg.inv(a.T @ (weight[:, None] * a)) * scatter
    growth, slope, level = p.tolist()
    if not growth > 3 * np.sqrt(covariance[0, 0]):
        why = "the blur does not grow away from any one distance beyond its noise"
        return LensFit(
            False, f"{why}: distances differ by {100 * spread / middle:.1f} %"
        )
    bend = slope / (2 * growth)
    focus, k = middle - spread * bend, 2 * np.sqrt(growth) / spread
    sharp = level - growth * bend**2  # squared
    by_p = [
        [spread * bend / growth, -spread / (2 * growth), 0],
        [1 / (np.sqrt(growth) * spread), 0, 0],
        [bend**2, -bend, 1],
    ]
    ci, k_ci, sharp_ci = 1.96 * np.sqrt(
        np.diag(by_p @ covariance @ np.transpose(by_p))
    )
    if sharp < -3 / 1.96 * sharp_ci:
        why = "the blur grows faster with distance than a lens's"
        return LensFit(False, f"{why}: something else blurs some edges")
    if ci > 0.5 * middle or focus < -ci:
        limits = f"{focus - ci:.2g} to {focus + ci:.2g} dioptres"
        return LensFit(False, f"the focus is somewhere within {limits}: not known")
    focus = max(focus, 0.0)
    words = (
        f"focus at {focus:.3g} +- {ci:.2g} dioptres, {k:.3g} +- {k_ci:.2g} px a dioptre,"
        f" from {len(d)} edges"
    )
    sharp_px = float(np.sqrt(max(sharp, 0.0)))
    return LensFit(True, words, float(k), focus, sharp_px, float(k_ci), float(ci))
