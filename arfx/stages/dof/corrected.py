"""The corrected formula, levels draft to high: layers on the ladder, strip by strip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.parallel import parallel_map
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.stages.dof import deposit, light
from arfx.stages.dof.cutout import continue_outside, object_radius
from arfx.stages.dof.depth_layers import DepthLayers, depth_layers, dioptre_of
from arfx.stages.dof.ladder import SHARP_PX, Ladder
from arfx.stages.dof.layer import Columns, Light, Spread, hull, reached, strips
from arfx.stages.dof.optics import Circles
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.real_pixels import RealPixels
from arfx.stages.dof.spread import TILE_PX
from arfx.stages.dof.surfaces import GRID_PX, Real, plane_radius, square_radius

Optics = tuple[np.float32, np.float32, np.float32]  # px per dioptre, focus dioptre, limit px
_NONE = np.empty((0, 0), np.float32)


@dataclass(frozen=True, eq=False, slots=True)
class CutLight:
    """Light of a cut-out on some rows: part : where in the frame;  columns : of the cut-out, where it is laid over anything"""

    part: Rect
    columns: Columns
    own: Light
    gap: Light


@dataclass(frozen=True, eq=False)
class CutOut:
    """A layer over `rect`: premultiplied colour, coverage, opacity, its own light and what it lets through.

    sharp : outside of it nothing is sharp that covers
    """

    rect: Rect
    colour: np.ndarray
    coverage: np.ndarray
    opacity: np.float32
    spread: Spread
    gap: Spread
    sharp: Rect

    def deposit(self, strip: tuple[int, int]) -> None:
        pixels = deposit.CutPixels(self.spread.radius, self.colour, self.coverage, self.opacity)
        self.spread.note(strip, deposit.deposit_cut(*strip, pixels, self.spread.sink))
        self.gap.note(strip, deposit.deposit_gap(*strip, pixels, self.gap.sink))

    def light(self, rows: Rect, name: str) -> CutLight | None:
        """What it sheds on the rows `rows` (their rectangle in the frame); None where it is not laid over any of them.

        name : of this layer, for memory that is used again
        """
        part = self.rect.clip(rows)
        top, bottom, x0 = part.y0 - self.rect.y0, part.y1 - self.rect.y0, self.rect.x0
        if part.empty:
            return None
        own, sharp = self.spread.rows(top, bottom, f"own {name}"), self.sharp.clip(part)
        a, b = hull((own.lo, own.hi), (sharp.x0 - x0, sharp.x1 - x0))
        a, b = max(a, part.x0 - x0), min(b, part.x1 - x0)
        if a >= b:
            return None
        return CutLight(part, (a, b), own, self.gap.rows(top, bottom, f"gap {name}"))

    def lay(self, at: CutLight, out: np.ndarray, state: np.ndarray, rows: Rect, first: int, real: RealPixels) -> bool:
        """Put it over the rows `rows` of out. first : of these rows in `real`. Returns whether it may be `light.TRIED`."""
        top, bottom = at.part.y0 - self.rect.y0, at.part.y1 - self.rect.y0
        to = slice(at.part.y0 - rows.y0, at.part.y1 - rows.y0)
        radius, colour, coverage = (a[top:bottom] for a in (self.spread.radius, self.colour, self.coverage))
        mine = deposit.CutPixels(radius, colour, coverage, self.opacity)
        tried: bool = light.lay_cut(
            out[to], state[to], first + at.part.y0 - rows.y0, at.columns, self.rect.x0 - rows.x0, top, at.own, at.gap, mine, real
        )
        return tried


def depth_range(facts: FrameFacts) -> tuple[float, float]:
    """Nearest and farthest distance, m, that a point of the object can have; a little wider for rounding."""
    near, far = facts.depth_range_m
    near = max(near * 0.999, EPS_DEPTH_M)
    return near, max(far * 1.001, near)


def object_box(facts: FrameFacts, frame: Rect, reach_px: float) -> Rect:
    """Pixels that the object's blur may change."""
    box = facts.raster_box
    return box.pad(int(np.ceil(reach_px)) + 1).clip(frame)


