"""Watercolor: the whole picture, real and virtual, as one painting of washes, lines, pigment and paper.

1. the object is toon-shaded under the clip's light; 2. cells follow what they lie on, each the exact mean of its pixels;
3. alike neighbours run into washes; 4. pigment and paper; 5. lines where colour, silhouette or crease are strong.
Labels are kept by the content of the field of sites, a whole picture by its content: what did not change is not made again,
and gives the same bits. Cost: O(pixels). Memory: about 105 bytes a pixel while a frame is painted, 68 of them the layers that
it reads (8K, with the finest cells that detail asks for: 3.8 GB measured, with the program; 4 bytes a pixel less with even
cells), and 12 for each of two kept pictures (none above 16 Mpx). Lines and toon are made beside the cells, on a free core.
Levels: draft has fewer, coarser cells with plain borders: a pixel takes its own cell's colour alone (a chamfer
transform costs four times the exact labels); high paints the patterns carried forward and backward and fades between
them (Bousseau et al. 2007); reference is standard with float64 labels by other means.
line_hold looks at the frame before as well (hold.py): its layers stay in memory, and each chunk renders one frame more.
Grain and dry brush lie on the paper and stay there: coherence along the motion is measured without them.
Source: docs/methods/watercolor.md. Leaves out: wet-in-wet flow, depth of the real scene beyond its plane.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numba
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.parallel import BackgroundTask
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View
from arfx.stages.watercolor.cells import cell_colours, neighbours, toned, washed
from arfx.stages.watercolor.digest import digest
from arfx.stages.watercolor.edges import lines_of, virtual_edges, yuv_matrix
from arfx.stages.watercolor.field import frame_field, ways
from arfx.stages.watercolor.hold import held, steps_back
from arfx.stages.watercolor.labels import Labels, Wobble, in_order, label
from arfx.stages.watercolor.measure import measured
from arfx.stages.watercolor.object_sites import Surface, object_sites, surface_of
from arfx.stages.watercolor.paint import paint, paint_cells
from arfx.stages.watercolor.params import WatercolorParams
from arfx.stages.watercolor.pigment import laid_out, paper_grain, turbulence
from arfx.stages.watercolor.reference import reference_labels
from arfx.stages.watercolor.rows import Cover, Picture, offset
from arfx.stages.watercolor.sites import GRID_PX, STEPS, Field, Sites, sites_of
from arfx.stages.watercolor.toon import EVEN, RAMP, toon, toon_light
from arfx.stages.watercolor.wobble import Wobbles

PAD_PX = 4  # around the model's box: what its raster may touch, and the smoothing before lines
_EVERY = 32  # rows of the object's layers that a frame is known by
BLEND_PX = 1.5  # from a cell's border, over which alike colours run into each other
_KEPT_SETS, _KEPT_PICTURES, _KEPT_MEASURES = 4, 2, 3
Key = tuple[Any, ...]
_LARGEST_KEPT_PX = 16_000_000
_VIRTUAL = (Layer.VIRTUAL, Layer.COVERAGE, Layer.NORMAL, Layer.DEPTH, Layer.ALBEDO, Layer.EMISSIVE)


@dataclass(frozen=True, eq=False)
class Cells:
    """Of one set of sites. flow (n,) : turbulence at the sites;  near, share (n, k) : neighbours, see cells.neighbours"""

    labels: Labels
    flow: np.ndarray
    near: np.ndarray
    share: np.ndarray


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level. grain : tile of the paper"""

    grain: np.ndarray
    wobbles: Wobbles
    surface: Surface


