"""Measures for the rows of Jia, Tang 2013: cells, edges, and what changes from frame to frame."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from arfx.core.advection import AdvectionField, pack_positions
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.pixels import Pixels
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage
from arfx.papers import s3_watercolor as paper
from arfx.papers.s3_watercolor import PrintedWatercolorParams
from arfx.reproduce.s3_scene import CELL_PX, Shown, cells_of, corrected, printed
from arfx.stages.watercolor.cells import mean_colours
from arfx.stages.watercolor.field import frame_field, nearness_factor
from arfx.stages.watercolor.labels import label
from arfx.stages.watercolor.lines import measure_edges, trace_lines
from arfx.stages.watercolor.sites import (
    GRID_PX,
    STEPS,
    Sites,
    make_sites,
    still_field,
)

Settings = Mapping[str, Any]  # of the section watercolor
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
    width = 128
    ramp = np.clip((np.arange(width) - (width - n) / 2 + 0.5) / n, 0, 1)[:, None]
    step = np.array([[left, right]] * 2, float)
    colours = step[0, 0] + ramp * (step[0, 1] - step[0, 0])
    # the measure is of square roots
    slope = np.tile(colours**2, (16, 1, 1)).astype(np.float32)
    edges = measure_edges(packed(slope), 0.0, 0.5, beta)
    own = paper.eq4_edges(step, 0.5, beta)[0, 0]
    return float(own), float(edges.measure[4, width // 4] * n / 2)


def printed_edges(coded: np.ndarray, p: PrintedWatercolorParams) -> np.ndarray:
    """(h, w) bool"""
    return paper.eq4_edges(coded, p.alpha, p.beta, p.yuv) > p.line_threshold


def corrected_lines(shown: Shown) -> np.ndarray:
    """(h, w) float32 strength of the lines of a frame, 0..1."""
    stage = corrected()
    view = shown.view(stage)
    return stage.lines_of(view, stage.with_toon(view))


def flips(frames: int) -> list[float]:
    """Share of the pixels along a grey step, in noise of 2/255, that get or lose more than
    half of their ink from frame to frame: as printed, corrected; each at the contrast at
    which most do."""
    p = PrintedWatercolorParams()
    c = corrected().params
    found = []
    for contrast in np.linspace(0.03, 0.25, 45):
        g = np.random.default_rng(1)
        base = np.full((240, 64, 3), 0.4)
        base[:, 32:] += contrast
        ink = []
        for _ in range(frames):
            coded = (base + g.normal(0, NOISE, base.shape)).astype(np.float32)
            edges = measure_edges(packed(coded**2))
            lines = trace_lines(edges, c.line_low, c.line_high, c.line_width_px)
            ink.append((printed_edges(coded, p)[:, 31], lines[:, 12:20].max(1)))
        seen = (np.array(kind, float) for kind in zip(*ink, strict=True))
        found.append([np.mean(np.abs(np.diff(kind, axis=0)) > 0.5) for kind in seen])
    return np.max(found, axis=0).tolist()


def still_frames(
    shown: Shown, frames: int, of_printed: Settings, of_corrected: Settings
) -> list[list[np.ndarray]]:
    """(h, w, 3) coded frames of a resting, noisy camera, printed and corrected."""
    moments = [shown.noisy(100 + k, NOISE) for k in range(frames)]
    both = printed(**of_printed), corrected(**of_corrected)
    return [
        [moment.painted(ready) for moment in moments]
        for ready in map(shown.ready, both)
    ]


def mean_squared(frames: Sequence[np.ndarray]) -> float:
    """Mean squared difference from frame to frame."""
    return float(np.mean(np.diff(frames, axis=0) ** 2))


def pan_errors(
    scene: Scene, frames: int, of_printed: Settings, of_corrected: Settings
) -> list[float]:
    """The same in a pan over things of all sizes, along the true motion: printed with cells
    fixed on the screen (that is, of one frame's random numbers), corrected with cells that
    move with the things."""
    rect = scene.camera.rect
    g = np.random.default_rng(5)
    step_px = 3
    height = rect.height
    width = rect.width
    wide = height, width + step_px * frames
    noise = [
        cv2.GaussianBlur(g.standard_normal(wide), (0, 0), s) * s for s in (4, 7, 12)
    ]
    world = np.clip(0.5 + 0.15 * np.stack(noise, -1) / np.std(noise), 0, 1)
    nodes = still_field(width, height, CELL_PX, 96)
    origin = nodes.x0, nodes.y0
    errors = []
    for stage in (printed(**of_printed), corrected(**of_corrected)):
        ready = ReadyStage.of(stage, scene, "standard")
        out = []
        for k in range(frames):
            x = step_px * k
            seen = world[:, x : x + width] + g.normal(0, NOISE, (height, width, 3))
            places = pack_positions(nodes.u + x, nodes.v)
            field = AdvectionField(0, GRID_PX, origin, nodes.u.shape, places)
            image = (np.clip(seen, 0, 1) ** 2).astype(np.float32)
            layers = Layers(rect, {Layer.IMAGE: Pixels(rect, image)})
            painted = ready.run(layers, FrameFacts(0, 0.0, advection=field))
            out.append(np.sqrt(np.asarray(painted[Layer.IMAGE]))[16:-16, 16:-16])
        still = np.array(out)
        apart = still[:-1, :, step_px:] - still[1:, :, :-step_px]
        errors.append(float(np.mean(apart**2)))
    return errors


def areas_on_plane(
    bands: int, repeats: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(depth, m, of bands of a plane that goes from FAR_M above to NEAR_M below; mean area
    of cells there, px, as printed with cones by the depth buffer, and corrected)."""
    height = _SIZE.height
    width = _SIZE.width
    dioptre = np.linspace(1 / FAR_M, 1 / NEAR_M, height)
    near_m = PrintedWatercolorParams().near_m
    depth = np.tile((1 - near_m * dioptre)[:, None], width)
    border = 3 * CELL_PX  # cells there are cut off
    field = still_field(width, height, CELL_PX, border)
    nodes_y = field.y0 + GRID_PX * np.arange(len(field.u))
    near = np.interp(nodes_y, np.arange(height), dioptre) / dioptre.mean()
    strength = corrected().params.nearer_finer
    field = replace(field, size=field.size * nearness_factor(near[:, None], strength))
    areas = np.zeros((2, bands, 2))  # of each formula: pixels, cells
    edges = np.linspace(border, height - border, bands + 1)
    for key in range(repeats):
        sites, by_depth = paper.voronoi(depth, *PLANE, key)
        other = make_sites(field, key, 10**6, CELL_PX)
        by_formula = (sites, by_depth), (other, label(other, _SIZE).first)
        for counts, (at, labels) in zip(areas, by_formula, strict=True):
            area = np.bincount(labels.ravel(), minlength=len(at))
            x = at.x / STEPS
            y = at.y / STEPS
            counted = (area > 0) & (x > border) & (x < width - border)
            counted &= y < height - border
            for k, weights in enumerate((area[counted], None)):
                counts[:, k] += np.histogram(y[counted], edges, weights=weights)[0]
    middle = 1 / np.interp((edges[1:] + edges[:-1]) / 2, np.arange(height), dioptre)
    return middle, *(areas[..., 0] / areas[..., 1])


def small_thing(repeats: int) -> list[float]:
    """A disc five cells wide at .25 m before a wall at 2 m: area of its cells over that of
    the wall's; share of it that the wall's cells cover, with cones by depth and with equal
    ones."""
    y, x = np.mgrid[: _SIZE.height, : _SIZE.width]
    disc = np.hypot(x - 200, y - 160) < 2.5 * CELL_PX
    near_m = PrintedWatercolorParams().near_m
    depth = np.where(disc, 1 - near_m / 0.25, 1 - near_m / 2)
    found = []
    for key in range(repeats):
        sites, by_depth = paper.voronoi(depth, *PLANE, key)
        _, equal = paper.voronoi(np.ones_like(depth), *PLANE, key)
        own = paper.at_sites(disc, sites, _SIZE)
        area = np.bincount(by_depth.ravel(), minlength=len(sites))
        lost = (np.mean(~own[labels][disc]) for labels in (by_depth, equal))
        found.append((area[own].mean() / area[~own].mean(), *lost))
    return np.mean(found, axis=0).tolist()


def convex_share(labels: np.ndarray) -> float:
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


def printed_cells(shown: Shown) -> tuple[np.ndarray, np.ndarray]:
    """(depth buffer, labels) (h, w) of a frame."""
    stage = printed()
    buffer = paper.depth_buffer(shown.view(stage), stage.params.near_m)
    return buffer, paper.voronoi(buffer, shown.layers.rect, *cells_of(shown), 1)[1]


def corrected_cells(shown: Shown) -> np.ndarray:
    """(h, w) labels of a frame's background by measured depth, as dense as the printed ones
    in the mean.
    """
    rect = shown.layers.rect
    strength = corrected().params.nearer_finer
    real_m = shown.layers[Layer.REAL_DEPTH]
    field, _ = frame_field(shown.facts, shown.scene, CELL_PX, strength, real_m)
    return label(make_sites(field, 1, 10**6, CELL_PX), rect).first


def lifted(sites: Sites) -> np.ndarray:
    """(n, 3) of the plane, 1/STEPS px, and so far over it that the nearest to a place of the plane
    is the nearest site by its weight."""
    return np.stack([sites.x, sites.y, np.sqrt(-sites.weight)], -1).astype(float)


def nearest_share(sites: Sites, labels: np.ndarray) -> float:
    """Of the pixels of the picture's corner, those labelled with the site nearest to them."""
    y, x = np.indices(labels.shape) * STEPS
    return _nearest(sites, np.stack([x, y, 0 * x], -1), labels)


def _nearest(sites: Sites, places: np.ndarray, labels: np.ndarray) -> float:
    points = lifted(sites)
    away, _ = KDTree(points).query(places)
    own = np.linalg.norm(places - points[labels], axis=-1)
    return float(np.mean(own <= away + 1e-9))


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


def own_cell_share(sites: Sites) -> float:
    """Of the sites, those that are the nearest to themselves."""
    return _nearest(sites, lifted(sites) * [1, 1, 0], np.arange(len(sites)))


def farthest(sites: Sites, labels: np.ndarray) -> float:
    """px from a pixel to its site, at most."""
    y, x = np.indices(labels.shape)
    return float(
        np.hypot(x - sites.x[labels] / STEPS, y - sites.y[labels] / STEPS).max()
    )


def mean_error(image: np.ndarray, labels: np.ndarray) -> float:
    """Grey levels from the colours of cells to the means of their pixels, at most."""
    used = np.unique(labels)
    colours = mean_colours(image, [labels], int(used.max()) + 1)[0][used]
    exact = [
        ndimage.mean(channel, labels, used) for channel in np.moveaxis(image, 2, 0)
    ]
    return float(255 * np.abs(colours - np.stack(exact, -1)).max())


def outline(thing: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels of it beside others."""
    return thing & ~ndimage.binary_erosion(thing, np.ones((3, 3)), border_value=1)


def share_near(where: np.ndarray, edges: np.ndarray) -> float:
    """Share of the pixels `where` with an edge at most 2 px away. Both (h, w) bool"""
    return float(ndimage.binary_dilation(edges, np.ones((5, 5)))[where].mean())
