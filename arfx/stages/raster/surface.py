"""Attributes of the model's surface where a ray meets it: colour, normal, material. Compiled, `rays` back end.

Textures, repeated: the mean of trilinear taps in the pyramids of textures.py, spread over the sample's parallelogram on the
texture, one for each half texel a side, up to a limit. Source of the level: a tap's area (OpenGL 4.6, 8.14)."""

# mypy: disable-error-code="no-untyped-def, call-arg, var-annotated"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.four import mean_of_rows
from arfx.stages.raster.arrays import Fragments, GBuffer, Hits, Surfaces, View
from arfx.stages.raster.textures import WRAP_COLUMN

_F = np.float32
# Cosine below which the footprint on the surface stops growing: one texel row would blur away a whole texture.
_GRAZING = 0.1
# A bilinear tap spreads over two texels; half a level finer comes nearest to the mean over its area (least error against the
# reference level on the sample models).
_SHARPER = 0.5
_ONE_TAP = 1.0  # texels along a sample, up to which one tap of the finest level is enough


@numba.njit(nogil=True, fastmath=True)
def _mean_of_texels(texels, i, j, k, m, a, b, c, d):  # pragma: no cover - compiled
    """a texels[i] + b texels[j] + c texels[k] + d texels[m], a tuple. texels : (n, 4) uint16"""
    return (
        _F(texels[i, 0]) * a + _F(texels[j, 0]) * b + _F(texels[k, 0]) * c + _F(texels[m, 0]) * d,
        _F(texels[i, 1]) * a + _F(texels[j, 1]) * b + _F(texels[k, 1]) * c + _F(texels[m, 1]) * d,
        _F(texels[i, 2]) * a + _F(texels[j, 2]) * b + _F(texels[k, 2]) * c + _F(texels[m, 2]) * d,
        _F(texels[i, 3]) * a + _F(texels[j, 3]) * b + _F(texels[k, 3]) * c + _F(texels[m, 3]) * d,
    )


@numba.njit(inline="always")
def _folded(u, wrap):  # pragma: no cover - compiled
    """A coordinate as one from 0 to 1, where the picture repeats (0), ends (1) or is mirrored (2)."""
    if wrap == 0:
        return u - np.floor(u)
    if wrap == 1:
        return min(max(u, np.float32(0)), np.float32(1))
    return abs(u - np.float32(2) * np.floor(np.float32(0.5) * u + np.float32(0.5)))


@line_kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _texel(texels, table, t, level, tu, tv, weight):  # pragma: no cover - compiled
    """Four channels, bilinear, of one level of texture t at tu, tv in 0..1, times weight; 1 = full."""
    one = np.float32(1)
    w, h = np.int32(max(table[t, 0] >> level, 1)), np.int32(max(table[t, 1] >> level, 1))
    start = np.int32(table[t, 3 + level])
    x, y = tu * np.float32(w) - np.float32(0.5), tv * np.float32(h) - np.float32(0.5)
    left, top = np.floor(x), np.floor(y)
    fx, fy = x - left, y - top
    x0, y0 = np.int32(left), np.int32(top)
    x1, y1 = np.int32(x0 + np.int32(1)), np.int32(y0 + np.int32(1))
    # the texels beyond the edges: those of the other side where the picture repeats
    across, down = np.int32(w - np.int32(1)), np.int32(h - np.int32(1))
    repeats_u, repeats_v = table[t, WRAP_COLUMN] == 0, table[t, WRAP_COLUMN + 1] == 0
    before, after = across if repeats_u else np.int32(0), np.int32(0) if repeats_u else across
    above, below = down if repeats_v else np.int32(0), np.int32(0) if repeats_v else down
    x0, x1 = x0 if x0 >= 0 else before, x1 if x1 < w else after
    y0, y1 = y0 if y0 >= 0 else above, y1 if y1 < h else below
    weight *= np.float32(1 / 65535)
    b, c, d = weight * fx * (one - fy), weight * (one - fx) * fy, weight * fx * fy
    i, j = np.uintp(start + y0 * w + x0), np.uintp(start + y0 * w + x1)
    k, m = np.uintp(start + y1 * w + x0), np.uintp(start + y1 * w + x1)
    return _mean_of_texels(texels, i, j, k, m, weight - b - c - d, b, c, d)


