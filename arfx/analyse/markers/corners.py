"""Sub-pixel corners of square markers: lines through the four sides' edges, met at the corners.

Two errors are predicted: what scatters along a side (sigma_px), and what all of its samples
share (shared_px). In which values edges are symmetric, light or code, is known once all of
the clip is (`search.choose_transfer`). Leaves out: rolling shutter.
Source: docs/methods/pose.md#corners. Cost: about 1 ms a frame, and .3 ms a marker."""

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.markers.detect import sides
from arfx.analyse.markers.edges import (
    FRACTIONS,
    SAMPLES,
    WINDOW_FRACTION,
    WINDOW_PX,
    find_edges,
)
from arfx.core.camera import FISHEYE, Camera
from arfx.core.colour import Transfer
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
# Of the blur of a side: what is looked at (the rim and the margin are a cell wide), to each
# side of an edge by standard deviations; a disc beyond a share of that is measured too large.
_LEAST_HALF_PX, _HALF_CELLS, _MOST_HALF_PX = 2.0, 0.7, 24.0
_WINDOWS, _LARGEST = 4.0, 0.25
_CLEAR = 20.0  # light (of 255) across an edge whose blur is measured
_ROUNDS = 2
FAINT = 0.25  # light (of 255) across an edge below which it is taken for none
# from coded luma to the values in which corners are refined
LIGHT, CODE = "srgb", "gamma:1"


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
    cell = cell_px(start, cells)
    half = np.clip(0.6 * cell, *HALF_PX)
    reach = np.clip(0.6 * cell, half, REACH_PX)
    bend = _bend(start, camera)
    edges = find_edges(luma, table, start, bend, (reach, half))
    # was an edge found, of enough contrast, straight, and not some other one far away?
    away = np.abs(edges.quad - start).max((1, 2))
    ok = (away <= np.maximum(3.0, 1.5 * reach.max(1))) & (edges.gain.min(1) > FAINT)
    ok &= edges.spread < half.max(1)
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


def side_blurs(
    luma: ndarray, corners_px: ndarray, cells: ndarray, table: ndarray
) -> ndarray:
    """(n, 4) standard deviation, px, of the blur across each side (corner k to k + 1); NaN
    where it cannot be measured. Arguments as of refine_corners, corners_px : (n, 4, 2)"""
    half = _HALF_CELLS * cell_px(corners_px, cells)
    half = far = np.clip(half, 1e-3, _MOST_HALF_PX)
    straight = np.zeros((len(half), 4, SAMPLES, 2))
    for _ in range(_ROUNDS):
        edges = find_edges(luma, table, corners_px, straight, (far, far))
        far = np.clip(_WINDOWS * edges.blurs, _LEAST_HALF_PX, half)
    clear = (edges.blurs <= _LARGEST * half) & (edges.gain > _CLEAR)
    return np.where(clear & (half >= _LEAST_HALF_PX), edges.blurs, np.nan)


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


def _bend(quad: ndarray, camera: Camera | None) -> ndarray:
    """(n, 4, SAMPLES, 2) px by which the image of a straight side leaves its chord."""
    if camera is None or not camera.distorted:
        return np.zeros((len(quad), 4, SAMPLES, 2))
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
        there = ideal[:, :, None] + share * side
        off = camera.project(np.insert(there, 2, 1.0, -1)) - foot
        along = divide((off * chord).sum(-1), (chord * chord).sum(-1))[..., None]
        share = share - along
    off -= along * chord
    return np.where(np.isfinite(off), off, 0.0)
