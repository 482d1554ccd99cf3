"""The scene of the rows of Jia, Tang 2013, teapot, cube and rabbit, of one model file, on a
desk with real things near and far; and measures: cells, edges, and what changes from frame to
frame.

`Shown` is a frame of the scene with the object in it, before it is painted: what either
formula's class is given."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy import ndarray
from scipy import ndimage

from arfx.core.colour import SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.pixels import Pixels
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, View
from arfx.papers import s3_watercolor as paper
from arfx.papers.s3_watercolor import PrintedWatercolor, PrintedWatercolorParams
from arfx.reproduce.work import Work, scene_named
from arfx.stages.watercolor import Watercolor
from arfx.stages.watercolor.cells import mean_colours
from arfx.stages.watercolor.lines import measure_edges
from arfx.stages.watercolor.params import WatercolorParams
from arfx.stages.watercolor.sites import STEPS, Sites

CELL_PX = 8
OBJECTS = ("teapot", "cube", "rabbit")


class Shown(NamedTuple):
    """layers : that the watercolour reads, and the objects' numbers, of the whole frame
    real : (h, w, 3) uint8, the camera's"""

    layers: Layers
    facts: FrameFacts
    scene: Scene
    real: ndarray

    @property
    def image(self) -> ndarray:
        """(h, w, 3) float32 coded: the frame with the objects."""
        return coded(self.layers[Layer.IMAGE])

    def ready(self, stage: Watercolor) -> ReadyStage:
        return ReadyStage.of(stage, self.scene, "standard")

    def view(self, stage: Watercolor) -> View:
        return self.ready(stage).view(self.layers, self.facts)

    def painted(self, stage: Watercolor) -> ndarray:
        """(h, w, 3) float32 coded."""
        return coded(self.ready(stage).run(self.layers, self.facts)[Layer.IMAGE])

    def noisy(self, index: int, sigma: float) -> Shown:
        """The same moment once more, as frame `index` of a resting camera: with other noise."""
        g = np.random.default_rng(index)
        noisy = np.clip(self.image + g.normal(0, sigma, self.image.shape), 0, 1)
        rect = self.layers.rect
        image = SRGB.decode(noisy).astype(np.float32)
        layers = Layers(
            rect, {**self.layers.written, Layer.IMAGE: Pixels(rect, image)}
        )
        return self._replace(layers=layers, facts=replace(self.facts, index=index))

    def objects(self) -> dict[str, ndarray]:
        """(h, w) bool of the pixels of each object: the model's parts from left to right."""
        middle = np.array([p.vertices[:, 0].mean() for p in self.scene.model.parts])
        place = (middle - middle.min()) / np.ptp(
            middle
        )  # teapot, then cube, then rabbit
        kind = np.append(-1, (place >= 0.5).astype(int) + (place >= 1))
        number = kind[self.layers[Layer.OBJECT_ID]]
        return {name: number == k for k, name in enumerate(OBJECTS)}

    def real_outlines(self) -> ndarray:
        """(h, w) bool: pixels that are nearer by a tenth than one beside them, of the real
        scene beside the objects.
        """
        depth = self.layers[Layer.REAL_DEPTH]
        own = self.layers[Layer.COVERAGE] > 0
        farther = cv2.dilate(depth, np.ones((3, 3), np.uint8))
        return (farther > 1.1 * depth) & ~ndimage.binary_dilation(
            own, np.ones((9, 9))
        )


def coded(linear: ndarray | Pixels) -> ndarray:
    """(h, w, 3) float32."""
    return SRGB.encode(np.clip(np.asarray(linear), 0, 1)).astype(np.float32)


def shown(work: Work) -> Shown:
    """The scene's frame up to the composite, lit by the corrected method: both formulas'
    classes paint the same picture.
    """
    width, height = work.scaled((640, 360), (240, 136))
    clip = work.clip(scene_named("group", width=width, height=height))
    model = {"file": work.model("group"), "fit": "26cm"}
    shot = work.shot(clip, {"model": model})
    layers = shot.renderer.after(shot.up_to("watercolor")[:-1]).view(
        shot.renderer.window
    )
    return Shown(layers, shot.facts, shot.job.scene, shot.renderer.original())


def printed(**settings: Any) -> PrintedWatercolor:
    return PrintedWatercolor(PrintedWatercolorParams(cell_px=CELL_PX, **settings))


def corrected(**settings: Any) -> Watercolor:
    return Watercolor(WatercolorParams(**settings))


EFFECTS = "wash lines lightness deepest edge_darkening flow wobble_px grain"
# cells alone
FLAT = {"saturation": 1.0, "toon": False, **dict.fromkeys(EFFECTS.split(), 0.0)}


NOISE = 2 / 255
NEAR_M, FAR_M = 0.35, 2.0  # of the plane on which cells are counted
_SIZE = Rect.of(480, 400)
# and its rows and columns of cells
PLANE = _SIZE, _SIZE.height // CELL_PX, _SIZE.width // CELL_PX