@numba.njit(inline="always")
def _in_world(rotation, x, y):  # pragma: no cover - compiled
    """Direction (x, y, 1) of the camera in world axes, float32. rotation : camera from world"""
    return (
        np.float32(rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0]),
        np.float32(rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1]),
        np.float32(rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2]),
    )


@line_kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _texture(texels, table, t, u, v, across, down, most):  # pragma: no cover - compiled
    """Four channels, mean over the parallelogram around u, v. across, down : its sides (u, v);  most : taps along a side"""
    one, zero = np.float32(1), np.float32(0)
    w, h = np.float32(table[t, 0]), np.float32(table[t, 1])
    ax, ay, bx, by = across[0] * w, across[1] * h, down[0] * w, down[1] * h
    # both sides in half texels, up to the limit
    n = min(max(np.int32(np.float32(2) * np.sqrt(ax * ax + ay * ay) + np.float32(0.99)), np.int32(1)), np.int32(most))
    m = min(max(np.int32(np.float32(2) * np.sqrt(bx * bx + by * by) + np.float32(0.99)), np.int32(1)), np.int32(most))
    share = one / np.float32(n * m)
    area = abs(ax * by - ay * bx) * share * np.float32(_SHARPER)
    lod = min(np.float32(0.5) * np.log2(area) if area > one else zero, np.float32(table[t, 2] - 1))
    level = np.int32(lod)
    mix = lod - np.float32(level)
    t0, t1, t2, t3 = zero, zero, zero, zero
    for j in range(m):
        q = (np.float32(j) + np.float32(0.5)) / np.float32(m) - np.float32(0.5)
        for i in range(n):
            p = (np.float32(i) + np.float32(0.5)) / np.float32(n) - np.float32(0.5)
            tu = _folded(u + p * across[0] + q * down[0], table[t, WRAP_COLUMN])
            tv = _folded(v + p * across[1] + q * down[1], table[t, WRAP_COLUMN + 1])
            c0, c1, c2, c3 = _texel(texels, table, t, level, tu, tv, (one - mix) * share)
            t0, t1, t2, t3 = t0 + c0, t1 + c1, t2 + c2, t3 + c3
            if mix > zero:
                c0, c1, c2, c3 = _texel(texels, table, t, np.int32(level + np.int32(1)), tu, tv, mix * share)
                t0, t1, t2, t3 = t0 + c0, t1 + c1, t2 + c2, t3 + c3
    return t0, t1, t2, t3


@numba.njit(inline="always")
def _along(slopes, f, z, slant, d, turn, normal):  # pragma: no cover - compiled
    """How texture coordinates change where the ray d turns by `turn`: the hit stays on the plane of face f.

    d, turn, normal : of three;  slant : 1 / (normal d)"""
    away = (normal[0] * turn[0] + normal[1] * turn[1] + normal[2] * turn[2]) * slant
    x, y, w = turn[0] - away * d[0], turn[1] - away * d[1], turn[2] - away * d[2]
    return (
        z * (slopes[f, 0, 0] * x + slopes[f, 0, 1] * y + slopes[f, 0, 2] * w),
        z * (slopes[f, 1, 0] * x + slopes[f, 1, 1] * y + slopes[f, 1, 2] * w),
    )


