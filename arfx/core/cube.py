"""The layout of a cube map: faces +x, -x, +y, -y, +z, -z, each (size, size)."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from arfx.core.codec import Document
from arfx.core.numerics import divide, normalise


@lru_cache(maxsize=4)
def face_directions(size: int) -> np.ndarray:
    """(6, size, size, 3) unit directions of the texels' centres.
    A face's rows and columns run along the other two axes, the last of them towards -z on the sides: with camera axes
    (x right, y down, z forward) a picture lies upright on +z."""
    t = (np.arange(size) + 0.5) / size * 2 - 1
    v, u = np.meshgrid(t, t, indexing="ij")
    one = np.ones_like(u)
    faces = [(one, v, -u), (-one, v, -u), (u, one, -v), (u, -one, -v), (u, v, one), (u, v, -one)]
    out = normalise(np.stack([np.stack(f, -1) for f in faces]))
    out.setflags(write=False)
    return out


@lru_cache(maxsize=4)
def solid_angles(size: int) -> np.ndarray:
    """(size, size) steradians of a face's texels; six faces make 4 pi exactly."""
    t = np.arange(size + 1) / size * 2 - 1
    v, u = np.meshgrid(t, t, indexing="ij")
    corner = np.arctan2(u * v, np.sqrt(u * u + v * v + 1))
    out: np.ndarray = corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]
    out.setflags(write=False)
    return out


def on_cube(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(face (n,), u, v (n,) in -1..1, along columns and rows) of directions (n, 3) of any length."""
    axis = np.abs(directions).argmax(1)
    major = np.take_along_axis(directions, axis[:, None], 1)[:, 0]
    x, y, z = divide(directions, np.abs(major)[:, None]).T
    # rows and columns of faces +-x are y, -z; of +-y x, -z; of +-z x, y
    return 2 * axis + (major < 0), np.choose(axis, [-z, x, x]), np.choose(axis, [y, -z, y])


def look_up(faces: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n, 3) radiance in directions (n, 3), axes of the cube (6, size, size, 3): linear between the texels of a face."""
    last = faces.shape[1] - 1
    face, u, v = on_cube(np.asarray(directions, float))
    x, y = (np.clip((t + 1) / 2 * (last + 1) - 0.5, 0, last) for t in (u, v))
    i, j = np.minimum(x.astype(int), max(last - 1, 0)), np.minimum(y.astype(int), max(last - 1, 0))
    i1, j1 = np.minimum(i + 1, last), np.minimum(j + 1, last)
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    top = faces[face, j, i] * (1 - fx) + faces[face, j, i1] * fx
    return np.asarray(top * (1 - fy) + (faces[face, j1, i] * (1 - fx) + faces[face, j1, i1] * fx) * fy)


@dataclass(frozen=True)
class CubeMap(Document):
    """A cube of radiance, as facts hold one. size : texels along a face's side;  data : text of float16, see `faces`
    axes : nine numbers, row by row, of the rotation to the cube's axes from the world's; None = they are the world's
    plane_rgb : radiance of the anchor's plane as seen, where the cube is a guess: what is next to its horizon agrees with it"""

    size: int
    data: str
    axes: tuple[float, ...] | None = None
    plane_rgb: tuple[float, ...] | None = None

    @staticmethod
    def of(faces: np.ndarray, axes: np.ndarray | None = None, plane_rgb: np.ndarray | None = None) -> CubeMap:
        """faces : (6, n, n, 3), clipped to +-6e4;  axes : (3, 3);  plane_rgb : (3,)"""
        data = base64.b64encode(np.clip(faces, -6e4, 6e4).astype("<f2").tobytes()).decode()  # float16 ends at 65504
        rows = (None if a is None else tuple(np.asarray(a, float).ravel().tolist()) for a in (axes, plane_rgb))
        return CubeMap(faces.shape[1], data, *rows)

    def faces(self) -> np.ndarray:
        """(6, n, n, 3) float16"""
        return np.frombuffer(base64.b64decode(self.data), "<f2").reshape(6, self.size, self.size, 3)
