"""Hide: real things nearer than the object hide it: COVERAGE and VIRTUAL times the visible share.

Only where the job measures the real scene's depth. How much nearer the real surface is, as
a share of its distance, says what is hidden; depth maps end some pixels beside the things
that they show, so a guided filter moves that mask's edge to the picture's own and softens
it. It looks at the object's pixels alone: its outline stays as it is. `draft` leaves the
mask as the depth has it. No level is above `standard`: more passes of the filter come to
rest farther from the true edge (sample scene 0022, against its exact masks).
Cost: O(pixels of the object before which something real stands). Leaves out: the shadow of
what is nearer on the object
(`holdout` keeps the object's off it). Source: guided filter (`guided`), each mean weighted
by where the object is."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.numerics import divide
from arfx.core.real_depth import TILE_PX
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.settings import Settings, setting
from arfx.core.stage import Demand, Stage, View
from arfx.stages.guided import reach_px, refined, window_px


class HideParams(Settings):
    margin: float = setting(
        0.03,
        "a real surface that is nearer by this fraction of its distance begins to hide the"
        " object, and by twice that hides it wholly",
        gt=0,
        le=1,
    )


class Hide(Stage):
    name = "hide"
    facts = frozenset({"pose", "depth"})
    levels = ("draft", "standard")
    Params = HideParams

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        depth = facts.real_depth
        if depth is None:
            return Demand(EMPTY, "the real scene's depth is not known")
        if facts.model_box.empty:
            return Demand(EMPTY, "model out of view")
        box = facts.raster_box.clip(frame)
        farthest = facts.depth_range_m[1]
        nearer = depth.tiles[1] * farthest > 1 + self.params.margin
        rect = EMPTY
        for y, x in np.argwhere(nearer):
            corners = (x, y, x + 1, y + 1)
            rect = rect.union(Rect(*(TILE_PX * int(v) for v in corners)).clip(box))
        if rect.empty:
            return Demand(
                EMPTY, f"nothing real is nearer than the object's {farthest:.2f} m"
            )
        return Demand(
            rect.pad(reach_px(scene)).clip(box),
            "something real may be in front of the object",
        )

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        return (
            out
            if level == "draft"
            else out.pad(reach_px(scene)).clip(scene.camera.rect)
        )

    def run(self, view: View, prepared: Any) -> Mapping[Layer, ndarray]:
        coverage, virtual = view[Layer.COVERAGE], view[Layer.VIRTUAL]
        visibility = rough_mask(
            coverage,
            view[Layer.DEPTH],
            view[Layer.REAL_DEPTH],
            self.params.margin,
        )
        valid = (coverage > 0).astype(np.float32)
        if view.level != "draft" and (visibility < 1).any():
            visibility = refined(
                visibility, valid, view[Layer.PLATE], window_px(view.scene)
            )
        return {
            Layer.COVERAGE: coverage * visibility,
            Layer.VIRTUAL: virtual * visibility[..., None],
        }


def rough_mask(
    coverage: ndarray, depth: ndarray, real: ndarray, margin: float
) -> ndarray:
    """(h, w) float32: 1 = seen, 0 = hidden, by depth alone; 1 where the object is not or a
    depth is none.

    depth, real : (h, w) m"""
    both = np.stack([depth, real])
    known = ((both > 0) & np.isfinite(both)).all(0) & (coverage > 0)
    nearer = divide(depth, real) - 1
    return np.where(known, np.clip(2 - nearer / margin, 0, 1), 1).astype(np.float32)