def render(
    now: Layers, facts: FrameFacts, frame: Rect, out: Rect, real: Real, grid: np.ndarray, at: Circles, ladder: Ladder,
    params: DofParams,
) -> Pixels:  # fmt: skip
    """IMAGE of a frame with a pose over `out`, and somewhat more of the same rows. frame : the whole picture"""
    optics = np.float32(at.px_per_dioptre), np.float32(at.focus), np.float32(at.limit_px)
    largest = float(at.radius_px(np.array(real.dioptre_range(grid))).max()) if params.scope == "all" else 0.0
    real_blurs = largest > SHARP_PX
    rect, everywhere = now.rect, real_blurs and (real.tiles is not None or bool(real.cut_outs))
    rows = strips(rect)
    nodes = real.base.dioptres(grid) if real.base is not None else np.zeros(grid.shape[:2], np.float32)
    hot = [(0, rect.width if everywhere else 0)] * len(rows)  # columns of each strip that hold a circle of 1 px
    if real_blurs and not everywhere:
        hot = _hot_columns(rows, rect, at.radius_px(np.maximum(nodes, real.background)))
    base = Spread(rect, ladder, max(largest, SHARP_PX), params.blades, params.blade_turn_deg)
    boxed = _object(now, facts, frame, optics, ladder, params)
    lit = reached(rows, hot, base.reach, rect.width)
    parts = []  # of the real scene, that are looked at
    for (top, bottom), (a, b) in zip(rows, lit, strict=True):
        strip = Rect(rect.x0, rect.y0 + top, rect.x1, rect.y0 + bottom)
        under = EMPTY if boxed is None else boxed.rect.clip(strip)
        parts += [Rect(rect.x0 + a, strip.y0, rect.x0 + b, strip.y1).union(Rect(under.x0, strip.y0, under.x1, strip.y1))]
    sharp = RealPixels.of(now, facts, parts)
    measured = _measured(now, sharp, real, at) if real_blurs else None
    cuts, kept = _real_cut_outs(rect, sharp, real, grid, optics, ladder, params) if real_blurs else ([], _NONE)
    if measured is not None:
        sharp = sharp.with_all(measured.base)
        cuts = _fronts(measured, rect, at, ladder, params)
    cuts += [boxed] if boxed else []
    image, background = sharp.image, np.float32(real.background)

    def start(k: int) -> None:
        (top, bottom), (a, b), (left, right) = rows[k], hot[k], lit[k]
        base.radius[top:bottom, left:right] = 0
        if a >= b:
            return
        if measured is not None:
            base.radius[top:bottom] = measured.radius[top:bottom]
        else:
            plane_radius(base.radius, top, bottom, a, b, rect.x0, rect.y0, nodes, background, optics)
        boost = np.float32(params.highlight_boost)
        base.note(rows[k], deposit.deposit_real(top, bottom, a, b, base.radius, sharp.flat, kept, boost, base.sink))

    parallel_map(start, [k for k, (a, b) in enumerate(lit) if a < b])
    parallel_map(lambda job: job[0].deposit(job[1]), [(c, s) for c in cuts for s in strips(c.rect)])
    result = np.empty(image.shape, np.float32)

    def finish(strip: tuple[int, int]) -> Rect:
        top, bottom = strip
        here = Rect(rect.x0, rect.y0 + top, rect.x1, rect.y0 + bottom)
        spread = base.rows(top, bottom, "base")
        lights = [(cut, shed) for k, cut in enumerate(cuts) if (shed := cut.light(here, str(k))) is not None]
        a, b = spread.lo, spread.hi
        for cut, shed in lights:
            left = cut.rect.x0 - rect.x0
            a, b = hull((a, b), (shed.columns[0] + left, shed.columns[1] + left))
        if a >= b:
            return EMPTY
        out, state = result[top:bottom], np.zeros((bottom - top, rect.width), np.uint8)
        if spread.lo < spread.hi:
            light.lay_real(out, state, top, a, b, spread, base.radius, sharp, kept)
        else:
            out[:, a:b] = image[top:bottom, a:b]
        if any([cut.lay(shed, out, state, here, top, sharp) for cut, shed in lights]):
            light.restore(out, state, image, top, a, b)
        return Rect(rect.x0 + a, here.y0, rect.x0 + b, here.y1)

    first, last = out.y0 - rect.y0, out.y1 - rect.y0
    made = parallel_map(finish, [(max(a, first), min(b, last)) for a, b in rows if a < last and b > first])
    return Pixels(rect, result, now.written[Layer.IMAGE], written=made)


