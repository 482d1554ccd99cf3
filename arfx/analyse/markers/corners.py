"""Sub-pixel corners of square markers: lines through the four sides' edges, met at the corners.

Two errors are predicted: what scatters along a side (sigma_px), and what all of its samples
share (shared_px). In which values edges are symmetric, light or code, is known once all of
the clip is (`chosen_transfer`): where edges are not symmetric in light, corners are refined in
code too. Leaves out: rolling shutter.
Source: docs/methods/pose.md#corners. Cost: about 1 ms a frame, and .3 ms a marker."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.markers.detect import Candidate, Detection, sides
from arfx.analyse.markers.edges import (
    FRACTIONS,
    SAMPLES,
    WINDOW_FRACTION,
    WINDOW_PX,
    Edges,
    find_edges,
)
from arfx.analyse.markers.inner_edges import misplaced_px
from arfx.core.camera import FISHEYE, Camera
from arfx.core.colour import Transfer
from arfx.core.marker_codes import cells_per_side
from arfx.core.numerics import divide

# OpenCV thresholds against a neighbourhood of up to 23 px: of a large marker it may report
# the inner border of the dark rim that is left of a wide black one, 11 px inside the edge.
# So far is looked where the first try finds no edge.
REACH_PX = 16.0
HALF_PX = (
    1.8,
    8.0,
)  # least and most that is looked at to either side of an edge; between them .6 of a cell
# Measured: error of an edge that lies along the pixels, by its blur (which holds the
# pixel's own width and that of the
# interpolation, together .5 px); and the directions in which rows of pixels lie.
_STEP_BLUR_PX, _STEP_PX = (0.455, 0.49, 0.65, 1.0), (0.3, 0.04, 0.03, 0.015)
# Measured: error of an edge, of the width of a cell, by the edge's blur over that width.
_BLUR_CELLS, _NEXT_CELL = (
    (0.15, 0.18, 0.21, 0.25, 0.29, 0.32),
    (0.0, 0.001, 0.002, 0.005, 0.014, 0.03),
)
_EXACT = (3, 40, 1e-12)  # of an undistorted point: most rounds, and their last step
_ROWS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [2, 1], [2, -1], [1, 2], [1, -2]])
FAINT = 0.25  # light (of 255) across an edge below which it is taken for none
MOST_PX = (
    1e5  # of a corner from the picture's: those that are farther off make no sense
)
# from coded luma to the values in which corners are refined
LIGHT, CODE = "srgb", "gamma:1"
SIGHTINGS = 12  # by fewer than that nothing is decided
# Measured: true linear blur gives skews up to .03 in light; camera-sharpened footage .19 in
# light and -.03 in code.
SKEWED = 0.07


class Corners(NamedTuple):
    """Refined corners of n markers.

    corners_px : (n, 4, 2);  sigma_px : (n,) predicted standard deviation of a corner
    coordinate, without shared_px
    blur_px : (n,) standard deviation of the edge's blur, median of sides;  inverted : (n,)
    white on black
    refined : (n,) False where no clear edge was found and the input corners are returned
    (sigma 1 px)
    skew : (n,) third moment of the edge's gradient over blur^3: near 0 where `table` makes
    the edge symmetric
    """

    corners_px: ndarray
    sigma_px: ndarray
    blur_px: ndarray
    inverted: ndarray
    refined: ndarray
    skew: ndarray


@cache
def linear_table(transfer: str = LIGHT) -> ndarray:
    """(256,) float32: coded luma to linear light on a scale of 0..255; read-only."""
    table = (Transfer(transfer).decode(np.arange(256) / 255.0) * 255.0).astype(
        np.float32
    )
    table.flags.writeable = False
    return table


def refine_corners(
    luma: ndarray,
    quads_px: ndarray,
    cells: ndarray,
    table: ndarray,
    camera: Camera | None = None,
) -> Corners:
    """Refine n markers of one image together.

    luma : (h, w) uint8;  quads_px : (n, 4, 2) clockwise in the picture, good to half a cell
    (at most REACH_PX)
    cells : (n,) cells along a side, border included;  table : linear_table();  camera : for
    the bend of the sides
    The result depends on the image around the quads only, never on how they were found."""
    start = np.array(quads_px, float).reshape(-1, 4, 2)
    sensible = (np.abs(start) < MOST_PX).all((1, 2)) & (min(luma.shape) > 1)
    near = np.where(sensible[:, None, None], start, 0.0)
    cell = cell_px(near, cells)
    half = np.clip(0.6 * cell, *HALF_PX)
    reach = np.clip(0.6 * cell, half, REACH_PX)
    bend = _bend(near, camera)
    edges = find_edges(luma, table, near, bend, (reach, half))
    ok = _clear(near, edges, half, reach)
    # a corner is where two lines meet, each known at its end to about twice the error of its
    # mean
    sigma = np.maximum(2.0 * edges.spread / np.sqrt(SAMPLES), 0.01)
    return Corners(
        np.where(ok[:, None, None], edges.quad, start),
        np.where(ok, sigma, 1.0),
        np.where(ok, edges.blur, np.nan),
        edges.inverted,
        ok,
        np.where(ok, edges.skew, np.nan),
    )


def shared_px(corners_px: ndarray, blur_px: ndarray, cells: ndarray) -> ndarray:
    """(n,) standard deviation of a corner coordinate that all samples of a side share,
    beside Corners.sigma_px.

    corners_px : (n, 4, 2);  blur_px : (n,) of Corners, NaN gives 0;  cells : (n,) cells
    along a side, border included
    The position of a step between pixels is known as well as the blur spreads it over
    several. A side that crosses many rows of pixels averages that away; one that keeps
    within a row, be it a diagonal one, does not. And blur brings the cells behind the
    border near."""
    side = np.roll(corners_px, -1, 1) - corners_px
    # rows of pixels along (x, y): 1 / |(x, y)| apart
    crossed = np.abs(side @ [_ROWS[:, 1], -_ROWS[:, 0]])
    apart2 = (_ROWS**2).sum(1) * (1.0 + (crossed / 1.2) ** 4) ** 2
    shared = (1.0 / apart2).sum(-1)
    cell, blur = cell_px(corners_px, cells), np.asarray(blur_px)[:, None]
    window = np.clip(WINDOW_FRACTION * np.clip(0.6 * cell, *HALF_PX), *WINDOW_PX)
    step = np.minimum(
        np.interp(blur, _STEP_BLUR_PX, _STEP_PX) * (WINDOW_PX[1] / window) ** 2,
        _STEP_PX[0],
    )
    near = cell * np.interp(divide(blur, cell), _BLUR_CELLS, _NEXT_CELL)
    # the line that runs to a corner from the samples on its side carries their error on,
    # and more of it if they disagree
    return np.where(
        np.isfinite(blur_px),
        np.sqrt((1.3**2 * step**2 * shared + near**2).mean(1)),
        0.0,
    )


def cell_px(quad: ndarray, cells: ndarray) -> ndarray:
    """(n, 4) px from each side of quads (n, 4, 2) to the next line of cells; cells : (n,)
    along a side.
    """
    length = sides(quad)
    opposite = length[:, [2, 3, 0, 1]]
    area2 = np.abs(np.linalg.det(quad[:, [2, 3]] - quad[:, [0, 1]]))
    deep = divide(area2[:, None], length + opposite) * np.minimum(
        divide(length, opposite, where_zero=1.0), 1.0
    )
    return np.asarray(deep / np.reshape(cells, (-1, 1)))


def _clear(start: ndarray, edges: Edges, half: ndarray, reach: ndarray) -> ndarray:
    """(n,) Was an edge found, of enough contrast, straight, and not some other one far away?"""
    away = np.abs(edges.quad - start).max((1, 2))
    near = away <= np.maximum(3.0, 1.5 * reach.max(1))
    return near & (edges.gain.min(1) > FAINT) & (edges.spread < half.max(1))


def _bend(quad: ndarray, camera: Camera | None) -> ndarray:
    """(n, 4, SAMPLES, 2) px by which the image of a straight side leaves its chord."""
    if camera is None or not camera.distorted:
        return np.zeros((len(quad), 4, SAMPLES, 2))
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    fisheye = camera.model == FISHEYE
    undistort = cv2.fisheye.undistortPoints if fisheye else cv2.undistortPoints
    ideal = undistort(
        quad.reshape(-1, 1, 2), camera.matrix, camera.distortion, criteria=_EXACT
    ).reshape(quad.shape)
    chord, side = ((np.roll(a, -1, 1) - a)[:, :, None] for a in (quad, ideal))
    foot = quad[:, :, None] + FRACTIONS[:, None] * chord
    share = FRACTIONS[:, None]
    for _ in range(
        2
    ):  # where along the ideal side: the lens moves points along it, too
        off = camera.distort(ideal[:, :, None] + share * side) * focal + centre - foot
        along = divide((off * chord).sum(-1), (chord * chord).sum(-1))[..., None]
        share = share - along
    off -= along * chord
    return np.where(np.isfinite(off), off, 0.0)


def symmetric_in_light(skew: float) -> bool:
    """Whether an edge is, or cannot be told to be otherwise. skew : in light"""
    return not abs(skew) > SKEWED


def chosen_transfer(in_light: Sequence[float], in_code: Sequence[float]) -> str:
    """LIGHT or CODE: in which edges are symmetric.

    in_light : skew of all prints;  in_code : of those that are not symmetric in light"""
    known, others = (
        [s for s in skews if np.isfinite(s)] for skews in (in_light, in_code)
    )
    if len(known) < SIGHTINGS or not others:
        return LIGHT
    skew, other = (abs(float(np.median(skews))) for skews in (known, others))
    return CODE if not symmetric_in_light(skew) and other < 0.5 * skew else LIGHT


def refine_found(
    luma: ndarray, found: Sequence[Candidate], transfer: str, camera: Camera
) -> list[tuple[Detection, float]]:
    """The prints that were found, refined in LIGHT or CODE, each with the skew of its edges,
    as of `Corners`."""
    if not found:
        return []
    quads, table = np.stack([c.quad_px for c in found]), linear_table(transfer)
    cells = np.array([cells_per_side(c.family) for c in found])
    r = refine_corners(luma, quads, cells, table, camera)
    numbers = (a.tolist() for a in (r.sigma_px, r.blur_px, r.inverted, r.skew))
    out = []
    for c, quad, sigma, blur, inverted, skew in zip(
        found, r.corners_px, *numbers, strict=True
    ):
        off = misplaced_px(luma, quad, c.family, c.id, inverted, table)
        out.append((Detection(c.key, quad, sigma, blur, inverted, off), skew))
    return out
