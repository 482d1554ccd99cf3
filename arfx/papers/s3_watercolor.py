"""Watercolour from Voronoi cells, as printed: Jia, Tang 2013.

The object is toon-shaded; the picture is split into the cells of a jittered grid, new in every frame, each with the mean colour
of its pixels; what an edge measure in RGB and Y'UV finds above a threshold is black.

Deviations. Cells do not get finer with nearness (section 3.1.2, the cones' size by depth). Labels are those of the nearest
site, which cones of sufficient height give too. The printed listing of the toon shader does not compile: its first threshold is
`toon_thresholds`' first. m, n, alpha, beta and the threshold are not stated: they are settings. Edges are drawn black.
Its errors: docs/methods/watercolor.md#errata."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.layers import Layer
from arfx.core.noise import noise
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import View
from arfx.errors import require_within
from arfx.stages.watercolor import Watercolor
from arfx.stages.watercolor.cells import means
from arfx.stages.watercolor.edges import yuv_matrix
from arfx.stages.watercolor.labels import label
from arfx.stages.watercolor.params import WatercolorParams
from arfx.stages.watercolor.sites import STEPS, Sites


@dataclass(frozen=True)
class PrintedWatercolorParams(WatercolorParams):
    """line_threshold : coded value from which an edge is drawn"""

    formula: str = field(default="paper", init=False)
    line_threshold: float = 0.12

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("watercolor", self, line_threshold=(0, 2))


def eq1_sites(rect: Rect, cell_px: float, key: int) -> Sites:
    """V(i, j) = (W/n (j + 1/2 + r), H/m (i + 1/2 + r')), r in (-1/2, 1/2). In the pixels' own coordinates.

    key : of the random numbers, as core.noise takes it"""
    n, m = max(round(rect.width / cell_px), 1), max(round(rect.height / cell_px), 1)
    r = [noise(Rect.of(n, m), key, channel) for channel in (0, 1)]
    x = rect.x0 - 0.5 + rect.width / n * (np.arange(n) + r[0])
    y = rect.y0 - 0.5 + rect.height / m * (np.arange(m)[:, None] + r[1])
    position = [np.round(a.ravel() * STEPS).astype(np.float32) for a in (x, y)]
    zero = np.zeros(m * n, np.float32)
    return Sites(position[0], position[1], zero, np.arange(m * n), position[0] / STEPS, position[1] / STEPS)


def named_by_colour(coded: np.ndarray, labels: np.ndarray, sites: Sites, rect: Rect) -> tuple[np.ndarray, int]:
    """(labels, count) in which cells whose sites show one 8-bit colour are one cell. coded : (h, w, 3) 0..1."""
    x = np.clip(np.round(sites.x / STEPS) - rect.x0, 0, rect.width - 1).astype(int)
    y = np.clip(np.round(sites.y / STEPS) - rect.y0, 0, rect.height - 1).astype(int)
    colour = np.round(np.clip(coded[y, x], 0, 1) * 255).astype(np.int64) @ np.array([65536, 256, 1])
    unique, number = np.unique(colour, return_inverse=True)
    return number.ravel().astype(np.int32)[labels], len(unique)


def eq2_yuv(coded: np.ndarray, alpha: float, matrix: str) -> np.ndarray:
    """(1 - alpha) |grad Y| + alpha (|grad U| + |grad V|) / 2. coded : (h, w, 3) R'G'B' 0..1"""
    yuv = (coded @ yuv_matrix(matrix).T.astype(coded.dtype)).astype(np.float32)
    strength = gradient(yuv)
    return (1 - alpha) * strength[..., 0] + alpha * strength[..., 1:].mean(-1)


def eq3_rgb(coded: np.ndarray) -> np.ndarray:
    """(|grad R| + |grad G| + |grad B|) / 3"""
    return gradient(np.asarray(coded, np.float32)).mean(-1)


def eq4_edges(coded: np.ndarray, alpha: float, beta: float, matrix: str = "bt601") -> np.ndarray:
    """(h, w) float32 beta Edge_YUV + (1 - beta) Edge_RGB, an edge where it is above the threshold."""
    return (beta * eq2_yuv(coded, alpha, matrix) + (1 - beta) * eq3_rgb(coded)).astype(np.float32)


def gradient(a: np.ndarray) -> np.ndarray:
    """(h, w, c) length of the difference to the pixels on the right and below; nothing lies behind the border."""
    dx, dy = np.zeros_like(a), np.zeros_like(a)
    dx[:, :-1] = np.diff(a, axis=1)
    dy[:-1] = np.diff(a, axis=0)
    return np.sqrt(dx * dx + dy * dy)


class PrintedWatercolor(Watercolor):
    levels = ("standard",)
    Params = PrintedWatercolorParams
    even: ClassVar[float] = 0.0  # the tones are of all the light, and hard
    ramp: ClassVar[float] = 0.0

    def __init__(self, params: PrintedWatercolorParams | None = None) -> None:
        super().__init__(params)
        self.history = 0

    def prepare(self, scene: Scene, level: str) -> Any:
        return None

    def run(self, view: View, prepared: None) -> Mapping[Layer, np.ndarray]:
        p, rect = self.params, view.rect
        image = self.with_toon(view).whole()
        coded = SRGB.encode(np.clip(image, 0, 1)).astype(np.float32)
        sites = eq1_sites(rect, p.cell_px, view.key)
        number, count = named_by_colour(coded, label(sites, rect).first, sites, rect)
        out = means(image, number, count)[number]
        out[eq4_edges(coded, p.alpha, p.beta, p.yuv) > p.line_threshold] = 0
        return {Layer.IMAGE: out}
