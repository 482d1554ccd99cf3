"""The poses of a clip over time, as the curves that `parts.html` draws: SVG, since loading a
plotting library takes longer than a short job."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.analyse.pose.visibility import jitter_px
from arfx.core.camera import Camera
from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED, FrameFacts

RAW, SMOOTH = "#d9822b", "#2f81f7"
STATUS_COLOUR = {MEASURED: "#2da44e", INTERPOLATED: "#d4a72c", ABSENT: "#cf5b56"}
_MOST_POINTS = 2000  # of a curve: more are drawn by the largest of several frames
_MOST_TICKS = 6


def pose_plot(
    facts: Sequence[FrameFacts], camera: Camera | None, points_m: ndarray | None
) -> Mapping[str, Any]:
    """Trembling before and after smoothing, reprojection error, and each frame's status as
    a coloured strip. points_m : (n, 3) world points whose trembling is shown"""
    times = np.array([f.time_s for f in facts], float)
    start, end = (times[0], times[-1]) if len(facts) else (0.0, 0.0)
    end += (end - start) / (len(facts) - 1) if len(facts) > 1 else 1.0
    jitter = []
    if camera is not None and points_m is not None and len(facts) > 2:
        for raw in (True, False):
            _, px = jitter_px(facts, points_m, camera, raw)
            known = np.isfinite(px).any()
            middle = f"median {np.nanmedian(px):.3g} px" if known else "unknown"
            label = f"{'before' if raw else 'after'} smoothing, {middle}"
            jitter.append((label, RAW if raw else SMOOTH, px))
    error = [
        np.nan if f.reprojection_px is None else f.reprojection_px for f in facts
    ]
    status = [f.status if f.status in STATUS_COLOUR else ABSENT for f in facts]
    changes = [k for k in range(len(status)) if k == 0 or status[k] != status[k - 1]]
    edges = [*times[changes], end]
    return {
        "start": start,
        "end": end,
        "ticks": [t for t in _ticks(end) if t >= start],
        "jitter": _panel(times, jitter),
        "error": _panel(times, [("", SMOOTH, np.array(error, float))]),
        "strip": [
            (a, b, STATUS_COLOUR[status[k]])
            for a, b, k in zip(edges, edges[1:], changes, strict=False)
        ],
    }


def _panel(
    times: ndarray, curves: Sequence[tuple[str, str, ndarray]]
) -> Mapping[str, Any]:
    """Curves of label, colour and values (n,) from 0 to the top of an axis with ticks."""
    most = [float(np.nanmax(px)) for _, _, px in curves if np.isfinite(px).any()]
    top = 1.05 * max([*most, 1e-3])
    shown = [(label, colour, _thinned(times, px)) for label, colour, px in curves]
    return {"top": top, "ticks": _ticks(top), "curves": shown}


def _thinned(times: ndarray, values: ndarray) -> list[list[tuple[float, float]]]:
    """The curve's pieces between frames of which nothing is known, as points."""
    first = np.arange(0, len(values), -(-len(values) // _MOST_POINTS) or 1)
    most = np.fmax.reduceat(values, first) if len(values) else values
    breaks = np.flatnonzero(~np.isfinite(most))
    pieces = np.split(np.column_stack([times[first], most]), breaks)
    known = (piece[np.isfinite(piece[:, 1])] for piece in pieces)
    return [[(x, y) for x, y in piece.tolist()] for piece in known if len(piece)]


def _ticks(end: float) -> list[float]:
    """Round numbers from 0 to `end`, a few of them."""
    least = end / _MOST_TICKS
    decade = 10 ** np.floor(np.log10(least))
    step = next(k * decade for k in (1, 2, 5, 10) if k * decade >= least)
    return [float(k * step) for k in range(int(end / step) + 1)]
