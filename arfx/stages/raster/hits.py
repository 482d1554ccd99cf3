"""From ray hits to attributes, and from samples to pixels: the compiled inner loops of the `rays` back end.

One row of `acc` gathers a sample's layers front to back, each weighted by its opacity times what is left of the light
behind those before it: columns 0 transmittance, 1-3 albedo, 4-6 normal, 7 metallic, 8 roughness, 9 specular,
10-12 emissive.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

COLUMNS = 13
# Transparency below half an 8-bit step of the opacity is none.
_CLEAR = 1.0 / 512.0
# Cosine below which the footprint on the surface stops growing: one texel row would blur away a whole texture.
_GRAZING = 0.1


@numba.njit(cache=True, nogil=True)
def world_directions(lens, rows_start, cols_start, height, width, rotation):  # pragma: no cover - compiled
    """Directions (h * w, 3) float32 in world axes from the table's (x/z, y/z); camera z of each is 1. And which are valid."""
    out = np.empty((height * width, 3), np.float32)
    valid = np.empty(height * width, np.bool_)
    k = 0
    for i in range(height):
        for j in range(width):
            x, y = lens[rows_start + i, cols_start + j, 0], lens[rows_start + i, cols_start + j, 1]
            valid[k] = np.isfinite(x) and np.isfinite(y)
            for c in range(3):
                out[k, c] = rotation[0, c] * x + rotation[1, c] * y + rotation[2, c]
            k += 1
    return out, valid