def _hot_columns(rows: list[tuple[int, int]], rect: Rect, on_nodes: np.ndarray) -> list[tuple[int, int]]:
    """Columns of each strip outside which no pixel of the endless plane is blurred, from tile to tile: a pixel's dioptre lies
    between those of the nodes around.

    on_nodes : (gh, gw) radius px on the direction grid
    """
    out, g0 = [], rect.x0 // GRID_PX
    hot = on_nodes[:, g0 : (rect.x1 - 1) // GRID_PX + 2] > SHARP_PX
    for top, bottom in rows:
        at = np.flatnonzero(hot[(rect.y0 + top) // GRID_PX : (rect.y0 + bottom - 1) // GRID_PX + 2].any(0))
        if not len(at):
            out.append((0, 0))
            continue
        x0, x1 = (int(at[0]) - 1 + g0) * GRID_PX, (int(at[-1]) + 1 + g0) * GRID_PX
        part = Rect(x0, 0, x1, 1).align(TILE_PX, 1).clip(Rect(rect.x0, 0, rect.x1, 1))
        out.append((part.x0 - rect.x0, part.x1 - rect.x0))
    return out


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
        cuts.append(_cut_out(box, radius, colour, coverage, np.float32(1), ladder, largest, params, box, box))
    return cuts


def _cut_out(
    rect: Rect, radius: np.ndarray, colour: np.ndarray, coverage: np.ndarray, opacity: np.float32, ladder: Ladder,
    largest: float, params: DofParams, held: Rect, sharp: Rect,
) -> CutOut:  # fmt: skip
    spread = Spread(rect, ladder, largest, params.blades, params.blade_turn_deg)
    gap = Spread(rect, ladder, largest, params.blades, params.blade_turn_deg)
    continue_outside(radius, coverage, rect, held)
    spread.radius, gap.radius = radius, radius
    colour = colour.view()
    colour.flags.writeable = False  # as a picture's: what goes by colours is compiled once for both
    return CutOut(rect, colour, coverage, opacity, spread, gap, sharp)


def _object(now: Layers, facts: FrameFacts, frame: Rect, optics: Optics, ladder: Ladder, params: DofParams) -> CutOut | None:
    """The virtual object; None where nothing of it is here or nothing of it is blurred."""
    box = facts.raster_box.clip(now.rect)
    if box.empty:
        return None
    part = now.crop(box)
    radius = np.empty((box.height, box.width), np.float32)
    near, far = (np.float32(d) for d in depth_range(facts))
    least, largest = object_radius(radius, part[Layer.COVERAGE], part[Layer.DEPTH], near, far, optics)
    if largest < 0:
        return None
    # sharp, it is still laid over the real scene anew where that is blurred
    rect = box if largest <= SHARP_PX else _around(facts, now.rect, frame, 2 * largest)
    padded = np.full((rect.height, rect.width), -1, np.float32)
    padded[box.slices_in(rect)] = radius
    coverage = np.zeros(padded.shape, np.float32)
    coverage[box.slices_in(rect)] = part[Layer.COVERAGE]
    coverage[padded < 0] = 0
    colour, tiles = np.empty((*padded.shape, 3), np.float32), box.align(TILE_PX, TILE_PX).clip(rect)
    colour[tiles.slices_in(rect)] = 0  # it is looked at in tiles that hold anything
    colour[box.slices_in(rect)] = part[Layer.VIRTUAL]
    opacity, sharp = np.float32(facts.opacity), box if least <= SHARP_PX else EMPTY
    return _cut_out(rect, padded, colour, coverage, opacity, ladder, max(float(largest), SHARP_PX), params, box, sharp)


def _around(facts: FrameFacts, rect: Rect, frame: Rect, reach_px: float) -> Rect:
    """What surrounds the object in `rect`; beyond the picture's edge too, except where the object may go on there."""
    box, n = facts.raster_box, int(np.ceil(min(reach_px, max(frame.width, frame.height) / 4))) + 1
    grown = Rect(
        rect.x0 - n if box.x0 > frame.x0 == rect.x0 else rect.x0, rect.y0 - n if box.y0 > frame.y0 == rect.y0 else rect.y0,
        rect.x1 + n if box.x1 < frame.x1 == rect.x1 else rect.x1, rect.y1 + n if box.y1 < frame.y1 == rect.y1 else rect.y1,
    )  # fmt: skip
    return box.pad(int(np.ceil(reach_px)) + 1).clip(grown)


def _real_cut_outs(
    area: Rect, sharp: RealPixels, real: Real, grid: np.ndarray, optics: Optics, ladder: Ladder, params: DofParams
) -> tuple[list[CutOut], np.ndarray]:
    """Real planes of limited size, farthest first, and the share of every pixel that they leave to what is behind."""
    if not real.cut_outs:
        return [], _NONE
    kept, cuts = np.ones((area.height, area.width), np.float32), []
    for plane in reversed(real.cut_outs):  # the nearest hides the others
        radius, inside = np.empty(kept.shape, np.float32), np.empty(kept.shape, np.float32)
        square_radius(radius, inside, area.x0, area.y0, plane.places(grid), np.float32(plane.half_m), optics)
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
        cuts.append(
            _cut_out(rect, radius[at].copy(), colour, inside[at].copy(), np.float32(1), ladder, largest, params, box, box)
        )
    return cuts[::-1], kept


def _box(mask: np.ndarray, rect: Rect) -> Rect:
    """Smallest rectangle of the frame that holds what is not 0."""
    ys, xs = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return EMPTY if not len(ys) else Rect(int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1).shift(rect.x0, rect.y0)
