"""The `pyrender` back end: a float geometry buffer drawn by OpenGL, and pixels made of it.

Each pixel gets k x k samples of an ideal camera over the rectangle only (cx, cy shifted by its corner); with lens distortion
the ideal picture is made as wide as the rectangle needs, and every sample looks up the texel its exact direction points to
(gl_resolve.py). BLEND materials are peeled front to back, up to MAX_LAYERS. Textures: OpenGL's mipmaps, averaged in coded
values. The near plane stands at 9/10 of the nearest vertex, at least NEAR_M; what is nearer is cut away.

Any thread may render, several at once too: drawing alone waits for the OpenGL thread (gl_draw.py)."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from arfx.core.camera import Camera
from arfx.core.layers import Layer, neutral
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.errors import InputError, RenderError
from arfx.stages.raster import gl_resolve, hits
from arfx.stages.raster import mesh as columns
from arfx.stages.raster.arrays import OUTPUTS, Buffers, GBuffer, no_samples, view
from arfx.stages.raster.gl_context import discard, on_gl_thread, open_context
from arfx.stages.raster.gl_draw import Drawing
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.mesh import Mesh

MAX_LAYERS = 8
NEAR_M = 1e-3
# Well below the 16384 of Mesa's drivers, beyond which every later draw fails too; this area keeps the buffers under 1 GB.
MAX_SIDE_PX = 8192
MAX_AREA_PX = 24_000_000
MAX_PARTS = 65_534
T = TypeVar("T")


class GlRenderer:
    """Renders rectangles of one mesh through one camera. samples : per pixel, rounded to a square k x k.

    Raises RenderError where no OpenGL context opens, InputError for more than MAX_PARTS parts."""

    any_rectangle = False  # the driver's fixed-point edges depend on the viewport's corner

    def __init__(self, mesh: Mesh, camera: Camera, samples: int) -> None:
        if len(mesh.ints) > MAX_PARTS:
            raise InputError(
                f"the model has {len(mesh.ints)} parts",
                f"at most {MAX_PARTS} with OpenGL; --set raster.backend=rays",
            )
        self.mesh, self.camera, self.lens = mesh, camera, LensTable(camera)
        self.k = max(round(samples**0.5), 1)
        offset = (np.arange(self.k) + 0.5) / self.k - 0.5
        radius = (offset[:, None] ** 2 + offset[None] ** 2).ravel()
        self.order = np.argsort(radius, kind="stable")
        self.glows = bool(mesh.floats[:, columns.EMIT_R : columns.CUTOFF].any())
        self.blends = bool((mesh.ints[:, columns.MODE] == 2).any())
        self.context = open_context()
        self.drawing = _on_gl_thread(Drawing, self.context, mesh, self.glows)
        weakref.finalize(
            self, discard, self.drawing.free
        ).atexit = False  # the driver takes all back when the process ends

    def render(self, rect: Rect, camera_from_world: Pose) -> dict[Layer, np.ndarray]:
        """All layers over `rect`, which lies in the frame. Raises RenderError where the driver refuses."""
        out = {name: neutral(name, rect) for name in OUTPUTS}
        if rect.empty:
            return out
        rows = max(min(MAX_SIDE_PX // self.k, MAX_AREA_PX // (self.k**2 * rect.width)), 1)
        for top in range(rect.y0, rect.y1, rows):
            strip = Rect(rect.x0, top, rect.x1, min(top + rows, rect.y1))
            self._strip(
                strip,
                camera_from_world,
                GBuffer(*(out[name][strip.slices_in(rect)] for name in OUTPUTS)),
            )
        return out

    def _strip(self, rect: Rect, pose: Pose, out: GBuffer) -> None:
        camera_from_mesh = Pose(pose.rotation, pose.apply(self.mesh.centre_m))
        depths = camera_from_mesh.apply(self.mesh.vertices)[:, 2]
        near, far = max(0.9 * float(depths.min()), NEAR_M), 1.1 * float(depths.max())
        lens = self.lens.directions(rect.pad(1))
        buffer_camera = self._ideal_camera(rect, lens)
        if far <= near or buffer_camera is None:
            return
        scale, shift, columns_px, rows_px = buffer_camera
        rotation = np.ascontiguousarray(pose.rotation)
        eye = pose.inverse().translation_m
        h, w, per = rect.height, rect.width, self.k**2
        directions, _ = hits.world_directions(lens[1:-1, 1:-1], rotation)
        texels = gl_resolve.texel_map(
            lens, h, w, self.k, scale, shift, rows_px, columns_px, not self.camera.distorted
        )
        from_mesh = np.diag([1.0, -1, -1, 1]) @ camera_from_mesh.matrix
        ideal = self.context.pyrender.IntrinsicsCamera(*scale, *(shift + 0.5), near, far)
        projection = ideal.get_projection_matrix(columns_px, rows_px)
        grid = np.array(
            [*scale, *shift, columns_px if self.camera.distorted else 0, rows_px], float
        )
        if not self.blends:
            buffers = Buffers(
                *_on_gl_thread(self.drawing, from_mesh, projection, columns_px, rows_px, None)
            )
            gl_resolve.resolve_opaque(
                texels, self.order, per, buffers, self.glows, grid, rotation, directions, eye, out
            )
            return
        samples, peel = no_samples(h * w * per), None
        for _ in range(MAX_LAYERS):
            buffers = Buffers(
                *_on_gl_thread(self.drawing, from_mesh, projection, columns_px, rows_px, peel)
            )
            if not gl_resolve.add_layer(
                texels, per, buffers, self.glows, grid, rotation, directions, samples
            ):
                break
            # nothing drawn at a texel: everything there has been peeled
            peel = np.where(buffers.surface[:, 3] > 0, buffers.geometry[:, 3], np.float32(3e38))
        # pixels are numbered with a margin of one, the lens table has two
        ys, xs = np.divmod(np.arange(h * w), w)
        numbers = (ys + 1) * (w + 2) + xs + 1
        none = np.zeros((h + 2) * (w + 2), np.int32)
        wide = view(self.lens.directions(rect.pad(2)), pose)
        hits.resolve_edges(numbers, self.order, samples, none.astype(np.float32), none, wide, out)

    def _ideal_camera(
        self, rect: Rect, lens: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int, int] | None:
        """Ideal camera of the buffer: position = direction * scale + shift; its size. None where nothing is seen."""
        c, k = self.camera, self.k
        focal, centre = np.array([c.fx, c.fy]), np.array([c.cx, c.cy])
        if not c.distorted:
            corner = np.array([rect.x0, rect.y0])
            return focal * k, (centre - corner) * k + (k - 1) / 2, rect.width * k, rect.height * k
        if np.isnan(lens).all():
            return None
        low, high = np.nanmin(lens, (0, 1)).astype(float), np.nanmax(lens, (0, 1)).astype(float)
        scale = focal * k
        size = (high - low) * scale + 2
        # A wide lens would need an endless ideal picture: it is made coarser instead.
        scale = scale * min(1.0, *(MAX_SIDE_PX / size), np.sqrt(MAX_AREA_PX / size.prod()))
        size = np.minimum(np.ceil((high - low) * scale).astype(int) + 2, MAX_SIDE_PX)
        # The buffer's grid is fixed to the picture, not to the rectangle.
        first = np.floor(low * scale + centre * k)
        return scale, centre * k - first, int(size[0]), int(size[1])


def _on_gl_thread(work: Callable[..., T], *args: Any) -> T:
    """work(*args) on the OpenGL thread. Raises RenderError with what the driver said."""
    from OpenGL.error import Error

    try:
        return on_gl_thread(work, *args)
    except Error as e:
        raise RenderError(
            f"OpenGL failed: {e!r}", "the rays back end needs no OpenGL: --set raster.backend=rays"
        ) from e
