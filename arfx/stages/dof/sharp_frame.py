"""What a frame's lens blurs, for every level but the reference: the sharp real scene, and what stands before it.

The virtual object, real planes of limited size and what was measured before the focus are occluders: colour, coverage and a
blur radius that goes on outside of their outline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.rect import EMPTY, Rect
from arfx.stages.dof.depth_layers import DepthLayers, depth_layers, dioptre_of
from arfx.stages.dof.layer import Columns, reached_columns, strips
from arfx.stages.dof.occluder import extrapolate_radius, object_radius
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.pyramid import SHARP_PX
from arfx.stages.dof.real_pixels import RealPixels
from arfx.stages.dof.spread import TILE_PX
from arfx.stages.dof.surfaces import GRID_PX, Real, plane_radius, square_radius

Optics = tuple[np.float32, np.float32, np.float32]  # px per dioptre, focus dioptre, limit px
_NONE = np.empty((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class Occluder:
    """Something before the real scene, over `rect`: blur radius (h, w) px, -1 = nothing near, premultiplied colour (h, w, 3),
    read-only, coverage (h, w), opacity.

    largest_px : no radius is larger;  sharp : outside of it nothing is sharp that covers"""

    rect: Rect
    radius: np.ndarray
    colour: np.ndarray
    coverage: np.ndarray
    opacity: np.float32
    largest_px: float
    sharp: Rect


@dataclass(frozen=True, eq=False)
class SharpFrame:
    """A frame before its blur, over `rect`.

    rows, blurred, reached : strips, and of each the columns with a circle of 1 px, and those that their light can reach
    nodes : (gh, gw) dioptres of the endless plane;  optics, background : of `plane_radius`
    real : its pixels;  visibility : (h, w) fraction of each that no occluder hides, (0, 0) = all
    measured : its layers, where depth was measured
    occluders : farthest first
    bits : (bh, bw, 3) of the composite, in place at = x0, y0, x1, y1; elsewhere it is the real scene"""

    rect: Rect
    rows: list[tuple[int, int]]
    blurred: list[Columns]
    reached: list[Columns]
    nodes: np.ndarray
    optics: Optics
    background: np.float32
    real: RealPixels
    visibility: np.ndarray
    measured: DepthLayers | None
    occluders: list[Occluder]
    bits: np.ndarray
    at: tuple[int, int, int, int]

    def fill_radius(self, k: int, radius: np.ndarray) -> None:
        """Of the real scene in strip k, where light can reach: rows of radius (h, w) px."""
        (top, bottom), (a, b), (left, right) = self.rows[k], self.blurred[k], self.reached[k]
        if a >= b:
            radius[top:bottom, left:right] = 0
        elif self.measured is not None:
            radius[top:bottom] = self.measured.radius[top:bottom]
        else:
            radius[top:bottom, left:a], radius[top:bottom, b:right] = 0, 0
            plane_radius(
                radius,
                top,
                bottom,
                a,
                b,
                self.rect.x0,
                self.rect.y0,
                self.nodes,
                self.background,
                self.optics,
            )


def real_radius_px(
    real: Real, grid: np.ndarray, coc: CircleOfConfusion, params: DofParams
) -> float:
    """Largest blur radius of the real scene; 0 where it keeps its own."""
    return coc.largest_px(real.dioptre_range(grid)) if params.scope == "all" else 0.0


def depth_range(facts: FrameFacts) -> tuple[float, float]:
    """Nearest and farthest distance, m, that a point of the object can have; a little wider for rounding."""
    near, far = facts.depth_range_m
    near = max(near * 0.999, EPS_DEPTH_M)
    return near, max(far * 1.001, near)


def object_box(facts: FrameFacts, frame: Rect, reach_px: float) -> Rect:
    """Pixels that the object's blur may change."""
    return facts.raster_box.pad(int(np.ceil(reach_px)) + 1).clip(frame)


