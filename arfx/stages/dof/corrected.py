"""The corrected formula, levels standard and high: layers splatted onto pyramids, spread and composited strip by strip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.parallel import parallel_map
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.stages.dof import compositing, splat
from arfx.stages.dof.layer import DARK, BlurLayer, BlurredRows, hull, strips
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.pyramid import SHARP_PX, Pyramid
from arfx.stages.dof.sharp_frame import Occluder, real_radius_px, sharp_frame
from arfx.stages.dof.surfaces import Real, move_light

Blurred = tuple[
    Rect, BlurredRows, BlurredRows
]  # part of the frame that a layer covers; on its rows its light, occluded weight


@dataclass(frozen=True, eq=False)
class OccluderLayer:
    """An occluder, its light and its occluded weight."""

    is_of: Occluder
    own: BlurLayer
    occluded: BlurLayer

    @staticmethod
    def of(occluder: Occluder, pyramid: Pyramid, params: DofParams) -> OccluderLayer:
        own, occluded = (
            BlurLayer(
                occluder.rect, pyramid, occluder.largest_px, params.blades, params.blade_turn_deg
            )
            for _ in range(2)
        )
        own.radius, occluded.radius = occluder.radius, occluder.radius
        return OccluderLayer(occluder, own, occluded)

    def splat(self, strip: tuple[int, int]) -> None:
        pixels = splat.OccluderPixels(
            self.is_of.radius, self.is_of.colour, self.is_of.coverage, self.is_of.opacity
        )
        self.own.record(strip, splat.splat_occluder(*strip, pixels, self.own.buffers))
        self.occluded.record(strip, splat.splat_occluded(*strip, pixels, self.occluded.buffers))

    def blurred_rows(self, rows: Rect, name: str) -> Blurred:
        """Of the rectangle `rows` of the frame. name : of this layer, for memory that is used again"""
        rect = self.is_of.rect
        part = rect.clip(rows)
        if part.empty:
            return EMPTY, DARK, DARK
        span = part.y0 - rect.y0, part.y1 - rect.y0
        own = self.own.rows(*span, f"own {name}")
        blurred = Rect(rect.x0 + own.lo, part.y0, rect.x0 + own.hi, part.y1)
        covered = blurred.union(self.is_of.sharp.clip(part)).clip(part)
        return covered, own, own if covered.empty else self.occluded.rows(*span, f"occluded {name}")

    def composite(self, blurred: Blurred, out: np.ndarray, state: np.ndarray, rows: Rect) -> bool:
        """Over the rows `rows` of out. Returns whether any pixel is `compositing.SHARP`."""
        (part, own, occluded), it = blurred, self.is_of
        top, bottom, down, left = (
            part.y0 - it.rect.y0,
            part.y1 - it.rect.y0,
            part.y0 - rows.y0,
            it.rect.x0,
        )
        radius, colour, coverage = (a[top:bottom] for a in (it.radius, it.colour, it.coverage))
        pixels = splat.OccluderPixels(radius, colour, coverage, it.opacity)
        columns, to = (part.x0 - left, part.x1 - left), slice(down, part.y1 - rows.y0)
        args = out[to], state[to], columns, (top, left - rows.x0), own, occluded, pixels
        return not part.empty and bool(compositing.composite_occluder(*args))


def render(
    now: Layers,
    facts: FrameFacts,
    frame: Rect,
    out: Rect,
    real: Real,
    grid: np.ndarray,
    coc: CircleOfConfusion,
    pyramid: Pyramid,
    params: DofParams,
) -> Pixels:
    """IMAGE of a frame with a pose over `out`, and somewhat more of the same rows. frame : the whole picture"""
    largest = max(real_radius_px(real, grid, coc, params), SHARP_PX)
    base = BlurLayer(now.rect, pyramid, largest, params.blades, params.blade_turn_deg)
    at = sharp_frame(now, facts, frame, real, grid, coc, params, base.margin_px, True)
    rect, rows, spread = at.rect, at.rows, at.real
    occluders = [OccluderLayer.of(o, pyramid, params) for o in at.occluders]
    if pyramid.slanted and real.base is not None and min(rect.width, rect.height) > 1:
        whole, moved = (
            at.real.crop(Rect.of(rect.width, rect.height)),
            np.empty((rect.height, rect.width, 3), np.float32),
        )
        corner, todo = (rect.x0, rect.y0), [k for k, (a, b) in enumerate(at.blurred) if a < b]

        def move(k):
            return move_light(
                moved, whole, rows[k], at.blurred[k], corner, at.nodes, at.background, at.optics
            )

        parallel_map(move, todo)
        spread = at.real.with_all(moved)
    boost = np.float32(params.highlight_boost)

    def start(k: int) -> None:
        (top, bottom), (a, b) = rows[k], at.blurred[k]
        at.fill_radius(k, base.radius)
        if a < b:
            lit = splat.splat_real(
                top, bottom, a, b, base.radius, spread.flat, at.visibility, boost, base.buffers
            )
            base.record(rows[k], lit)

    parallel_map(start, [k for k, (a, b) in enumerate(at.reached) if a < b])
    parallel_map(
        lambda job: job[0].splat(job[1]), [(c, s) for c in occluders for s in strips(c.is_of.rect)]
    )
    result = np.empty((rect.height, rect.width, 3), np.float32)

    def finish(strip: tuple[int, int]) -> Rect:
        top, bottom = strip
        here = Rect(rect.x0, rect.y0 + top, rect.x1, rect.y0 + bottom)
        base_rows = base.rows(top, bottom, "base")
        layers = [(layer, layer.blurred_rows(here, str(k))) for k, layer in enumerate(occluders)]
        a, b = base_rows.lo, base_rows.hi
        for _, (part, *_) in layers:
            a, b = hull((a, b), (part.x0 - rect.x0, part.x1 - rect.x0))
        if a >= b:
            return EMPTY
        out, state = result[top:bottom], np.zeros((bottom - top, rect.width), np.uint8)
        if base_rows.lo >= base_rows.hi:
            base_rows = DARK._replace(lo=a, hi=a)
        compositing.composite_real(
            out, state, top, a, b, base_rows, base.radius, at.real, at.visibility
        )
        any_sharp = any([layer.composite(light, out, state, here) for layer, light in layers])
        compositing.restore(out, state, top, (a, b), any_sharp, at.real, at.bits, at.at)
        return Rect(rect.x0 + a, here.y0, rect.x0 + b, here.y1)

    first, last = out.y0 - rect.y0, out.y1 - rect.y0
    made = parallel_map(
        finish, [(max(a, first), min(b, last)) for a, b in rows if a < last and b > first]
    )
    return Pixels(rect, result, now.written[Layer.IMAGE], written=made)
