"""SHADOW of every pixel: where its viewing ray meets the plane, each light's picture of the plane is looked up there.

Cost: O(pixels x lights). The lens is followed by viewing directions at every GRID_PX-th pixel, linear between.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.stages.lightmap.plane import PlaneTexture
from arfx.stages.viewing import GRID_PX


def light_left(
    rect: Rect, grid: np.ndarray, anchor_from_camera: Pose, textures: Sequence[PlaneTexture], shares: np.ndarray,
    blocked: PlaneTexture | None, faint: float, strength: float,
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) float32 ratio of the light that the object leaves the plane; 1 where it leaves all. Read-only, and one value
    for three channels where every light has one.

    grid (gh, gw, 3) : float32 viewing directions as `direction_grid` makes them
    textures, shares (t, 3) : the ambient light first, then the directional ones; each one's part of the plane's light
    blocked : share of every directional light that something real takes already
    faint : darkening under it is left out, over 3 times as much kept whole, faded between;  strength : 0..1
    """
    extra = (blocked,) if blocked is not None else ()
    every = [*textures, *extra]
    sizes = np.array([[t.dark.size, *t.dark.shape] for t in every], np.int64)
    meta = np.column_stack([np.cumsum(sizes[:, 0]) - sizes[:, 0], sizes[:, 1:]])
    texels = every[0].dark.ravel() if len(every) == 1 else np.concatenate([t.dark.ravel() for t in every])
    grey = bool((shares == shares[:, :1]).all())
    nodes = grid.reshape(-1, 3) @ anchor_from_camera.rotation.T.astype(np.float32)
    left = _look_up(
        rect.x0, rect.y0, rect.width, rect.height, nodes.reshape(grid.shape),
        anchor_from_camera.translation_m.astype(np.float32), texels, meta,
        np.array([t.texel_from_m for t in every], np.float32), shares[:, : 1 if grey else 3].astype(np.float32),
        blocked is not None, np.float32(faint), np.float32(0.5 / max(faint, 1e-6)), np.float32(strength),
    )  # fmt: skip
    return np.broadcast_to(left, (rect.height, rect.width, 3))


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _look_up(
    x0, y0, width, height, nodes, origin, texels, meta, affine, shares, blocked, faint, rise, strength
):  # pragma: no cover - compiled
    """(h, w, c).  meta (t, 3) : offset into `texels`, rows, columns;  affine (t, 2, 3) texels from metres;  shares (t, c)"""
    channels = shares.shape[1]
    out = np.empty((height, width, channels), np.float32)
    zero, one = np.float32(0), np.float32(1)
    step, nowhere = np.float32(1.0 / GRID_PX), np.float32(1e9)
    g0, g1 = x0 // GRID_PX, (x0 + width - 1) // GRID_PX + 1
    span, lead = (g1 - g0) * GRID_PX, x0 - g0 * GRID_PX
    px, py = np.empty(span, np.float32), np.empty(span, np.float32)
    place, fu, fv = np.empty(width, np.int32), np.empty(width, np.float32), np.empty(width, np.float32)
    dark, open_ = np.empty(width, np.float32), np.empty(width, np.float32)
    taken = np.empty((channels, width), np.float32)
    count = shares.shape[0]
    for j in range(height):
        iy = (y0 + j) // GRID_PX
        fy = np.float32((y0 + j) % GRID_PX) * step
        for ix in range(g0, g1):
            # both ends of a run of GRID_PX pixels on this line
            ax = nodes[iy, ix, 0] + fy * (nodes[iy + 1, ix, 0] - nodes[iy, ix, 0])
            ay = nodes[iy, ix, 1] + fy * (nodes[iy + 1, ix, 1] - nodes[iy, ix, 1])
            az = nodes[iy, ix, 2] + fy * (nodes[iy + 1, ix, 2] - nodes[iy, ix, 2])
            bx = nodes[iy, ix + 1, 0] + fy * (nodes[iy + 1, ix + 1, 0] - nodes[iy, ix + 1, 0])
            by = nodes[iy, ix + 1, 1] + fy * (nodes[iy + 1, ix + 1, 1] - nodes[iy, ix + 1, 1])
            bz = nodes[iy, ix + 1, 2] + fy * (nodes[iy + 1, ix + 1, 2] - nodes[iy, ix + 1, 2])
            dx, dy, dz = (bx - ax) * step, (by - ay) * step, (bz - az) * step
            at = (ix - g0) * GRID_PX
            for i in range(GRID_PX):
                t = np.float32(i)
                vz = az + t * dz
                s = -origin[2] / vz
                # away from the plane, or no direction maps here: as far from every picture as can be
                px[at + i] = origin[0] + s * (ax + t * dx) if vz < 0 else nowhere
                py[at + i] = origin[1] + s * (ay + t * dy) if vz < 0 else nowhere
        taken[:] = zero
        open_[:] = one
        for m in range(meta.shape[0]):
            k = meta.shape[0] - 1 - m  # what is blocked comes last in the list and first here
            rows, columns = meta[k, 1], meta[k, 2]
            part = texels[meta[k, 0] : meta[k, 0] + rows * columns]
            last_u, last_v, across = np.float32(columns - 1.01), np.float32(rows - 1.01), np.int32(columns)
            ux, uy, u0 = affine[k, 0, 0], affine[k, 0, 1], affine[k, 0, 2]
            wx, wy, w0 = affine[k, 1, 0], affine[k, 1, 1], affine[k, 1, 2]
            # from the first to the last run of which not both ends lie beyond the same side of the picture
            i0, i1 = width, 0
            for q in range(0, span, GRID_PX):
                a, c = np.uintp(q), np.uintp(q + GRID_PX - 1)
                au, av = ux * px[a] + uy * py[a] + u0, wx * px[a] + wy * py[a] + w0
                cu, cv = ux * px[c] + uy * py[c] + u0, wx * px[c] + wy * py[c] + w0
                off = (max(au, cu) < zero) | (min(au, cu) > last_u) | (max(av, cv) < zero) | (min(av, cv) > last_v)
                if not off:
                    i0, i1 = min(i0, q - lead), q + GRID_PX - lead
            i0, i1 = max(i0, 0), min(i1, width)
            n = max(i1 - i0, 0)
            xs, ys = px[lead + i0 : lead + i1], py[lead + i0 : lead + i1]
            for i in range(n):
                u = min(max(ux * xs[i] + uy * ys[i] + u0, zero), last_u)
                v = min(max(wx * xs[i] + wy * ys[i] + w0, zero), last_v)
                iu, iv = np.int32(u), np.int32(v)
                fu[i], fv[i] = u - np.float32(iu), v - np.float32(iv)
                place[i] = iv * across + iu
            for i in range(n):
                a = np.uintp(place[i])
                c = np.uintp(place[i] + across)
                e = part[a] + fu[i] * (part[a + np.uintp(1)] - part[a])
                f = part[c] + fu[i] * (part[c + np.uintp(1)] - part[c])
                dark[i] = e + fv[i] * (f - e)
            seen = open_[i0:i1]
            if k == count:
                for i in range(n):
                    seen[i] = one - dark[i]
                continue
            if blocked and k > 0:
                for i in range(n):
                    dark[i] *= seen[i]
            for channel in range(channels):
                _add(taken[channel, i0:i1], dark, shares[k, channel])
        if blocked:  # what is there already is less than the whole light
            for channel in range(channels):
                ambient = shares[0, channel]
                for i in range(width):
                    taken[channel, i] /= max(ambient + (one - ambient) * open_[i], np.float32(1e-6))
        r, g, b = taken[0], taken[channels // 2], taken[channels - 1]
        for i in range(width):
            t = min(max((max(max(r[i], g[i]), b[i]) - faint) * rise, zero), one)
            dark[i] = strength * t * t * (np.float32(3) - t - t)
        if channels == 1:
            line = out[j].reshape(-1)
            for i in range(width):
                line[i] = one - min(dark[i] * r[i], one)
            continue
        for i in range(width):
            out[j, i, 0] = one - min(dark[i] * r[i], one)
            out[j, i, 1] = one - min(dark[i] * g[i], one)
            out[j, i, 2] = one - min(dark[i] * b[i], one)
    return out


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _add(out, dark, share):  # pragma: no cover - compiled
    for i in range(out.shape[0]):
        out[i] += share * dark[i]
