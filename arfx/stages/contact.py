"""Shadow of the object on the plane that it stands on, under the default light: soft, and dark where they touch.

The object and the default light do not move on their plane, so the share of light that is left is one small picture of
the plane, made once per clip with rays (embree): cosine-weighted visibility of the ambient hemisphere and of the
light's disc. Each frame only looks it up. Cost: O(pixels of the footprint). Leaves out: other real surfaces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numba
import numpy as np
from scipy.spatial import ConvexHull

from arfx.core.cost import Cost
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, neutral
from arfx.core.light import Light
from arfx.core.numerics import HALF_GREY
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Level, Window
from arfx.errors import ConfigError
from arfx.stages.occlusion import Occluder, cone, hemisphere
from arfx.stages.viewing import GRID_PX, direction_grid

SHOWS = 0.08  # darkening of linear light by less than this is left out; up to 3 times as much it is faded, without an edge
_OUTLINES: WeakKeyDictionary[Scene, np.ndarray] = WeakKeyDictionary()


@dataclass(frozen=True)
class ContactParams:
    """strength : share of the computed darkening that is shown, 0..1"""

    strength: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.strength <= 1:
            raise ConfigError(f"contact.strength must be between 0 and 1, is {self.strength:g}")


@dataclass(frozen=True, eq=False)
class Prepared:
    """ratio : (n, n, 3 or 1) light left on the plane;  centre_m, half_m (2,) : the rectangle it covers, anchor axes
    grid : (gh, gw, 3) viewing directions every GRID_PX pixels"""

    ratio: np.ndarray
    centre_m: np.ndarray
    half_m: np.ndarray
    grid: np.ndarray


class Contact:
    name = "contact"
    reads: frozenset[Layer] = frozenset()
    writes = frozenset({Layer.SHADOW})
    levels = (Level("draft", 0.02), Level("standard", 0.02), Level("high", 0.02), Level("reference", 0.02))
    needs_facts = frozenset({"pose"})
    reach = 0
    Params = ContactParams

    def __init__(self, params: ContactParams | None = None) -> None:
        self.params = params or ContactParams()

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        pose = facts.camera_from_world
        if pose is None or facts.opacity <= 0:
            return Demand(EMPTY, "marker not visible")
        if self.params.strength < HALF_GREY:
            return Demand(EMPTY, "contact shadow changes less than half a grey level")
        eye = scene.world_from_anchor.inverse().apply(pose.inverse().translation_m)
        if eye[2] <= 0:
            return Demand(EMPTY, "plane seen from behind")
        outline = outline_m(scene)
        points = np.column_stack([outline, np.zeros(len(outline))])
        seen = scene.camera.project(pose.apply(scene.world_from_anchor.apply(points)))
        rect = frame if not np.isfinite(seen).all() else Rect.around(seen, 1.0).clip(frame)
        return Demand(rect, "contact shadow in view" if not rect.empty else "contact shadow out of view")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Rect:
        return out

    def cost(self, need: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Cost:
        return Cost(level.seconds_per_mpx * need.area / 1e6, need.area * 4.0 * 3)

    def prepare(self, scene: Scene, level: Level) -> Prepared:
        texels, rays = {"draft": (96, 48), "standard": (160, 96), "high": (256, 144), "reference": (384, 400)}[level.name]
        centre, half = _box(outline_m(scene))
        ratio = faded(light_left(scene, centre, half, texels, rays))
        ratio = (1 + (ratio - 1) * self.params.strength).astype(np.float32)
        if (ratio == ratio[..., :1]).all():
            ratio = np.ascontiguousarray(ratio[..., :1])
        return Prepared(ratio, centre, half, direction_grid(scene.camera))

    def run(
        self, window: Window, scene: Scene, prepared: Any, level: Level, rng: np.random.Generator
    ) -> Mapping[Layer, np.ndarray]:
        pose = window.facts[-1].camera_from_world
        assert pose is not None
        rect = window.now.rect
        anchor_from_camera = (pose @ scene.world_from_anchor).inverse()
        origin = anchor_from_camera.translation_m.astype(np.float32)
        if origin[2] <= 0:  # the plane is seen from behind
            return {Layer.SHADOW: neutral(Layer.SHADOW, rect)}
        scale = prepared.ratio.shape[0] / (2 * prepared.half_m)
        low = prepared.centre_m - prepared.half_m
        # within a float32 of the exact place: 1e-7 of the distance, far below a texel
        nodes = (prepared.grid @ anchor_from_camera.rotation.T).astype(np.float32)
        shadow = _look_up(
            rect.x0,
            rect.y0,
            rect.width,
            rect.height,
            nodes,
            origin,
            prepared.ratio,
            low.astype(np.float32),
            scale.astype(np.float32),
        )
        return {Layer.SHADOW: shadow}


def outline_m(scene: Scene) -> np.ndarray:
    """(k, 2) metres, anchor axes: points along the convex outline in which the shadow shows.

    Found on a coarse map of a generous region: that of the footprint, the shadow cast by every light at least 20 degrees
    high, and a border of one object height (beyond it the ambient occlusion is under (h / 2h)^2 / 4).
    """
    cached: np.ndarray | None = _OUTLINES.get(scene)
    if cached is not None:
        return cached
    points = scene.world_from_anchor.inverse().apply(scene.model_corners_m)
    height = max(float(points[:, 2].max()), 0.0)
    ground = [points[:, :2]]
    for light in scene.light.lights:
        d = scene.world_from_anchor.rotation.T @ light.unit
        if d[2] > np.sin(np.radians(20)):
            ground.append(points[:, :2] - np.maximum(points[:, 2:], 0) * d[:2] / d[2])
    every = np.concatenate(ground)
    centre, half = _box(np.concatenate([every - height, every + height]))
    texels = 64
    dark = np.argwhere(light_left(scene, centre, half, texels, 64).min(-1) < 1 - SHOWS)[:, ::-1]
    if not len(dark):
        dark = np.array([[texels / 2, texels / 2]])
    # a texel and its neighbours: the coarse map may miss the border by one
    grown = (dark[:, None] + np.array([[-1, -1], [2, -1], [2, 2], [-1, 2]])).reshape(-1, 2)
    hull = grown[ConvexHull(grown).vertices]
    t = np.linspace(0, 1, 5)[:-1, None, None]  # points along the sides too: a lens bends them
    sides = (hull * (1 - t) + np.roll(hull, -1, 0) * t).reshape(-1, 2)
    outline: np.ndarray = centre + half * (sides / texels * 2 - 1)
    _OUTLINES[scene] = outline
    return outline


def _box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half sides of the axis-parallel box around points (n, 2); no side is zero."""
    low, high = points.min(0), points.max(0)
    return (low + high) / 2, np.maximum((high - low) / 2, 1e-3)