@numba.njit(inline="always")
def _surface(face, b1, b2, z, d, side, level, seen_from: View, mesh: Surfaces):  # pragma: no cover - compiled
    """Opacity, albedo (3), unit normal (3), metallic, roughness, specular, emissive (3) of one hit.

    d : the ray, camera z = 1;  z : depth of the hit;  side : of the sample's square at depth 1
    level : of textures' pyramids, for a single tap; -1 = filtered, a constant, of which the compiler makes a function of its own
    Inlined: a call with a dozen arrays takes ten times as long as the arithmetic (reference counts)."""
    normals, uv, floats, ints, table = mesh.normals, mesh.uv, mesh.floats, mesh.ints, mesh.table
    face_normal, texels, slopes, rotation = mesh.face_normal, mesh.texels, mesh.uv_slopes, seen_from.rotation
    dx, dy, dz = d
    # unsigned indices spare numba the test for negative ones
    f = np.uintp(face)
    p = np.uintp(mesh.part[f])
    i0, i1, i2 = np.uintp(mesh.faces[f, 0]), np.uintp(mesh.faces[f, 1]), np.uintp(mesh.faces[f, 2])
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    fx, fy, fz = face_normal[f, 0], face_normal[f, 1], face_normal[f, 2]
    facing = fx * dx + fy * dy + fz * dz
    b0 = np.float32(1) - b1 - b2
    r, g, b, alpha = mean_of_rows(mesh.colours, i0, i1, i2, b0, b1, b2)
    r, g, b, alpha = floats[p, 0] * r, floats[p, 1] * g, floats[p, 2] * b, floats[p, 3] * alpha
    metallic, rough = floats[p, 4], floats[p, 5]
    er, eg, eb = floats[p, 7], floats[p, 8], floats[p, 9]
    for slot in range(mesh.slots):
        t = ints[p, slot]
        if t < 0:
            continue
        tu = b0 * uv[i0, 0] + b1 * uv[i1, 0] + b2 * uv[i2, 0]
        tv = b0 * uv[i0, 1] + b1 * uv[i1, 1] + b2 * uv[i2, 1]
        if level >= 0:
            tu = _folded(tu, table[t, WRAP_COLUMN])
            tv = _folded(tv, table[t, WRAP_COLUMN + 1])
            t0, t1, t2, t3 = _texel(texels, table, t, np.int32(min(level, table[t, 2] - 1)), tu, tv, np.float32(1))
        else:
            cosine = max(abs(facing), np.float32(_GRAZING) * length)
            slant, reach = np.float32(1) / (cosine if facing > 0 else -cosine), z * side
            right = np.float32(rotation[0, 0]), np.float32(rotation[0, 1]), np.float32(rotation[0, 2])
            below = np.float32(rotation[1, 0]), np.float32(rotation[1, 1]), np.float32(rotation[1, 2])
            across = _along(slopes, f, reach, slant, d, right, (fx, fy, fz))
            down = _along(slopes, f, reach, slant, d, below, (fx, fy, fz))
            t0, t1, t2, t3 = _texture(texels, table, t, tu, tv, across, down, seen_from.taps)
        if slot == 0:
            r, g, b, alpha = r * t0, g * t1, b * t2, alpha * t3
        elif slot == 1:
            metallic, rough = metallic * t2, rough * t1
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
    excess = (nx * dx + ny * dy + nz * dz) / (length * length)
    if excess > 0:
        nx, ny, nz = nx - excess * dx, ny - excess * dy, nz - excess * dz
    n = np.sqrt(nx * nx + ny * ny + nz * nz)
    if n > np.float32(1e-6):
        nx, ny, nz = nx / n, ny / n, nz / n
    else:
        s = np.float32(-1) if facing > 0 else np.float32(1)
        nx, ny, nz = s * fx, s * fy, s * fz
    return alpha, r, g, b, nx, ny, nz, metallic, rough, floats[p, 6], er, eg, eb


@line_kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def surfaces(hits: Hits, directions, seen_from: View, mesh: Surfaces, values):  # pragma: no cover - compiled
    """Attributes of hits into values (n, 13), in the order of `_surface`. Rows of misses stay as they are.

    directions : (n, 3) with camera z = 1"""
    prim, bary_u, bary_v, depth = hits
    for k in range(prim.shape[0]):
        if prim[k] < 0:
            continue
        d = directions[k, 0], directions[k, 1], directions[k, 2]
        alpha, r, g, b, nx, ny, nz, metallic, rough, specular, er, eg, eb = _surface(
            prim[k], bary_u[k], bary_v[k], depth[k], d, seen_from.pixel, -1, seen_from, mesh
        )
        values[k, 0], values[k, 1], values[k, 2], values[k, 3] = alpha, r, g, b
        values[k, 4], values[k, 5], values[k, 6] = nx, ny, nz
        values[k, 7], values[k, 8], values[k, 9] = metallic, rough, specular
        values[k, 10], values[k, 11], values[k, 12] = er, eg, eb


