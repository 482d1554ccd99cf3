"""The layout of a cube map: faces +x, -x, +y, -y, +z, -z, each (size, size)."""

from __future__ import annotations

import base64
from functools import lru_cache
from typing import Any

import numpy as np

from arfx.core.numerics import normalise

_MOST = 6e4  # float16 ends at 65504


@lru_cache(maxsize=4)
def face_directions(size: int) -> np.ndarray:
    """(6, size, size, 3) unit directions of the texels' centres.

    A face's rows and columns run along the other two axes, the last of them towards -z on the sides: with camera axes
    (x right, y down, z forward) a picture lies upright on +z.
    """
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


def packed(faces: np.ndarray) -> dict[str, Any]:
    """A cube (6, n, n, 3) as facts hold it: {"size": n, "faces": base64 of float16}, values within +-_MOST."""
    half = np.clip(faces, -_MOST, _MOST).astype("<f2")
    return {"size": int(faces.shape[1]), "faces": base64.b64encode(half.tobytes()).decode("ascii")}


def unpacked(told: dict[str, Any]) -> np.ndarray:
    """(6, n, n, 3) float16. Raises KeyError, TypeError or ValueError for anything that `packed` does not make."""
    n = int(told["size"])
    return np.frombuffer(base64.b64decode(told["faces"]), "<f2").reshape(6, n, n, 3)
