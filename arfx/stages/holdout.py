"""Holdout: keeps the plane's shadow off real things that are not the plane, by measured depth.

`lightmap` knows one plane and dims every pixel in which it would be seen. Where the job
measures the real scene's depth, what is nearer (a thing that stands on the plane) or
farther (the floor beyond a table's edge) keeps its light. How far off counts follows from
the depth's own noise on the prints; holes were filled along the picture's edges before.
Depth maps end some pixels beside the things that they show, so beside such an edge a guided
filter moves it to the picture's own. `draft` leaves the depth's edges as they are; no level
is above `standard`, as in `hide`. `gi` asks the depth itself, plane by plane, and adds to
what is left. Cost: O(pixels of the shadow). Leaves out: the shadow that such a thing would
really take, and cast on the object.
Source: guided filter (`guided`)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.numerics import divide
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.settings import Settings, setting
from arfx.core.stage import Demand, Stage, View
from arfx.stages.guided import reach_px, refined, window_px
from arfx.stages.light.planes import on_plane
from arfx.stages.viewing import between_nodes, direction_grid

_SIGMAS = 3.0  # of the depth's noise, within which a pixel lies on the plane


class HoldoutParams(Settings):
    tolerance: float = setting(
        0.01,
        "a real surface takes the whole shadow if it is off the plane by at most this"
        " fraction of its distance, and none if it is off by twice that. Noisy depth gets"
        " more: three standard deviations, measured on the markers",
        gt=0,
        le=1,
    )


class Holdout(Stage):
    name = "holdout"
    facts = frozenset({"pose", "depth"})
    levels = ("draft", "standard")
    Params = HoldoutParams

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        if facts.real_depth is None:
            return Demand(EMPTY, "the real scene's depth is not known")
        return Demand(None, "measured depth shows which pixels are the plane")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        return (
            out
            if level == "draft"
            else out.pad(reach_px(scene)).clip(scene.camera.rect)
        )

    def prepare(self, scene: Scene, level: str) -> ndarray:
        return direction_grid(scene.camera)

    def run(self, view: View, prepared: Any) -> Mapping[Layer, Pixels]:
        now, scene = view.layers, view.scene
        inside = now.extent(Layer.SHADOW)
        if inside.empty:
            return {Layer.SHADOW: Pixels(inside, np.empty((0, 0, 3), np.float32))}
        around = self.needs(inside, view.facts, scene, view.level).clip(now.rect)
        part, depth = now.crop(around), view.facts.real_depth
        tolerance = max(
            self.params.tolerance, 0.0 if depth is None else _SIGMAS * depth.noise
        )
        dioptres = plane_dioptres(
            prepared, view.pose @ scene.world_from_anchor, around
        )
        fraction = on_plane(part[Layer.REAL_DEPTH], dioptres, tolerance)
        if view.level != "draft" and (fraction < 1).any():
            fraction = refined(
                fraction, np.ones_like(fraction), part[Layer.PLATE], window_px(scene)
            )
        fraction = fraction[inside.slices_in(around)][..., None]
        shadow = now.crop(inside)[Layer.SHADOW]
        # the same bits where the fraction is 1
        return {Layer.SHADOW: Pixels(inside, shadow + (1 - shadow) * (1 - fraction))}


def plane_dioptres(grid: ndarray, camera_from_plane: Pose, rect: Rect) -> ndarray:
    """(h, w) float32, 1/m: of the plane z = 0 along each pixel's axis; <= 0 where it is not
    in view.

    grid : as `direction_grid`"""
    normal = camera_from_plane.rotation[:, 2]
    height = float(normal @ camera_from_plane.translation_m)
    nodes = (grid @ normal * divide(1.0, height)).astype(np.float32)
    return between_nodes(nodes, rect)
