"""From samples along rays to pixels: compiled inner loops of the `rays` back end.

One row of `sums` gathers a sample's layers front to back: columns 0 transmittance, 1-3 albedo, 4-6 normal, 7 metallic,
8 roughness, 9 specular, 10-12 emissive."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.stages.raster.arrays import COLUMNS, GBuffer, Samples, Surfaces, View
from arfx.stages.raster.mesh import MODE, TWO_SIDED

# Transparency below half an 8-bit step of the opacity is none.
_CLEAR = 1.0 / 512.0


@numba.njit(cache=True, nogil=True)
def world_directions(inner, rotation):  # pragma: no cover - compiled
    """Directions (n * m, 3) float32 in world axes from those in the camera, (n, m, 2) x/z, y/z; camera z of each is 1. And
    which are valid."""
    n, m = inner.shape[:2]
    out = np.empty((n * m, 3), np.float32)
    valid = np.empty(n * m, np.bool_)
    for i in range(n):
        for j in range(m):
            k, x, y = i * m + j, inner[i, j, 0], inner[i, j, 1]
            valid[k] = np.isfinite(x) and np.isfinite(y)
            for c in range(3):
                out[k, c] = rotation[0, c] * x + rotation[1, c] * y + rotation[2, c]
    return out, valid


@numba.njit(cache=True, nogil=True)
def sample_directions(lens, pixels, width, offsets):  # pragma: no cover - compiled
    """Directions (k, s, 2) in the camera of `offsets` (s, 2) px around `pixels` (k,), from a table with one pixel of margin."""
    s = offsets.shape[0]
    inner = np.empty((pixels.shape[0], s, 2), np.float32)
    for a in range(pixels.shape[0]):
        i, j = pixels[a] // width + 1, pixels[a] % width + 1
        for b in range(s):
            dx, dy = offsets[b, 0], offsets[b, 1]
            x = lens[i, j, 0] + 0.5 * dx * (lens[i, j + 1, 0] - lens[i, j - 1, 0])
            x += 0.5 * dy * (lens[i + 1, j, 0] - lens[i - 1, j, 0])
            y = lens[i, j, 1] + 0.5 * dx * (lens[i, j + 1, 1] - lens[i, j - 1, 1])
            y += 0.5 * dy * (lens[i + 1, j, 1] - lens[i - 1, j, 1])
            inner[a, b, 0], inner[a, b, 1] = x, y
    return inner


@numba.njit(cache=True, nogil=True, error_model="numpy")
def accumulate(
    active, prim, z, values, directions, start, mesh: Surfaces, samples: Samples, masked, continuing
):  # pragma: no cover - compiled
    """Add one layer of hits to the samples `active`; returns how many rays go on, listed in `continuing`.

    z, values : depth and attributes of the hits;  start : (samples,) moved behind the hit where the ray goes on
    masked : (samples,) bool, set where a cut-out material is met"""
    part, face_normal, ints = mesh.part, mesh.face_normal, mesh.ints
    acc, depth, ident = samples
    count = 0
    for a in range(active.shape[0]):
        if prim[a] < 0:
            continue
        f, k = np.uintp(prim[a]), np.uintp(active[a])
        facing = (
            face_normal[f, 0] * directions[k, 0]
            + face_normal[f, 1] * directions[k, 1]
            + face_normal[f, 2] * directions[k, 2]
        )
        if facing > 0 and ints[part[f], TWO_SIDED] == 0:
            start[k] = z[a]
            continuing[count] = active[a]
            count += 1
            continue
        if ints[part[f], MODE] == 1:
            masked[k] = True
        if values[a, 0] > _CLEAR:
            w = acc[k, 0] * values[a, 0]
            acc[k, 0] -= w
            for c in range(1, COLUMNS):
                acc[k, c] += w * values[a, c]
            if ident[k] == 0:
                ident[k] = part[f] + 1
                depth[k] = z[a]
        if acc[k, 0] > _CLEAR:
            start[k] = z[a]
            continuing[count] = active[a]
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def write_pixel(
    y, x, acc, z, ident, direction, eye, sums, out: GBuffer
):  # pragma: no cover - compiled
    """Mean of a pixel's samples, acc (n, COLUMNS), over the covering ones. z, ident : its depth and number

    sums : (12,) scratch"""
    count = acc.shape[0]
    covered = np.float32(0)
    hits = 0
    for k in range(count):
        covered += np.float32(1) - acc[k, 0]
        if acc[k, 0] < 1:
            hits += 1
    if hits == 0:
        return
    out.coverage[y, x] = min(covered / count, np.float32(1))
    inverse = np.float32(1) / covered
    sums[:] = 0
    for k in range(count):
        for c in range(12):
            sums[c] += acc[k, c + 1]
    for c in range(3):
        out.albedo[y, x, c] = sums[c] * inverse
        out.emissive[y, x, c] = sums[9 + c] * inverse
        out.material[y, x, c] = sums[6 + c] * inverse
    out.material[y, x, 3] = covered / hits
    n = np.sqrt(sums[3] * sums[3] + sums[4] * sums[4] + sums[5] * sums[5])
    for c in range(3):
        if n > 1e-6:
            out.normal[y, x, c] = sums[3 + c] / n
        else:  # opposite sides cancel in this pixel: straight towards the camera
            out.normal[y, x, c] = -direction[c] / np.sqrt(
                direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2
            )
    out.depth[y, x] = z
    for c in range(3):
        out.position[y, x, c] = eye[c] + z * direction[c]
    out.object_id[y, x] = ident


@numba.njit(cache=True, nogil=True, error_model="numpy")
def resolve_centres(
    height, width, edge, samples: Samples, directions, eye, out: GBuffer
):  # pragma: no cover - compiled
    """Pixels that need one sample only; samples cover one pixel more on each side than the layers."""
    acc, depth, ident = samples
    sums = np.empty(12, np.float32)
    for y in range(height - 2):
        for x in range(width - 2):
            k = (y + 1) * width + x + 1
            if ident[k] != 0 and not edge[k]:
                write_pixel(y, x, acc[k : k + 1], depth[k], ident[k], directions[k], eye, sums, out)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def resolve_edges(
    pixels, order, samples: Samples, centre_depth, centre_ident, view: View, out: GBuffer
):  # pragma: no cover - compiled
    """Pixels of many samples; numbered with one pixel of margin.

    centre_depth, centre_ident : (pixels,) of the pixels' own centres;  order : (s,) sample numbers from the centre outwards"""
    acc, depth, ident = samples
    lens, rotation, eye, _, _ = view
    count, width = order.shape[0], lens.shape[1] - 2
    sums, direction = np.zeros(12, np.float32), np.empty(3, np.float32)
    for a in range(pixels.shape[0]):
        k = pixels[a]
        y, x = k // width - 1, k % width - 1
        u, v = lens[y + 2, x + 2, 0], lens[y + 2, x + 2, 1]
        for c in range(3):
            direction[c] = rotation[0, c] * u + rotation[1, c] * v + rotation[2, c]
        z, number = centre_depth[a], centre_ident[a]
        if number == 0:
            for b in range(count):
                s = a * count + order[b]
                if ident[s] > 0:
                    number, z = ident[s], depth[s]
                    break
        write_pixel(y, x, acc[a * count : (a + 1) * count], z, number, direction, eye, sums, out)
