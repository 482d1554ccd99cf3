"""Exact marker prints: the cells of a printed marker as a small picture, with its sheet's white border."""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.marker import MarkerSpec, opencv_name


def marker_cells(spec: MarkerSpec) -> np.ndarray:
    """(n, n) bool, True = paper, of a marker with its one-cell black border; row 0 is the print's top."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, opencv_name(spec.family)))
    side = dictionary.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, spec.id, side, borderBits=1)) > 127


def sheet_albedo(
    spec: MarkerSpec, margin_cells: float, ink: float, paper: float, inverted: bool = False, right_ink: float | None = None
) -> tuple[np.ndarray, float]:
    """Albedo picture of the whole sheet and the sheet's side in metres.

    The margin is made exact by cutting every cell into a whole number of texels. right_ink : ink albedo at the right
    edge, growing linearly from `ink` at the left (worn print); None = even.
    Returns (rows, columns, 1) float64.
    """
    cells = marker_cells(spec)
    if inverted:
        cells = ~cells
    n = cells.shape[0]
    per_cell = 4  # a margin of quarters of a cell is exact; finer ones are rounded to it
    margin = round(margin_cells * per_cell)
    big = np.kron(cells, np.ones((per_cell, per_cell), bool))
    whole = np.pad(big, margin, constant_values=not inverted)
    ramp = np.linspace(ink, ink if right_ink is None else right_ink, whole.shape[1])
    albedo = np.where(whole, paper, ramp[None, :])
    return albedo[..., None], spec.size_m * whole.shape[0] / (n * per_cell)
