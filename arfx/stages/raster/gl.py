"""Which faces a camera sees, by OpenGL: a picture of face numbers, looked up along directions.

The picture is an ideal camera's, over the rectangle only, k x k texels a pixel whose middle
one lies on the pixel's centre; a direction takes the texel next to it (Burns and Hunt 2013,
"The visibility buffer"). With lens distortion the picture is made as wide as the rectangle
needs. The near plane stands at 9/10 of the nearest vertex, at least NEAR_M; what is nearer
is cut away. Any thread may ask, several at once too: drawing alone waits for the OpenGL
thread (gl_draw.py)."""

import weakref
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.rect import Rect
from arfx.core.scene_mesh import SceneMesh
from arfx.errors import RenderError
from arfx.stages.raster.gl_context import discard, on_gl_thread, open_context
from arfx.stages.raster.gl_draw import Drawing
from arfx.stages.raster.record import NearestFaces, View, bounds_of
from arfx.stages.raster.visible import depths_along

NEAR_M = 1e-3
# Well below the 16384 of Mesa's drivers, beyond which every later draw fails too.
MAX_SIDE_PX = 8192
MAX_AREA_PX = 24_000_000
T = TypeVar("T")


class Picture(NamedTuple):
    """scale, shift : (2,) a direction's place is direction * scale + shift, in texels
    width, height : texels"""

    scale: ndarray
    shift: ndarray
    width: int
    height: int

    def looked_up(self, numbers: ndarray, x: ndarray, y: ndarray) -> ndarray:
        """int32 of `numbers` (texels,), bottom row first, along directions; -1 beyond."""
        with np.errstate(invalid="ignore"):
            column = np.floor(x * self.scale[0] + self.shift[0] + 0.5)
            row = np.floor(y * self.scale[1] + self.shift[1] + 0.5)
            inside = (column >= 0) & (column < self.width)
            inside &= (row >= 0) & (row < self.height)
        out = np.full(x.shape, -1, np.int32)
        texel = (self.height - 1 - row[inside]) * self.width + column[inside]
        out[inside] = numbers[texel.astype(np.int64)]
        return out


NOTHING = Picture(np.ones(2), np.zeros(2), 0, 0)


class GlFaces:
    """Faces of one mesh seen by one camera. samples : of a pixel, rounded to an odd square k x k.

    Raises RenderError where no OpenGL context opens."""

    any_rectangle = (
        False  # the driver's fixed-point edges depend on the viewport's corner
    )

    def __init__(
        self, mesh: SceneMesh, camera: Camera, curvature: float, samples: int
    ) -> None:
        self._mesh, self._camera = mesh, camera
        self._side = 2 * round((samples**0.5 - 1) / 2) + 1
        offset = (np.arange(self._side) + 0.5) / self._side - 0.5
        self.offsets = np.stack(np.meshgrid(offset, offset), -1).reshape(-1, 2)
        self.context = open_context()
        self.drawing = _on_gl_thread(Drawing, self.context, mesh)
        # the driver takes all back when the process ends
        weakref.finalize(self, discard, self.drawing.free).atexit = False

    def frame(self, view: View, rect: Rect) -> NearestFaces:
        """Raises RenderError where the driver refuses."""
        depths, points, faces = view.points[:, 2], view.points, self._mesh.faces
        near, far = max(0.9 * float(depths.min()), NEAR_M), 1.1 * float(depths.max())
        picture = self._picture(view) if far > near else NOTHING
        numbers = np.zeros(0, np.int32)
        if picture.width:
            numbers = self._drawn(view, picture, near, far)

        def nearest(
            x: ndarray, y: ndarray, pixels: ndarray | None = None
        ) -> tuple[ndarray, ndarray]:
            face = picture.looked_up(numbers, x, y)
            depth = depths_along(points, faces, face.ravel(), x.ravel(), y.ravel())
            return face, depth.reshape(x.shape)

        return nearest

    def _drawn(
        self, view: View, picture: Picture, near: float, far: float
    ) -> ndarray:
        """(texels,) int32 numbers of faces, -1 = none, bottom row first."""
        middle = picture.shift + 0.5
        ideal = self.context.pyrender.IntrinsicsCamera(
            *picture.scale, *middle, near, far
        )
        projection = ideal.get_projection_matrix(picture.width, picture.height)
        to_gl = np.diag([1.0, -1, -1, 1])
        camera_from_mesh = np.eye(4)
        camera_from_mesh[:3, :3] = view.rotation
        camera_from_mesh[:3, 3] = (
            view.points[0] - view.rotation @ self._mesh.vertices[0]
        )
        size = picture.width, picture.height
        return _on_gl_thread(
            self.drawing, to_gl @ camera_from_mesh, projection, *size
        )

    def _picture(self, view: View) -> Picture:
        """The ideal camera's; empty where no direction is known."""
        c = self._camera
        low, high = bounds_of(view)
        if not np.isfinite(low).all():
            return NOTHING
        scale = np.array([c.fx, c.fy]) * self._side
        size = (high - low) * scale + 2
        # A wide lens would need an endless ideal picture: it is made coarser instead.
        scale = scale * min(
            1.0, *(MAX_SIDE_PX / size), np.sqrt(MAX_AREA_PX / size.prod())
        )
        width, height = np.minimum(
            np.ceil((high - low) * scale).astype(int) + 2, MAX_SIDE_PX
        )
        centre = np.array([c.cx, c.cy]) * self._side
        # The texels' grid is fixed to the picture, not to the rectangle.
        return Picture(
            scale, centre - np.floor(low * scale + centre), int(width), int(height)
        )


def _on_gl_thread(work: Callable[..., T], *args: Any) -> T:
    """work(*args) on the OpenGL thread. Raises RenderError with what the driver said."""
    from OpenGL.error import Error

    try:
        return on_gl_thread(work, *args)
    except Error as e:
        raise RenderError(
            f"OpenGL failed: {e!r}",
            "the rays back end needs no OpenGL: --set raster.backend=rays",
        ) from e