@numba.njit(cache=True, nogil=True)
def sample_directions(lens, pixels, width, offsets, rotation):  # pragma: no cover - compiled
    """Directions of `offsets` (s, 2) px around `pixels` (k,), from a table with one pixel of margin.

    Returns them in the camera (k, s, 2), in the world (k * s, 3), and which are valid (k * s,).
    """
    s = offsets.shape[0]
    inner = np.empty((pixels.shape[0], s, 2), np.float32)
    out = np.empty((pixels.shape[0] * s, 3), np.float32)
    valid = np.empty(pixels.shape[0] * s, np.bool_)
    for a in range(pixels.shape[0]):
        i, j = pixels[a] // width + 1, pixels[a] % width + 1
        for b in range(s):
            dx, dy = offsets[b, 0], offsets[b, 1]
            x = lens[i, j, 0] + 0.5 * dx * (lens[i, j + 1, 0] - lens[i, j - 1, 0])
            x += 0.5 * dy * (lens[i + 1, j, 0] - lens[i - 1, j, 0])
            y = lens[i, j, 1] + 0.5 * dx * (lens[i, j + 1, 1] - lens[i, j - 1, 1])
            y += 0.5 * dy * (lens[i + 1, j, 1] - lens[i - 1, j, 1])
            inner[a, b, 0], inner[a, b, 1] = x, y
            k = a * s + b
            valid[k] = np.isfinite(x) and np.isfinite(y)
            for c in range(3):
                out[k, c] = rotation[0, c] * x + rotation[1, c] * y + rotation[2, c]
    return inner, out, valid


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def surfaces(
    prim, bary_u, bary_v, depth, skip, directions, pixel,
    faces, part, face_normal, normals, uv, colours, uv_per_m, floats, ints, texels, table, values,
):  # fmt: skip  # pragma: no cover - compiled
    """Attributes of hits into values (n, 13): 0 opacity, the rest as in `acc`. Rows of misses and of `skip` stay as they are.

    depth : (n,) of the hits;  directions : (n, 3) with camera z = 1;  pixel : footprint of a sample at depth 1

    Textures: trilinear in the pyramids of textures.py, repeated.
    One body without calls: passing two dozen arrays to a function once per hit
    takes ten times as long as the arithmetic (reference counts).
    """
    for k in range(prim.shape[0]):
        if prim[k] < 0 or skip[k]:
            continue
        # unsigned indices spare numba the test for negative ones
        f = np.uintp(prim[k])
        p = np.uintp(part[f])
        i0, i1, i2 = np.uintp(faces[f, 0]), np.uintp(faces[f, 1]), np.uintp(faces[f, 2])
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        facing = face_normal[f, 0] * dx + face_normal[f, 1] * dy + face_normal[f, 2] * dz
        b1, b2 = bary_u[k], bary_v[k]
        b0 = np.float32(1) - b1 - b2
        r = floats[p, 0] * (b0 * colours[i0, 0] + b1 * colours[i1, 0] + b2 * colours[i2, 0])
        g = floats[p, 1] * (b0 * colours[i0, 1] + b1 * colours[i1, 1] + b2 * colours[i2, 1])
        b = floats[p, 2] * (b0 * colours[i0, 2] + b1 * colours[i1, 2] + b2 * colours[i2, 2])
        alpha = floats[p, 3] * (b0 * colours[i0, 3] + b1 * colours[i1, 3] + b2 * colours[i2, 3])
        metallic, rough = floats[p, 4], floats[p, 5]
        er, eg, eb = floats[p, 7], floats[p, 8], floats[p, 9]
        for slot in range(3):
            t = ints[p, slot]
            if t < 0:
                continue
            tu = b0 * uv[i0, 0] + b1 * uv[i1, 0] + b2 * uv[i2, 0]
            tv = b0 * uv[i0, 1] + b1 * uv[i1, 1] + b2 * uv[i2, 1]
            tu -= np.floor(tu)
            tv -= np.floor(tv)
            # the pixel's footprint on the surface, as the side of a square of the same area, in texels
            cosine = max(abs(facing) / length, np.float32(_GRAZING))
            side = depth[k] * pixel * uv_per_m[f] / np.sqrt(cosine) * np.sqrt(np.float32(table[t, 0] * table[t, 1]))
            lod = np.log2(side) if side > np.float32(1) else np.float32(0)
            lod = min(lod, np.float32(table[t, 2] - 1))
            first = int(lod)
            mix = np.float32(lod - first)
            t0, t1, t2, t3 = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for step in range(2):
                share = np.float32(1) - mix if step == 0 else mix
                if share <= 0.0:
                    continue
                share *= np.float32(1 / 65535)
                level = min(first + step, table[t, 2] - 1)
                w, h = max(table[t, 0] >> level, 1), max(table[t, 1] >> level, 1)
                start = table[t, 3 + level]
                x, y = tu * np.float32(w) - np.float32(0.5), tv * np.float32(h) - np.float32(0.5)
                x0, y0 = int(np.floor(x)), int(np.floor(y))
                fx, fy = np.float32(x - x0), np.float32(y - y0)
                x1, y1 = x0 + 1, y0 + 1
                x0, x1 = x0 if x0 >= 0 else w - 1, x1 if x1 < w else 0
                y0, y1 = y0 if y0 >= 0 else h - 1, y1 if y1 < h else 0
                a, b_, c, d = (
                    np.uintp(start + y0 * w + x0), np.uintp(start + y0 * w + x1),
                    np.uintp(start + y1 * w + x0), np.uintp(start + y1 * w + x1),
                )  # fmt: skip
                wb, wc, wd = share * fx * (1 - fy), share * (1 - fx) * fy, share * fx * fy
                wa = share - wb - wc - wd
                t0 += wa * texels[a, 0] + wb * texels[b_, 0] + wc * texels[c, 0] + wd * texels[d, 0]
                t1 += wa * texels[a, 1] + wb * texels[b_, 1] + wc * texels[c, 1] + wd * texels[d, 1]
                t2 += wa * texels[a, 2] + wb * texels[b_, 2] + wc * texels[c, 2] + wd * texels[d, 2]
                t3 += wa * texels[a, 3] + wb * texels[b_, 3] + wc * texels[c, 3] + wd * texels[d, 3]
            if slot == 0:
                r, g, b, alpha = r * t0, g * t1, b * t2, alpha * t3
            elif slot == 1:
                metallic, rough = metallic * t0, rough * t1
            else:
                er, eg, eb = er * t0, eg * t1, eb * t2
        mode = ints[p, 3]
        if mode == 0:
            alpha = np.float32(1)
        elif mode == 1:
            alpha = np.float32(1) if alpha >= floats[p, 10] else np.float32(0)
        nx = b0 * normals[i0, 0] + b1 * normals[i1, 0] + b2 * normals[i2, 0]
        ny = b0 * normals[i0, 1] + b1 * normals[i1, 1] + b2 * normals[i2, 1]
        nz = b0 * normals[i0, 2] + b1 * normals[i1, 2] + b2 * normals[i2, 2]
        if facing > 0:  # the back of a two-sided surface
            nx, ny, nz = -nx, -ny, -nz
        # an interpolated normal can lean away at the outline: it is turned back to just facing the camera
        away = (nx * dx + ny * dy + nz * dz) / (length * length)
        if away > 0:
            nx, ny, nz = nx - away * dx, ny - away * dy, nz - away * dz
        n = np.sqrt(nx * nx + ny * ny + nz * nz)
        if n > np.float32(1e-6):
            nx, ny, nz = nx / n, ny / n, nz / n
        else:
            s = np.float32(-1) if facing > 0 else np.float32(1)
            nx, ny, nz = s * face_normal[f, 0], s * face_normal[f, 1], s * face_normal[f, 2]
        values[k, 0], values[k, 1], values[k, 2], values[k, 3] = alpha, r, g, b
        values[k, 4], values[k, 5], values[k, 6] = nx, ny, nz
        values[k, 7], values[k, 8], values[k, 9] = metallic, rough, floats[p, 6]
        values[k, 10], values[k, 11], values[k, 12] = er, eg, eb


