"""What rays meet: colour, normal and material of the surface, summed up for each pixel; one loop
for pixel centres, samples along edges and layers behind transparent ones."""

# mypy: disable-error-code="no-untyped-def, call-arg, var-annotated, arg-type, assignment"
from typing import NamedTuple

import numpy as np

from arfx.core.compiled import FAST, kernel, line_kernel
from arfx.core.vectors import cross, dot, scaled, shifted, vector
from arfx.stages.raster.record import (
    ALBEDO,
    COAT,
    COVERED,
    EMISSIVE,
    MARGIN,
    MATERIAL,
    MET,
    NORMAL,
    OCCLUSION,
    PLAIN_COLUMNS,
    SHEEN,
    SMOOTH,
    GBuffer,
    Rays,
    View,
)
from arfx.stages.raster.tables import (
    BASE,
    BASE_SLOT,
    COAT_FACTORS,
    COAT_ROUGHNESS_SLOT,
    COAT_SLOT,
    CUT_OUT,
    CUTOFF,
    EMISSION,
    EMISSIVE_SLOT,
    METAL_SLOT,
    METALLIC,
    MODE,
    NORMAL_SCALE,
    NORMAL_SLOT,
    OCCLUSION_SLOT,
    OCCLUSION_STRENGTH,
    SHEEN_SLOT,
    TWO_SIDED,
    SurfaceTables,
)
from arfx.stages.raster.texture_filter import filtered
from arfx.stages.raster.visible import planes_of, vertices_of

_F = np.float32
# Transparency below half an 8-bit step of the opacity is none.
CLEAR = 1.0 / 512.0


class Hit(NamedTuple):
    """Where a ray meets a face: depth, weights of its corners, and how those of the second and
    third one grow over a pixel to the right and down; the ray in world axes, and its product with
    the face's normal, above 0 from behind."""

    z: float
    weights: tuple[float, float, float]
    across: tuple[float, float]
    down: tuple[float, float]
    ray: tuple[float, float, float]
    facing: float


@kernel(inline="always")
def _in_world(rotation, x, y):  # pragma: no cover - compiled
    """Direction (x, y, 1) of the camera in world axes, float32. rotation : camera from world"""
    along = shifted(shifted(rotation[2], y, rotation[1]), x, rotation[0])
    return _F(along[0]), _F(along[1]), _F(along[2])


@kernel(inline="always")
def _hit(f, x, y, view, mesh):  # pragma: no cover - compiled
    """Where the ray x, y meets the plane of face f."""
    i, j, k = vertices_of(mesh.faces, f)
    a, b, c, volume = planes_of(view.points, i, j, k)
    towards = x, y, 1.0
    side_b, side_c = dot(b, towards), dot(c, towards)
    inverse = 1.0 / (dot(a, towards) + side_b + side_c)
    b1, b2 = side_b * inverse, side_c * inverse
    scale = view.pixel * inverse
    total_x, total_y = a[0] + b[0] + c[0], a[1] + b[1] + c[1]
    across = _F(scale * (b[0] - b1 * total_x)), _F(scale * (c[0] - b2 * total_x))
    down = _F(scale * (b[1] - b1 * total_y)), _F(scale * (c[1] - b2 * total_y))
    ray = _in_world(view.rotation, x, y)
    weights = _F(1.0 - b1 - b2), _F(b1), _F(b2)
    return Hit(
        _F(volume * inverse),
        weights,
        across,
        down,
        ray,
        dot(mesh.face_normal[f], ray),
    )


@kernel(inline="always")
def _along(uv, corners, first, growth, laid, side):  # pragma: no cover - compiled
    """(2,) how a place on a texture moves over a sample as the corners' weights grow.

    first : column of the texture's coordinates;  laid : (2, 3), of the texture
    side : of the sample, in pixels"""
    i, j, k = corners
    second = first + np.uintp(1)
    in_b, in_c = side * growth[0], side * growth[1]
    u = in_b * (uv[j, first] - uv[i, first]) + in_c * (uv[k, first] - uv[i, first])
    v = in_b * (uv[j, second] - uv[i, second]) + in_c * (
        uv[k, second] - uv[i, second]
    )
    return laid[0, 0] * u + laid[0, 1] * v, laid[1, 0] * u + laid[1, 1] * v