def faded(ratio: np.ndarray) -> np.ndarray:
    """Light left with faint darkening taken out: none below SHOWS, all of it from 3 times as much, smooth between."""
    dark = 1 - ratio
    t = np.clip((dark.max(-1, keepdims=True) - SHOWS) / (2 * SHOWS), 0, 1)
    out: np.ndarray = 1 - dark * (t * t * (3 - 2 * t))
    return out


def light_left(scene: Scene, centre: np.ndarray, half: np.ndarray, texels: int, rays: int) -> np.ndarray:
    """(texels, texels, 3) float64 share of the default light that reaches the anchor's plane with the object there.

    centre, half (2,) : the rectangle, metres, anchor axes.  Row 0 is the lowest y. Noise of the ray count is smoothed
    over a texel.
    """
    import cv2

    anchor_from_world = scene.world_from_anchor.inverse()
    occluder = Occluder(anchor_from_world.apply(scene.model_points_m), np.concatenate(_shifted_faces(scene)))
    t = (np.arange(texels) + 0.5) / texels * 2 - 1
    x, y = np.meshgrid(centre[0] + half[0] * t, centre[1] + half[1] * t)
    lift = 1e-4 * float(half.max())  # off the plane, or a base that lies in it would hide every ray or none, by rounding
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, lift)], -1)
    light: Light = scene.light
    ambient = np.asarray(light.ambient_rgb, float)
    seen = occluder.visible_share(points, hemisphere(rays))
    left, whole = ambient * seen[:, None], ambient.copy()
    for li in light.lights:
        d = scene.world_from_anchor.rotation.T @ li.unit
        if d[2] <= 0:
            continue
        share = occluder.visible_share(points, cone(d, max(li.angular_size_deg, 0.5), max(rays // 3, 16)))
        left = left + np.asarray(li.rgb) * d[2] * share[:, None]
        whole = whole + np.asarray(li.rgb) * d[2]
    ratio = np.where(whole > 0, left / np.where(whole > 0, whole, 1), 1.0).reshape(texels, texels, 3)
    ratio = cv2.GaussianBlur(ratio, (0, 0), 0.8, borderType=cv2.BORDER_REPLICATE)
    clipped: np.ndarray = np.clip(ratio, 0, 1)
    return clipped


def _shifted_faces(scene: Scene) -> list[np.ndarray]:
    faces, start = [], 0
    for part in scene.model.parts:
        faces.append(part.faces + start)
        start += len(part.vertices)
    return faces


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _look_up(x0, y0, width, height, nodes, origin, ratio, low, scale):  # pragma: no cover - compiled
    """SHADOW over a rectangle.

    nodes : (gh, gw, 3) float32 viewing directions in anchor axes at every GRID_PX-th pixel, linear between
    origin : (3,) the camera in anchor axes;  low, scale : (2,) metres to texels
    ratio : (n, n, 3), or (n, n, 1) where the light has no colour
    """
    out = np.ones((height, width, 3), np.float32)
    n, channels = ratio.shape[0], ratio.shape[2]
    far, half, one = np.float32(n), np.float32(0.5), np.float32(1)
    step = np.float32(1.0 / GRID_PX)
    # whole cells of the grid, so that the inner loop has a fixed length
    g0, g1 = x0 // GRID_PX, (x0 + width - 1) // GRID_PX + 1
    us, vs = np.empty((g1 - g0) * GRID_PX, np.float32), np.empty((g1 - g0) * GRID_PX, np.float32)
    last = np.int32(n - 1)
    for j in range(height):
        iy = (y0 + j) // GRID_PX
        fy = np.float32((y0 + j) % GRID_PX) * step
        for ix in range(g0, g1):
            # both ends of a run of GRID_PX pixels on this line
            ax = nodes[iy, ix, 0] + fy * (nodes[iy + 1, ix, 0] - nodes[iy, ix, 0])
            ay = nodes[iy, ix, 1] + fy * (nodes[iy + 1, ix, 1] - nodes[iy, ix, 1])
            az = nodes[iy, ix, 2] + fy * (nodes[iy + 1, ix, 2] - nodes[iy, ix, 2])
            bx = nodes[iy, ix + 1, 0] + fy * (nodes[iy + 1, ix + 1, 0] - nodes[iy, ix + 1, 0])
            by = nodes[iy, ix + 1, 1] + fy * (nodes[iy + 1, ix + 1, 1] - nodes[iy, ix + 1, 1])
            bz = nodes[iy, ix + 1, 2] + fy * (nodes[iy + 1, ix + 1, 2] - nodes[iy, ix + 1, 2])
            dx, dy, dz = (bx - ax) * step, (by - ay) * step, (bz - az) * step
            at = (ix - g0) * GRID_PX
            for i in range(GRID_PX):
                t = np.float32(i)
                vz = az + t * dz
                s = -origin[2] / vz if vz < 0 else np.float32(np.nan)  # away from the plane, or no direction maps here
                us[at + i] = (origin[0] + s * (ax + t * dx) - low[0]) * scale[0] - half
                vs[at + i] = (origin[1] + s * (ay + t * dy) - low[1]) * scale[1] - half
        for i in range(width):
            k = np.uintp(x0 - g0 * GRID_PX + i)
            u, v = us[k], vs[k]
            if not ((u > -one) & (v > -one) & (u < far) & (v < far)):
                continue
            iu, iv = np.int32(u + one) - np.int32(1), np.int32(v + one) - np.int32(1)
            fu, fv = u - np.float32(iu), v - np.float32(iv)
            a, b = np.uintp(max(iu, np.int32(0))), np.uintp(min(iu + np.int32(1), last))
            c, d = np.uintp(max(iv, np.int32(0))), np.uintp(min(iv + np.int32(1), last))
            e = ratio[c, a, 0] + fu * (ratio[c, b, 0] - ratio[c, a, 0])
            f = ratio[d, a, 0] + fu * (ratio[d, b, 0] - ratio[d, a, 0])
            grey = e + fv * (f - e)
            out[j, i, 0], out[j, i, 1], out[j, i, 2] = grey, grey, grey
            for m in range(1, channels):
                e = ratio[c, a, m] + fu * (ratio[c, b, m] - ratio[c, a, m])
                f = ratio[d, a, m] + fu * (ratio[d, b, m] - ratio[d, a, m])
                out[j, i, m] = e + fv * (f - e)
    return out
