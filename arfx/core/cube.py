"""The layout of a cube map: faces +x, -x, +y, -y, +z, -z, each (size, size)."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy import ndarray

from arfx.core.codec import Document
from arfx.core.numerics import divide, normalise


@lru_cache(maxsize=4)
def face_directions(size: int) -> ndarray:
    """(6, size, size, 3) unit directions of the texels' centres.
    A face's rows and columns run along the other two axes, the last of them towards -z on
    the sides: with camera axes (x right, y down, z forward) a picture lies upright on
    +z."""
    out = normalise(on_faces((np.arange(size) + 0.5) / size * 2 - 1))
    out.setflags(write=False)
    return out


def on_faces(t: ndarray) -> ndarray:
    """(6, n, n, 3) places on the planes of the faces, at t (n,) along rows and columns; a
    face ends at -1 and 1.
    """
    v, u = np.meshgrid(t, t, indexing="ij")
    one = np.ones_like(u)
    faces = [
        (one, v, -u),
        (-one, v, -u),
        (u, one, -v),
        (u, -one, -v),
        (u, v, one),
        (u, v, -one),
    ]
    return np.stack([np.stack(f, -1) for f in faces])


@lru_cache(maxsize=4)
def solid_angles(size: int) -> ndarray:
    """(size, size) steradians of a face's texels; six faces make 4 pi exactly."""
    t = np.arange(size + 1) / size * 2 - 1
    v, u = np.meshgrid(t, t, indexing="ij")
    corner = np.arctan2(u * v, np.sqrt(u * u + v * v + 1))
    out: ndarray = (
        corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]
    )
    out.setflags(write=False)
    return out


def on_cube(directions: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """(face (n,), u, v (n,) in -1..1, along columns and rows) of directions (n, 3) of any
    length.
    """
    axis = np.abs(directions).argmax(1)
    major = np.take_along_axis(directions, axis[:, None], 1)[:, 0]
    x, y, z = divide(directions, np.abs(major)[:, None]).T
    # rows and columns of faces +-x are y, -z; of +-y x, -z; of +-z x, y
    return (
        2 * axis + (major < 0),
        np.choose(axis, [-z, x, x]),
        np.choose(axis, [y, -z, y]),
    )


def look_up(faces: ndarray, directions: ndarray) -> ndarray:
    """(n, c) values in directions (n, 3), axes of the cube (6, size, size, c): linear
    between the texels of a face, the outermost beyond them.
    """
    n = faces.shape[1]
    face, *across = on_cube(np.asarray(directions, float))
    place = np.clip((np.stack(across) + 1) / 2 * n - 0.5, 0, n - 1)
    low = place.astype(np.intp)
    (x, y), (right, below) = low, np.minimum(low + 1, n - 1)
    u, v = (place - low)[..., None]
    return (
        (1 - v) * (1 - u) * faces[face, y, x]
        + (1 - v) * u * faces[face, y, right]
        + v * (1 - u) * faces[face, below, x]
        + v * u * faces[face, below, right]
    )


def bordered(faces: ndarray) -> ndarray:
    """(6, n + 2, n + 2, c) of a cube (6, n, n, c): each face with a texel of its neighbours
    all around.
    """
    n = faces.shape[1]
    out = np.pad(faces, ((0, 0), (1, 1), (1, 1), (0, 0)))
    around = np.ones(out.shape[:3], bool)
    around[:, 1:-1, 1:-1] = False
    places = on_faces((np.arange(-1, n + 1) + 0.5) / n * 2 - 1)
    out[around] = look_up(faces, places[around])
    return out


def resampled(faces: ndarray, size: int) -> ndarray:
    """(6, size, size, c) of a cube (6, n, n, c) with fewer texels: linear between them,
    over the edges too.
    """
    n = faces.shape[1]
    if n == size:
        return faces
    x = ((np.arange(size) + 0.5) / size * n + 0.5)[:, None] - np.arange(n + 2)
    share = np.clip(1 - np.abs(x), 0, None).astype(faces.dtype)
    return np.moveaxis(share @ np.moveaxis(bordered(faces), 3, 1) @ share.T, 1, 3)


@lru_cache(maxsize=2)
def _nearby(size: int, reach_deg: float) -> ndarray:
    """(texels, texels) weights of `spread`; rows sum to 1."""
    d = face_directions(size).reshape(-1, 3)
    angle = np.degrees(np.arccos(np.clip(d @ d.T, -1, 1)))
    weight = np.exp(-angle / reach_deg) * np.tile(solid_angles(size).ravel(), 6)
    return np.asarray((weight / weight.sum(1, keepdims=True)).astype(np.float32))


def spread(faces: ndarray, reach_deg: float) -> ndarray:
    """(6, n, n, c) float32 of a cube: each texel the mean of all, whose weight falls to 1 /
    e within an angle. n <= 16: its cost is O(n^4)"""
    return (
        _nearby(faces.shape[1], reach_deg)
        @ faces.reshape(-1, faces.shape[-1]).astype(np.float32)
    ).reshape(faces.shape)


@dataclass(frozen=True, slots=True)
class SeenEnvironment(Document):
    """What the clip saw of the surroundings about one frame, between two of the scene's
    `environment_maps`.
    maps : their names;  share : weight of the second, 0..1
    axes : nine numbers, row by row, of the rotation to the maps' axes from the world's;
    None = they are the world's
    """

    maps: tuple[str, str]
    share: float
    axes: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class CubeMap(Document):
    """A cube of radiance, as facts hold one. size : texels along a face's side;  data :
    text of float16, see `faces`
    axes : nine numbers, row by row, of the rotation to the cube's axes from the world's;
    None = they are the world's
    plane_rgb : radiance of the anchor's plane as seen, where the cube is a guess: what is
    next to its horizon agrees with it
    """

    size: int
    data: str
    axes: tuple[float, ...] | None = None
    plane_rgb: tuple[float, ...] | None = None

    @staticmethod
    def of(
        faces: ndarray,
        axes: ndarray | None = None,
        plane_rgb: ndarray | None = None,
    ) -> CubeMap:
        """faces : (6, n, n, 3), clipped to +-6e4;  axes : (3, 3);  plane_rgb : (3,)"""
        data = base64.b64encode(
            np.clip(faces, -6e4, 6e4).astype("<f2").tobytes()
        ).decode()  # float16 ends at 65504
        rows = (
            None if a is None else tuple(np.asarray(a, float).ravel().tolist())
            for a in (axes, plane_rgb)
        )
        return CubeMap(faces.shape[1], data, *rows)

    def faces(self) -> ndarray:
        """(6, n, n, 3) float16"""
        return np.frombuffer(base64.b64decode(self.data), "<f2").reshape(
            6, self.size, self.size, 3
        )