@kernel(inline="always")
def _apply_textures(
    f, p, hit, side, view, mesh, values
):  # pragma: no cover - compiled
    """Multiply what is in `values` by the part's textures. side : of the sample, in pixels

    Returns what the normal map shows, 0..1, unused where there is none."""
    corners, uv = vertices_of(mesh.faces, f), mesh.uv
    i, j, k = corners
    map_x, map_y, map_z = _F(0.5), _F(0.5), _F(1)
    for slot in range(mesh.slots):
        if mesh.ints[p, slot] < 0:
            continue
        t, c = np.uintp(mesh.ints[p, slot]), np.uintp(mesh.uv_first[p, slot])
        laid, d = mesh.laid[p, slot], c + np.uintp(1)
        u = dot(hit.weights, (uv[i, c], uv[j, c], uv[k, c]))
        v = dot(hit.weights, (uv[i, d], uv[j, d], uv[k, d]))
        place = dot(laid[0], (u, v, _F(1))), dot(laid[1], (u, v, _F(1)))
        wide = _along(uv, corners, c, hit.across, laid, side)
        high = _along(uv, corners, c, hit.down, laid, side)
        red, green, blue, alpha = filtered(
            mesh.texels, mesh.table, t, place, wide, high, view.taps
        )
        if slot == NORMAL_SLOT:
            map_x, map_y, map_z = red, green, blue
        elif slot == BASE_SLOT:
            _multiply(values, ALBEDO, red, green, blue)
            values[COVERED] *= alpha
        elif slot == METAL_SLOT:
            _multiply(values, MATERIAL, blue, green, _F(1))
        elif slot == EMISSIVE_SLOT:
            _multiply(values, EMISSIVE, red, green, blue)
        elif values.shape[0] > PLAIN_COLUMNS:
            _apply_extra(
                slot,
                red,
                green,
                blue,
                alpha,
                mesh.floats[p, OCCLUSION_STRENGTH],
                values,
            )
    return map_x, map_y, map_z


@kernel(inline="always")
def _multiply(values, first, a, b, c):  # pragma: no cover - compiled
    values[first] *= a
    values[first + 1] *= b
    values[first + 2] *= c


@kernel(inline="always")
def _apply_extra(
    slot, red, green, blue, alpha, strength, values
):  # pragma: no cover - compiled
    """Textures of occlusion, clear coat and sheen."""
    if slot == OCCLUSION_SLOT:
        values[OCCLUSION] = _F(1) + strength * (red - _F(1))
    elif slot == COAT_SLOT:
        values[COAT] *= red
    elif slot == COAT_ROUGHNESS_SLOT:
        values[COAT + 1] *= green
    elif slot == SHEEN_SLOT:
        _multiply(values, SHEEN, red, green, blue)
    else:
        values[SHEEN + 3] *= alpha


@kernel(inline="always")
def _interpolated(rows, f, hit, mesh):  # pragma: no cover - compiled
    """(3,) of rows (n, 3 or more) at a hit."""
    i, j, k = vertices_of(mesh.faces, f)
    a, b, c = hit.weights
    return shifted(shifted(scaled(a, rows[i]), b, rows[j]), c, rows[k])


@kernel(inline="always")
def _bent_normal(normal, shown, f, p, hit, mesh):  # pragma: no cover - compiled
    """(3,) the normal that a normal map shows, in world axes, any length.

    Source: glTF 2.0, 3.9.3; as it is stated there, nothing is made unit before it is summed.
    """
    scale = _F(2) * mesh.floats[p, NORMAL_SCALE]
    x, y = scale * (shown[0] - _F(0.5)), scale * (shown[1] - _F(0.5))
    z = _F(2) * shown[2] - _F(1)
    tangent = _interpolated(mesh.tangents, f, hit, mesh)
    y *= mesh.tangents[np.uintp(mesh.faces[f, 0]), 3]
    across = shifted(scaled(x, tangent), y, cross(normal, tangent))
    return shifted(across, z, normal)


@kernel(inline="always")
def _write_normal(first, normal, hit, f, mesh, values):  # pragma: no cover - compiled
    """Write a normal: unit, towards the camera; the face's own where it has no length."""
    if hit.facing > 0:  # the back of a two-sided surface
        normal = scaled(_F(-1), normal)
    # one that leans away at the outline is turned back to just facing the camera
    excess = dot(normal, hit.ray) / dot(hit.ray, hit.ray)
    if excess > 0:
        normal = shifted(normal, -excess, hit.ray)
    length = np.sqrt(dot(normal, normal))
    if length < _F(1e-6):
        length = _F(-1) if hit.facing > 0 else _F(1)
        normal = vector(mesh.face_normal[f])
    for c in range(3):
        values[first + c] = normal[c] / length


@kernel(inline="always")
def _write_surface(f, hit, side, view, mesh, values):  # pragma: no cover - compiled
    """Write what a hit shows into `values`; its opacity into the column COVERED.

    side : of the sample, in pixels"""
    p = np.uintp(mesh.part[f])
    i, j, k = vertices_of(mesh.faces, f)
    floats, colours = mesh.floats, mesh.colours
    colour = _interpolated(colours, f, hit, mesh)
    for c in range(3):
        values[ALBEDO + c] = floats[p, BASE + c]
        values[MATERIAL + c] = floats[p, METALLIC + c]
        values[EMISSIVE + c] = floats[p, EMISSION + c]
    _multiply(values, ALBEDO, colour[0], colour[1], colour[2])
    alpha = dot(hit.weights, (colours[i, 3], colours[j, 3], colours[k, 3]))
    values[COVERED] = floats[p, BASE + 3] * alpha
    if values.shape[0] > PLAIN_COLUMNS:
        values[OCCLUSION] = _F(1)
        for c in range(SMOOTH - COAT):
            values[COAT + c] = floats[p, COAT_FACTORS + c]
    smooth = _interpolated(mesh.normals, f, hit, mesh)
    normal = smooth
    if mesh.slots > 0:
        shown = _apply_textures(f, p, hit, side, view, mesh, values)
        if mesh.ints[p, NORMAL_SLOT] >= 0:
            normal = _bent_normal(smooth, shown, f, p, hit, mesh)
    if mesh.ints[p, MODE] == 0:
        values[COVERED] = 1
    elif mesh.ints[p, MODE] == CUT_OUT:
        values[COVERED] = values[COVERED] >= floats[p, CUTOFF]
    _write_normal(NORMAL, normal, hit, f, mesh, values)
    if values.shape[0] > PLAIN_COLUMNS:
        _write_normal(SMOOTH, smooth, hit, f, mesh, values)


