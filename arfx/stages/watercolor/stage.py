"""Watercolor: the whole picture, real and virtual, as one painting of washes, lines, pigment and
paper.

1. the object is toon-shaded under the clip's light; 2. cells follow what they lie on, each the
exact mean of its pixels; 3. alike neighbours run into washes; 4. pigment and paper; 5. lines where
colour, silhouette or crease are strong. Cells are kept while the field of sites stays what it is.
Lines are made beside the cells, on a free core. Cost: O(pixels).
Levels paint the same cells: standard with half the rounds of washes and plain borders;
high all of it, at every pixel's middle; reference is the mean of sixteen places in each. Time and
error of each: docs/methods/watercolor.md#levels.
Grain lies on the paper and stays there: coherence along the motion is measured without it.
Source: docs/methods/watercolor.md. Leaves out: wet-in-wet flow; without measured depth, that of
real things off the plane."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial, reduce
from math import ceil
from operator import iadd
from typing import Any, ClassVar, NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, packed
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View
from arfx.stages.watercolor.cells import (
    adjust_tone,
    mean_colours,
    neighbours,
    smooth_washes,
)
from arfx.stages.watercolor.field import frame_field
from arfx.stages.watercolor.labels import (
    EVERY_PIXEL,
    Labels,
    Wobble,
    label,
    sort_sites,
)
from arfx.stages.watercolor.lines import (
    add_object_edges,
    enlarge_lines,
    measure_edges,
    object_edges,
    trace_lines,
)
from arfx.stages.watercolor.object_sites import (
    SurfacePoints,
    object_sites,
    sample_surface,
)
from arfx.stages.watercolor.paint import How, painted
from arfx.stages.watercolor.params import WatercolorParams
from arfx.stages.watercolor.pigment import paper_grain, turbulence
from arfx.stages.watercolor.sites import (
    GRID_PX,
    STEPS,
    Place,
    SiteField,
    Sites,
    make_sites,
)
from arfx.stages.watercolor.toon import EVEN, replace_lit, tones, toon_light
from arfx.stages.watercolor.wobble import Wobbles, field_shift, object_shift

BLEND_PX = 1.5  # from a cell's border, over which alike colours run into each other
_OBJECT_CELL = 0.8  # size of the object's cells, of the background's
_ROUNDS = 8  # of a wash of strength 1
_KEPT = 4  # sets of cells


class Accuracy(NamedTuple):
    """rounds : fraction of the rounds of `smooth_washes` that is made, each as strong as those
        that it stands for
    borders : alike cells run into each other, unlike ones get a dark edge; else a pixel has its
        own cell's colour
    places : along a pixel's side at which it is labelled and painted; it shows their mean
    """

    rounds: float
    borders: bool
    places: int = 1


ACCURACY = {
    "standard": Accuracy(0.5, False),
    "high": Accuracy(1.0, True),
    "reference": Accuracy(1.0, True, places=4),
}


@dataclass(frozen=True, eq=False)
class CellSet:
    """Of one set of sites. labels : for each place in the pixels;  flow (n,) : turbulence at the
        sites
    near, weight (n, k) : of cells.neighbours"""

    labels: tuple[Labels, ...]
    flow: ndarray
    near: ndarray
    weight: ndarray


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level. paper : of `paper_grain`"""

    paper: ndarray
    wobbles: Wobbles
    surface: SurfacePoints


