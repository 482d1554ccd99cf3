"""Step 3 of Yao, Tao, Wu 2018: an environment cube out of the one picture, and how step 4 reads it.

The picture in thirds: its left and right parts on -x and +x, upper and lower on -y and +y, the
middle in front and, mirrored, behind. Axes are the camera's (x right, y down, z forward), so the
paper's -z is +z here. RGBA16, with mip levels, linear over the cube's edges as graphics cards read
it; what lies to both sides of an edge is as the picture was cut.

Its errors: docs/methods/gi.md#errata."""

from functools import lru_cache

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.light.surroundings import SIZE, foldable
from arfx.core.cube import look_up, on_cube, on_faces

FACE_PX = 128
FULL = 65535  # of 16 bits
OVER = 1e-6  # of half a face


def step3_environment(image: ndarray, size: int = SIZE) -> ndarray:
    """(6, size, size, 3) radiance as of `surroundings.cube_from_picture`: the picture in
    thirds, its middle the front and, mirrored, the back, the parts beside the middle the sides.
    There is a seam where those meet the back."""
    picture = foldable(image)
    ys, xs = (np.linspace(0, n, 4).round().astype(int) for n in picture.shape[:2])

    def third(row: int, column: int) -> ndarray:
        part = picture[ys[row] : ys[row + 1], xs[column] : xs[column + 1]]
        return cv2.resize(part, (size, size), interpolation=cv2.INTER_AREA)

    # a side's first line is the one that touches the front
    left = third(1, 0)[:, ::-1]
    up = third(0, 1)[::-1]
    front = third(1, 1)
    return np.stack([third(1, 2), left, third(2, 1), up, front, front])


def step3_mipmap(cube: ndarray) -> list[ndarray]:
    """RGBA16 (6, n + 2, n + 2, 4) uint16 of every level, each face with a border of its neighbours'
    texels.

    cube (6, n, n, 3) : radiance, n a power of two; what is brighter than 1 is cut"""
    levels = [np.clip(np.concatenate([cube, np.ones_like(cube[..., :1])], -1), 0, 1)]
    while (n := levels[-1].shape[1] // 2) > 0:
        levels.append(levels[-1].reshape(6, n, 2, n, 2, 4).mean((2, 4)))
    return [np.rint(with_border(level) * FULL).astype(np.uint16) for level in levels]


def with_border(faces: ndarray) -> ndarray:
    """(6, n + 2, n + 2, c) of faces (6, n, n, c): the texels next to them over the edge."""
    n = faces.shape[1]
    out = look_up(faces, bordered_directions(n)).reshape(6, n + 2, n + 2, -1)
    # at a corner three faces meet
    ends = slice(None, None, n + 1)
    inner = slice(1, -1, max(n - 1, 1))
    others = out[:, inner, inner] + out[:, ends, inner] + out[:, inner, ends]
    out[:, ends, ends] = others / 3
    return out


@lru_cache(maxsize=8)
def bordered_directions(n: int) -> ndarray:
    """(6 (n + 2)^2, 3) of the texels' centres, as `face_directions`, and of places just over the
    edge beside them."""
    t = np.clip((np.arange(-1, n + 1) + 0.5) / n * 2 - 1, -1 - OVER, 1 + OVER)
    return on_faces(t).reshape(-1, 3)


def mip_level(half_angle_deg: float, size: int = FACE_PX) -> float:
    """1/2 log2(Omega_cone / Omega_texel) of a cube with faces of size^2 texels; 0 for what is
    narrower than a texel."""
    cone = 2 * np.pi * (1 - np.cos(np.radians(half_angle_deg)))
    return max(0.5 * float(np.log2(cone / (4 * np.pi / (6 * size**2)))), 0.0)


def step4_environment(
    mipmap: list[ndarray], directions: ndarray, half_angle_deg: float
) -> ndarray:
    """(n, 3) radiance about the middles of cones (n, 3), camera axes, by their aperture."""
    from scipy.ndimage import map_coordinates

    level = min(mip_level(half_angle_deg, mipmap[0].shape[1] - 2), len(mipmap) - 1)
    below = min(int(level), len(mipmap) - 2)
    face, u, v = on_cube(directions)
    out = np.zeros((len(directions), 3))
    for k, share in ((below, below + 1 - level), (below + 1, level - below)):
        row, column = ((t + 1) / 2 * (mipmap[k].shape[1] - 2) + 0.5 for t in (v, u))
        for c in range(3):
            channel = mipmap[k][..., c]
            places = (face, row, column)
            out[:, c] += (
                share / FULL * map_coordinates(channel, places, float, order=1)
            )
    return out
