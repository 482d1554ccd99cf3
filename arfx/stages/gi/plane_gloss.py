"""The object mirrored in a glossy real plane: one cone about the mirrored line of sight, only where it can meet the object.

What the plane mirrors without the object is in the picture already; what the object sends takes its place, so the change is
F x (object - (1 - left) x what is behind it), as a share of the pixel. F as for the object's own gloss.
Source: docs/methods/gi.md#delta. Cost: O(pixels of the mirror image x
steps). Leaves out: highlights of the lamps, and their shadow in the mirror image's place.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.stages.gi.cones import Bricks, trace
from arfx.stages.gi.plane_pixels import agrees
from arfx.stages.gi.split_sum import gloss_weights
from arfx.stages.gi.surroundings import Behind, Planes, behind, first_plane

_FAST = {"contract", "nsz", "arcp"}
BLUR = 0.6  # a rough plane's mirror image is wider by this share of the object's height, times the lobe's tangent
SHARPEST = 0.2  # roughness of the narrowest cone: a narrower one would show the voxels themselves


class Gloss(NamedTuple):
    """Of the planes. f0, roughness;  table : `split_sum`;  walk, tangent : of the mirror cone
    least : share mirrored under which nothing shows"""

    f0: np.float32
    roughness: np.float32
    table: np.ndarray
    walk: np.ndarray
    tangent: np.float32
    least: np.float32


def mirror_rect(scene: Scene, planes: Planes, tangent: float, pose: Pose, frame: Rect) -> Rect:
    """Pixels in which the planes can mirror the object; the whole frame where its image reaches behind the camera.

    tangent : of the lobe's half-angle, by which a rough plane widens the image
    """
    corners = scene.world_from_anchor.inverse().apply(scene.model_corners_m)
    eye = scene.world_from_anchor.inverse().apply(pose.inverse().translation_m)
    camera_from_anchor = pose @ scene.world_from_anchor
    out = EMPTY
    for axes in planes.axes.astype(float):
        normal = axes[3]
        height = (corners - axes[0]) @ normal
        if (eye - axes[0]) @ normal <= 0 or height.max() <= 0:
            continue
        mirrored = corners - 2 * np.clip(height, 0, None)[:, None] * normal
        reach = BLUR * tangent * float(height.max())
        spread = np.concatenate([mirrored + s * reach * a for s in (-1, 1) for a in (axes[1], axes[2])])
        placed = camera_from_anchor.apply(spread)
        if placed[:, 2].min() <= 1e-3:
            return frame
        seen = scene.camera.project(placed)
        if not np.isfinite(seen).all():
            return frame
        out = out.union(Rect.around(seen, 2.0))
    return out.clip(frame)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def mirror_in_planes(
    plate, directions, origin, bias, gloss: Gloss, bricks: Bricks, low, size, back: Behind, real
):  # fmt: skip  # pragma: no cover - compiled
    """(h, w, 3) float32: radiance that the planes' mirror image of the object adds to the picture, or takes from it.

    plate (h, w, 3) : of the picture;  directions (h, w, 3) : viewing, z = 1, and origin (3,) : the camera, both anchor axes
    low (3,), size : corner and side of the voxels, metres;  real : as `add_delta`
    """
    axes, tangent = back.axes, gloss.tangent
    rows, columns = plate.shape[:2]
    out = np.zeros((rows, columns, 3), np.float32)
    zero, one = np.float32(0), np.float32(1)
    half_deg = np.float32(np.arctan(tangent) * np.float32(57.29578))
    for i in range(rows):
        for j in range(columns):
            dx, dy, dz = directions[i, j, 0], directions[i, j, 1], directions[i, j, 2]
            p, t = first_plane(axes, origin[0], origin[1], origin[2], dx, dy, dz)
            if p < 0 or not t > 0:
                continue
            share = agrees(real, i, j, t)
            if share <= 0:
                continue
            px, py, pz = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
            nx, ny, nz = axes[p, 3, 0], axes[p, 3, 1], axes[p, 3, 2]
            s = one / np.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx * s, dy * s, dz * s
            along = dx * nx + dy * ny + dz * nz
            ga, gb = gloss_weights(gloss.table, gloss.roughness, -along)
            f = (gloss.f0 * ga + gb) * share
            if f < gloss.least:
                continue
            d = dx - 2 * along * nx, dy - 2 * along * ny, dz - 2 * along * nz
            at = (px - low[0]) / size, (py - low[1]) / size, (pz - low[2]) / size
            r, g, b, left = trace(bricks, gloss.walk, at, d, at, (zero, zero, zero), False)
            if left >= one:
                continue
            er, eg, eb = behind(back, p, (px, py, pz), d, tangent, half_deg)
            out[i, j, 0] = f * (r - (one - left) * er)
            out[i, j, 1] = f * (g - (one - left) * eg)
            out[i, j, 2] = f * (b - (one - left) * eb)
            for c in range(3):  # the picture cannot lose more than it shows
                out[i, j, c] = max(out[i, j, c], min(bias[c] - plate[i, j, c], zero))
    return out