@line_kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def write_centres(hits: Hits, edge, seen_from: View, glows, mesh: Surfaces, later, out: GBuffer):  # pragma: no cover - compiled
    """All layers of an opaque mesh from one sample a pixel; those of misses and of `edge` pixels become neutral. So do those
    with a texture finer than the pixel, where it may have several taps: their number is returned, `later` lists them.

    Hits cover one pixel more on each side than the layers do;  glows : else EMISSIVE is left alone"""
    prim, bary_u, bary_v, depth = hits
    lens, rotation, eye = seen_from.lens, seen_from.rotation, seen_from.eye
    coverage, depth_out, normal, position, albedo, material, emissive, object_id = out
    part, face_normal, height, width = mesh.part, mesh.face_normal, lens.shape[0] - 2, lens.shape[1] - 2
    least, count, level = np.float32(_GRAZING), np.uintp(0), np.int32(0)
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            k = np.uintp(i * width + j)
            y, x = np.uintp(i - 1), np.uintp(j - 1)
            clear = prim[k] < 0 or edge[k]
            dx, dy, dz = _in_world(rotation, lens[i + 1, j + 1, 0], lens[i + 1, j + 1, 1])
            if not clear:
                f = np.uintp(prim[k])
                facing = abs(face_normal[f, 0] * dx + face_normal[f, 1] * dy + face_normal[f, 2] * dz)
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                texels = depth[k] * seen_from.pixel * length * mesh.texels_per_m[f] / max(facing, least * length)
                if texels > np.float32(_ONE_TAP) and seen_from.taps > 1:
                    clear = True
                    later[count] = k
                    count += np.uintp(1)
                else:
                    level = np.int32(np.log2(texels)) if texels > np.float32(2) else np.int32(0)
            if clear:
                coverage[y, x], depth_out[y, x], object_id[y, x] = 0, np.inf, 0
                for c in range(3):
                    albedo[y, x, c], normal[y, x, c], material[y, x, c], position[y, x, c] = 0, 0, 0, 0
                material[y, x, 3] = 0
                continue
            z = depth[k]
            _, r, g, b, nx, ny, nz, metallic, rough, specular, er, eg, eb = _surface(
                prim[k], bary_u[k], bary_v[k], z, (dx, dy, dz), seen_from.pixel, level, seen_from, mesh
            )
            coverage[y, x], depth_out[y, x], object_id[y, x] = 1, z, part[np.uintp(prim[k])] + 1
            albedo[y, x, 0], albedo[y, x, 1], albedo[y, x, 2] = r, g, b
            normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx, ny, nz
            material[y, x, 0], material[y, x, 1], material[y, x, 2], material[y, x, 3] = metallic, rough, specular, 1
            position[y, x, 0], position[y, x, 1], position[y, x, 2] = eye[0] + z * dx, eye[1] + z * dy, eye[2] + z * dz
            if glows:
                emissive[y, x, 0], emissive[y, x, 1], emissive[y, x, 2] = er, eg, eb
    return count


