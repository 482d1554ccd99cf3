"""The paper's light map M(n) itself, per pixel: I(v) = g rho_v M(n_v) + b, eq. (3), where the analysis wrote one.

`FrameFacts.light_map` holds what M has beside its lights' own cosine lobes, so that lights which the object takes from itself
can be left out of M.
Source: Tan, Chen, Sun 2009, eq. (3), (7); docs/methods/light.md#idea.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.cube import CubeMap
from arfx.errors import RenderError

_NONE = np.zeros((6, 0, 0, 3), np.float32), np.eye(3, dtype=np.float32)


def printed_map(found: CubeMap | None) -> tuple[np.ndarray, np.ndarray]:
    """(cube (6, n, n, 3) float32, map_from_world (3, 3)); n is 0 where no map was written."""
    if found is None:
        return _NONE
    faces, axes = found.faces(), np.eye(3) if found.axes is None else np.array(found.axes).reshape(3, 3)
    if faces.shape[1] < 2 or not np.isfinite(faces).all() or not np.isfinite(axes).all():
        raise RenderError("facts: the light map needs faces of finite numbers, 2 x 2 or more")
    return faces.astype(np.float32), axes.astype(np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_map(r, g, b, dr, dg, db, nx, ny, nz, cube, axes, n):  # pragma: no cover - compiled
    """r, g, b = diffuse albedo times the map for the first n pixels' normals, linear between the texels of a face."""
    size = cube.shape[1]
    half, last = np.float32(0.5), np.float32(size - 1)
    for i in range(n):
        x = axes[0, 0] * nx[i] + axes[0, 1] * ny[i] + axes[0, 2] * nz[i]
        y = axes[1, 0] * nx[i] + axes[1, 1] * ny[i] + axes[1, 2] * nz[i]
        z = axes[2, 0] * nx[i] + axes[2, 1] * ny[i] + axes[2, 2] * nz[i]
        ax, ay, az = abs(x), abs(y), abs(z)
        if ax >= ay and ax >= az:
            face, u, v, most = (0 if x >= 0 else 1), -z, y, ax
        elif ay >= az:
            face, u, v, most = (2 if y >= 0 else 3), x, -z, ay
        else:
            face, u, v, most = (4 if z >= 0 else 5), x, y, az
        scale = half * np.float32(size) / max(most, np.float32(1e-12))
        c = min(max(u * scale + half * last, np.float32(0)), last)
        d = min(max(v * scale + half * last, np.float32(0)), last)
        i0, j0 = min(int(c), size - 2), min(int(d), size - 2)
        fx, fy = c - np.float32(i0), d - np.float32(j0)
        for k in range(3):
            top = cube[face, j0, i0, k] + fx * (cube[face, j0, i0 + 1, k] - cube[face, j0, i0, k])
            low = cube[face, j0 + 1, i0, k] + fx * (cube[face, j0 + 1, i0 + 1, k] - cube[face, j0 + 1, i0, k])
            light = top + fy * (low - top)
            if k == 0:
                r[i] = dr[i] * light
            elif k == 1:
                g[i] = dg[i] * light
            else:
                b[i] = db[i] * light
