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
from typing import ClassVar, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.job import Analysis, AnalysisFrame
from arfx.analyse.markers.corners import LIGHT, cell_px, linear_table
from arfx.analyse.markers.edges import FRACTIONS, SAMPLES, find_edges
from arfx.analyse.markers.search import ANY, Sighting
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.lens import LensFit
from arfx.core.marker import FAMILIES, Marker
from arfx.core.marker_codes import cells_per_side
from arfx.core.numerics import condition, divide, normalise
from arfx.core.pose import Pose

_LEAST_HALF_PX = 2.0
_HALF_CELLS, _MOST_HALF_PX = (
    0.7,
    24.0,
)  # what is looked at: the rim and the margin are a cell wide
_WINDOWS = 4.0  # to each side of an edge, by standard deviations of its blur
_LARGEST = 0.25  # of the half width: a disc beyond it is measured too large
_FAINT = 20.0  # light (of 255) across an edge
_ROUNDS = 2
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


def side_blurs(
    luma: ndarray, corners_px: ndarray, cells: int, table: ndarray
) -> ndarray:
    """(4,) standard deviation, px, of the blur across each side (corner k to k + 1); NaN
    where it cannot be measured.

    luma : (h, w) uint8;  corners_px : (4, 2) clockwise in the picture;  table : (256,)
    coded luma to linear light, 0..255
    """
    half = _HALF_CELLS * cell_px(corners_px[None], np.array([cells]))
    half = far = np.clip(half, 1e-3, _MOST_HALF_PX)
    straight = np.zeros((1, 4, SAMPLES, 2))
    for _ in range(_ROUNDS):
        edges = find_edges(luma, table, corners_px[None], straight, (far, far))
        far = np.clip(_WINDOWS * edges.blurs, _LEAST_HALF_PX, half)
    clear = (edges.blurs <= _LARGEST * half) & (edges.gain > _FAINT)
    return np.where(clear & (half >= _LEAST_HALF_PX), edges.blurs, np.nan)[0]


class SideBlurs(NamedTuple):
    """The blur of a print's sides, (4,) px, in one frame, in the values of a transfer;
    corners (4, 2) px"""

    frame: int
    transfer: str
    key: str
    blurs: ndarray
    corners: ndarray


class SideReader:
    """Measures how the sides of coded prints are blurred."""

    tables: ClassVar[Mapping[str, type]] = {"sides": SideBlurs}

    def __init__(self) -> None:
        self.sides: list[SideBlurs] = []

    def step(self, frame: AnalysisFrame, shown: Sequence[Sighting]) -> None:
        for s in shown:
            corners = s.print.corners_px
            family = s.print.key.rpartition(":")[0]
            # nothing is known of the edges around a pattern
            if s.duplicate or family not in FAMILIES:
                continue
            table = linear_table(s.transfer or LIGHT)
            blurs = side_blurs(frame.luma, corners, cells_per_side(family), table)
            if np.isfinite(blurs).any():
                row = SideBlurs(frame.index, s.transfer, s.print.key, blurs, corners)
                self.sides.append(row)


def with_lens(
    clip: Analysis, sides: Sequence[SideBlurs], markers: Sequence[Marker]
) -> Analysis:
    """The clip with `lens` in every frame, and the fit in summary["footage_lens"]."""
    transfer = clip.summary["edge_transfer"]
    readings = [s for s in sides if s.transfer in (transfer, ANY)]
    fit = footage_lens(clip.facts, readings, markers, clip.world_from_marker)
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
    readings: Sequence[SideBlurs],
    markers: Sequence[Marker],
    world_from_marker: Mapping[str, Pose],
) -> LensFit:
    corners_m = {m.key: m.corners_m for m in markers}
    before: dict[str, tuple[int, ndarray]] = {}
    rows = []
    for number, _, key, blurs, corners in readings:
        last, before[key] = before.get(key), (number, corners)
        fact = facts[number]
        pose = fact.camera_from_world
        if fact.status != MEASURED or pose is None or key not in world_from_marker:
            continue
        shift = np.zeros((4, 2))
        if last is not None and last[0] == number - 1:
            shift = corners - last[1]
        z = (pose @ world_from_marker[key]).apply(corners_m[key])[:, 2]
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
    if spread < 1e-6 * middle:
        return LensFit(
            False, "the markers are all at one distance: any focus explains the blur"
        )
    error = 2 * blur * sigma  # of blur squared
    a = np.vander((d - middle) / spread, 3) / error[:, None]
    if condition(a.T @ a) > MAX_CONDITION:
        return LensFit(
            False, "the markers' distances do not separate a parabola from a line"
        )
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