class Watercolor(Stage):
    name = "watercolor"
    reads = frozenset({Layer.IMAGE, *_VIRTUAL})
    writes = frozenset({Layer.IMAGE})
    levels: ClassVar[tuple[str, ...]] = ("draft", "standard", "high", "reference")
    facts = frozenset({"flow", "light"})
    Params = WatercolorParams
    without_object = True
    even: ClassVar[float] = EVEN  # of toon shading
    ramp: ClassVar[float] = RAMP

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
        wobbles = Wobbles(scene.seed, p.wobble_px if p.pigment else 0.0)
        return Prepared(paper_grain(scene.seed, p.grain_px), wobbles, surface_of(scene, scene.seed))

    def run(self, view: View, prepared: Any) -> Mapping[Layer, np.ndarray]:
        p = self.params
        fields = [(self._field(view, way), share) for way, share in ways(view.facts, p.anchored, view.level == "high")]

        before = self._before(view)
        content = _content(view)
        earlier = None if before is None else _content(before)

        def make() -> np.ndarray:
            # neither needs the cells: they are made beside them
            picture = BackgroundTask(lambda: self.with_toon(view))
            if before is None or earlier is None:
                lines = BackgroundTask(lambda: self._lines(picture(), view))
            else:
                lines = BackgroundTask(lambda: self._held_lines((view, content), (before, earlier)))
            painted = [self._painted(view, prepared, *field, picture, lines) for field, _ in fields]
            if len(painted) == 1:
                return painted[0]
            (_, first), (_, second) = fields
            return cv2.addWeighted(painted[0], first, painted[1], second, 0).reshape(painted[0].shape)

        if view.rect.area > _LARGEST_KEPT_PX:
            return {Layer.IMAGE: make()}
        key = (
            tuple((sites_key, share) for (_, _, sites_key), share in fields), view.rect, content, earlier,
            tuple(_pose_key(pose) for (_, pose, _), _ in fields),
        )  # fmt: skip
        return {Layer.IMAGE: view.memo.of_frame.get(key, make, "picture", _KEPT_PICTURES)}

    def _field(self, view: View, way: str) -> tuple[Field, Any, bytes]:
        """(where the sites come from, the pose that goes with it, a number of the field's content)."""
        p, facts, cell_px = self.params, view.facts, self._cell_px(view.level)

        def make() -> tuple[Field, Any, bytes]:
            where, pose = frame_field(facts, view.scene, cell_px, p.nearer_finer, p.anchored, way, p.detail)
            return where, pose, _field_key(where)

        found = facts.advection if p.anchored else None
        if found is None:
            key: tuple[Any, ...] = (_pose_key(facts.camera_from_world),)
        else:
            key = (getattr(found, way), found.detail, _pose_key(found.pose))
        made: tuple[Field, Any, bytes] = view.memo.of_frame.get(key, make, "field", _KEPT_SETS)
        return made

    def _cell_px(self, level: str) -> float:
        return self.params.cell_px * (1.4 if level == "draft" else 1.0)

    def with_toon(self, view: View) -> Picture:
        """The picture with the object toon-shaded."""
        p, image = self.params, view[Layer.IMAGE]
        box = view.layers.extent(Layer.COVERAGE).clip(_box(view))
        if not p.toon or box.empty:
            return Picture(image)
        part = view.layers.crop(box)
        if not part[Layer.COVERAGE].any():
            return Picture(image)
        light = view.light
        direction, radiance = toon_light(light, view.scene.world_from_anchor.rotation[:, 2])
        even = self.even * np.clip(light.ambient_rgb, 0, radiance)
        patch = toon(
            part[Layer.IMAGE], part[Layer.VIRTUAL], part[Layer.COVERAGE], part[Layer.NORMAL], part[Layer.ALBEDO],
            part[Layer.EMISSIVE], direction, radiance, even, p.toon_thresholds, p.toon_factors, view.facts.opacity,
            self.ramp,
        )  # fmt: skip
        return Picture(image, patch, *offset(box, view.rect))

    def _painted(
        self, view: View, prepared: Prepared, where: Field, pose: Any, sites_key: bytes, picture: BackgroundTask[Picture],
        lines: BackgroundTask[np.ndarray],
    ) -> np.ndarray:  # fmt: skip
        p, rect = self.params, view.rect
        make = lambda: self._cells(where, view, prepared)  # noqa: E731
        cells = view.memo.of_frame.get((sites_key, rect), make, "cells", _KEPT_SETS)
        cover = Cover(cells.labels)
        if pose is not None:
            cover, cells = self._with_object(view, cells, prepared, pose)
        colours = cell_colours(picture(), cover)
        root = washed(colours[:, :3], cells.near, cells.share, colours[:, 3], 0.02 + 0.16 * p.wash, int(np.ceil(8 * p.wash)))
        root = toned(root, p.lightness, p.saturation, p.deepest)
        ink = np.array(p.ink_rgb, np.float32)
        if not p.pigment:
            return paint_cells(cover, root * root, lines(), p.lines, ink)
        strengths = np.array([p.edge_darkening, 0.25, p.flow, p.grain, p.lines, p.dry_brush], np.float32)
        return paint(picture(), cover, colours, root, cells.flow, prepared.grain, lines(), strengths, ink, rect.x0, rect.y0)

    def _lines(self, picture: Picture, view: View) -> np.ndarray:
        """Strength of lines, empty where none are wanted."""
        p = self.params
        if p.lines <= 0:
            return np.zeros((0, 0), np.float32)
        made = measured(picture, yuv_matrix(p.yuv), p.alpha, p.beta, p.line_smooth_px)
        return lines_of(made, p.line_low, p.line_high, p.line_width_px, *self._virtual_edges(view))

    def _before(self, view: View) -> View | None:
        """The frame before, where lines are held and it shows the same things."""
        if not self.history or not view.before:
            return None
        before, now = view.before[-1], view.facts
        then = before.facts
        return before if then.index == now.index - 1 and then.shot == now.shot and before.rect == view.rect else None

    def _held_lines(self, now: tuple[View, Key], before: tuple[View, Key]) -> np.ndarray:
        """Strength of lines, from the measures of both frames: each is made once."""
        p, view = self.params, now[0]

        def made(seen: View, key: Key) -> np.ndarray:
            make = lambda: measured(self.with_toon(seen), yuv_matrix(p.yuv), p.alpha, p.beta, p.line_smooth_px)  # noqa: E731
            found: np.ndarray = view.memo.of_frame.get(key, make, "measure", _KEPT_MEASURES)
            return found

        (own, *_), (then, *_) = (self._field(v, "nodes") for v in (view, before[0]))
        back, out = steps_back(own, then), made(*now).copy()
        if back is not None:
            out[0] = held(out[0], made(*before)[0], back, own.x0 - view.rect.x0, own.y0 - view.rect.y0)
        return lines_of(out, p.line_low, p.line_high, p.line_width_px, *self._virtual_edges(view))

    def _virtual_edges(self, view: View) -> tuple[np.ndarray | None, tuple[int, int]]:
        """(edges of the object or None, where they lie on the half-size grid of the whole picture)."""
        now, rect, box = view.layers, view.rect, _box(view)
        if box.empty:
            return None, (0, 0)
        y, x = (box.y0 - rect.y0) // 2, (box.x0 - rect.x0) // 2
        whole = Rect(2 * x + rect.x0, 2 * y + rect.y0, box.x1, box.y1)
        seen = now.extent(Layer.COVERAGE).clip(whole)
        if seen.empty:
            return None, (0, 0)
        part = now.crop(seen)
        at, shape = offset(seen, whole), (whole.height, whole.width)
        return virtual_edges(part[Layer.COVERAGE], part[Layer.NORMAL], part[Layer.DEPTH], view.facts.opacity, at, shape), (y, x)

    def _cells(self, where: Field, view: View, prepared: Prepared) -> Cells:
        scene, rect, level = view.scene, view.rect, view.level
        cell, area = self._cell_px(level), scene.camera.rect.area
        most = int(min(2 * area + 4096, 12 * area / cell**2 + 65536))  # more cells than pixels tell nothing apart
        # borders stray with the things, not with the screen: as far as one shift of the whole picture can say
        wobble = prepared.wobbles.of_field(where)
        sites = in_order(sites_of(where, scene.seed, most, cell), rect, wobble)
        labels = self._labels(sites, rect, wobble, level)
        size = _size_at(where.size, where.x0, where.y0, sites.x, sites.y) if self.params.wash > 0 else np.zeros(0, np.float32)
        return self._described(sites, labels, size, scene.seed)

    def _described(self, sites: Sites, labels: Labels, size: np.ndarray, seed: int) -> Cells:
        """size (n,) : of cells at the sites, px; not read where there are no washes"""
        p = self.params
        flow = turbulence(sites.u, sites.v, seed, p.flow_px) if p.pigment and len(sites) else np.zeros(labels.count, np.float32)
        if p.wash > 0 and len(sites) > 1:
            near, share = neighbours(sites.x, sites.y, size * STEPS)
        else:
            near, share = np.zeros((labels.count, 0), np.int32), np.zeros((labels.count, 0), np.float32)
        return Cells(labels, flow, near, share)

    def _labels(self, sites: Sites, rect: Rect, wobble: Wobble, level: str, mask: np.ndarray | None = None) -> Labels:
        blend = BLEND_PX if self.params.pigment and level != "draft" else 0.0
        if level == "reference":
            moved = laid_out(wobble.tile, wobble.x + rect.x0, wobble.y + rect.y0, rect.width, rect.height)
            return reference_labels(sites, rect, moved.astype(np.float32), blend)
        return label(sites, rect, wobble, blend, mask)

    def _with_object(self, view: View, cells: Cells, prepared: Prepared, pose: Any) -> tuple[Cover, Cells]:
        """Labels, and what is known of all cells, with those of the object's surface in the pixels that it mostly covers."""
        now, scene, level, cell = view.layers, view.scene, view.level, 0.8 * self._cell_px(view.level)
        box = now.extent(Layer.COVERAGE).clip(_box(view))
        inside = now.crop(box)[Layer.COVERAGE] >= 0.5
        if not inside.any():
            return Cover(cells.labels), cells

        def make() -> Cells:
            sites = object_sites(prepared.surface, scene.camera, pose, cell, self.params.flow_px)
            wobble = prepared.wobbles.of_object(scene.camera, pose, scene.world_from_anchor.translation_m)
            sites = in_order(sites, box, wobble)
            labels = self._labels(sites, box, wobble, level, inside)
            return self._described(sites, labels, np.full(len(sites), cell, np.float32), scene.seed + 1)

        key = ("object", _pose_key(pose), box, digest(inside.view(np.uint8)))
        own = view.memo.of_frame.get(key, make, "cells", _KEPT_SETS)
        # neighbours within the object only: paint does not run over its outline
        if own.near.shape[1] and cells.near.shape[1]:
            near = np.concatenate([cells.near, own.near + np.int32(cells.labels.count)])
            share = np.concatenate([cells.share, own.share])
        else:
            near, share = (np.zeros((cells.labels.count + own.labels.count, 0), t) for t in (np.int32, np.float32))
        cover = Cover(cells.labels, own.labels, inside, *offset(box, view.rect))
        return cover, Cells(cells.labels, np.concatenate([cells.flow, own.flow]), near, share)


