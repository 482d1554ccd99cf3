"""Watercolor: the whole picture, real and virtual, as one painting of washes, lines, pigment and paper.

1. the object is toon-shaded under the clip's light; 2. cells follow what they lie on, each the exact mean of its pixels;
3. alike neighbours run into washes; 4. pigment and paper; 5. lines where colour, silhouette or crease are strong.
Labels are memoised by the content of the site field, a whole picture by its content: what did not change is not made again,
and gives the same bits. Cost: O(pixels). Memory: about 105 bytes a pixel while a frame is painted, 68 of them the layers that
it reads (8K, with the finest cells that detail asks for: 3.8 GB measured, with the program; 4 bytes a pixel less with even
cells), and 12 for each of two memoised pictures (none above 16 Mpx). Lines and toon are made beside the cells, on a free core.
Levels (levels.py) paint the same cells: draft at half the size, without washes; standard with half the rounds of washes and
plain borders; high all of it, at every pixel's middle; reference is the mean of nine places in each (81 bytes a pixel more).
line_hold looks at the frame before as well (temporal.py): its layers stay in memory, and each chunk renders one frame more.
Grain and dry brush lie on the paper and stay there: coherence along the motion is measured without them.
Source: docs/methods/watercolor.md. Leaves out: wet-in-wet flow; without measured depth, that of real things off the plane."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any, ClassVar

import cv2
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, packed
from arfx.core.parallel import BackgroundTask
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View
from arfx.stages.watercolor.cells import (
    adjust_tone,
    cell_colours,
    mean_colours,
    neighbours,
    smooth_washes,
)
from arfx.stages.watercolor.digest import digest
from arfx.stages.watercolor.edges import trace_lines, virtual_edges, yuv_matrix
from arfx.stages.watercolor.field import RealDioptre, advection_directions, frame_field
from arfx.stages.watercolor.half import double_lines, half_rect, halve_sites, halved
from arfx.stages.watercolor.labels import Labels, Wobble, label, sort_sites
from arfx.stages.watercolor.levels import ACCURACY
from arfx.stages.watercolor.measure import edge_measure
from arfx.stages.watercolor.object_sites import Surface, object_sites, sample_surface
from arfx.stages.watercolor.paint import paint
from arfx.stages.watercolor.paint_plain import paint_plain
from arfx.stages.watercolor.params import WatercolorParams
from arfx.stages.watercolor.pigment import paper_grain, turbulence
from arfx.stages.watercolor.reference import labels_within
from arfx.stages.watercolor.rows import Cells, Picture, combine_labels, offset
from arfx.stages.watercolor.sites import GRID_PX, STEPS, SiteField, Sites, make_sites
from arfx.stages.watercolor.temporal import backward_flow, temporal_blend
from arfx.stages.watercolor.toon import EVEN, ObjectLayers, Tones, toon, toon_light
from arfx.stages.watercolor.wobble import Wobbles

PAD_PX = 4  # around the model's box: what its raster may touch, and the smoothing before lines
_EVERY = 32  # rows of the object's layers that a frame is known by
BLEND_PX = 1.5  # from a cell's border, over which alike colours run into each other
_COARSE_SMOOTH = 0.8  # of the smoothing before lines: a coarser grid smooths by itself
_MEMO_SETS, _MEMO_PICTURES, _MEMO_MEASURES = 4, 2, 3
Key = tuple[Any, ...]
_MEMO_LIMIT_PX = 16_000_000
_VIRTUAL = (Layer.VIRTUAL, Layer.COVERAGE, Layer.NORMAL, Layer.DEPTH, Layer.ALBEDO, Layer.EMISSIVE)


@dataclass(frozen=True, eq=False)
class CellSet:
    """Of one set of sites. labels : of the pixels' middles;  flow (n,) : turbulence at the sites
    near, weight (n, k) : of cells.neighbours;  within : labels of further places in the pixels"""

    labels: Labels
    flow: np.ndarray
    near: np.ndarray
    weight: np.ndarray
    within: tuple[Labels, ...] = ()


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level. grain : tile of the paper"""

    grain: np.ndarray
    wobbles: Wobbles
    surface: Surface


