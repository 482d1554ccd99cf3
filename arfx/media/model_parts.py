"""What all model files share: triangles under their node's transform made into a part of the
model; colours, and materials whose numbers are in range.

Vertex normals for files that bring none: smooth across flat edges, sharp across the others.

Linear in the number of faces: corners that share a vertex are joined across each flat edge, and
every joined group gets one normal, weighted by corner angle (Thuermer and Wuethrich 1998).

Tangents of vertices that a normal texture needs, where a file brings none: those of MikkTSpace.

glTF 2.0 section 3.7.2.1 asks for them: programs that bake normal textures use them too. Corners
of one vertex (same place, normal and texture coordinates) are joined across edges to faces that
the picture covers the same way round. Each group gets the mean of its faces' directions along the
picture's rows, laid into the plane of the vertex normal and weighted by corner angle.
Source: Mikkelsen 2008, Simulation of Wrinkled Surfaces Revisited, chapter 2.

Leaves out: a face that the picture covers with no area joins no group, its tangents lie anyhow
across the normals (in MikkTSpace it takes after the neighbour that comes first)."""

from dataclasses import replace

import numpy as np
from numpy import ndarray
from PIL import Image

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, MASK, OPAQUE, Material, Part
from arfx.core.numerics import angle_between, divide, normalise, same_rows
from arfx.core.scene_mesh import across
from arfx.errors import InputError

# Squared double area below which a triangle has no plane, as a fraction of the model's extent to
# the fourth power: float32 coordinates are exact to 6e-8 of the extent, a height below is rounding.
_DEGENERATE = (6e-8) ** 4
_BRIGHTEST = 1e6  # emission, where white paper in full light is 1
_UNIT = (
    "metallic",
    "roughness",
    "clearcoat",
    "clearcoat_roughness",
    "sheen_roughness",
)
CREASE_DEG = 40.0


Rows = dict[str, ndarray]
Placed = tuple[ndarray, Rows, ndarray, Material]  # what `part_of` takes


def part_of(
    faces: ndarray, given: Rows, model_from_mesh: ndarray, material: Material
) -> Part | None:
    """A part of the model, without faces that have no area; None where none is left.

    faces : (m, 3) int, of one material
    given : by name what each vertex has, in the mesh's own axes: "vertices" (n, 3), and where the
        file gives them "normals", "uv", "second_uv", "colours", "tangents", as of core.model.Part;
        unusable ones are left out
    model_from_mesh : (4, 4)
    Raises InputError: faces of vertices that there are not, numbers that are not finite."""
    if not len(faces):
        return None
    rows, linear = dict(given), model_from_mesh[:3, :3]
    rows["vertices"] = rows["vertices"] @ linear.T + model_from_mesh[:3, 3]
    count = len(rows["vertices"])
    if not 0 <= faces.min() <= faces.max() < count:
        raise InputError(
            f"faces refer to vertex {faces.max()}, there are {count}",
            "the file is damaged",
        )
    if bad := int((~np.isfinite(rows["vertices"])).any(1).sum()):
        raise InputError(
            f"{bad} of {count} vertices are not finite numbers",
            "export it again; look for NaN or inf",
        )
    rows = _usable(rows)
    side = float(np.sign(np.linalg.det(linear))) or 1.0
    if side < 0:  # a mirror turns every triangle inside out
        faces = faces[:, ::-1]
    corners = rows["vertices"][faces]
    least = _DEGENERATE * float(np.ptp(corners, axis=(0, 1)).max()) ** 4
    faces = faces[(across(corners) ** 2).sum(1) > least]
    if not len(faces):
        return None
    own = {}  # what corners have, whatever vertex they are of
    if "normals" in rows:
        # the inverse transpose turns normals rightly under any matrix; times the determinant
        # it is there for every one, and a mirror's turns them inwards
        cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
        rows["normals"] = normalise(rows["normals"] @ (side * cofactors).T)
    if "normals" not in rows or not rows["normals"][faces].any(-1).all():
        rows.pop("tangents", None)  # they belong to the file's normals
        rows.pop("normals", None)
        if len(rows) == 1:  # nothing else keeps vertices at one place apart
            first, number = same_rows(rows["vertices"])
            rows, faces = {"vertices": rows["vertices"][first]}, number[faces]
        own["normals"] = corner_normals(rows["vertices"], faces)
    if "tangents" in rows:
        along = normalise(rows["tangents"][:, :3] @ linear.T)
        signs = side * np.sign(rows["tangents"][:, 3])
        rows["tangents"] = np.column_stack([along, signs])
    part = _indexed(faces, rows, own, material)
    texture = material.normal_texture or material.clearcoat_normal_texture
    uv = None if texture is None else part.uv_on(texture)
    if uv is None:
        return replace(part, tangents=None)
    if part.tangents is not None:
        return part
    tangents = corner_tangents(part.vertices, part.faces, part.normals, uv)
    return _indexed(faces, rows, own | {"tangents": tangents}, material)


