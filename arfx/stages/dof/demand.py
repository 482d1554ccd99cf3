"""Which pixels a frame's lens would change, before any pixel is looked at."""

from __future__ import annotations

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.real_depth import TILE_PX
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Demand
from arfx.stages.dof.aperture import SHARP_PX
from arfx.stages.dof.layers import box_of, depth_range, object_box
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.planes import Real
from arfx.stages.viewing import GRID_PX


def object_radius_px(facts: FrameFacts, coc: CircleOfConfusion) -> float:
    """Bound of the blur's radius on the virtual object; 0 where none is in view."""
    if facts.model_box.empty:
        return 0.0
    near, far = depth_range(facts)
    return coc.largest_px((1 / near, 1 / far))


def demand(
    facts: FrameFacts,
    frame: Rect,
    coc: CircleOfConfusion,
    real: Real | None,
    grid: np.ndarray,
) -> Demand:
    """real : None = the real scene keeps its own blur"""
    on_object = object_radius_px(facts, coc)
    on_real = 0.0 if real is None else coc.largest_px(real.dioptre_range(grid))
    largest = max(on_object, on_real)
    if largest <= SHARP_PX:
        return Demand(EMPTY, f"largest blur circle {2 * largest:.1f} px < 1 px")
    rect = EMPTY
    if on_object > SHARP_PX:
        rect = object_box(facts, frame, 2 * on_object)
    if real is not None and on_real > SHARP_PX:
        rect = rect.union(blurred_rect(real, grid, coc).clip(frame))
    words = f"blur circles up to {2 * largest:.1f} px"
    return Demand(rect, words if not rect.empty else f"{words}, but out of view")


def blurred_rect(real: Real, grid: np.ndarray, coc: CircleOfConfusion) -> Rect:
    """Rectangle of the tiles with a blur circle of 1 px or more, and what their discs reach."""
    if real.tiles is not None:
        # the largest circle of a range is at one of its ends
        radius, side = coc.radius_px(real.tiles).max(0), TILE_PX
    else:
        radius, side = coc.radius_px(real.dioptres(grid)), GRID_PX
        for plane in real.finite_planes:
            positions = plane.positions(grid)
            own = coc.radius_px(np.maximum(positions[..., 2], 0))
            radius = np.maximum(radius, np.where(plane.within(positions, 4.0), own, 0))
    box = box_of(radius > SHARP_PX)
    if box.empty:
        return EMPTY
    whole = Rect(*(side * v for v in (box.x0, box.y0, box.x1, box.y1)))
    node = 0 if real.tiles is not None else GRID_PX  # a node stands for the tiles around it
    return whole.pad(int(np.ceil(float(radius.max()))) + 1 + node)


def needs(
    out: Rect,
    facts: FrameFacts,
    coc: CircleOfConfusion,
    real: Real | None,
    grid: np.ndarray,
    frame: Rect,
) -> Rect:
    """Pixels whose light can reach `out`, and those that decide how far it is spread."""
    if real is not None and real.tiles is not None:
        return frame  # what is hidden is filled in from wherever something is known
    on_object = object_radius_px(facts, coc)
    on_real = 0.0 if real is None else coc.largest_px(real.dioptre_range(grid))
    need = out.pad(_margin_px(on_real)) if on_real > SHARP_PX else out
    if real is not None and real.finite_planes:
        need = need.union(out.pad(3 * _margin_px(on_real)))
    if on_object > SHARP_PX:
        # outside of an outline the radius goes on: light, its own continuation, and what that is
        # from
        box = object_box(facts, frame, 2 * on_object)
        need = need.union(out.clip(box).pad(3 * _margin_px(on_object)))
    return need.clip(frame)


def _margin_px(radius_px: float) -> int:
    """How far light goes, with interpolation between cells, which grow with the radius."""
    return int(np.ceil(2.5 * radius_px)) + 2 * GRID_PX