def edge_of(
    left: Sequence[float], right: Sequence[float], beta: float
) -> tuple[float, float]:
    """What the printed and the corrected measure make of a step between two colours, coded;
    alpha = 0.5.

    The corrected one is of a slope of n px from one to the other, times n: it is a measure
    per px of half the picture."""
    n = 64
    step = np.array([[left, right]] * 2, float)
    ramp = np.clip((np.arange(2 * n) + 0.5) / n - 0.5, 0, 1)[:, None]
    # the measure is of square roots
    slope = (step[0, 0] + ramp * (step[0, 1] - step[0, 0])) ** 2
    packed_slope = packed(np.tile(slope, (16, 1, 1)).astype(np.float32))
    corrected = measure_edges(packed_slope, 0.0, 0.5, beta).measure[4, n // 2]
    own = paper.eq4_edges(step, 0.5, beta)[0, 0]
    return float(own), float(corrected * n / 2)


def corrected_lines(shown: Shown) -> ndarray:
    """(h, w) float32 strength of the lines of a frame, 0..1."""
    stage = corrected()
    view = shown.view(stage)
    return stage.lines_of(view, stage.with_toon(view))


def change_at_rest(shown: Shown, stage: Watercolor, frames: int) -> float:
    """Of a resting, noisy camera: mean squared difference from frame to frame, coded."""
    made = [shown.noisy(100 + k, NOISE).painted(stage) for k in range(frames)]
    return float(np.mean(np.diff(made, axis=0) ** 2))


def areas_on_plane(bands: int, repeats: int) -> tuple[ndarray, ndarray]:
    """(depth, m, of bands of a plane that goes from FAR_M above to NEAR_M below; mean area
    of printed cells there, px, with cones by the depth buffer)."""
    height = _SIZE.height
    width = _SIZE.width
    dioptre = np.linspace(1 / FAR_M, 1 / NEAR_M, height)
    near_m = PrintedWatercolorParams().near_m
    depth = np.tile((1 - near_m * dioptre)[:, None], width)
    border = 3 * CELL_PX  # cells there are cut off
    edges = np.linspace(border, height - border, bands + 1)
    sums = np.zeros((2, bands))  # pixels, cells
    for key in range(repeats):
        sites, labels = paper.voronoi(depth, *PLANE, key)
        area = np.bincount(labels.ravel(), minlength=len(sites))
        x, y = sites.x / STEPS, sites.y / STEPS
        counted = (area > 0) & (x > border) & (x < width - border)
        counted &= y < height - border
        for k, weights in enumerate((area[counted], None)):
            sums[k] += np.histogram(y[counted], edges, weights=weights)[0]
    middle = 1 / np.interp((edges[1:] + edges[:-1]) / 2, np.arange(height), dioptre)
    return middle, sums[0] / sums[1]


def convex_share(labels: ndarray) -> float:
    """Of the cells, those that hold every pixel whose centre lies in the hull of their
    pixels' centres.
    """
    from skimage.measure import regionprops
    from skimage.morphology import convex_hull_image

    convex = []
    # of cells in one line, which are convex
    with warnings.catch_warnings(action="ignore"):
        for cell in regionprops(labels + 1):
            hull = convex_hull_image(cell.image, offset_coordinates=False)
            convex.append(hull.sum() <= cell.area)
    return float(np.mean(convex))


def rectangles_with_site(sites: Sites, rect: Rect, m: int, n: int) -> float:
    """Of m x n rectangles, those in which a site lies, to the half step that sites are
    rounded by.
    """
    held = np.zeros((m, n), bool)
    area = (0, rect.height), (0, rect.width)
    for dx, dy in itertools.product((-0.5, 0.5), repeat=2):
        x = (sites.x + dx) / STEPS - rect.x0 + 0.5
        y = (sites.y + dy) / STEPS - rect.y0 + 0.5
        held |= np.histogram2d(y, x, (m, n), area)[0] > 0
    return float(held.mean())


def mean_error(image: ndarray, labels: ndarray) -> float:
    """Grey levels from the colours of cells to the means of their pixels, at most."""
    used = np.unique(labels)
    colours = mean_colours(image, [labels], int(used.max()) + 1)[0][used]
    exact = [
        ndimage.mean(channel, labels, used) for channel in np.moveaxis(image, 2, 0)
    ]
    return float(255 * np.abs(colours - np.stack(exact, -1)).max())


def outline(thing: ndarray) -> ndarray:
    """(h, w) bool: pixels of it beside others."""
    return thing & ~ndimage.binary_erosion(thing, np.ones((3, 3)), border_value=1)


def share_near(where: ndarray, edges: ndarray) -> float:
    """Share of the pixels `where` with an edge at most 2 px away. Both (h, w) bool"""
    return float(ndimage.binary_dilation(edges, np.ones((5, 5)))[where].mean())