def _usable(rows: Rows) -> Rows:
    """Those of the right length, with all numbers finite; of texture coordinates single ones may
    be 0."""
    out = {}
    for name, values in rows.items():
        finite = np.isfinite(values).all(1, keepdims=True)
        if len(values) == len(rows["vertices"]) and (
            name.endswith("uv") or finite.all()
        ):
            out[name] = np.where(finite, values, 0.0)
    return out


def _indexed(
    faces: ndarray,
    rows: Rows,
    own: Rows,
    material: Material,
) -> Part:
    """Of those vertices that faces use, once for all corners that have the same of their own.

    rows : (n, k) of vertices;  own : (3 m, k) of the corners of faces (m, 3)"""
    corners = faces.ravel()
    first, number = same_rows(np.column_stack([corners, *own.values()]))
    shared = {name: values[corners[first]] for name, values in rows.items()}
    split = {name: values[first] for name, values in own.items()}
    numbers = number.reshape(-1, 3).astype(np.int32)
    return Part(faces=numbers, material=material, **(shared | split))


def plain_material(has_colours: bool, double_sided: bool) -> Material:
    """Of a mesh that has none: light grey, white where vertices have colours of their own."""
    grey = 1.0 if has_colours else 0.8
    return Material(base_colour=(grey, grey, grey, 1.0), double_sided=double_sided)


def shares(values: ndarray) -> ndarray:
    """Whole numbers as shares of the largest one, at least -1; floats as they are."""
    if values.dtype.kind == "f":
        return values
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)


def unit_colours(values: ndarray) -> ndarray:
    """(n, 4) between 0 and 1 of red, green, blue and maybe alpha (n, 3 or 4), whole numbers as
    `shares`; what is no number leaves a colour alone."""
    out = np.ones((len(values), 4))
    out[:, : values.shape[1]] = np.nan_to_num(
        shares(values), nan=1, posinf=1, neginf=1
    )
    return np.clip(out, 0.0, 1.0)


def linear_colours(display: ndarray) -> ndarray:
    """(n, 4) of display colours (sRGB) as `unit_colours` takes them."""
    out = unit_colours(display)
    out[:, :3] = SRGB.decode(out[:, :3])
    return out


def resized(picture: ndarray, wide: int, high: int) -> ndarray:
    """A picture (h, w, 4) uint8 of another size."""
    return np.asarray(Image.fromarray(picture).resize((wide, high)))


def checked(material: Material) -> Material:
    """The same, what is a share between 0 and 1, and opaque where its alpha mode is none.

    Raises InputError: one of its numbers is out of range; ValueError: a colour has too few or
    too many."""
    colours = (material.base_colour, material.emissive, material.sheen_colour)
    if [len(colour) for colour in colours] != [4, 3, 3]:
        raise ValueError
    numbers = [
        np.ravel(x) for x in vars(material).values() if isinstance(x, (float, tuple))
    ]
    numbers += [t.picture_from_uv.ravel() for t in material.textures.values()]
    if not (np.abs(np.concatenate(numbers)) <= _BRIGHTEST).all():
        what = (
            f"material {material.name!r} holds numbers that are not finite, or above"
        )
        raise InputError(f"{what} {_BRIGHTEST:g}", "export it again")
    mode = material.alpha_mode.upper()
    shares = {name: min(max(getattr(material, name), 0.0), 1.0) for name in _UNIT}
    return replace(
        material, alpha_mode=mode if mode in (MASK, BLEND) else OPAQUE, **shares
    )


