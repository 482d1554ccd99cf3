"""From the float buffers that OpenGL filled to pixels: k x k samples each, looked up where the real lens sees them.

Without distortion sample and buffer texel coincide. With it the buffer shows the ideal camera, and each sample takes the
texel next to where its own exact direction points: attributes of two surfaces are never interpolated."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.stages.raster.arrays import Buffers, GBuffer, Samples


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texel_map(
    lens, height, width, k, scale, shift, rows, columns, exact
):  # pragma: no cover - compiled
    """(h * w * k * k,) int32 index of the texel of every sample, -1 = none. Buffers are stored bottom row first.

    lens : directions with one pixel of margin;  scale, shift : (2,) buffer position = direction * scale + shift
    exact : no distortion: samples and texels coincide"""
    out = np.empty(height * width * k * k, np.int32)
    n = 0
    for y in range(height):
        for x in range(width):
            i, j = y + 1, x + 1
            for sy in range(k):
                for sx in range(k):
                    if exact:
                        row, col = y * k + sy, x * k + sx
                    else:
                        dx, dy = (sx + 0.5) / k - 0.5, (sy + 0.5) / k - 0.5
                        u = lens[i, j, 0] + 0.5 * dx * (lens[i, j + 1, 0] - lens[i, j - 1, 0])
                        u += 0.5 * dy * (lens[i + 1, j, 0] - lens[i - 1, j, 0])
                        v = lens[i, j, 1] + 0.5 * dx * (lens[i, j + 1, 1] - lens[i, j - 1, 1])
                        v += 0.5 * dy * (lens[i + 1, j, 1] - lens[i - 1, j, 1])
                        u, v = u * scale[0] + shift[0], v * scale[1] + shift[1]
                        if not (-0.5 <= u < columns - 0.5 and -0.5 <= v < rows - 0.5):
                            out[n] = -1
                            n += 1
                            continue
                        row, col = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
                    out[n] = (rows - 1 - row) * columns + col
                    n += 1
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def resolve_opaque(
    texels, order, per, buffers: Buffers, glows, grid, rotation, directions, eye, out: GBuffer
):  # pragma: no cover - compiled
    """Means over the covering samples of each pixel; depth and number from the one next to the centre.

    grid : (6,) scale x y, shift x y, columns, rows of the buffer; columns = 0 where texels lie on the samples"""
    geometry, colour, surface, glow = buffers
    coverage, depth, normal, position, albedo, material, emissive, object_id = out
    unit, (height, width) = np.float32(1.0 / 65535.0), coverage.shape
    for y in range(height):
        for x in range(width):
            first = (y * width + x) * per
            hits, nearest = 0, -1
            ar, ag, ab = np.float32(0), np.float32(0), np.float32(0)
            nx, ny, nz = np.float32(0), np.float32(0), np.float32(0)
            m0, m1, m2 = np.float32(0), np.float32(0), np.float32(0)
            e0, e1, e2 = np.float32(0), np.float32(0), np.float32(0)
            for s in range(per):
                t = texels[first + order[s]]
                if t < 0:
                    continue
                a = np.uintp(t)
                if surface[a, 3] == 0:
                    continue
                if nearest < 0:
                    nearest = t
                hits += 1
                ar, ag, ab = ar + colour[a, 0], ag + colour[a, 1], ab + colour[a, 2]
                nx, ny, nz = nx + geometry[a, 0], ny + geometry[a, 1], nz + geometry[a, 2]
                m0, m1, m2 = m0 + surface[a, 0], m1 + surface[a, 1], m2 + surface[a, 2]
                if glows:
                    e0, e1, e2 = e0 + glow[a, 0], e1 + glow[a, 1], e2 + glow[a, 2]
            if hits == 0:
                continue
            inverse = np.float32(1) / hits
            k = y * width + x
            coverage[y, x] = np.float32(hits) / per
            albedo[y, x, 0], albedo[y, x, 1], albedo[y, x, 2] = (
                ar * unit * inverse,
                ag * unit * inverse,
                ab * unit * inverse,
            )
            material[y, x, 0], material[y, x, 1] = m0 * unit * inverse, m1 * unit * inverse
            material[y, x, 2], material[y, x, 3] = m2 * unit * inverse, 1
            emissive[y, x, 0], emissive[y, x, 1], emissive[y, x, 2] = (
                e0 * inverse,
                e1 * inverse,
                e2 * inverse,
            )
            n = np.sqrt(nx * nx + ny * ny + nz * nz)
            z = geometry[nearest, 3]
            if grid[4] > 0:
                z = _tangent_depth(z, nearest, geometry, grid, rotation, directions[k])
            depth[y, x] = z
            object_id[y, x] = int(surface[nearest, 3])
            d0, d1, d2 = directions[k, 0], directions[k, 1], directions[k, 2]
            if n > 1e-3:
                normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx / n, ny / n, nz / n
            else:
                n = -np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
                normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = d0 / n, d1 / n, d2 / n
            position[y, x, 0], position[y, x, 1], position[y, x, 2] = (
                eye[0] + z * d0,
                eye[1] + z * d1,
                eye[2] + z * d2,
            )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tangent_depth(z, texel, geometry, grid, rotation, direction):  # pragma: no cover - compiled
    """Depth of the texel's tangent plane in the pixel's own direction; z itself where the plane is seen edge-on."""
    columns = int(grid[4])
    row, col = int(grid[5]) - 1 - texel // columns, texel % columns
    u, v = (col - grid[2]) / grid[0], (row - grid[3]) / grid[1]
    here, there, length = 0.0, 0.0, 0.0
    for c in range(3):
        d = rotation[0, c] * u + rotation[1, c] * v + rotation[2, c]
        here += geometry[texel, c] * d
        there += geometry[texel, c] * direction[c]
        length += direction[c] * direction[c]
    if here >= 0 or there >= -0.1 * np.sqrt(length):
        return z
    return np.float32(z * here / there)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_layer(
    texels, per, buffers: Buffers, glows, grid, rotation, directions, samples: Samples
):  # pragma: no cover - compiled
    """Put one peeled layer behind those in `samples`; returns whether any light is left behind it."""
    geometry, colour, surface, glow = buffers
    acc, depth, ident = samples
    unit = np.float32(1.0 / 65535.0)
    any_light = False
    for k in range(texels.shape[0]):
        t = texels[k]
        if t < 0 or surface[t, 3] == 0 or acc[k, 0] <= 0.002:
            continue
        w = acc[k, 0] * colour[t, 3] * unit
        acc[k, 0] -= w
        for c in range(3):
            acc[k, 1 + c] += w * colour[t, c] * unit
            acc[k, 4 + c] += w * geometry[t, c]
            acc[k, 7 + c] += w * surface[t, c] * unit
            if glows:
                acc[k, 10 + c] += w * glow[t, c]
        if ident[k] == 0:
            ident[k], depth[k] = int(surface[t, 3]), geometry[t, 3]
            if grid[4] > 0:
                depth[k] = _tangent_depth(
                    depth[k], t, geometry, grid, rotation, directions[k // per]
                )
        if acc[k, 0] > 0.002:
            any_light = True
    return any_light
