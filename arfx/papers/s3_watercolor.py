"""Watercolour from Voronoi cells, as printed: Jia, Tang 2013.

The object is toon-shaded; the picture is split into the cells of a jittered grid, new in every
frame, drawn as cones into a depth buffer, each with the mean colour of its pixels; what an edge
measure in RGB and Y'UV finds above a threshold is black. All of it works on coded values, as a
frame buffer holds them.

Not stated, and settings here: m, n, alpha, beta, the threshold, and the near clip plane of the
depth buffer; the far one is at infinity. How a cone's size follows from the depth: in proportion.
Cones are round and as long as it takes to leave no hole. The printed listing of the toon shader
does not compile: its first threshold is `toon_thresholds`' first. Its `myColor` is the model's own
colour at each pixel, `lightDir` points to the strongest light. Edges are drawn black. Its errors:
docs/methods/watercolor.md#errata."""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB
from arfx.core.compiled import kernel
from arfx.core.layers import Layer
from arfx.core.noise import noise
from arfx.core.numerics import normalise
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.settings import Fraction, setting
from arfx.core.stage import View
from arfx.stages.dof.depth_layers import dioptre_of
from arfx.stages.watercolor import Watercolor
from arfx.stages.watercolor.cells import mean_colours
from arfx.stages.watercolor.field import plane_dioptre
from arfx.stages.watercolor.lines import ALPHA, BETA, yuv_matrix
from arfx.stages.watercolor.params import ToonSettings
from arfx.stages.watercolor.sites import STEPS, Sites
from arfx.stages.watercolor.toon import tones, toon_light

LEAST = 0.05  # of a cone's size: OpenGL cuts off what is before the near clip plane


class PrintedWatercolorParams(ToonSettings):
    formula: str = "paper"
    m: int = setting(
        0, "rows of cells, 0 = as many as make cells of cell_px", ge=0, le=4096
    )
    n: int = setting(0, "columns of cells, likewise", ge=0, le=4096)
    near_m: float = setting(
        0.1,
        "near clip plane of the depth buffer, whose value is the size of a cone; 0 = all"
        " cones alike",
        ge=0,
        le=1e3,
    )
    alpha: Fraction = setting(ALPHA, "weight of U and V in the edges of YUV")
    beta: Fraction = setting(BETA, "weight of YUV in all edges")
    yuv: Literal["bt601", "bt709"] = setting("bt601", "matrix of Y'UV: bt601, bt709")
    line_threshold: float = setting(
        0.12, "coded value from which an edge is drawn", ge=0, le=2
    )


# 3.1.1 Voronoi diagram


def eq1_sites(rect: Rect, m: int, n: int, key: int) -> Sites:
    """V(i, j) = (W/n (j + 1/2 + r), H/m (i + 1/2 + r')), r in (-1/2, 1/2). In the pixels' own
    coordinates.

    key : of the random numbers, as core.noise takes it"""
    r = [noise(Rect.of(n, m), key, channel) for channel in (0, 1)]
    x = rect.x0 - 0.5 + rect.width / n * (np.arange(n) + r[0])
    y = rect.y0 - 0.5 + rect.height / m * (np.arange(m)[:, None] + r[1])
    x, y = (np.round(a.ravel() * STEPS).astype(np.float32) for a in (x, y))
    return Sites(x, y, np.zeros_like(x), np.arange(m * n), x / STEPS, y / STEPS)


# 3.1.2 Stylised frame