def corner_normals(vertices: ndarray, faces: ndarray) -> ndarray:
    """(3 m, 3) unit, of the corners of faces.

    vertices : (n, 3), those at the same place count as one;  faces : (m, 3) int, none without area
    """
    p = vertices[faces]
    flat = normalise(across(p))
    place = same_rows(vertices)[1][faces]
    a, b = _shared_edges(place)
    smooth = (flat[a // 3] * flat[b // 3]).sum(1) > np.cos(np.radians(CREASE_DEG))
    along = flat[:, None]
    out = _smoothed(place, a[smooth], b[smooth], p, along, along)
    # opposite faces cancel: each keeps its own
    return np.where(out.any(1, keepdims=True), out, np.repeat(flat, 3, 0))


def corner_tangents(
    vertices: ndarray,
    faces: ndarray,
    normals: ndarray,
    uv: ndarray,
) -> ndarray:
    """(3 m, 4) of the corners of faces (m, 3), as of core.model.Part.

    vertices : (n, 3);  normals : (n, 3) unit;  uv : (n, 2) on the normal texture, v = 0 on top
    """
    p, n = vertices[faces], normals[faces]
    t = uv[faces] * (1, -1)  # v upwards, as the sign of a tangent counts it
    (u1, u2), (v1, v2) = (t[:, 1:] - t[:, :1]).T
    side = np.asarray(np.sign(u1 * v2 - v1 * u2))
    edge1, edge2 = np.moveaxis(p[:, 1:] - p[:, :1], 1, 0)
    along_u = side[:, None] * (v2[:, None] * edge1 - v1[:, None] * edge2)
    along_u = normalise(divide(along_u, np.abs(along_u).max(1, keepdims=True)))
    side[~along_u.any(1)] = 0  # the picture covers it with no area
    place = same_rows(np.concatenate([vertices, normals, uv], 1))[1][faces]
    a, b = _shared_edges(place)
    joined = (side[a // 3] * side[b // 3] > 0) & (place.flat[a] != place.flat[b])
    directions = _in_plane(along_u[:, None], n)
    tangents = _smoothed(place, a[joined], b[joined], p, n, directions)
    normal = n.reshape(-1, 3)
    anyhow = _in_plane(np.eye(3)[np.abs(normal).argmin(1)], normal)
    tangents = np.where(tangents.any(1, keepdims=True), tangents, anyhow)
    return np.column_stack([tangents, np.repeat(np.where(side == 0, 1.0, side), 3)])


def _shared_edges(place: ndarray) -> tuple[ndarray, ndarray]:
    """Corners (e,) and (e,) from which two faces run along one edge, each towards its next corner.

    place : (m, 3) int, number of each corner's place"""
    edge = np.sort(np.stack([place, np.roll(place, -1, 1)], -1).reshape(-1, 2), 1)
    order = np.lexsort(edge.T[::-1])
    same = (edge[order[1:]] == edge[order[:-1]]).all(1)  # sorted, equal ones meet
    return order[:-1][same], order[1:][same]


def _smoothed(
    place: ndarray,
    a: ndarray,
    b: ndarray,
    p: ndarray,
    normals: ndarray,
    directions: ndarray,
) -> ndarray:
    """(3 m, 3) mean directions of corners that belong together, weighted by corner angle.

    place : as of `_shared_edges`;  a, b : those edges across which corners belong together
    p : (m, 3, 3);  normals : (m, 3, 3) or (m, 1, 3);  directions : likewise, unit"""
    from trimesh.graph import connected_component_labels

    end = np.roll(np.arange(place.size).reshape(-1, 3), -1, 1).ravel()
    opposite = place.flat[a] != place.flat[b]
    there = np.where(opposite, [end[b], b], [b, end[b]])
    links = np.stack([[a, end[a]], there], -1).reshape(-1, 2)
    group = connected_component_labels(links, node_count=place.size)
    # turned by a quarter, in the plane of the normals
    sides = (np.cross(normals, np.roll(p, k, 1) - p) for k in (-1, 1))
    weighted = angle_between(*sides)[..., None] * directions
    sums = [np.bincount(group, axis) for axis in weighted.reshape(-1, 3).T]
    return normalise(np.stack(sums, 1))[group]


def _in_plane(v: ndarray, normal: ndarray) -> ndarray:
    """Unit vectors (..., 3) of what of v is across the normal."""
    return normalise(v - normal * (v * normal).sum(-1, keepdims=True))