@numba.njit(cache=True, nogil=True, error_model="numpy")
def accumulate(
    active, prim, z, values, directions, start, hidden, layered, part, face_normal, ints, acc, depth, ident, masked, onward
):  # fmt: skip  # pragma: no cover - compiled
    """Add one layer of hits to the samples `active`; returns how many rays go on, listed in `onward`.

    z, values : depth and attributes of the hits;  start : (samples,) moved behind the hit where the ray goes on
    masked : (samples,) bool, set where a cut-out material is met
    """
    going = 0
    for a in range(active.shape[0]):
        if prim[a] < 0:
            continue
        f, k = np.uintp(prim[a]), np.uintp(active[a])
        facing = (
            face_normal[f, 0] * directions[k, 0] + face_normal[f, 1] * directions[k, 1] + face_normal[f, 2] * directions[k, 2]
        )
        if hidden[f] and facing > 0:
            start[k] = z[a]
            onward[going] = active[a]
            going += 1
            continue
        if ints[part[f], 3] == 1:
            masked[k] = True
        if values[a, 0] > _CLEAR:
            w = acc[k, 0] * values[a, 0]
            acc[k, 0] -= w
            for c in range(1, COLUMNS):
                acc[k, c] += w * values[a, c]
            if ident[k] == 0:
                ident[k] = part[f] + 1
                depth[k] = z[a]
        if layered and acc[k, 0] > _CLEAR:
            start[k] = z[a]
            onward[going] = active[a]
            going += 1
    return going


