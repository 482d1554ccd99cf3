"""The corrected formula, levels draft to high: layers on the ladder, strip by strip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, Patch, neutral
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.rect import EMPTY, Rect
from arfx.stages.dof import deposit, light
from arfx.stages.dof.cutout import continue_outside, object_radius
from arfx.stages.dof.depth_layers import DepthLayers, depth_layers, dioptre_of
from arfx.stages.dof.ladder import SHARP_PX, Ladder
from arfx.stages.dof.layer import DARK, Spread, strips
from arfx.stages.dof.optics import Circles
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.real_pixels import RealPixels
from arfx.stages.dof.surfaces import GRID_PX, Real, plane_radius, square_radius
from arfx.stages.dof.work import on_all_cores

Optics = tuple[np.float32, np.float32, np.float32]  # px per dioptre, focus dioptre, limit px
_NONE = np.empty((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class CutOut:
    """A layer over `rect`: premultiplied colour, coverage, opacity, its own light and what it lets through."""

    rect: Rect
    colour: np.ndarray
    coverage: np.ndarray
    opacity: np.float32
    spread: Spread
    gap: Spread

    def deposit(self, strip: tuple[int, int]) -> None:
        radius, coverage = self.spread.radius, self.coverage
        self.spread.note(strip, deposit.deposit_cut(*strip, radius, self.colour, coverage, self.opacity, *self.spread.sink))
        self.gap.note(strip, deposit.deposit_gap(*strip, radius, coverage, self.opacity, *self.gap.sink))

    def lay(self, out: np.ndarray, state: np.ndarray, rows: Rect, first: int, real: RealPixels) -> None:
        """Put it over the rows `rows` (their rectangle in the frame) of out. first : of these rows in `real`"""
        part = self.rect.clip(rows)
        if part.empty:
            return
        top, bottom = part.y0 - self.rect.y0, part.y1 - self.rect.y0
        own, gap = self.spread.rows(top, bottom, "own"), self.gap.rows(top, bottom, "gap")
        at = slice(part.y0 - rows.y0, part.y1 - rows.y0)
        mine = slice(top, bottom)
        light.lay_cut(
            out[at], state[at], first + part.y0 - rows.y0, part.x0 - self.rect.x0, part.x1 - self.rect.x0, self.rect.x0 - rows.x0,
            top, *own.parts, *gap.parts,
            self.spread.radius[mine], self.colour[mine], self.coverage[mine], self.opacity, real.image, real.patch, real.box,
        )  # fmt: skip


def depth_range(facts: FrameFacts) -> tuple[float, float]:
    """Nearest and farthest distance, m, that a point of the object can have; a little wider for rounding."""
    near, far = facts.depth_range_m
    near = max(near * 0.999, EPS_DEPTH_M)
    return near, max(far * 1.001, near)


def object_box(facts: FrameFacts, frame: Rect, reach_px: float) -> Rect:
    """Pixels that the object's blur may change."""
    box = facts.drawn_box
    return box.pad(int(np.ceil(reach_px)) + 1).clip(frame)