@line_kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def write_edges(
    pixels, samples, order, hits: Hits, centres: Hits, seen_from: View, glows, mesh: Surfaces, met: Fragments, out: GBuffer
):  # fmt: skip  # pragma: no cover - compiled
    """Pixels of many samples of an opaque mesh: means over the samples that meet it. Those that none meets stay as they are.

    What a face has is linear on it, so that it is worked out once for all samples of a pixel that meet it, at their mean.
    pixels (n,) : numbered with one pixel of margin;  samples (n, s, 2) : directions in the camera
    order (s,) : sample numbers from the centre outwards;  hits : of n * s samples;  centres : of every pixel's centre"""
    prim, bary_u, bary_v, depth = hits
    lens, rotation, eye = seen_from.lens, seen_from.rotation, seen_from.eye
    coverage, depth_out, normal, position, albedo, material, emissive, object_id = out
    part, width = mesh.part, lens.shape[1] - 2
    face, sums = met
    count, one = np.uintp(order.shape[0]), np.uintp(1)
    for a in range(pixels.shape[0]):
        y, x = np.uintp(pixels[a] // width - 1), np.uintp(pixels[a] % width - 1)
        start = np.uintp(a) * count
        hit_count, faces = np.float32(0), np.uintp(0)
        for i in range(count):
            s = np.uintp(i)
            k = start + s
            if prim[k] < 0:
                continue
            hit_count += np.float32(1)
            face[faces] = prim[k]
            m = np.uintp(0)
            while face[m] != prim[k]:
                m += one
            if m == faces:
                faces += one
                for c in range(6):
                    sums[m, c] = 0
            sums[m, 0], sums[m, 1], sums[m, 2] = sums[m, 0] + np.float32(1), sums[m, 1] + bary_u[k], sums[m, 2] + bary_v[k]
            sums[m, 3] += depth[k]
            sums[m, 4], sums[m, 5] = sums[m, 4] + samples[a, s, 0], sums[m, 5] + samples[a, s, 1]
        if hit_count == 0:
            continue
        r, g, b = np.float32(0), np.float32(0), np.float32(0)
        nx, ny, nz = np.float32(0), np.float32(0), np.float32(0)
        metallic, rough, specular = np.float32(0), np.float32(0), np.float32(0)
        er, eg, eb = np.float32(0), np.float32(0), np.float32(0)
        for i in range(faces):
            m = np.uintp(i)
            w = sums[m, 0]
            mean = np.float32(1) / w
            d = _in_world(rotation, sums[m, 4] * mean, sums[m, 5] * mean)
            side = seen_from.pixel * np.sqrt(w / np.float32(count))
            _, r1, g1, b1, x1, y1, z1, metallic1, rough1, specular1, er1, eg1, eb1 = _surface(
                face[m], sums[m, 1] * mean, sums[m, 2] * mean, sums[m, 3] * mean, d, side, -1, seen_from, mesh
            )
            r, g, b = r + w * r1, g + w * g1, b + w * b1
            nx, ny, nz = nx + w * x1, ny + w * y1, nz + w * z1
            metallic, rough, specular = metallic + w * metallic1, rough + w * rough1, specular + w * specular1
            er, eg, eb = er + w * er1, eg + w * eg1, eb + w * eb1
        centre = np.uintp(pixels[a])
        chosen, z = centres.face[centre], centres.depth[centre]
        if chosen < 0:
            for i in range(count):
                k = start + np.uintp(order[i])
                if prim[k] >= 0:
                    chosen, z = prim[k], depth[k]
                    break
        lx, ly = lens[y + np.uintp(2), x + np.uintp(2), 0], lens[y + np.uintp(2), x + np.uintp(2), 1]
        dx, dy, dz = _in_world(rotation, lx, ly)
        inverse = np.float32(1) / hit_count
        coverage[y, x], depth_out[y, x], object_id[y, x] = hit_count / np.float32(count), z, part[np.uintp(chosen)] + 1
        albedo[y, x, 0], albedo[y, x, 1], albedo[y, x, 2] = r * inverse, g * inverse, b * inverse
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > np.float32(1e-6):
            normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx / length, ny / length, nz / length
        else:  # opposite sides cancel in this pixel: straight towards the camera
            length = -np.sqrt(dx * dx + dy * dy + dz * dz)
            normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = dx / length, dy / length, dz / length
        material[y, x, 0], material[y, x, 1], material[y, x, 2] = metallic * inverse, rough * inverse, specular * inverse
        material[y, x, 3] = 1
        position[y, x, 0], position[y, x, 1], position[y, x, 2] = eye[0] + z * dx, eye[1] + z * dy, eye[2] + z * dz
        if glows:
            emissive[y, x, 0], emissive[y, x, 1], emissive[y, x, 2] = er * inverse, eg * inverse, eb * inverse
