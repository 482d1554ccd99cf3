"""Textures of a real plane, looked up where each pixel's viewing ray meets it.

The lens is followed by viewing directions as `viewing.direction_grid` has them. Cost: O(pixels)
for each texture."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.core.compiled import FAST, kernel
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.vectors import vector
from arfx.stages.viewing import between_nodes

_F = np.float32
_LEAST_LIGHT = _F(1e-6)  # share of a plane's light under which it counts as none


@dataclass(frozen=True, eq=False)
class PlaneTexture:
    """A picture of a plane.

    dark ([c,] rows, columns) : float32, 0 along the border: so is everything outside
    texel_from_m (2, 3) : column and row from plane coordinates (x, y, 1), metres"""

    dark: np.ndarray
    texel_from_m: np.ndarray


class PlaneView:
    """The pixels of a rectangle as they see a plane.

    grid : viewing directions of the camera, as `direction_grid` makes them
    plane_from_camera : pose whose z axis is the plane's normal"""

    def __init__(self, rect: Rect, grid: np.ndarray, plane_from_camera: Pose) -> None:
        turned = (grid @ plane_from_camera.rotation.T).astype(np.float32)
        self.rect, self._eye = rect, plane_from_camera.translation_m
        self._directions = between_nodes(turned, rect)

    def add(
        self,
        out: np.ndarray,
        texture: PlaneTexture,
        weights: np.ndarray,
        share: np.ndarray | None = None,
    ) -> None:
        """out (c, h, w) float32 += weights (c,) x the texture x share (h, w), None = 1.

        texture : of c channels, or one for all
        """
        linear, offset = texture.texel_from_m[:, :2], texture.texel_from_m[:, 2]
        start = *(linear @ self._eye[:2] + offset), self._eye[2]
        ray = np.array(start, np.float32), np.ascontiguousarray(linear, np.float32)
        seen = np.zeros((0, 0), np.float32) if share is None else share
        weights = np.asarray(weights, np.float32)
        texels = texture.dark.reshape(-1, *texture.dark.shape[-2:])
        _add_texture(out, self._directions, *ray, texels, weights, seen)


def shadow_ratio(
    view: PlaneView,
    soft: Sequence[PlaneTexture],
    lamps: Sequence[PlaneTexture],
    weights: np.ndarray,
    ambient: np.ndarray,
    blocked: PlaneTexture | None,
    faint: float,
    strength: float,
) -> np.ndarray:
    """(h, w, 3) float32 ratio of the light that the object leaves the plane; 1 where it leaves all.

    soft, lamps : what is taken of their light;  weights (t, 3) : of each, its part of the
    plane's light
    ambient (3,) : the soft light's part;  blocked : share of every lamp's light that
    something real takes already
    faint : darkening under it is left out, over 3 times as much kept whole, faded between
    strength : 0..1"""
    height, width = view.rect.height, view.rect.width
    grey = bool((weights == weights[:, :1]).all() and (ambient == ambient[0]).all())
    channels = 1 if grey else 3  # a tenth of the time: most light is soft alone
    taken = np.zeros((channels, height, width), np.float32)
    lamps_left = None
    if blocked is not None:
        lamps_left = np.ones((1, height, width), np.float32)
        view.add(lamps_left, blocked, np.array([-1.0]))
    for k, texture in enumerate((*soft, *lamps)):
        reaches = None if lamps_left is None or k < len(soft) else lamps_left[0]
        view.add(taken, texture, weights[k, :channels], reaches)
    if lamps_left is not None:  # what is there already is less than the whole light
        part = ambient[:channels].astype(np.float32)[:, None, None]
        taken /= np.maximum(part + (1 - part) * lamps_left, _LEAST_LIGHT)
    ratio = np.empty((height, width, 3), np.float32)
    rise = _F(0.5 / max(faint, 1e-6))
    _write_ratio(ratio, taken, _F(faint), rise, _F(strength))
    return ratio


@kernel(fastmath=FAST, error_model="numpy")
def _add_texture(
    out, directions, start, linear, texture, weights, share
):  # pragma: no cover - compiled
    """Rows of `PlaneView.add`.

    directions (h, w, 3) : of the pixels;  start (3,) : column, row and height of their eye
    linear (2, 2) : columns and rows per metre;  texture (c or 1, rows, columns)
    """
    channels, height, width = out.shape
    layers, rows, columns = texture.shape
    zero, one = _F(0), np.uintp(1)
    last_u, last_v = _F(columns - 1.01), _F(rows - 1.01)
    for j in range(height):
        for i in range(width):
            dx, dy, dz = vector(directions[j, i])
            distance = start[2] / -dz
            u = start[0] + distance * (linear[0, 0] * dx + linear[0, 1] * dy)
            v = start[1] + distance * (linear[1, 0] * dx + linear[1, 1] * dy)
            if not (dz < zero and zero < u < last_u and zero < v < last_v):
                continue
            column, row = np.int32(u), np.int32(v)
            across, down = u - _F(column), v - _F(row)
            a, b = np.uintp(column), np.uintp(row)
            value = zero
            for c in range(channels):
                if c < layers:
                    above, below = texture[c, b], texture[c, b + one]
                    top = above[a] + across * (above[a + one] - above[a])
                    bottom = below[a] + across * (below[a + one] - below[a])
                    value = top + down * (bottom - top)
                    if share.shape[0] > 0:
                        value *= share[j, i]
                out[c, j, i] += weights[c] * value


@kernel(fastmath=FAST, error_model="numpy")
def _write_ratio(out, taken, faint, rise, strength):  # pragma: no cover - compiled
    """out (h, w, 3) : 1 - `taken` (c, h, w), faded in above `faint` by the channel that
    loses most.
    """
    channels, height, width = taken.shape
    zero, one, three = _F(0), _F(1), _F(3)
    shown = np.empty(width, np.float32)
    for j in range(height):
        r, g, b = taken[0, j], taken[channels // 2, j], taken[channels - 1, j]
        for i in range(width):
            t = min(max((max(max(r[i], g[i]), b[i]) - faint) * rise, zero), one)
            shown[i] = strength * t * t * (three - t - t)
        for i in range(width):
            out[j, i, 0] = one - min(shown[i] * r[i], one)
            out[j, i, 1] = one - min(shown[i] * g[i], one)
            out[j, i, 2] = one - min(shown[i] * b[i], one)