def render(
    now: Layers, facts: FrameFacts, frame: Rect, out: Rect, real: Real, grid: np.ndarray, at: Circles, ladder: Ladder,
    params: DofParams,
) -> Patch:  # fmt: skip
    """IMAGE of a frame with a pose over `out`, or somewhat more of the same rows. frame : the whole picture"""
    optics = np.float32(at.px_per_dioptre), np.float32(at.focus), np.float32(at.limit_px)
    largest = float(at.radius_px(np.array(real.dioptre_range(grid))).max()) if params.scope == "all" else 0.0
    real_blurs = largest > SHARP_PX
    rect = now.rect if real_blurs else out  # where the real scene is sharp its pixels stay where they are
    sharp = RealPixels.of(now.crop(rect), facts)
    measured = _measured(now, sharp, real, at) if real_blurs else None
    base = Spread(rect, ladder, max(largest, SHARP_PX), params.blades, params.blade_turn_deg)
    cuts, kept = _real_cut_outs(rect, sharp, real, grid, optics, ladder, params) if real_blurs else ([], _NONE)
    if measured is not None:
        sharp = sharp.with_all(measured.base)
        cuts = _fronts(measured, rect, at, ladder, params)
    boxed = _object(now, facts, frame, optics, ladder, params)
    cuts += [boxed] if boxed else []
    image = sharp.image
    nodes = real.base.dioptres(grid) if real.base is not None else np.zeros(grid.shape[:2], np.float32)
    background = np.float32(real.background)
    on_nodes = at.radius_px(np.maximum(nodes, real.background))
    rows = strips(rect)

    def start(strip: tuple[int, int]) -> None:
        if measured is None and _sharp_strip(strip, rect, on_nodes):
            base.radius[slice(*strip)] = 0
            return
        if measured is not None:
            base.radius[slice(*strip)] = measured.radius[slice(*strip)]
        else:
            plane_radius(base.radius, *strip, rect.x0, rect.y0, nodes, background, *optics)
        boost = np.float32(params.highlight_boost)
        flat = image.reshape(rect.height, -1), sharp.patch.reshape(len(sharp.patch), 3 * sharp.patch.shape[1])
        base.note(strip, deposit.deposit_real(*strip, base.radius, *flat, sharp.box, kept, boost, *base.sink))

    if real_blurs:
        on_all_cores(start, rows)
    on_all_cores(lambda job: job[0].deposit(job[1]), [(c, s) for c in cuts for s in strips(c.rect)])
    first, last = out.y0 - rect.y0, out.y1 - rect.y0
    result = np.empty((last - first, *image.shape[1:]), np.float32)

    def finish(strip: tuple[int, int]) -> None:
        top, bottom = strip
        out, state = result[top - first : bottom - first], np.zeros((bottom - top, rect.width), np.uint8)
        spread = base.rows(top, bottom, "base") if real_blurs else DARK
        here = Rect(rect.x0, rect.y0 + top, rect.x1, rect.y0 + bottom)
        if spread.lo >= spread.hi:
            out[:] = image[top:bottom]
        else:
            light.lay_real(out, state, image, top, *spread.parts, base.radius, sharp.patch, sharp.box, kept)
        active = EMPTY
        for cut in cuts:
            cut.lay(out, state, here, top, sharp)
            active = active.union(cut.rect.clip(here))
        if not active.empty:
            light.restore(out, state, image, top, active.x0 - rect.x0, active.x1 - rect.x0)

    on_all_cores(finish, [(max(a, first), min(b, last)) for a, b in rows if a < last and b > first])
    return Patch(Rect(rect.x0, out.y0, rect.x1, out.y1), result)