def depth_buffer(view: View, near_m: float) -> ndarray:
    """(h, w) float32 0..1: what OpenGL's depth buffer holds with the far clip plane at infinity, 1
    - near_m / depth. Of the object, around it of the measured depth or the marker's plane; 1, as it
    is cleared, where nothing is known."""
    facts = view.facts
    rect = view.rect
    dioptre = np.zeros((rect.height, rect.width), np.float32)
    if facts.real_depth is not None:
        dioptre = dioptre_of(view[Layer.REAL_DEPTH])
    elif facts.camera_from_world is not None:
        x = np.arange(rect.x0, rect.x1)
        y = np.arange(rect.y0, rect.y1)[:, None]
        placed = facts.camera_from_world @ view.scene.world_from_anchor
        dioptre = plane_dioptre(x, y, view.scene.camera, placed)
    own = view[Layer.COVERAGE] >= 0.5
    dioptre = np.where(own, dioptre_of(view[Layer.DEPTH]), dioptre)
    return np.clip(1 - near_m * dioptre, LEAST, 1).astype(np.float32)


def cones(sites: Sites, size: ndarray, rect: Rect, m: int, n: int) -> ndarray:
    """(h, w) int32: whose cone is nearest. A cone's apex is at its site and at depth 0; where it is
    as wide as its size, (m n,), its depth is 1. Of m x n sites in a jittered grid."""
    # no pixel is farther from the site of its own cell of the grid than that cell's diagonal: no
    # cone need be longer
    length = (np.hypot(rect.width / n, rect.height / m) + 1 / STEPS) / float(
        size.min()
    )
    labels = np.zeros((rect.height, rect.width), np.int32)
    x = (sites.x / STEPS - rect.x0).astype(float)
    y = (sites.y / STEPS - rect.y0).astype(float)
    _draw_cones(
        x, y, size.astype(float), length, np.full(labels.shape, np.inf), labels
    )
    return labels


@kernel()
def _draw_cones(x, y, size, length, depth, labels):  # pragma: no cover - compiled
    """depth (h, w) : the depth buffer, squared, and labels are written; of equal depths the first
    one stays."""
    h, w = labels.shape
    for k in range(x.shape[0]):
        radius = length * size[k]
        slope = 1 / (size[k] * size[k])
        top = max(int(np.ceil(y[k] - radius)), 0)
        left = max(int(np.ceil(x[k] - radius)), 0)
        for j in range(top, min(int(np.floor(y[k] + radius)) + 1, h)):
            for i in range(left, min(int(np.floor(x[k] + radius)) + 1, w)):
                z = ((i - x[k]) ** 2 + (j - y[k]) ** 2) * slope
                if z < depth[j, i]:
                    depth[j, i] = z
                    labels[j, i] = k


def at_sites(pixels: ndarray, sites: Sites, rect: Rect) -> ndarray:
    """(m n, ...) what the picture holds at the sites."""
    x = np.clip(np.round(sites.x / STEPS) - rect.x0, 0, rect.width - 1).astype(int)
    y = np.clip(np.round(sites.y / STEPS) - rect.y0, 0, rect.height - 1).astype(int)
    return pixels[y, x]


def voronoi(
    buffer: ndarray, rect: Rect, m: int, n: int, key: int
) -> tuple[Sites, ndarray]:
    """(sites of (1), (h, w) whose cell), by cones as large as a buffer (h, w) is at their sites."""
    sites = eq1_sites(rect, m, n, key)
    return sites, cones(sites, at_sites(buffer, sites, rect), rect, m, n)


def named_by_colour(
    coded: ndarray, labels: ndarray, sites: Sites, rect: Rect
) -> tuple[ndarray, int]:
    """(labels, count) in which cells whose sites show one 8-bit colour are one cell.

    coded : (h, w, 3) 0..1"""
    colour = np.round(np.clip(at_sites(coded, sites, rect), 0, 1) * 255).astype(int)
    unique, number = np.unique(colour @ [65536, 256, 1], return_inverse=True)
    return number.ravel().astype(np.int32)[labels], len(unique)


# 3.2 Edges