@numba.njit(cache=True, nogil=True, error_model="numpy")
def write_centres(
    prim, depth, edge, values, directions, height, width, eye, glows, part,
    coverage, depth_out, normal, position, albedo, material, emissive, object_id,
):  # fmt: skip  # pragma: no cover - compiled
    """Pixels of an opaque mesh that need one sample only. Hits cover one pixel more on each side than the layers do."""
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            k = np.uintp(i * width + j)
            if prim[k] < 0 or edge[k]:
                continue
            y, x, z = np.uintp(i - 1), np.uintp(j - 1), depth[k]
            coverage[y, x] = 1
            depth_out[y, x] = z
            object_id[y, x] = part[np.uintp(prim[k])] + 1
            for c in range(3):
                albedo[y, x, c] = values[k, 1 + c]
                normal[y, x, c] = values[k, 4 + c]
                material[y, x, c] = values[k, 7 + c]
                position[y, x, c] = eye[c] + z * directions[k, c]
                if glows:  # else the layer stays the untouched zeros that it is
                    emissive[y, x, c] = values[k, 10 + c]
            material[y, x, 3] = 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def write_pixel(
    sums, y, x, acc, first, count, chosen, depth, ident, direction, eye, coverage, depth_out, normal, position, albedo,
    material, emissive, object_id,
):  # fmt: skip  # pragma: no cover - compiled
    """Mean of samples first .. first + count over the covering ones; depth and number come from sample `chosen`."""
    covered = np.float32(0)
    hits = 0
    for k in range(first, first + count):
        covered += np.float32(1) - acc[k, 0]
        if acc[k, 0] < 1:
            hits += 1
    if hits == 0:
        return
    coverage[y, x] = min(covered / count, np.float32(1))
    inverse = np.float32(1) / covered
    sums[:] = 0
    for k in range(first, first + count):
        for c in range(12):
            sums[c] += acc[k, c + 1]
    for c in range(3):
        albedo[y, x, c] = sums[c] * inverse
        emissive[y, x, c] = sums[9 + c] * inverse
        material[y, x, c] = sums[6 + c] * inverse
    material[y, x, 3] = covered / hits
    n = np.sqrt(sums[3] * sums[3] + sums[4] * sums[4] + sums[5] * sums[5])
    for c in range(3):
        if n > 1e-6:
            normal[y, x, c] = sums[3 + c] / n
        else:  # opposite sides cancel in this pixel: straight towards the camera
            normal[y, x, c] = -direction[c] / np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    z = depth[chosen]
    depth_out[y, x] = z
    for c in range(3):
        position[y, x, c] = eye[c] + z * direction[c]
    object_id[y, x] = ident[chosen]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def resolve_centres(
    height, width, edge, acc, depth, ident, directions, eye, coverage, depth_out, normal, position, albedo, material,
    emissive, object_id,
):  # fmt: skip  # pragma: no cover - compiled
    """Pixels that need one sample only; samples cover one pixel more on each side than the layers."""
    for y in range(height - 2):
        for x in range(width - 2):
            k = (y + 1) * width + x + 1
            if ident[k] == 0 or edge[k]:
                continue
            share = np.float32(1) - acc[k, 0]
            inverse = np.float32(1) / share
            nx, ny, nz = acc[k, 4], acc[k, 5], acc[k, 6]
            n = np.sqrt(nx * nx + ny * ny + nz * nz)
            n = n if n > 1e-6 else np.float32(1)
            normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx / n, ny / n, nz / n
            for c in range(3):
                albedo[y, x, c] = acc[k, 1 + c] * inverse
                material[y, x, c] = acc[k, 7 + c] * inverse
                emissive[y, x, c] = acc[k, 10 + c] * inverse
                position[y, x, c] = eye[c] + depth[k] * directions[k, c]
            coverage[y, x] = share
            material[y, x, 3] = share
            depth_out[y, x] = depth[k]
            object_id[y, x] = ident[k]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def resolve_edges(
    width, pixels, samples, order, acc, depth, ident, centre_depth, centre_ident, lens, rotation, eye, coverage, depth_out,
    normal, position, albedo, material, emissive, object_id,
):  # fmt: skip  # pragma: no cover - compiled
    """Pixels of many samples; numbered with one pixel of margin, two in the lens table.

    order : (samples,) sample numbers from the pixel's centre outwards
    """
    sums, direction = np.zeros(12, np.float32), np.empty(3, np.float32)
    one_depth, one_ident = np.empty(1, np.float32), np.empty(1, np.int32)
    for a in range(pixels.shape[0]):
        k = pixels[a]
        y, x = k // width - 1, k % width - 1
        u, v = lens[y + 2, x + 2, 0], lens[y + 2, x + 2, 1]
        for c in range(3):
            direction[c] = rotation[0, c] * u + rotation[1, c] * v + rotation[2, c]
        one_ident[0] = centre_ident[k]
        one_depth[0] = centre_depth[k]
        if one_ident[0] == 0:
            for b in range(samples):
                s = a * samples + order[b]
                if ident[s] > 0:
                    one_ident[0], one_depth[0] = ident[s], depth[s]
                    break
        write_pixel(
            sums, y, x, acc, a * samples, samples, 0, one_depth, one_ident, direction, eye, coverage, depth_out, normal,
            position, albedo, material, emissive, object_id,
        )  # fmt: skip