def _sharp_strip(strip: tuple[int, int], rect: Rect, on_nodes: np.ndarray) -> bool:
    """Whether no pixel of the endless plane is blurred in a strip: its dioptres lie between those of the nodes around.

    on_nodes : (gh, gw) radius px on the direction grid
    """
    y0, y1 = (rect.y0 + strip[0]) // GRID_PX, (rect.y0 + strip[1] - 1) // GRID_PX + 2
    return bool(on_nodes[y0:y1, rect.x0 // GRID_PX : (rect.x1 - 1) // GRID_PX + 2].max() <= SHARP_PX)


def _measured(now: Layers, sharp: RealPixels, real: Real, at: Circles) -> DepthLayers | None:
    """The real scene by its measured depth; None where it has none."""
    if real.tiles is None:
        return None
    return depth_layers(sharp.crop(Rect.of(now.rect.width, now.rect.height)), dioptre_of(now[Layer.REAL_DEPTH]), at)


def _fronts(measured: DepthLayers, rect: Rect, at: Circles, ladder: Ladder, params: DofParams) -> list[CutOut]:
    cuts = []
    for front in measured.fronts:
        largest = max(float(front.radius.max()), SHARP_PX)
        box = _box(front.coverage, rect).pad(int(np.ceil(2 * largest)) + 1).clip(rect)
        part = box.slices_in(rect)
        radius, colour, coverage = (np.ascontiguousarray(a[part]) for a in (front.radius, front.colour, front.coverage))
        cuts.append(_cut_out(box, radius, colour, coverage, np.float32(1), ladder, largest, params))
    return cuts


def _cut_out(
    rect: Rect, radius: np.ndarray, colour: np.ndarray, coverage: np.ndarray, opacity: np.float32, ladder: Ladder,
    largest: float, params: DofParams,
) -> CutOut:  # fmt: skip
    spread = Spread(rect, ladder, largest, params.blades, params.blade_turn_deg)
    gap = Spread(rect, ladder, largest, params.blades, params.blade_turn_deg)
    continue_outside(radius, coverage, rect, 2 * largest)
    spread.radius, gap.radius = radius, radius
    return CutOut(rect, colour, coverage, opacity, spread, gap)


def _object(now: Layers, facts: FrameFacts, frame: Rect, optics: Optics, ladder: Ladder, params: DofParams) -> CutOut | None:
    """The virtual object; None where nothing of it is here or nothing of it is blurred."""
    box = facts.drawn_box.clip(now.rect)
    if box.empty:
        return None
    part = now.crop(box)
    radius = np.empty((box.height, box.width), np.float32)
    near, far = (np.float32(d) for d in depth_range(facts))
    largest = float(object_radius(radius, part[Layer.COVERAGE], part[Layer.DEPTH], near, far, *optics))
    if largest < 0:
        return None
    # sharp, it is still laid over the real scene anew where that is blurred
    rect = box if largest <= SHARP_PX else _around(facts, now.rect, frame, 2 * largest)
    padded = np.full((rect.height, rect.width), -1, np.float32)
    padded[box.slices_in(rect)] = radius
    colour, coverage = (_spanning(now, layer, rect) for layer in (Layer.VIRTUAL, Layer.COVERAGE))
    coverage[padded < 0] = 0
    return _cut_out(rect, padded, colour, coverage, np.float32(facts.opacity), ladder, max(largest, SHARP_PX), params)


def _around(facts: FrameFacts, rect: Rect, frame: Rect, reach_px: float) -> Rect:
    """What surrounds the object in `rect`; beyond the picture's edge too, except where the object may go on there."""
    box, n = facts.drawn_box, int(np.ceil(min(reach_px, max(frame.width, frame.height) / 4))) + 1
    grown = Rect(
        rect.x0 - n if box.x0 > frame.x0 == rect.x0 else rect.x0, rect.y0 - n if box.y0 > frame.y0 == rect.y0 else rect.y0,
        rect.x1 + n if box.x1 < frame.x1 == rect.x1 else rect.x1, rect.y1 + n if box.y1 < frame.y1 == rect.y1 else rect.y1,
    )  # fmt: skip
    return box.pad(int(np.ceil(reach_px)) + 1).clip(grown)


def _spanning(now: Layers, layer: Layer, rect: Rect) -> np.ndarray:
    """A layer over `rect`, nothing where it passes the layers' own rectangle."""
    out, both = neutral(layer, rect), rect.clip(now.rect)
    if not both.empty:
        out[both.slices_in(rect)] = now.crop(both)[layer]
    return out


def _real_cut_outs(
    area: Rect, sharp: RealPixels, real: Real, grid: np.ndarray, optics: Optics, ladder: Ladder, params: DofParams
) -> tuple[list[CutOut], np.ndarray]:
    """Real planes of limited size, farthest first, and the share of every pixel that they leave to what is behind."""
    if not real.cut_outs:
        return [], _NONE
    kept, cuts = np.ones((area.height, area.width), np.float32), []
    for plane in reversed(real.cut_outs):  # the nearest hides the others
        radius, inside = np.empty(kept.shape, np.float32), np.empty(kept.shape, np.float32)
        square_radius(radius, inside, area.x0, area.y0, plane.places(grid), np.float32(plane.half_m), *optics)
        inside *= kept
        radius[inside == 0] = -1
        kept -= inside
        box = _box(inside, area)
        if box.empty:
            continue
        largest = max(float(radius.max()), SHARP_PX)
        rect = box.pad(int(np.ceil(2 * largest)) + 1).clip(area)
        at = rect.slices_in(area)
        colour = sharp.crop(rect.shift(-area.x0, -area.y0)) * inside[at][..., None]
        cuts.append(_cut_out(rect, radius[at].copy(), colour, inside[at], np.float32(1), ladder, largest, params))
    return cuts[::-1], kept


def _box(mask: np.ndarray, rect: Rect) -> Rect:
    """Smallest rectangle of the frame that holds what is not 0."""
    ys, xs = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return EMPTY if not len(ys) else Rect(int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1).shift(rect.x0, rect.y0)
