"""Which pixels a frame's lens would change, before any pixel is looked at."""

from __future__ import annotations

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.real_depth import TILE_PX
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Demand
from arfx.stages.dof.mipmap import reach_px
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.pyramid import SHARP_PX
from arfx.stages.dof.sharp_frame import box_of, depth_range, object_box
from arfx.stages.dof.surfaces import GRID_PX, Real


def object_radius_px(facts: FrameFacts, coc: CircleOfConfusion) -> float:
    """Bound of the blur's radius on the virtual object; 0 where none is in view."""
    if facts.model_box.empty:
        return 0.0
    near, far = depth_range(facts)
    return coc.largest_px((1 / near, 1 / far))


def _blurred_object_box(facts: FrameFacts, frame: Rect, radius_px: float) -> Rect:
    """Pixels that the object's blur may change: at draft they lie up to twice the radius away, where its layer ends."""
    return object_box(facts, frame, 2 * radius_px)


def demand(
    facts: FrameFacts, frame: Rect, coc: CircleOfConfusion, real: Real | None, grid: np.ndarray
) -> Demand:
    """real : None = the real scene keeps its own blur"""
    on_object = object_radius_px(facts, coc)
    on_real = 0.0 if real is None else coc.largest_px(real.dioptre_range(grid))
    largest = max(on_object, on_real)
    if largest <= SHARP_PX:
        return Demand(EMPTY, f"largest blur circle {2 * largest:.1f} px < 1 px")
    rect = EMPTY
    if on_object > SHARP_PX:
        rect = _blurred_object_box(facts, frame, on_object)
    if real is not None and on_real > SHARP_PX:
        rect = rect.union(blurred_rect(real, grid, coc).clip(frame))
    words = f"blur circles up to {2 * largest:.1f} px"
    return Demand(rect, words if not rect.empty else f"{words}, but out of view")


def blurred_rect(real: Real, grid: np.ndarray, coc: CircleOfConfusion) -> Rect:
    """Rectangle of the grid's tiles with a blur circle of 1 px or more, and what their discs reach."""
    if real.tiles is not None:
        radius = coc.radius_px(real.tiles).max(
            0
        )  # the largest circle of a range is at one of its ends
        box = box_of(radius > SHARP_PX)
        return Rect(*(TILE_PX * v for v in (box.x0, box.y0, box.x1, box.y1))).pad(
            int(np.ceil(float(radius.max()))) + 1
        )
    dioptre = np.full(grid.shape[:2], real.background)
    if real.base is not None:
        dioptre = np.maximum(real.base.dioptres(grid), real.background)
    radius = coc.radius_px(dioptre)
    for plane in real.finite_planes:
        p = plane.positions(grid)
        near = (p[..., 2] > 0) & (np.abs(p[..., :2]).max(-1) <= 4 * plane.half_m * p[..., 2])
        radius = np.where(near, np.maximum(radius, coc.radius_px(np.maximum(p[..., 2], 0))), radius)
    box = box_of(radius > SHARP_PX)
    if box.empty:
        return EMPTY
    pad = GRID_PX + int(np.ceil(float(radius.max())))  # a node stands for the tiles around it
    return Rect(
        box.x0 * GRID_PX, box.y0 * GRID_PX, (box.x1 - 1) * GRID_PX + 1, (box.y1 - 1) * GRID_PX + 1
    ).pad(pad)


def needs(
    out: Rect,
    facts: FrameFacts,
    coc: CircleOfConfusion,
    real: Real | None,
    grid: np.ndarray,
    frame: Rect,
    draft: bool,
) -> Rect:
    """Pixels whose light can reach `out`, and those that decide how far it is spread."""
    if real is not None and real.tiles is not None:
        return frame  # what is hidden is filled in from wherever something is known
    on_object = object_radius_px(facts, coc)
    on_real = 0.0 if real is None else coc.largest_px(real.dioptre_range(grid))
    # cells of the pyramid and interpolation between them reach a little beyond the disc
    need = out.pad(_margin_px(on_real, draft)) if on_real > SHARP_PX else out
    if real is not None and real.finite_planes:
        need = need.union(out.pad(3 * _margin_px(on_real, draft)))
    if on_object > SHARP_PX:
        # an edge's disc is continued outside of it: light, its own continuation, and what that is taken from
        need = need.union(
            out.clip(_blurred_object_box(facts, frame, on_object)).pad(
                3 * _margin_px(on_object, draft)
            )
        )
    return need.clip(frame)


def _margin_px(radius_px: float, draft: bool) -> int:
    return max(int(np.ceil(1.25 * radius_px)) + 2 * GRID_PX, reach_px(radius_px) if draft else 0)