def sharp_frame(
    now: Layers,
    facts: FrameFacts,
    frame: Rect,
    real: Real,
    grid: np.ndarray,
    coc: CircleOfConfusion,
    params: DofParams,
    margin_px: int,
    hides: bool,
) -> SharpFrame:
    """Of a frame with a pose. frame : the whole picture;  margin_px : how far the real scene's light goes at most
    hides : light of it that the object takes is told apart (`SharpFrame.visibility`)"""
    optics = np.float32(coc.px_per_dioptre), np.float32(coc.focus), np.float32(coc.limit_px)
    real_blurs = real_radius_px(real, grid, coc, params) > SHARP_PX
    rect, everywhere = now.rect, real_blurs and (real.tiles is not None or bool(real.finite_planes))
    rows = strips(rect)
    nodes = (
        real.base.dioptres(grid) if real.base is not None else np.zeros(grid.shape[:2], np.float32)
    )
    blurred = [(0, rect.width if everywhere else 0)] * len(
        rows
    )  # columns of each strip that hold a circle of 1 px
    if real_blurs and not everywhere:
        blurred = _blurred_columns(rows, rect, coc.radius_px(np.maximum(nodes, real.background)))
    boxed = _object(now, facts, frame, optics)
    reached = reached_columns(rows, blurred, margin_px, rect.width)
    parts = []  # of the real scene, that are looked at
    for (top, bottom), (a, b) in zip(rows, reached, strict=True):
        strip = Rect(rect.x0, rect.y0 + top, rect.x1, rect.y0 + bottom)
        under = EMPTY if boxed is None else boxed.rect.clip(strip)
        parts += [
            Rect(rect.x0 + a, strip.y0, rect.x0 + b, strip.y1).union(
                Rect(under.x0, strip.y0, under.x1, strip.y1)
            )
        ]
    sharp = RealPixels.of(now, facts, parts)
    measured = None
    occluders, visibility = (
        _real_occluders(rect, sharp, real, grid, optics) if real_blurs else ([], _NONE)
    )
    if boxed is not None and real_blurs and real.base is not None and not occluders and hides:
        visibility = _seen_behind(now, facts, real, nodes, coc)
    if real_blurs and real.tiles is not None:
        measured = depth_layers(
            sharp.crop(Rect.of(rect.width, rect.height)), dioptre_of(now[Layer.REAL_DEPTH]), coc
        )
        sharp = sharp.with_all(measured.base)
        for front in measured.fronts:
            colour_of = lambda part: front.colour[part.slices]  # noqa: B023, E731
            occluders.append(_real_occluder(rect, front.radius, front.coverage, colour_of))
    occluders += [boxed] if boxed else []
    # elsewhere the composite is the real scene: what `sharp` was before `with_all`
    own = (
        rect if measured is not None else now.extent(Layer.IMAGE).union(facts.raster_box.clip(rect))
    )
    bits = packed(np.zeros((0, 0, 3), np.float32) if own.empty else now.crop(own)[Layer.IMAGE])
    place = own.shift(-rect.x0, -rect.y0)
    at = place.x0, place.y0, place.x1, place.y1
    background = np.float32(real.background)
    return SharpFrame(
        rect,
        rows,
        blurred,
        reached,
        nodes,
        optics,
        background,
        sharp,
        visibility,
        measured,
        occluders,
        bits,
        at,
    )


