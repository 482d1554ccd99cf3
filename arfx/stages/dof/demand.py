"""Which pixels a frame's lens would change, before any pixel is looked at."""

from __future__ import annotations

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.real_depth import TILE_PX
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Demand
from arfx.stages.dof.corrected import depth_range, object_box
from arfx.stages.dof.ladder import SHARP_PX
from arfx.stages.dof.optics import Circles
from arfx.stages.dof.surfaces import GRID_PX, Real


def object_radius_px(facts: FrameFacts, at: Circles) -> float:
    """Bound of the blur's radius on the virtual object; 0 where none is in view."""
    if facts.model_box.empty:
        return 0.0
    near, far = depth_range(facts)
    return float(at.radius_px(np.array([1 / near, 1 / far])).max())


def real_radius_px(real: Real, grid: np.ndarray, at: Circles) -> float:
    """Bound of the blur's radius on the real scene."""
    low, high = real.dioptre_range(grid)
    return float(at.radius_px(np.array([low, high])).max())


def demand(facts: FrameFacts, frame: Rect, at: Circles, real: Real | None, grid: np.ndarray) -> Demand:
    """real : None = the real scene keeps its own blur"""
    on_object = object_radius_px(facts, at)
    on_real = 0.0 if real is None else real_radius_px(real, grid, at)
    largest = max(on_object, on_real)
    if largest <= SHARP_PX:
        return Demand(EMPTY, f"largest blur circle {2 * largest:.1f} px < 1 px")
    rect = EMPTY
    if on_object > SHARP_PX:
        rect = object_box(facts, frame, on_object)
    if real is not None and on_real > SHARP_PX:
        rect = rect.union(blurred_rect(real, grid, at).clip(frame))
    words = f"blur circles up to {2 * largest:.1f} px"
    return Demand(rect, words if not rect.empty else f"{words}, but out of view")


def blurred_rect(real: Real, grid: np.ndarray, at: Circles) -> Rect:
    """Rectangle of the grid's tiles with a blur circle of 1 px or more, and what their discs reach."""
    if real.tiles is not None:
        return _blurred_tiles(real.tiles, at)
    dioptre = np.full(grid.shape[:2], real.background)
    if real.base is not None:
        dioptre = np.maximum(real.base.dioptres(grid), real.background)
    most = at.radius_px(dioptre)
    for plane in real.cut_outs:
        p = plane.places(grid)
        near = (p[..., 2] > 0) & (np.abs(p[..., :2]).max(-1) <= 4 * plane.half_m * p[..., 2])
        most = np.where(near, np.maximum(most, at.radius_px(np.maximum(p[..., 2], 0))), most)
    hot = most > SHARP_PX
    ys, xs = np.flatnonzero(hot.any(1)), np.flatnonzero(hot.any(0))
    if not len(ys):
        return EMPTY
    pad = GRID_PX + int(np.ceil(float(most.max())))  # a node stands for the tiles around it
    return Rect(int(xs[0]) * GRID_PX, int(ys[0]) * GRID_PX, int(xs[-1]) * GRID_PX + 1, int(ys[-1]) * GRID_PX + 1).pad(pad)


def _blurred_tiles(tiles: np.ndarray, at: Circles) -> Rect:
    most = at.radius_px(tiles).max(0)  # the circle grows from the focus to both sides: its largest is at an end of the range
    ys, xs = np.flatnonzero((most > SHARP_PX).any(1)), np.flatnonzero((most > SHARP_PX).any(0))
    if not len(ys):
        return EMPTY
    tiled = Rect(int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1)
    return Rect(*(TILE_PX * v for v in (tiled.x0, tiled.y0, tiled.x1, tiled.y1))).pad(int(np.ceil(float(most.max()))) + 1)


def needs(out: Rect, facts: FrameFacts, at: Circles, real: Real | None, grid: np.ndarray, frame: Rect) -> Rect:
    """Pixels whose light can reach `out`, and those that decide how far it is spread."""
    if real is not None and real.tiles is not None:
        return frame  # what is hidden is filled in from wherever something is known
    on_object = object_radius_px(facts, at)
    on_real = 0.0 if real is None else real_radius_px(real, grid, at)
    # cells of the ladder and interpolation between them reach a little beyond the disc
    need = out.pad(_reach(on_real)) if on_real > SHARP_PX else out
    if real is not None and real.cut_outs:
        need = need.union(out.pad(3 * _reach(on_real)))
    if on_object > SHARP_PX:
        # an edge's disc is continued outside of it: light, its own continuation, and what that is taken from
        need = need.union(out.clip(object_box(facts, frame, on_object)).pad(3 * _reach(on_object)))
    return need.clip(frame)


def _reach(radius_px: float) -> int:
    return int(np.ceil(1.25 * radius_px)) + 2 * GRID_PX