@numba.njit(cache=True, nogil=True)
def _size_at(size, x0, y0, x, y):  # pragma: no cover - compiled
    """(n,) float32 size of cells at the sites, px: that of the nearest node (size (gh, gw), the first one at x0, y0)."""
    gh, gw = size.shape
    out = np.empty(x.shape[0], np.float32)
    for k in range(x.shape[0]):
        i, j = np.int64(np.rint((y[k] / STEPS - y0) / GRID_PX)), np.int64(np.rint((x[k] / STEPS - x0) / GRID_PX))
        out[k] = size[min(max(i, 0), gh - 1), min(max(j, 0), gw - 1)]
    return out


def _pose_key(pose: Pose | None) -> bytes | None:
    return None if pose is None else pose.rotation.tobytes() + pose.translation_m.tobytes()


def _field_key(where: Field) -> bytes:
    h = hashlib.blake2b(digest_size=16)
    for a in (where.u, where.v, where.size):
        h.update(np.ascontiguousarray(a).tobytes())
    h.update(repr((where.x0, where.y0)).encode())
    return h.digest()


def _box(view: View) -> Rect:
    """What the object may touch."""
    return view.facts.model_box.pad(PAD_PX).clip(view.rect) if view.facts.present else EMPTY


def _content(view: View) -> Key:
    """What a frame shows."""
    now, facts, box = view.layers, view.facts, _box(view)
    out: list[Any] = [digest(now[Layer.IMAGE])]
    box = now.extent(Layer.COVERAGE).clip(box)
    if not box.empty:
        part = now.crop(box)
        # few rows tell one state of the object from another: its colours are in the picture, its pose is known
        out += [digest(part[name][::_EVERY]) for name in (Layer.COVERAGE, Layer.NORMAL)]
    return (*out, box, facts.opacity, repr(view.light), _pose_key(facts.camera_from_world))