def toon(
    myColor: ndarray,
    normal: ndarray,
    lightDir: ndarray,
    threshold: tuple[float, float],
    factor: tuple[float, float, float],
) -> ndarray:
    """The listing. (h, w, 3) coded: the colour itself where n . l is above the first threshold, .4
    of it above .2, else .1.

    myColor : (h, w, 3) coded;  threshold, factor : `toon_thresholds` and `toon_factors`"""
    intensity = normalise(normal) @ normalise(lightDir)
    return tones(intensity, threshold, factor, ramp=0.0)[..., None] * myColor


def eq2_yuv(coded: ndarray, alpha: float, matrix: str) -> ndarray:
    """(1 - alpha) |grad Y| + alpha (|grad U| + |grad V|) / 2. coded : (h, w, 3) R'G'B' 0..1"""
    yuv = (coded @ yuv_matrix(matrix).T.astype(coded.dtype)).astype(np.float32)
    strength = gradient(yuv)
    return (1 - alpha) * strength[..., 0] + alpha * strength[..., 1:].mean(-1)


def eq3_rgb(coded: ndarray) -> ndarray:
    """(|grad R| + |grad G| + |grad B|) / 3"""
    return gradient(np.asarray(coded, np.float32)).mean(-1)


def eq4_edges(
    coded: ndarray, alpha: float, beta: float, matrix: str = "bt601"
) -> ndarray:
    """(h, w) float32 beta Edge_YUV + (1 - beta) Edge_RGB, an edge where it is above the
    threshold."""
    own = beta * eq2_yuv(coded, alpha, matrix) + (1 - beta) * eq3_rgb(coded)
    return own.astype(np.float32)


def gradient(a: ndarray) -> ndarray:
    """(h, w, c) length of the difference to the pixels on the right and below; nothing lies behind
    the border."""
    dx = np.diff(a, axis=1, append=a[:, -1:])
    dy = np.diff(a, axis=0, append=a[-1:])
    return np.sqrt(dx * dx + dy * dy)


# 3.3 The picture


class PrintedWatercolor(Watercolor):
    levels = ("standard",)
    Params = PrintedWatercolorParams

    def prepare(self, scene: Scene, level: str) -> Any:
        return None

    def run(self, view: View, prepared: None) -> Mapping[Layer, ndarray]:
        p = self.params
        coded = self.frame(view)
        out = self.cells(view, coded)
        out[eq4_edges(coded, p.alpha, p.beta, p.yuv) > p.line_threshold] = 0
        return {Layer.IMAGE: SRGB.decode(out).astype(np.float32)}

    def cells(self, view: View, coded: ndarray) -> ndarray:
        """(h, w, 3) the coded picture in the mean colours of its cells."""
        p = self.params
        rect = view.rect
        m = p.m or max(round(rect.height / p.cell_px), 1)
        n = p.n or max(round(rect.width / p.cell_px), 1)
        buffer = depth_buffer(view, p.near_m)
        sites, labels = voronoi(buffer, rect, m, n, view.key)
        number, count = named_by_colour(coded, labels, sites, rect)
        return mean_colours(coded, [number], count)[0][number]

    def frame(self, view: View) -> ndarray:
        """(h, w, 3) float32 coded: real scene and object, which is toon-shaded."""
        p = self.params
        image = view[Layer.IMAGE]
        box = view.layers.extent(Layer.COVERAGE)
        if p.toon and view.facts.present and not box.empty:
            part = view.layers.crop(box)
            image = image.copy()
            up = view.scene.world_from_anchor.rotation[:, 2]
            lightDir, _ = toon_light(view.light, up)
            myColor = SRGB.encode(np.clip(part[Layer.ALBEDO], 0, 1))
            normal = part[Layer.NORMAL]
            steps = (p.toon_thresholds, p.toon_factors)
            shaded = SRGB.decode(toon(myColor, normal, lightDir, *steps))
            covered = part[Layer.COVERAGE][..., None] * shaded
            image[box.slices_in(view.rect)] += view.facts.opacity * (
                covered - part[Layer.VIRTUAL]
            )
        return SRGB.encode(np.clip(image, 0, 1)).astype(np.float32)
