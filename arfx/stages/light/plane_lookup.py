"""Textures of a real plane, looked up where each pixel's viewing ray meets it.

The lens is followed by viewing directions at every GRID_PX-th pixel, linear between. Cost:
O(pixels) for each texture."""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, kernel
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.stages.viewing import GRID_PX

_F = np.float32
_LEAST_LIGHT = _F(1e-6)  # share of a plane's light under which it counts as none


@dataclass(frozen=True, eq=False)
class PlaneTexture:
    """A picture of a plane.

    dark ([c,] rows, columns) : float32, 0 along the border: so is everything outside
    texel_from_m (2, 3) : column and row from plane coordinates (x, y, 1), metres"""

    dark: ndarray
    texel_from_m: ndarray


class PlaneView:
    """The pixels of a rectangle as they see a plane.

    grid : viewing directions of the camera, as `direction_grid` makes them
    plane_from_camera : pose whose z axis is the plane's normal"""

    def __init__(self, rect: Rect, grid: ndarray, plane_from_camera: Pose) -> None:
        left, top = rect.x0 // GRID_PX, rect.y0 // GRID_PX
        right, bottom = (rect.x1 - 1) // GRID_PX + 2, (rect.y1 - 1) // GRID_PX + 2
        self.rect = rect
        self._corner = rect.x0 - left * GRID_PX, rect.y0 - top * GRID_PX
        near = grid[top:bottom, left:right]
        turned = near.reshape(-1, 3) @ plane_from_camera.rotation.T
        self._directions = np.ascontiguousarray(turned.T).reshape(3, *near.shape[:2])
        self._eye = plane_from_camera.translation_m

    def add(
        self,
        out: ndarray,
        texture: PlaneTexture,
        weights: ndarray,
        share: ndarray | None = None,
    ) -> None:
        """out (c, h, w) float32 += weights (c,) x the texture x share (h, w), None = 1.

        texture : of c channels, or one for all
        """
        linear, offset = texture.texel_from_m[:, :2], texture.texel_from_m[:, 2]
        across = np.tensordot(linear, self._directions[:2], 1)
        nodes = np.stack([*across, self._directions[2]]).astype(np.float32)
        start = np.array(
            [*(linear @ self._eye[:2] + offset), self._eye[2]], np.float32
        )
        seen = np.zeros((0, 0), np.float32) if share is None else share
        weights = np.asarray(weights, np.float32)
        texels = texture.dark.reshape(-1, *texture.dark.shape[-2:])
        _add_texture(out, self._corner, nodes, start, texels, weights, seen)


def shadow_ratio(
    view: PlaneView,
    soft: Sequence[PlaneTexture],
    lamps: Sequence[PlaneTexture],
    weights: ndarray,
    ambient: ndarray,
    blocked: PlaneTexture | None,
    faint: float,
    strength: float,
) -> ndarray:
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
    out, corner, nodes, start, texture, weights, share
):  # pragma: no cover - compiled
    """Rows of `PlaneView.add`.

    corner : the first pixel, from the first node;  texture (c or 1, rows, columns)
    nodes (3, gh, gw) : column and row by which a ray moves on, and its rise;  start (3,) : of all
    """
    channels, height, width = out.shape
    layers, rows, columns = texture.shape
    x0, y0 = corner
    cells = nodes.shape[2] - 1
    line = np.empty((3, cells + 1), np.float32)
    moved = np.empty((3, cells * GRID_PX), np.float32)
    zero, step, one = _F(0), _F(1.0 / GRID_PX), np.uintp(1)
    last_u, last_v = _F(columns - 1.01), _F(rows - 1.01)
    for j in range(height):
        cell_row, below_row = (y0 + j) // GRID_PX, _F((y0 + j) % GRID_PX) * step
        for k in range(3):
            above, below = nodes[k, cell_row], nodes[k, cell_row + 1]
            for i in range(cells + 1):
                line[k, i] = above[i] + below_row * (below[i] - above[i])
            for q in range(cells):
                first, left = np.uintp(q * GRID_PX), line[k, q]
                rise = line[k, q + 1] - left
                for i in range(GRID_PX):
                    moved[k, first + np.uintp(i)] = left + _F(i) * step * rise
        u, v, z = moved[0, x0 : x0 + width], moved[1, x0:], moved[2, x0:]
        for i in range(width):
            meets = z[i] < zero
            distance = start[2] / -z[i]
            column, row = start[0] + distance * u[i], start[1] + distance * v[i]
            u[i], v[i] = column if meets else zero, row if meets else zero
        for i in range(width):
            if not (zero < u[i] < last_u and zero < v[i] < last_v):
                continue
            column, row = np.int32(u[i]), np.int32(v[i])
            across, down = u[i] - _F(column), v[i] - _F(row)
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
