"""Brightness of each frame where several normals are seen at once: exposure that pumps, all lamps faded together.

One factor per frame and one irradiance over normals explain such a clip: E(n, t) = g_t E(n). Where a frame shows one normal
only, the two cannot be told apart, and nothing is tried. `drift` is what speaks against any account that rests: the same
normal seen at different times, in different light.
"""

from __future__ import annotations

import numpy as np

from arfx.analyse.icosphere import icosphere
from arfx.core.light import harmonics
from arfx.core.numerics import divide

_CELL_LEVEL = 4  # 4 degrees: within, normals count as one
_WINDOW_S = 0.25
_LEAST_FRAMES = 0.8  # share of the frames that show normals apart
_APART = 0.97  # length of a frame's mean normal, below which its normals are apart: 28 degrees between two
_PASSES = 60


def drift(times_s: np.ndarray, normals: np.ndarray, irradiance: np.ndarray, group: np.ndarray | None = None) -> float:
    """Root mean square over time, relative to the level, of how normals differ from themselves at other times of a group.

    times_s : (k,);  normals, irradiance : (k, 3);  group : (k,) int. Means of a quarter of a second, so that noise is little.
    """
    light = np.asarray(irradiance, float).mean(1)
    level = float(np.percentile(light, 90)) if len(light) else 0.0
    if level <= 0:
        return 0.0
    H = harmonics(normals)
    off = (light - H @ np.linalg.lstsq(H, light, rcond=1e-6)[0]) / level  # slope within a cell taken out
    g = np.zeros(len(light), int) if group is None else np.asarray(group)
    cell = np.unique(g * len(icosphere(_CELL_LEVEL).vertices) + icosphere(_CELL_LEVEL).nearest(normals), return_inverse=True)[1]
    count = np.bincount(cell)
    off = off - (np.bincount(cell, off) / count)[cell]
    again = count[cell] > 1
    window = np.unique(np.floor((times_s - times_s.min()) / _WINDOW_S), return_inverse=True)[1]
    many = np.bincount(window, again)
    mean = divide(np.bincount(window, off), many)
    return float(np.sqrt(divide((many * mean**2).sum(), many.sum())))


def gains(times_s: np.ndarray, normals: np.ndarray, irradiance: np.ndarray) -> np.ndarray | None:
    """(k,) factor of each observation's frame, median 1; None where frames do not show several normals apart.

    Alternating least squares of the factors and of the irradiance in harmonics up to degree 2.
    """
    _, frame = np.unique(times_s, return_inverse=True)
    count = np.bincount(frame)
    mean = np.stack([np.bincount(frame, normals[:, i]) for i in range(3)], 1) / count[:, None]
    if np.mean(np.linalg.norm(mean, axis=1) < _APART) < _LEAST_FRAMES:
        return None
    light, H = np.asarray(irradiance, float).mean(1), harmonics(normals)
    g = np.ones(len(count))
    for _ in range(_PASSES):
        rows = g[frame, None] * H
        model = H @ np.linalg.lstsq(rows, light, rcond=1e-6)[0]
        last, g = g, matched(frame, model, light)
        if np.abs(g - last).max() < 1e-5:
            break
    return g[frame] if (g > 1e-3).all() else None


def matched(frame: np.ndarray, model: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(frames,) factors that bring the model (k,) to the light (k,) seen, median 1. frame : (k,) int from 0 on, no gaps"""
    g = divide(np.bincount(frame, model * light), np.bincount(frame, model * model))
    return divide(g, float(np.median(g)), where_zero=1.0)
