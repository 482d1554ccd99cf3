"""From a mesh to layers: which faces are seen, where pixels need more rays, what the rays meet.

More than one ray goes through a pixel only where an outline, a sharp edge or a cut-out passes
through it (edges.py). Directions are those of the distorted camera, so nothing is warped. Rays go
on behind transparent layers and cut-outs, up to MAX_LAYERS, by embree.
Cost: O(faces + pixels of the rectangle + edge pixels x samples); measured in `Raster.levels`.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.layers import Layer, neutral
from arfx.core.model import OPAQUE
from arfx.core.numerics import normalise
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.scene_mesh import SceneMesh
from arfx.stages.raster.edges import edge_pixels
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.record import (
    ALL_COLUMNS,
    COVERED,
    EXTRA_OUTPUTS,
    MARGIN,
    OUTPUTS,
    PLAIN_COLUMNS,
    SMOOTH,
    GBuffer,
    NearestFaces,
    Rays,
    View,
    rays_through,
)
from arfx.stages.raster.surface import CLEAR, add_surfaces, merged_by_face, resolve
from arfx.stages.raster.tables import CUT_OUT, MODE, has_extras, surface_tables
from arfx.stages.triangles import Triangles

MAX_LAYERS = 8
REFERENCE_SAMPLES = 256
# A ray goes on this far behind a hit, as a fraction of the depth: eight steps of float32.
_ONWARD = np.float32(1e-6)
_STRIP_PX, _BLOCK_RAYS = 1 << 20, 1 << 20  # at a time: bounds memory to about 200 MB


class FacesSeen(Protocol):
    """A way to find the faces that a camera sees: by rays or by OpenGL.

    offsets : (s, 2) places of a pixel's samples, px from its centre
    any_rectangle : a pixel comes out the same whatever rectangle it is in"""

    offsets: ndarray
    any_rectangle: bool

    def frame(self, view: View, rect: Rect) -> NearestFaces: ...


class Renderer:
    """Renders rectangles of one mesh through one camera.

    find_faces : makes FacesSeen of mesh, camera, the lens's curvature (1 / px) and samples
    samples : of a pixel that an edge crosses; of a mesh with transparency a quarter, because each
    one is followed through it. A texture gets half as many taps along a pixel's side as there are
    samples along it. From REFERENCE_SAMPLES on, rays go through all pixels, each by itself
    """

    def __init__(
        self,
        mesh: SceneMesh,
        camera: Camera,
        find_faces: Callable[[SceneMesh, Camera, float, int], FacesSeen],
        samples: int,
    ) -> None:
        self.mesh, self.camera, self.lens = mesh, camera, LensTable(camera)
        self.tables = surface_tables(mesh)
        self.extras = has_extras(mesh)
        self.layered = any(
            material.alpha_mode != OPAQUE for material in mesh.materials
        )
        self.everywhere = samples >= REFERENCE_SAMPLES
        fewer = self.layered and not self.everywhere
        count = max(samples // 4, min(samples, 4)) if fewer else samples
        self.faces = find_faces(mesh, camera, self.lens.curvature, count)
        offsets = self.faces.offsets
        self.offsets = offsets[np.argsort((offsets**2).sum(1), kind="stable")]
        self.taps = max(round(np.sqrt(samples) / 2), 1)
        self.pixel = float(1.0 / np.sqrt(camera.fx * camera.fy))
        self.triangles = (
            Triangles(mesh.corners_m, robust=True) if self.layered else None
        )

    def nothing(self, rect: Rect) -> dict[Layer, ndarray]:
        """All layers that this model has, as if it were not seen."""
        names = (*OUTPUTS, *EXTRA_OUTPUTS) if self.extras else OUTPUTS
        return {name: neutral(name, rect) for name in names}

    def render(self, rect: Rect, camera_from_world: Pose) -> dict[Layer, ndarray]:
        """All layers of OUTPUTS over `rect`, which lies in the frame; those of EXTRA_OUTPUTS for a
        model that has any of them."""
        out = self.nothing(rect)
        rows = max(_STRIP_PX // max(rect.width, 1), 1)
        for top in range(rect.y0, rect.y1, rows):
            strip = Rect(rect.x0, top, rect.x1, min(top + rows, rect.y1))
            if not strip.empty:
                part = {
                    name: array[strip.slices_in(rect)] for name, array in out.items()
                }
                self._strip(strip, camera_from_world, part)
        return out

    def _strip(
        self, rect: Rect, camera_from_world: Pose, out: dict[Layer, ndarray]
    ) -> None:
        view = self._view(rect, camera_from_world)
        # One pixel more on each side: a pixel's neighbours do not depend on the rectangle.
        wide = rect.pad(1)
        nearest = self.faces.frame(view, wide)
        wide_x, wide_y = (
            np.ascontiguousarray(a[1:-1, 1:-1]) for a in (view.x, view.y)
        )
        wide_face, wide_depth = nearest(wide_x, wide_y)
        if self.everywhere:
            edge = np.ones(rect.area, bool)
        else:
            seen = wide_face, wide_depth
            mask = edge_pixels(self.mesh, self.camera, view, wide, *seen)
            edge = mask[1:-1, 1:-1].ravel()
        centres = [
            a[1:-1, 1:-1].ravel() for a in (wide_face, wide_depth, wide_x, wide_y)
        ]
        face, _, x, y = centres
        if (
            self.layered
        ):  # how much of a cut-out a pixel shows, its centre does not tell
            edge |= (self.tables.ints[self.mesh.part[face], MODE] == CUT_OUT) & (
                face >= 0
            )
        plain = np.flatnonzero((face >= 0) & ~edge)
        count, whole = len(plain), np.ones(len(plain), np.float32)
        rays = rays_through(np.arange(count), face[plain], x[plain], y[plain], whole)
        sums = self._follow(rays, count, view)
        self._write(plain, rays.part, rays.depth, sums, view, out)
        sampled = np.flatnonzero(edge)
        step = max(_BLOCK_RAYS // len(self.offsets), 1)
        for start in range(0, len(sampled), step):
            pixels = sampled[start : start + step]
            row, column = np.divmod(pixels, rect.width)
            place = row + MARGIN, column + MARGIN
            x, y = (_around(a, *place, self.offsets) for a in (view.x, view.y))
            number = (row + 1) * wide.width + column + 1
            found = nearest(x, y, number)
            of_centre = [a[pixels] for a in centres]
            self._sampled(pixels, of_centre, (*found, x, y), view, out)

    def _sampled(
        self,
        pixels: ndarray,
        centre: Sequence[ndarray],
        samples: Sequence[ndarray],
        view: View,
        out: dict[Layer, ndarray],
    ) -> None:
        """Write pixels (n,) of `out`, each from its samples; depth and part are the centre's, where
        that meets anything, else those of the sample next to it that does.

        centre : face, depth, x, y (n,);  samples : the same (n, s), the nearest first"""
        count, most = samples[0].shape
        if self.layered or self.everywhere:
            joined = (
                np.column_stack(pair) for pair in zip(centre, samples, strict=True)
            )
            face, _, x, y = (a.ravel() for a in joined)
            share = np.full((count, 1 + most), 1 / most, np.float32)
            share[:, 0] = 0
            number = np.repeat(np.arange(count), 1 + most)
            rays = rays_through(number, face, x, y, share.ravel())
            sums = self._follow(rays, count, view)
            part, depth = (
                rays.part.reshape(share.shape),
                rays.depth.reshape(share.shape),
            )
        else:
            face, _, x, y = samples
            rays = rays_through(*merged_by_face(face, x, y))
            sums = self._follow(rays, count, view)
            face, depth = (np.column_stack([centre[k], samples[k]]) for k in range(2))
            part = np.where(face >= 0, self.mesh.part[face], np.int32(-1))
        first = np.arange(count), (part >= 0).argmax(1)
        self._write(pixels, part[first], depth[first], sums, view, out)

    def _write(
        self,
        pixels: ndarray,
        part: ndarray,
        depth: ndarray,
        sums: ndarray,
        view: View,
        out: dict[Layer, ndarray],
    ) -> None:
        """Write pixels (n,) from their sums; as `resolve`."""
        resolve(
            pixels, part, depth, sums, view, GBuffer(*(out[name] for name in OUTPUTS))
        )
        if self.extras:
            shown = sums[:, COVERED] > 0
            means = sums[shown] / sums[shown, COVERED, None]
            means[:, SMOOTH : SMOOTH + 3] = normalise(means[:, SMOOTH : SMOOTH + 3])
            place = np.unravel_index(pixels[shown], out[Layer.COVERAGE].shape)
            for name, columns in EXTRA_OUTPUTS.items():
                out[name][place] = means[:, columns]

    def _view(self, rect: Rect, camera_from_world: Pose) -> View:
        directions = self.lens.directions(rect.pad(MARGIN))
        centre = camera_from_world.apply(self.mesh.centre_m)
        return View(
            np.ascontiguousarray(directions[..., 0], float),
            np.ascontiguousarray(directions[..., 1], float),
            Pose(camera_from_world.rotation, centre).apply(self.mesh.vertices),
            np.ascontiguousarray(camera_from_world.rotation),
            camera_from_world.inverse().translation_m,
            self.pixel,
            self.taps,
        )

    def _follow(self, rays: Rays, count: int, view: View) -> ndarray:
        """(count, columns) sums of what the rays meet, layer by layer, for each pixel."""
        sums = np.zeros(
            (count, ALL_COLUMNS if self.extras else PLAIN_COLUMNS), np.float32
        )
        values = np.empty(sums.shape[1], np.float32)
        add_surfaces(rays, view, self.tables, values, sums)
        if self.triangles is None:
            return sums
        eye = (view.eye - self.mesh.centre_m).astype(np.float32)
        for _ in range(MAX_LAYERS - 1):
            going = np.flatnonzero((rays.face >= 0) & (rays.clear > CLEAR))
            if not len(going):
                break
            in_camera = np.column_stack(
                [rays.x[going], rays.y[going], np.ones(len(going))]
            )
            directions = (in_camera @ view.rotation).astype(np.float32)
            start = rays.reached[going, None] * (1 + _ONWARD)
            behind = np.full(len(rays.face), -1, np.int32)
            hits = self.triangles.first_hits(eye + start * directions, directions)
            behind[going] = hits["primID"]
            rays = rays._replace(face=behind)
            add_surfaces(rays, view, self.tables, values, sums)
        return sums


def _around(
    directions: ndarray, row: ndarray, column: ndarray, offsets: ndarray
) -> ndarray:
    """(n, s) directions at `offsets` (s, 2) px from pixels (n,), linear between pixels."""
    centre = directions[row, column][:, None]
    across = (directions[row, column + 1] - directions[row, column - 1])[:, None] / 2
    down = (directions[row + 1, column] - directions[row - 1, column])[:, None] / 2
    around = across * offsets[:, 0]
    around += down * offsets[:, 1]
    around += centre
    return np.asarray(around)
