"""The corrected formula, level draft: each layer is looked up in its image pyramid, by the radius of the pixel that is made.

That is the blur of the other levels wherever the radius changes slowly over the picture. Behind a blurred object the plane's
light counts whole, though the object takes a part of it (`sharp_frame._seen_behind`)."""

from __future__ import annotations

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.parallel import parallel_map
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.stages.dof import mipmap
from arfx.stages.dof.compositing import restore
from arfx.stages.dof.layer import hull
from arfx.stages.dof.mipmap import Mipmap, reach_px, shares
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.pyramid import SHARP_PX
from arfx.stages.dof.sharp_frame import Occluder, SharpFrame, real_radius_px, sharp_frame
from arfx.stages.dof.splat import OccluderPixels
from arfx.stages.dof.surfaces import Real

_SHARE = shares(0)


class _Blurred:
    """An occluder and its pyramid."""

    def __init__(self, occluder: Occluder) -> None:
        rect = self.rect = occluder.rect
        self.pixels = OccluderPixels(
            occluder.radius, occluder.colour, occluder.coverage, occluder.opacity
        )
        self.mipmap = Mipmap(
            (rect.x0, rect.y0), (0, 0, rect.width, rect.height), occluder.largest_px
        )
        self.mipmap.fill_occluder(self.pixels)
        self.coarse = self.mipmap.mix()

    def composite(self, out: np.ndarray, state: np.ndarray, rows: Rect) -> bool:
        """Over the rows `rows` of out. Returns whether any pixel is `compositing.SHARP`."""
        part, left = self.rect.clip(rows), self.rect.x0
        if part.empty:
            return False
        to, at = (
            slice(part.y0 - rows.y0, part.y1 - rows.y0),
            (part.y0 - self.rect.y0, left - rows.x0),
        )
        columns, odd = (part.x0 - left, part.x1 - left), self.mipmap.odd[0]
        return bool(
            mipmap.composite_occluder(
                out[to], state[to], columns, at, odd, _SHARE, self.coarse, self.pixels
            )
        )


def render(
    now: Layers,
    facts: FrameFacts,
    frame: Rect,
    out: Rect,
    real: Real,
    grid: np.ndarray,
    coc: CircleOfConfusion,
    params: DofParams,
) -> Pixels:
    """IMAGE of a frame with a pose over `out`, and somewhat more of the same rows. frame : the whole picture"""
    largest = max(real_radius_px(real, grid, coc, params), SHARP_PX)
    at = sharp_frame(now, facts, frame, real, grid, coc, params, reach_px(largest), False)
    rect, rows = at.rect, at.rows
    radius = np.empty((rect.height, rect.width), np.float32)
    base = _real_mipmap(at, radius, largest, np.float32(params.highlight_boost))
    occluders = [_Blurred(o) for o in at.occluders]
    result = np.empty((rect.height, rect.width, 3), np.float32)

    def finish(k: int) -> Rect:
        top, bottom = max(rows[k][0], first), min(rows[k][1], last)
        here = Rect(rect.x0, rect.y0 + top, rect.x1, rect.y0 + bottom)
        a, b = at.blurred[k]
        for layer in occluders:
            part = layer.rect.clip(here).shift(-rect.x0, 0)
            a, b = hull((a, b), (part.x0, part.x1) if not part.empty else (0, 0))
        if a >= b:
            return EMPTY
        to, state = result[top:bottom], np.zeros((bottom - top, rect.width), np.uint8)
        if base is None:
            to[:, a:b] = at.real.crop(Rect(a, top, b, bottom))
        else:
            place, odd = (top, *base.window[:2]), base.odd[0]
            columns = (
                a,
                b,
                *at.blurred[k],
            )  # beside them nothing is blurred, and parts of the plate may not be made
            mipmap.composite_real(
                to,
                state,
                columns,
                place,
                odd,
                _SHARE,
                base.values[0],
                radius,
                at.real,
                at.visibility,
            )
        any_sharp = any([layer.composite(to, state, here) for layer in occluders])
        restore(to, state, top, (a, b), any_sharp, at.real, at.bits, at.at)
        return Rect(rect.x0 + a, here.y0, rect.x0 + b, here.y1)

    first, last = out.y0 - rect.y0, out.y1 - rect.y0
    made = parallel_map(finish, [k for k, (a, b) in enumerate(rows) if a < last and b > first])
    return Pixels(rect, result, now.written[Layer.IMAGE], written=made)


def _real_mipmap(
    at: SharpFrame, radius: np.ndarray, largest_px: float, boost: np.float32
) -> Mipmap | None:
    """Pyramid of the real scene, and its radius (h, w) filled, where any of it is blurred; None = nowhere."""
    reached = [(k, a, b) for k, (a, b) in enumerate(at.reached) if a < b]
    if not reached:
        return None
    window = (
        min(a for _, a, _ in reached),
        at.rows[reached[0][0]][0],
        max(b for *_, b in reached),
        at.rows[reached[-1][0]][1],
    )
    radius[window[1] : window[3], window[0] : window[2]] = 0
    parallel_map(lambda k: at.fill_radius(k, radius), [k for k, *_ in reached])
    made = Mipmap((at.rect.x0, at.rect.y0), window, largest_px)
    made.fill_real(at.real, radius, at.visibility, boost)
    made.mix()
    return made