class Watercolor(Stage):
    name = "watercolor"
    reads = frozenset({Layer.IMAGE, *_VIRTUAL, Layer.REAL_DEPTH})
    writes = frozenset({Layer.IMAGE})
    levels: ClassVar[tuple[str, ...]] = tuple(ACCURACY)
    facts = frozenset({"flow", "light"})
    Params = WatercolorParams
    without_object = True

    def __init__(self, params: WatercolorParams | None = None) -> None:
        super().__init__(params)
        p = self.params
        self.history = int(p.line_hold and p.lines > 0)

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        return Demand(frame, "the whole picture is painted")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        """All of it: a cell's colour and a line's strength may depend on pixels far outside."""
        return scene.camera.rect

    def prepare(self, scene: Scene, level: str) -> Prepared:
        p = self.params
        wobbles = Wobbles(scene.seed, p.wobble_px if p.pigment else 0.0, 2 if ACCURACY[level].half else 1)
        return Prepared(paper_grain(scene.seed, p.grain_px), wobbles, sample_surface(scene, scene.seed))

    def run(self, view: View, prepared: Any) -> Mapping[Layer, np.ndarray]:
        p = self.params
        fields = [
            (self._field(view, direction), weight)
            for direction, weight in advection_directions(view.facts, p.anchored, p.two_patterns)
        ]
        half, before = ACCURACY[view.level].half, self._before(view)
        # a picture of half the size is made at once: it is quicker to know again than the whole one
        known = BackgroundTask(lambda: self._shown(view)) if half else None
        for field, _ in fields:  # beside it
            self._background_cells(view, prepared, *field)
        content = _content(view, known().image if known else view[Layer.IMAGE])
        earlier = () if before is None else _content(before, before[Layer.IMAGE])

        def make() -> np.ndarray:
            # neither needs the cells: they are made beside them
            picture = known or BackgroundTask(lambda: self._shown(view))
            lines = BackgroundTask(lambda: self._lines(picture, view, content, before, earlier))
            painted = [self._painted(view, prepared, *field, picture, lines) for field, _ in fields]
            if len(painted) == 1:
                return painted[0]
            (_, first), (_, second) = fields
            return cv2.addWeighted(painted[0], first, painted[1], second, 0).reshape(painted[0].shape)

        if view.rect.area > _MEMO_LIMIT_PX:
            return {Layer.IMAGE: make()}
        key = (
            tuple((sites_key, weight) for (_, _, sites_key), weight in fields), view.rect, content, earlier,
            tuple(_pose_key(pose) for (_, pose, _), _ in fields),
        )  # fmt: skip
        return {Layer.IMAGE: view.memo.of_frame.get(key, make, "picture", _MEMO_PICTURES)}

    def _field(self, view: View, direction: str) -> tuple[SiteField, Any, Key]:
        """(site field, the pose that goes with it, a key for the field's content)."""
        p, facts = self.params, view.facts
        real = None
        if p.nearer_finer > 0 and facts.real_depth is not None:
            real = RealDioptre.of(view[Layer.REAL_DEPTH], view.rect)

        def make() -> tuple[SiteField, Any, Key]:
            field, pose = frame_field(facts, view.scene, p.cell_px, p.nearer_finer, p.anchored, direction, p.detail, real)
            return field, pose, (field.x0, field.y0, *(digest(a) for a in (field.u, field.v, field.size)))

        found = facts.advection if p.anchored else None
        key: Key = (_pose_key(facts.camera_from_world),)
        if found is not None:
            key = (getattr(found, direction), found.detail, _pose_key(found.pose))
        if real is not None:
            key = (*key, digest(real.mean))
        made: tuple[SiteField, Any, Key] = view.memo.of_frame.get(key, make, "field", _MEMO_SETS)
        return made

    def with_toon(self, view: View, half: bool = False) -> Picture:
        """The picture with the object toon-shaded. half : of half the size, toon of one in 2 x 2 pixels"""
        p, image, every = self.params, view[Layer.IMAGE], 2 if half else 1
        image, box = halved(image) if half else image, view.layers.extent(Layer.COVERAGE).clip(_box(view))
        if not p.toon or box.empty:
            return Picture(image)
        part, (top, left) = view.layers.crop(box), offset(box, view.rect)
        layers, first = ObjectLayers(*(packed(part[Layer(n)]) for n in ObjectLayers._fields)), (-top % every, -left % every)
        shown = layers.coverage[first[0] :: every, first[1] :: every]
        if not shown.any():
            return Picture(image)
        light = view.light
        towards = toon_light(light, view.scene.world_from_anchor.rotation[:, 2])
        even = EVEN * np.clip(light.ambient_rgb, 0, towards[1])
        tones = Tones.of(towards, even, p.toon_thresholds, p.toon_factors, view.facts.opacity)
        (top, left), (h, w) = (-(-n // every) for n in (top, left)), shown.shape
        patch = toon(image[top : top + h, left : left + w], layers, tones, first, every)
        return Picture(image, patch, top, left)

    def _shown(self, view: View) -> Picture:
        """What is painted: the picture with the object toon-shaded, of half the size where the level says so."""
        return self.with_toon(view, ACCURACY[view.level].half)

    def _painted(
        self, view: View, prepared: Prepared, field: SiteField, pose: Any, sites_key: Key, picture: BackgroundTask[Picture],
        lines: BackgroundTask[np.ndarray],
    ) -> np.ndarray:  # fmt: skip
        """picture : of `_shown`"""
        p, rect = self.params, view.rect
        # the object's cells are made beside the background's
        own = BackgroundTask(lambda: None if pose is None else self._object_cells(view, prepared, pose))
        cells = self._background_cells(view, prepared, field, pose, sites_key)
        each, accuracy = [combine_labels(labels) for labels in (cells.labels, *cells.within)], ACCURACY[view.level]
        if (found := own()) is not None:
            each, cells = _with_object(cells, *found)
        colours = mean_colours([cell_colours(picture(), labels) for labels in each])
        whole = ceil(8 * p.wash)
        rounds = accuracy.rounds_of(whole)
        root = smooth_washes(
            colours[:, :3], cells.near, cells.weight, colours[:, 3], 0.02 + 0.16 * p.wash, rounds, whole / max(rounds, 1)
        )  # fmt: skip
        root = adjust_tone(root, p.lightness, p.saturation, p.deepest)
        ink = np.array(p.ink_rgb, np.float32)
        strengths = np.array([p.edge_darkening, 0.25, p.flow, p.grain, p.lines, p.dry_brush], np.float32)
        strengths[[0, 2, 3, 5]] *= p.pigment
        paper = prepared.grain, rect.x0, rect.y0

        def made(labels: Cells) -> np.ndarray:
            if not labels.second.size:
                return paint_plain(labels, root, cells.flow, paper, lines(), strengths, ink, (rect.height, rect.width))
            return paint(picture(), labels, colours, root, cells.flow, paper, lines(), strengths, ink)

        out = made(each[0])
        for labels in each[1:]:
            out += made(labels)
        return out if len(each) == 1 else out / np.float32(len(each))

    def _lines(
        self, picture: BackgroundTask[Picture], view: View, content: Key, before: View | None, earlier: Key
    ) -> np.ndarray:  # fmt: skip
        """Strength of lines, empty where none are wanted. before, earlier : the frame whose edges are blended in, its content"""
        p, get, half = self.params, view.memo.of_frame.get, ACCURACY[view.level].half
        if p.lines <= 0:
            return np.zeros((0, 0), np.float32)
        every, smooth_px = (2, _COARSE_SMOOTH * p.line_smooth_px / 2) if half else (1, p.line_smooth_px)

        def measure(toon_shaded: Picture) -> np.ndarray:
            return edge_measure(toon_shaded, yuv_matrix(p.yuv), p.alpha, p.beta, smooth_px)

        if before is None:
            edges = measure(picture())
        else:
            (now, *_), (then, *_) = (self._field(v, "nodes") for v in (view, before))
            edges = get(content, lambda: measure(picture()), "measure", _MEMO_MEASURES).copy()
            back = backward_flow(now, then)
            if back is not None:
                old = get(earlier, lambda: measure(self.with_toon(before)), "measure", _MEMO_MEASURES)
                edges[0] = temporal_blend(edges[0], old[0], back, now.x0 - view.rect.x0, now.y0 - view.rect.y0)
        virtual, at = self.virtual_edges_of(view, every)
        lines = trace_lines(edges, every * p.line_low, every * p.line_high, p.line_width_px / every, virtual, at)
        return double_lines(lines, (view.rect.height + 1) // 2, (view.rect.width + 1) // 2) if half else lines

    def _before(self, view: View) -> View | None:
        """The frame before, where its lines are to be blended in and it shows the same things; lines of half the size are not
        steadied by that."""
        if not self.history or not view.before or ACCURACY[view.level].half:
            return None
        before, now = view.before[-1], view.facts
        then = before.facts
        return before if then.index == now.index - 1 and then.shot == now.shot and before.rect == view.rect else None

    def virtual_edges_of(self, view: View, every: int = 1) -> tuple[np.ndarray | None, tuple[int, int]]:
        """(edges of the object or None, where they lie on the grid of one in 2 x `every` pixels of the whole picture)."""
        now, rect, box = view.layers, view.rect, _box(view)
        if box.empty:
            return None, (0, 0)
        pitch = 2 * every
        y, x = (box.y0 - rect.y0) // pitch, (box.x0 - rect.x0) // pitch
        whole = Rect(pitch * x + rect.x0, pitch * y + rect.y0, box.x1, box.y1)
        seen = now.extent(Layer.COVERAGE).clip(whole)
        if seen.empty:
            return None, (0, 0)
        part, (top, left) = now.crop(seen), offset(seen, whole)
        layers, shape = [part[name] for name in (Layer.COVERAGE, Layer.NORMAL, Layer.DEPTH)], (whole.height, whole.width)
        return virtual_edges(layers[0], layers[1], layers[2], view.facts.opacity, (top, left), shape, every), (y, x)

    def _background_cells(self, view: View, prepared: Prepared, field: SiteField, _pose: Any, sites_key: Key) -> CellSet:
        """Of what `_field` made."""
        cell, rect, seed = self.params.cell_px, view.rect, view.scene.seed
        area = view.scene.camera.rect.area
        limit = int(min(2 * area + 4096, 12 * area / cell**2 + 65536))  # more cells than pixels tell nothing apart

        def make() -> CellSet:
            # borders stray with the things, not with the screen: as far as one shift of the whole picture can say
            wobble, sites = prepared.wobbles.of_field(field, _corner(rect, view.level)), make_sites(field, seed, limit, cell)
            return self._cells(sites, rect, wobble, view.level, seed, lambda ordered: _size_at(field, ordered))

        made: CellSet = view.memo.of_frame.get((sites_key, rect), make, "cells", _MEMO_SETS)
        return made

    def _cells(
        self, sites: Sites, rect: Rect, wobble: Wobble, level: str, seed: int, size_at: Callable[[Sites], np.ndarray],
        mask: np.ndarray | None = None,
    ) -> CellSet:  # fmt: skip
        """size_at : (n,) sizes of the cells at the sites, px;  mask (h, w) : pixels of `rect` that are asked for, None = all"""
        p, accuracy = self.params, ACCURACY[level]
        if accuracy.half:
            sites, rect = halve_sites(sites, rect), half_rect(rect)
        sites = sort_sites(sites, rect, wobble)
        blend = BLEND_PX if p.pigment and accuracy.borders else 0.0
        if accuracy.places > 1:
            labels, *within = labels_within(sites, rect, wobble, blend, accuracy.places)
        else:
            labels, within = label(sites, rect, wobble, blend, mask), []
        flow = turbulence(sites.u, sites.v, seed, p.flow_px) if p.pigment and len(sites) else np.zeros(labels.count, np.float32)
        near, weight = np.zeros((labels.count, 0), np.int32), np.zeros((labels.count, 0), np.float32)
        if accuracy.rounds > 0 and p.wash > 0 and len(sites) > 1:
            near, weight = neighbours(sites.x, sites.y, size_at(sites) * STEPS)
        return CellSet(labels, flow, near, weight, tuple(within))

    def _object_cells(self, view: View, prepared: Prepared, pose: Any) -> tuple[CellSet, np.ndarray, int, int] | None:
        """Cells of the object's surface; (h, w) bool, pixels that it mostly covers, and their first row and column. None where it
        covers none."""
        now, scene, level, cell = view.layers, view.scene, view.level, 0.8 * self.params.cell_px
        box = now.extent(Layer.COVERAGE).clip(_box(view))
        inside, (top, left) = now.crop(box)[Layer.COVERAGE] >= 0.5, offset(box, view.rect)
        if ACCURACY[level].half:
            inside, box = inside[top % 2 :: 2, left % 2 :: 2].copy(), Rect(box.x0 + left % 2, box.y0 + top % 2, box.x1, box.y1)
            top, left = (top + 1) // 2, (left + 1) // 2
        if not inside.any():
            return None

        def make() -> CellSet:
            p = self.params
            sites, size_px = object_sites(prepared.surface, scene, pose, cell, p.flow_px, p.nearer_finer)
            wobble = prepared.wobbles.of_object(scene.camera, pose, scene.world_from_anchor.translation_m, _corner(box, level))
            return self._cells(sites, box, wobble, level, scene.seed + 1, lambda ordered: size_px[ordered.key], inside)

        key = ("object", _pose_key(pose), box, digest(inside.view(np.uint8)))
        return view.memo.of_frame.get(key, make, "cells", _MEMO_SETS), inside, top, left


def _with_object(cells: CellSet, own: CellSet, inside: np.ndarray, top: int, left: int) -> tuple[list[Cells], CellSet]:
    """Labels of each place in the pixels, and what is known of all cells, with those of the object where it is."""
    # neighbours within the object only: paint does not run over its outline
    if own.near.shape[1] and cells.near.shape[1]:
        near = np.concatenate([cells.near, own.near + np.int32(cells.labels.count)])
        weight = np.concatenate([cells.weight, own.weight])
    else:
        near, weight = (np.zeros((cells.labels.count + own.labels.count, 0), t) for t in (np.int32, np.float32))
    pairs = zip((cells.labels, *cells.within), (own.labels, *own.within), strict=True)
    each = [combine_labels(back, front, inside, top, left) for back, front in pairs]
    return each, CellSet(cells.labels, np.concatenate([cells.flow, own.flow]), near, weight)


def _size_at(field: SiteField, sites: Sites) -> np.ndarray:
    """(n,) float32 size of cells at the sites, px: that of the nearest node."""
    i, j = ((a / STEPS - first) / GRID_PX for a, first in ((sites.y, field.y0), (sites.x, field.x0)))
    gh, gw = field.size.shape
    return field.size[np.rint(i).astype(int).clip(0, gh - 1), np.rint(j).astype(int).clip(0, gw - 1)].astype(np.float32)


def _pose_key(pose: Pose | None) -> bytes | None:
    return None if pose is None else pose.rotation.tobytes() + pose.translation_m.tobytes()


def _corner(rect: Rect, level: str) -> tuple[int, int]:
    """The pixel of the frame that the wobble's first is: at half the size, whose pixels count from there, that of `rect`."""
    return (rect.x0, rect.y0) if ACCURACY[level].half else (0, 0)


def _box(view: View) -> Rect:
    """What the object may touch."""
    return view.facts.model_box.pad(PAD_PX).clip(view.rect) if view.facts.present else EMPTY


def _content(view: View, image: np.ndarray) -> Key:
    """What a frame shows, by the image that is painted."""
    now, facts, box = view.layers, view.facts, _box(view)
    out: list[Any] = [digest(image)]
    box = now.extent(Layer.COVERAGE).clip(box)
    if not box.empty:
        part = now.crop(box)
        # few rows tell one state of the object from another: its colours are in the picture, its pose is known
        out += [digest(part[name][::_EVERY]) for name in (Layer.COVERAGE, Layer.NORMAL)]
    return (*out, box, facts.opacity, repr(view.light), _pose_key(facts.camera_from_world))