@line_kernel(error_model="numpy", fastmath=FAST)
def add_surfaces(
    rays: Rays, view: View, mesh: SurfaceTables, values, sums
):  # pragma: no cover
    """Add what rays meet to their pixels' sums (n, columns), and take it off what rays let pass.

    values : (columns,) float32, scratch"""
    for ray in range(rays.face.shape[0]):
        if rays.face[ray] < 0:
            continue
        f, pixel = np.uintp(rays.face[ray]), np.uintp(rays.pixel[ray])
        hit = _hit(f, rays.x[ray], rays.y[ray], view, mesh)
        rays.reached[ray] = hit.z
        p = np.uintp(mesh.part[f])
        if hit.facing > 0 and mesh.ints[p, TWO_SIDED] == 0:
            continue
        share = rays.share[ray]
        _write_surface(f, hit, np.sqrt(share), view, mesh, values)
        alpha = values[COVERED]
        if alpha <= _F(CLEAR):
            continue
        if rays.part[ray] < 0:
            rays.part[ray], rays.depth[ray] = p, hit.z
            sums[pixel, MET] += share
        weight = share * rays.clear[ray] * alpha
        rays.clear[ray] *= _F(1) - alpha
        sums[pixel, COVERED] += weight
        for c in range(ALBEDO, values.shape[0]):
            sums[pixel, c] += weight * values[c]


@kernel()
def merged_by_face(face, x, y):  # pragma: no cover - compiled
    """Samples of a pixel that meet the same face as one ray, in their mean direction: what a face
    has is linear on it. face, x, y : (n, s)

    Returns pixel, face, x, y, share of the rays that meet anything, as `Rays` has them."""
    most, samples = face.size, face.shape[1]
    pixel, out_face = np.empty(most, np.int64), np.empty(most, np.int32)
    out_x, out_y, out_share = (
        np.empty(most),
        np.empty(most),
        np.empty(most, np.float32),
    )
    count = np.uintp(0)
    for a in range(face.shape[0]):
        start = count
        for b in range(samples):
            if face[a, b] < 0:
                continue
            out_face[count] = face[a, b]
            m = start
            while out_face[m] != face[a, b]:
                m += np.uintp(1)
            if m == count:
                pixel[m], out_x[m], out_y[m], out_share[m] = a, 0, 0, 0
                count += np.uintp(1)
            out_x[m] += x[a, b]
            out_y[m] += y[a, b]
            out_share[m] += 1
        for m in range(start, count):
            out_x[m] /= out_share[m]
            out_y[m] /= out_share[m]
            out_share[m] /= samples
    return (
        pixel[:count],
        out_face[:count],
        out_x[:count],
        out_y[:count],
        out_share[:count],
    )


@line_kernel(error_model="numpy", fastmath=FAST)
def resolve(
    pixels, part, depth, sums, view: View, out: GBuffer
):  # pragma: no cover - compiled
    """Write pixels (n,), numbered within `out`, from their sums; those that meet nothing stay.

    part, depth : (n,), of the surface that their centre sees, or the ray next to it"""
    width = np.int64(out.coverage.shape[1])
    for a in range(pixels.shape[0]):
        covered = sums[a, COVERED]
        if part[a] < 0 or not covered > 0:
            continue
        y, x = np.uintp(pixels[a] // width), np.uintp(pixels[a] % width)
        row, column = y + np.uintp(MARGIN), x + np.uintp(MARGIN)
        ray = _in_world(view.rotation, view.x[row, column], view.y[row, column])
        z, inverse = depth[a], _F(1) / covered
        out.coverage[y, x] = min(covered, _F(1))
        out.depth[y, x], out.object_id[y, x] = z, part[a] + 1
        normal = vector(sums[a, NORMAL : NORMAL + 3])
        length = np.sqrt(dot(normal, normal))
        if (
            length < _F(1e-6) * covered
        ):  # opposite sides cancel: straight towards the camera
            normal, length = scaled(_F(-1), ray), np.sqrt(dot(ray, ray))
        for c in range(3):
            out.normal[y, x, c] = normal[c] / length
            out.position[y, x, c] = _F(view.eye[c] + z * ray[c])
            out.albedo[y, x, c] = sums[a, ALBEDO + c] * inverse
            out.material[y, x, c] = sums[a, MATERIAL + c] * inverse
            out.emissive[y, x, c] = sums[a, EMISSIVE + c] * inverse
        out.material[y, x, 3] = min(covered / sums[a, MET], _F(1))
