"""A real shadow on part of a print: where it lies, what is left of the light, and what its edge
tells of the lamp.

A darker room darkens all of a print; a shadow's edge leaves some of its bright cells as they
were. What casts it stands beside the print, over the shaded part, because the print is seen:
so the lamp is on that side. The edge's width is the lamp's size, seen from what casts it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.facts import PlaneShadow
from arfx.core.numerics import divide, medians, smoothstep

# of the brightest quarter's light; above it vignetting, a near lamp or gloss may be the
# reason
LEAST_LEFT = 0.7
CASTER_M = 0.1  # a hand above the print
MOST_EDGES = 60  # frames


def quarters(cells: ndarray) -> ndarray:
    """(2, 2) light on a print's quarters, rows from the top, NaN = not known. cells : (n, n)
    of bright ones, NaN = not known"""
    low = np.arange(len(cells)) >= len(cells) // 2
    own = (2 * low[:, None] + low).ravel() == np.arange(4)[:, None]
    return medians(cells.ravel(), own & np.isfinite(cells).ravel()).reshape(2, 2)


def clearly_shaded(cells: ndarray) -> bool:
    """Whether a quarter is clearly darker than the brightest one; nothing is clear where one
    is not known.
    """
    light = quarters(cells)
    return bool(0 < light.max() >= light.min() / LEAST_LEFT)


def light_at(cells: ndarray, place: ndarray) -> float:
    """Light of white at a place (2,) on the print, x right and y up, -1 .. 1; 0 in the middle."""
    right, up = np.clip(place + 0.5, 0, 1)
    return float(np.sum(np.outer([up, 1 - up], [1 - right, right]) * quarters(cells)))


def real_shadow(cells: ndarray, corners_m: ndarray) -> PlaneShadow:
    """The shadow on the anchor's print. cells : without the camera's bias;  corners_m : (4,
    3) of the print. Anchor axes: x right, y up.
    """
    light = quarters(cells)
    top, bottom = np.clip(divide(light, light.max()), 0, 1).tolist()
    x, y, _ = corners_m.max(0).tolist()
    return PlaneShadow((-x, -y, x, y), (tuple(bottom), tuple(top)))


def edge_clue(cells: Sequence[ndarray], corners_m: ndarray) -> dict[str, Any] | None:
    """What the edge tells of the lamp, for the report; None where no shadow lay on the print.

    cells : of the frames in which one did;  corners_m : (4, 3) of the print
    """
    if not len(cells):
        return None
    some = cells[:: len(cells) // MOST_EDGES + 1]
    towards, width = map(np.array, zip(*map(_edge, some), strict=True))
    x, y = np.median(towards, 0)
    size = np.degrees(np.median(width) * np.ptp(corners_m) / CASTER_M)
    return {
        "verdict": "likely",
        "azimuth_deg": float(np.degrees(np.arctan2(y, x))),
        "within_deg": 90.0,
        "size_deg": float(min(size, 90.0)),
        "reason": "a shadow's edge on the print: the lamp is on the shaded side; its size if"
        f" what casts the shadow is {100 * CASTER_M:g} cm above",
    }


def _edge(cells: ndarray) -> tuple[ndarray, float]:
    """(unit vector (2,) from the lit to the shaded part, x right and y up; width of the edge
    over the print's side).
    """
    from scipy.optimize import least_squares

    row, column = np.nonzero(np.isfinite(cells))
    n = len(cells)
    places = np.stack([(column + 0.5) / n - 0.5, 0.5 - (row + 0.5) / n], -1)
    light = cells[row, column] / quarters(cells).max()
    slope = np.linalg.lstsq(np.column_stack([places, np.ones(len(row))]), light)[0]

    def off(p: ndarray) -> ndarray:
        across = places @ [np.cos(p[0]), np.sin(p[0])] - p[1]
        return p[3] + (p[4] - p[3]) * smoothstep(across / np.exp(p[2]) + 0.5) - light

    start = [
        np.arctan2(-slope[1], -slope[0]),
        0.0,
        np.log(0.5),
        light.max(),
        light.min(),
    ]
    p = least_squares(off, start, loss="soft_l1", f_scale=0.05).x
    return np.array([np.cos(p[0]), np.sin(p[0])]), float(np.exp(p[2]))