class Watercolor(Stage):
    name = "watercolor"
    levels: ClassVar[tuple[str, ...]] = tuple(ACCURACY)
    facts = frozenset({"flow", "light", "depth"})
    Params: ClassVar[type] = WatercolorParams
    without_object = True

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        return Demand(frame, "the whole picture is painted")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        """All of it: a cell's colour and a line's strength may depend on pixels far outside."""
        return scene.camera.rect

    def prepare(self, scene: Scene, level: str) -> Prepared:
        wobbles = Wobbles(scene.seed, self.params.wobble_px)
        return Prepared(
            paper_grain(scene.seed), wobbles, sample_surface(scene, scene.seed)
        )

    def run(self, view: View, prepared: Any) -> Mapping[Layer, ndarray]:
        picture = self.with_toon(view)
        lines = self.lines_of(view, picture)
        cells = self.cells_of(view, prepared)
        paint = self._mixed(view.level, prepared, cells, picture)
        corner = view.rect.x0, view.rect.y0
        paint_on = partial(painted, picture, lines, corner, *paint)
        image = reduce(iadd, map(paint_on, cells.labels))
        image /= np.float32(len(cells.labels))
        return {Layer.IMAGE: image}

    # the picture that is painted

    def with_toon(self, view: View) -> ndarray:
        """(h, w, 3) float32: the picture with the object toon-shaded, read-only."""
        p, image, box = self.params, view[Layer.IMAGE], _object_box(view)
        if not p.toon or box.empty:
            return packed(image)
        part = view.layers.crop(box)
        towards, radiance = toon_light(
            view.light, view.scene.world_from_anchor.rotation[:, 2]
        )
        even = EVEN * np.clip(view.light.ambient_rgb, 0, radiance)
        cosine = cv2.transform(
            packed(part[Layer.NORMAL]), towards[None].astype(np.float32)
        )
        tone = tones(cosine, p.toon_thresholds, p.toon_factors)
        light = np.column_stack([np.diag(radiance - even), even])
        lit = cv2.transform(cv2.merge([tone] * 3), light.astype(np.float32))
        flat = lit * part[Layer.ALBEDO]
        flat += part[Layer.EMISSIVE]
        flat *= cv2.merge([part[Layer.COVERAGE]] * 3)
        out, at = image.copy(), box.slices_in(view.rect)
        out[at] = replace_lit(out[at], part[Layer.VIRTUAL], flat, view.facts.opacity)
        return packed(out)

    def lines_of(self, view: View, picture: ndarray) -> ndarray:
        """(h, w) float32 strength of lines. picture : of `with_toon`"""
        p, rect = self.params, view.rect
        if p.lines <= 0:
            return np.zeros((rect.height, rect.width), np.float32)
        edges = measure_edges(picture)
        # with nothing of the object around it, from an even pixel on
        box = _object_box(view).shift(-rect.x0, -rect.y0).pad(2).align(2, 2)
        box = box.clip(Rect.of(rect.width, rect.height))
        if not box.empty:
            part = view.layers.crop(box.shift(rect.x0, rect.y0))
            shape = part[Layer.COVERAGE], part[Layer.NORMAL], part[Layer.DEPTH]
            of_object = object_edges(*shape, view.facts.opacity)
            add_object_edges(edges, of_object, box.x0 // 2, box.y0 // 2, p.line_high)
        lines = trace_lines(edges, p.line_low, p.line_high, p.line_width_px)
        return enlarge_lines(lines, rect.height, rect.width)

    # its cells

    def cells_of(self, view: View, prepared: Prepared) -> CellSet:
        """Cells of the background, and those of the object where it covers a pixel mostly."""
        field, pose = self.field_of(view)
        cells = self._background_cells(view, prepared, field)
        box = _object_box(view)
        if pose is None or box.empty:
            return cells
        inside = view.layers.crop(box)[Layer.COVERAGE] >= 0.5
        if not inside.any():
            return cells
        own = self._object_cells(view, prepared, pose, box, inside)
        pairs = zip(cells.labels, own.labels, strict=True)
        part = box.slices_in(view.rect)
        labels = tuple(back.overlaid(front, inside, part) for back, front in pairs)
        # neighbours within the object only: paint does not run over its outline
        count = np.int32(cells.labels[0].count)
        near = np.concatenate([cells.near, own.near + count])
        weight = np.concatenate([cells.weight, own.weight])
        return CellSet(labels, np.concatenate([cells.flow, own.flow]), near, weight)

    def field_of(self, view: View) -> tuple[SiteField, Pose | None]:
        p = self.params
        deep = p.nearer_finer > 0 and view.facts.real_depth is not None
        real_m = view[Layer.REAL_DEPTH] if deep else None
        return frame_field(view.facts, view.scene, p.cell_px, p.nearer_finer, real_m)

    def _background_cells(
        self, view: View, prepared: Prepared, field: SiteField
    ) -> CellSet:
        cell_px, rect, seed = self.params.cell_px, view.rect, view.scene.seed
        area = view.scene.camera.rect.area
        # more cells than pixels tell nothing apart
        limit = int(min(2 * area + 4096, 12 * area / cell_px**2 + 65536))

        def make() -> CellSet:
            # borders stray with the things, as far as one shift of the whole picture can say
            wobble = partial(prepared.wobbles.at, *field_shift(field))
            sites = make_sites(field, seed, limit, cell_px)
            size = partial(_size_at, field)
            return self._cell_set(view.level, sites, rect, wobble, size, seed)

        cells: CellSet = view.memo.of_frame.get(
            (field.key(), rect), make, "cells", _KEPT
        )
        return cells

    def _object_cells(
        self,
        view: View,
        prepared: Prepared,
        pose: Pose,
        box: Rect,
        inside: ndarray,
    ) -> CellSet:
        """inside (h, w) bool : pixels of `box` that the object mostly covers"""
        p, scene = self.params, view.scene

        def make() -> CellSet:
            origin_m = scene.world_from_anchor.translation_m
            shift = object_shift(scene.camera, pose, origin_m)
            wobble = partial(prepared.wobbles.at, *shift)
            how = pose, _OBJECT_CELL * p.cell_px, p.nearer_finer
            sites, sizes = object_sites(prepared.surface, scene, *how)
            what = wobble, lambda sorted_: sizes[sorted_.key], scene.seed + 1, inside
            return self._cell_set(view.level, sites, box, *what)

        key = (
            pose.rotation.tobytes(),
            pose.translation_m.tobytes(),
            box,
            inside.tobytes(),
        )
        cells: CellSet = view.memo.of_frame.get(
            key, make, "cells of the object", _KEPT
        )
        return cells

    def _cell_set(
        self,
        level: str,
        sites: Sites,
        rect: Rect,
        wobble: Callable[[Place], Wobble],
        size_px: Callable[[Sites], ndarray],
        seed: int,
        inside: ndarray = EVERY_PIXEL,
    ) -> CellSet:
        """wobble : of a place in the pixels;  size_px : (n,) of the cells at n sites"""
        blend_px = BLEND_PX if self.params.edge_darkening > 0 else 0.0
        blend_px *= ACCURACY[level].borders
        places = _places(level)
        sites = sort_sites(sites, rect, wobble(places[0]))
        labels = tuple(
            label(sites.seen_from(place), rect, wobble(place), blend_px, inside)
            for place in places
        )
        flow = np.resize(turbulence(sites.u, sites.v, seed), labels[0].count)
        near, weight = neighbours(sites.x, sites.y, size_px(sites) * STEPS)
        return CellSet(labels, flow, near, weight)

    def _mixed(
        self, level: str, prepared: Prepared, cells: CellSet, picture: ndarray
    ) -> tuple[ndarray, ndarray, How]:
        """The paint for each cell, the paper, and how it is painted, as `painted` takes them."""
        p = self.params
        labellings = [labels.first for labels in cells.labels]
        mean, area = mean_colours(picture, labellings, cells.labels[0].count)
        every_round = ceil(_ROUNDS * p.wash)
        rounds = ceil(ACCURACY[level].rounds * every_round)
        step = every_round / max(rounds, 1)
        contrast = 0.02 + 0.16 * p.wash
        root = smooth_washes(
            mean, cells.near, cells.weight, area, contrast, rounds, step
        )
        root = adjust_tone(root, p.lightness, p.saturation, p.deepest)
        washes = np.column_stack([mean, root, np.float32(p.flow) * cells.flow])
        ink = np.array(p.ink_rgb, np.float32)
        how = np.float32(p.edge_darkening), np.float32(p.lines), ink
        return washes, np.float32(p.grain) * prepared.paper, how


def _object_box(view: View) -> Rect:
    """Pixels that the object may cover."""
    return view.layers.extent(Layer.COVERAGE) if view.facts.present else EMPTY


def _places(level: str) -> list[Place]:
    """(x, y) px from a pixel's middle, spread evenly."""
    n = ACCURACY[level].places
    along = [(k + 0.5) / n - 0.5 for k in range(n)]
    return [(x, y) for y in along for x in along]


def _size_at(field: SiteField, sites: Sites) -> ndarray:
    """(n,) float32 size of cells at the sites, px: that of the nearest node."""
    rows, columns = field.size.shape
    row = np.rint((sites.y / STEPS - field.y0) / GRID_PX).astype(int)
    column = np.rint((sites.x / STEPS - field.x0) / GRID_PX).astype(int)
    nearest = row.clip(0, rows - 1), column.clip(0, columns - 1)
    return field.size[nearest].astype(np.float32)
