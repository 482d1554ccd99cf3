"""Real shadow on the plane: where a light is known to be blocked already, the object's shadow must not take it again."""

from __future__ import annotations

import numpy as np

from arfx.core.facts import PlaneShadow
from arfx.core.numerics import divide
from arfx.errors import RenderError
from arfx.stages.lightmap.plane import PlaneTexture


def blocked_texture(shadow: PlaneShadow, ambient_share: np.ndarray) -> PlaneTexture:
    """Share of the directional light that is taken already: (1 - ratio) / (1 - ambient share), 0..1.

    ambient_share (3,). With it the object's shadow is what it takes of the light that is there:
    ratio = (ambient x V + direct x left x V_l) / (ambient + direct x left), so that the result is never darker than the
    ambient light alone with the object in it, however dark the plate is.
    """
    (x0, y0, x1, y1), ratio = shadow.box_m, np.array(shadow.ratio)
    if ratio.ndim != 2 or not ratio.size or not np.isfinite(ratio).all() or not (x1 > x0 and y1 > y0):
        raise RenderError("facts: the real shadow on the plane needs a box with an extent and a grid of finite numbers")
    taken = np.clip(divide(1 - ratio, 1 - float(ambient_share.mean())), 0, 1)
    rows, columns = taken.shape
    padded = np.zeros((rows + 2, columns + 2), np.float32)
    padded[1:-1, 1:-1] = taken
    sx, sy = columns / (x1 - x0), rows / (y1 - y0)
    return PlaneTexture(padded, np.array([[sx, 0, 0.5 - x0 * sx], [0, sy, 0.5 - y0 * sy]]))
