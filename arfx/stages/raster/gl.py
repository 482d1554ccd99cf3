"""Which faces a camera sees, by OpenGL: a picture of face numbers, looked up along directions.

The picture is an ideal camera's, over the rectangle only, k x k texels a pixel whose middle
one lies on the pixel's centre; a direction takes the texel next to it (Burns and Hunt 2013,
"The visibility buffer"). With lens distortion the picture is made as wide as the rectangle
needs. The near plane stands at 9/10 of the nearest vertex, at least NEAR_M; what is nearer
is cut away. Any thread may ask, several at once too: drawing alone waits for the OpenGL
thread (gl_draw.py)."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np

from arfx.core.camera import Camera
from arfx.core.rect import Rect
from arfx.core.scene_mesh import SceneMesh
from arfx.errors import RenderError
from arfx.stages.raster.gl_context import discard, on_gl_thread, open_context
from arfx.stages.raster.gl_draw import Drawing
from arfx.stages.raster.record import View
from arfx.stages.raster.visible import depths_along

NEAR_M = 1e-3
# Well below the 16384 of Mesa's drivers, beyond which every later draw fails too.
MAX_SIDE_PX = 8192
MAX_AREA_PX = 24_000_000
T = TypeVar("T")


class Picture(NamedTuple):
    """scale, shift : (2,) a direction's place is direction * scale + shift, in texels
    width, height : texels"""

    scale: np.ndarray
    shift: np.ndarray
    width: int
    height: int


class GlFaces:
    """Faces of one mesh seen by one camera. samples : of a pixel, rounded to an odd square k x k.

    Raises RenderError where no OpenGL context opens."""

    any_rectangle = False  # the driver's fixed-point edges depend on the viewport's corner

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

    def frame(self, view: View, rect: Rect) -> GlFrame:
        """Raises RenderError where the driver refuses."""
        depths = view.points[:, 2]
        near, far = max(0.9 * float(depths.min()), NEAR_M), 1.1 * float(depths.max())
        picture = self._picture(view)
        if far <= near or picture is None:
            return GlFrame(
                self._mesh, view, Picture(np.ones(2), np.zeros(2), 0, 0), np.zeros(0)
            )
        middle = picture.shift + 0.5
        ideal = self.context.pyrender.IntrinsicsCamera(*picture.scale, *middle, near, far)
        projection = ideal.get_projection_matrix(picture.width, picture.height)
        to_gl = np.diag([1.0, -1, -1, 1])
        camera_from_mesh = np.eye(4)
        camera_from_mesh[:3, :3] = view.rotation
        camera_from_mesh[:3, 3] = view.points[0] - view.rotation @ self._mesh.vertices[0]
        size = picture.width, picture.height
        numbers = _on_gl_thread(self.drawing, to_gl @ camera_from_mesh, projection, *size)
        return GlFrame(self._mesh, view, picture, numbers)

    def _picture(self, view: View) -> Picture | None:
        """The ideal camera's; None where no direction is known."""
        c = self._camera
        if np.isnan(view.x).all():
            return None
        low = np.array([np.nanmin(view.x), np.nanmin(view.y)])
        high = np.array([np.nanmax(view.x), np.nanmax(view.y)])
        scale = np.array([c.fx, c.fy]) * self._side
        size = (high - low) * scale + 2
        # A wide lens would need an endless ideal picture: it is made coarser instead.
        scale = scale * min(1.0, *(MAX_SIDE_PX / size), np.sqrt(MAX_AREA_PX / size.prod()))
        width, height = np.minimum(
            np.ceil((high - low) * scale).astype(int) + 2, MAX_SIDE_PX
        )
        centre = np.array([c.cx, c.cy]) * self._side
        # The texels' grid is fixed to the picture, not to the rectangle.
        return Picture(
            scale, centre - np.floor(low * scale + centre), int(width), int(height)
        )


class GlFrame:
    """One frame of GlFaces. numbers : (texels,) int32, of faces, -1 = none, bottom row first"""

    def __init__(
        self, mesh: SceneMesh, view: View, picture: Picture, numbers: np.ndarray
    ) -> None:
        self._mesh, self._view, self._picture, self._numbers = mesh, view, picture, numbers

    def centres(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As of FacesOfFrame."""
        return self._along(x, y)

    def samples(
        self, shape: tuple[int, int], pixels: np.ndarray, x: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As of FacesOfFrame."""
        return self._along(x, y)

    def _along(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale, shift, width, height = self._picture
        with np.errstate(invalid="ignore"):
            column = np.floor(x * scale[0] + shift[0] + 0.5)
            row = np.floor(y * scale[1] + shift[1] + 0.5)
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        face = np.full(x.shape, -1, np.int32)
        texel = (height - 1 - row[inside]) * width + column[inside]
        face[inside] = self._numbers[texel.astype(np.int64)]
        depth = depths_along(
            self._view.points, self._mesh.faces, face.ravel(), x.ravel(), y.ravel()
        )
        return face, depth.reshape(x.shape)


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