def _blurred_columns(
    rows: list[tuple[int, int]], rect: Rect, on_nodes: np.ndarray
) -> list[tuple[int, int]]:
    """Columns of each strip outside which no pixel of the endless plane is blurred, from tile to tile: a pixel's dioptre lies
    between those of the nodes around.

    on_nodes : (gh, gw) radius px on the direction grid"""
    out, g0 = [], rect.x0 // GRID_PX
    blurred = on_nodes[:, g0 : (rect.x1 - 1) // GRID_PX + 2] > SHARP_PX
    for top, bottom in rows:
        tiles = np.flatnonzero(
            blurred[(rect.y0 + top) // GRID_PX : (rect.y0 + bottom - 1) // GRID_PX + 2].any(0)
        )
        if not len(tiles):
            out.append((0, 0))
            continue
        x0, x1 = (int(tiles[0]) - 1 + g0) * GRID_PX, (int(tiles[-1]) + 1 + g0) * GRID_PX
        part = Rect(x0, 0, x1, 1).align(TILE_PX, 1).clip(Rect(rect.x0, 0, rect.x1, 1))
        out.append((part.x0 - rect.x0, part.x1 - rect.x0))
    return out


def _real_occluder(
    area: Rect, radius: np.ndarray, coverage: np.ndarray, colour_of: Callable[[Rect], np.ndarray]
) -> Occluder:
    """Of a part of the real scene, over as much of `area` as it and its blur take. radius, coverage : over all of `area`

    colour_of : premultiplied colour of a rectangle, px from the area's corner"""
    largest, box = max(float(radius.max()), SHARP_PX), box_of(coverage)
    part = box.pad(int(np.ceil(2 * largest)) + 1).clip(Rect.of(area.width, area.height))
    colour, rect = np.ascontiguousarray(colour_of(part)), part.shift(area.x0, area.y0)
    covered = box.shift(area.x0, area.y0)
    radius, coverage = radius[part.slices].copy(), coverage[part.slices].copy()
    return _occluder(rect, radius, colour, coverage, np.float32(1), largest, covered, covered)


def _occluder(
    rect: Rect,
    radius: np.ndarray,
    colour: np.ndarray,
    coverage: np.ndarray,
    opacity: np.float32,
    largest: float,
    covered: Rect,
    sharp: Rect,
) -> Occluder:
    extrapolate_radius(radius, coverage, rect, covered)
    colour = colour.view()
    colour.flags.writeable = False  # as a picture's: what goes by colours is compiled once for both
    return Occluder(rect, radius, colour, coverage, opacity, largest, sharp)


def _object(now: Layers, facts: FrameFacts, frame: Rect, optics: Optics) -> Occluder | None:
    """The virtual object; None where nothing of it is here or nothing of it is blurred."""
    box = facts.raster_box.clip(now.rect)
    if box.empty:
        return None
    part = now.crop(box)
    radius = np.empty((box.height, box.width), np.float32)
    near, far = (np.float32(d) for d in depth_range(facts))
    least, largest = object_radius(
        radius, part[Layer.COVERAGE], part[Layer.DEPTH], near, far, optics
    )
    if largest < 0:
        return None
    # a sharp object too is composited again where the real scene behind it is blurred
    rect = box if largest <= SHARP_PX else _around(facts, now.rect, frame, 2 * largest)
    padded = np.full((rect.height, rect.width), -1, np.float32)
    padded[box.slices_in(rect)] = radius
    coverage = np.zeros(padded.shape, np.float32)
    coverage[box.slices_in(rect)] = np.fmax(
        part[Layer.COVERAGE], 0
    )  # as `object_radius` takes it: not a number is none
    colour, tiles = np.empty((*padded.shape, 3), np.float32), box.align(TILE_PX, TILE_PX).clip(rect)
    colour[tiles.slices_in(rect)] = 0  # it is looked at in tiles that hold anything
    colour[box.slices_in(rect)] = part[Layer.VIRTUAL]
    opacity, sharp = np.float32(facts.opacity), box if least <= SHARP_PX else EMPTY
    return _occluder(
        rect, padded, colour, coverage, opacity, max(float(largest), SHARP_PX), box, sharp
    )


def _seen_behind(
    now: Layers, facts: FrameFacts, real: Real, nodes: np.ndarray, coc: CircleOfConfusion
) -> np.ndarray:
    """(h, w) fraction of the light of each pixel of the real plane that comes past the object.

    Through the place o of the lens a pixel p sees the plane at p + s o, the object at p + s' o: with s = s' what the pinhole
    sees. Where either is sharp every point of the plane comes past from somewhere."""
    box = facts.raster_box.clip(now.rect)
    part, (near, far) = now.crop(box), depth_range(facts)
    plane, one = np.empty((box.height, box.width), np.float32), np.float32(1)
    itself = (
        one,
        np.float32(0),
        np.float32(np.inf),
    )  # a radius of 1 px a dioptre from a focus at infinity
    plane_radius(
        plane,
        0,
        box.height,
        0,
        box.width,
        box.x0,
        box.y0,
        nodes,
        np.float32(real.background),
        itself,
    )
    plane -= np.float32(coc.focus)
    own = one / np.clip(part[Layer.DEPTH], np.float32(near), np.float32(far)) - np.float32(
        coc.focus
    )
    smaller, larger = np.minimum(np.abs(own), np.abs(plane)), np.maximum(np.abs(own), np.abs(plane))
    alike = np.where(own * plane > 0, divide(smaller, larger), 0).astype(np.float32)
    out = np.ones((now.rect.height, now.rect.width), np.float32)
    out[box.slices_in(now.rect)] -= alike * part[Layer.COVERAGE] * np.float32(facts.opacity)
    return out


def _around(facts: FrameFacts, rect: Rect, frame: Rect, reach_px: float) -> Rect:
    """What surrounds the object in `rect`; beyond the picture's edge too, except where the object may go on there."""
    box, n = facts.raster_box, int(np.ceil(min(reach_px, max(frame.width, frame.height) / 4))) + 1
    grown = Rect(
        rect.x0 - n if box.x0 > frame.x0 == rect.x0 else rect.x0,
        rect.y0 - n if box.y0 > frame.y0 == rect.y0 else rect.y0,
        rect.x1 + n if box.x1 < frame.x1 == rect.x1 else rect.x1,
        rect.y1 + n if box.y1 < frame.y1 == rect.y1 else rect.y1,
    )
    return box.pad(int(np.ceil(reach_px)) + 1).clip(grown)


def _real_occluders(
    area: Rect, sharp: RealPixels, real: Real, grid: np.ndarray, optics: Optics
) -> tuple[list[Occluder], np.ndarray]:
    """Real planes of limited size, farthest first, and (h, w) what fraction of every pixel behind them stays visible."""
    if not real.finite_planes:
        return [], _NONE
    visibility, occluders = np.ones((area.height, area.width), np.float32), []
    for plane in reversed(real.finite_planes):  # the nearest hides the others
        radius, inside = (
            np.empty(visibility.shape, np.float32),
            np.empty(visibility.shape, np.float32),
        )
        square_radius(
            radius,
            inside,
            area.x0,
            area.y0,
            plane.positions(grid),
            np.float32(plane.half_m),
            optics,
        )
        inside *= visibility
        radius[inside == 0] = -1
        visibility -= inside
        if inside.any():
            colour_of = lambda part: sharp.crop(part) * inside[part.slices][..., None]  # noqa: B023, E731
            occluders.append(_real_occluder(area, radius, inside, colour_of))
    return occluders[::-1], visibility


def box_of(mask: np.ndarray) -> Rect:
    """Smallest rectangle that holds what is not 0."""
    ys, xs = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return Rect(int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1) if len(ys) else EMPTY
