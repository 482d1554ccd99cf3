"""Real things that stand nearer than the virtual object hide it: COVERAGE and VIRTUAL times the share that is seen.

Only where the job measures the real scene's depth. How much nearer the real surface is, as a share of its distance, says
what is hidden; depth maps end some pixels beside the things that they show, so a guided filter moves that mask's edge to
the picture's own and softens it. It looks at the object's pixels alone: its outline stays as it is.
Cost: O(pixels of the object before which something real stands). Leaves out: shadows of and on what is nearer.
Source: guided filter (`guided`), each mean weighted by where the object is.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numba
import numpy as np

from arfx.core.cost import Cost
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.real_depth import TILE_PX, real_depth_of
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Level, Window
from arfx.errors import ConfigError
from arfx.stages.guided import coded, guided

_WINDOW_SHARE = 1 / 160  # radius of the filter's window over the picture's width
_PASSES = 2  # each draws the edge nearer to the picture's
_FAINT = 0.06  # a share below this, and above 1 less this, is the filter's own spill
_EPS = 0.05**2  # variance of the picture, coded 0..1, from which an edge counts as one


@dataclass(frozen=True)
class HideParams:
    """margin : a real surface hides what is farther by more than this share of its distance; by twice that, wholly"""

    margin: float = 0.03

    def __post_init__(self) -> None:
        if not 0 < self.margin <= 1:
            raise ConfigError(f"hide.margin must be above 0 and at most 1, is {self.margin}", "a share of the distance: 0.03")


class Hide:
    name = "hide"
    reads = frozenset({Layer.PLATE, Layer.VIRTUAL, Layer.COVERAGE, Layer.DEPTH, Layer.REAL_DEPTH})
    writes = frozenset({Layer.VIRTUAL, Layer.COVERAGE})
    levels = (Level("standard", 0.06),)
    needs_facts = frozenset({"pose"})
    reach = 0
    Params = HideParams

    def __init__(self, params: HideParams | None = None) -> None:
        self.params = params or HideParams()

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        if facts.camera_from_world is None or facts.opacity <= 0:
            return Demand(EMPTY, "marker not visible")
        told = real_depth_of(facts)
        if told is None:
            return Demand(EMPTY, "the real scene's depth is not known")
        if facts.model_box.empty:
            return Demand(EMPTY, "model out of view")
        box = facts.drawn_box.clip(frame)
        farthest = facts.depth_range_m[1]
        nearer = told.tiles[1] * farthest > 1 + self.params.margin
        rect = EMPTY
        for y, x in np.argwhere(nearer):
            corners = (x, y, x + 1, y + 1)
            rect = rect.union(Rect(*(TILE_PX * int(v) for v in corners)).clip(box))
        if rect.empty:
            return Demand(EMPTY, f"nothing real is nearer than the object's {farthest:.2f} m")
        return Demand(rect.pad(reach_px(scene)).clip(box), "something real may stand before the object")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Rect:
        return out.pad(reach_px(scene)).clip(scene.camera.rect)

    def cost(self, need: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Cost:
        return Cost(level.seconds_per_mpx * need.area / 1e6, need.area * 4.0 * 20)

    def prepare(self, scene: Scene, level: Level) -> None:
        return None

    def run(
        self, window: Window, scene: Scene, prepared: Any, level: Level, rng: np.random.Generator
    ) -> Mapping[Layer, np.ndarray]:
        now = window.now
        coverage, virtual = now[Layer.COVERAGE], now[Layer.VIRTUAL]
        seen = rough_mask(coverage, now[Layer.DEPTH], now[Layer.REAL_DEPTH], np.float32(self.params.margin))
        there = (coverage > 0).astype(np.float32)
        if (seen < 1).any():
            seen = refined(seen, there, coded(now[Layer.PLATE]), window_px(scene))
        return {Layer.COVERAGE: coverage * seen, Layer.VIRTUAL: virtual * seen[..., None]}


def window_px(scene: Scene) -> int:
    """Radius of the filter's window."""
    return max(round(scene.camera.width * _WINDOW_SHARE), 3)


def reach_px(scene: Scene) -> int:
    """How far a pixel of the mask is decided from."""
    return 2 * _PASSES * window_px(scene)


@numba.njit(cache=True, nogil=True)
def rough_mask(coverage, depth, real, margin):  # pragma: no cover - compiled
    """(h, w) float32: 1 = seen, 0 = hidden, by depth alone; 1 where the object is not or a depth is none.

    depth, real : (h, w) m
    """
    out = np.ones(coverage.shape, np.float32)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            z, r = depth[y, x], real[y, x]
            if coverage[y, x] > 0 and 0 < z < np.inf and 0 < r < np.inf:
                nearer = (z - r) / r
                out[y, x] = min(max(np.float32(2) - nearer / margin, np.float32(0)), np.float32(1))
    return out


def refined(mask: np.ndarray, there: np.ndarray, guide: np.ndarray, radius_px: int) -> np.ndarray:
    """mask (h, w), its edges moved to those of guide (h, w, 3); the same bits where it is even all around.

    there : (h, w) 1 where the mask means anything, else 0
    """
    moved = mask
    for _ in range(_PASSES):
        moved = guided(moved, guide, radius_px, _EPS, there)
    moved = np.clip((moved - _FAINT) / (1 - 2 * _FAINT), 0, 1)
    around = np.ones((4 * _PASSES * radius_px + 1,) * 2, np.uint8)
    least = cv2.erode(np.where(there > 0, mask, 1).astype(np.float32), around)
    most = cv2.dilate(np.where(there > 0, mask, 0).astype(np.float32), around)
    return np.where((most > least) & (there > 0), moved, mask).astype(np.float32)
