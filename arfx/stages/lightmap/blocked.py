"""Real shadow on the plane: where a light is known to be blocked already, the object's shadow must not take it again.

The analysis may put `already_blocked` into `FrameFacts.extra`, a picture of the anchor's plane:
    {"box_m": [x0, y0, x1, y1], "ratio": [[...], ...]}
box_m : metres, anchor axes;  ratio : rows from y0 up, columns from x0: plate over what the frame's light gives the same
surface without anything in the way, both without the camera's bias, as measured where the surface is known (the white of
the marker). 1 = lit; the ambient share of the light = all directional light blocked. Outside the box nothing is known: lit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from arfx.core.numerics import divide
from arfx.errors import RenderError
from arfx.stages.lightmap.plane import PlaneTexture

KEY = "already_blocked"


def blocked_texture(extra: dict[str, Any], ambient_share: np.ndarray) -> PlaneTexture | None:
    """Share of the directional light that is taken already: (1 - ratio) / (1 - ambient share), 0..1. None where not told.

    ambient_share (3,). With it the object's shadow is what it takes of the light that is there:
    ratio = (ambient x V + direct x left x V_l) / (ambient + direct x left), so that the result is never darker than the
    ambient light alone with the object in it, however dark the plate is.
    """
    told = extra.get(KEY)
    if told is None:
        return None
    try:
        x0, y0, x1, y1 = (float(v) for v in told["box_m"])
        ratio = np.array(told["ratio"], float)
    except (KeyError, TypeError, ValueError) as e:
        raise RenderError(f"facts: extra.{KEY} is not understood: {e!r}") from None
    if ratio.ndim != 2 or not ratio.size or not np.isfinite(ratio).all() or not (x1 > x0 and y1 > y0):
        raise RenderError(f"facts: extra.{KEY} needs a box with an extent and a grid of finite numbers")
    taken = np.clip(divide(1 - ratio, 1 - float(ambient_share.mean())), 0, 1)
    rows, columns = taken.shape
    padded = np.zeros((rows + 2, columns + 2), np.float32)
    padded[1:-1, 1:-1] = taken
    sx, sy = columns / (x1 - x0), rows / (y1 - y0)
    return PlaneTexture(padded, np.array([[sx, 0, 0.5 - x0 * sx], [0, sy, 0.5 - y0 * sy]]))
