"""Points all over the object that light is gathered at and sent from, and the rays between them.

Rays meet the object's triangles (embree). A triangle that lets light pass stops a ray as
often as it is opaque, so that thin and transparent parts dim what lies behind them. Cost:
O(rays), once a clip."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB
from arfx.core.model import CLAMP, MIRROR, Material
from arfx.core.numerics import normalise
from arfx.core.parallel import parallel_map
from arfx.core.sampling import GOLDEN_RAD, frame_about, hemisphere, r2
from arfx.core.scene import Scene
from arfx.core.scene_mesh import SceneMesh
from arfx.stages.triangles import Triangles, anchor_mesh

_LIFT_EXTENTS = 1e-3  # rays begin that far over the surface
_RAYS_IN_FLIGHT = 1 << 18
_PASSES = 4  # of a ray through parts that let light pass
_PROBES = 8  # rays that tell the inside of a closed surface
_INSIDE = 0.6  # share of them that meets a back face there
# of the extent: a face counts at least as much as a strip of that width as long as its
# longest edge
_STRIP = 0.04
_OPAQUE, _UNSEEN = 0.999, 0.001


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays of some points meet: n points, k rays of each.

    rows : of the points;  starts (n, 1, 3) : metres, where they begin;  directions (n, k, 3) : unit
    face (n, k) : of the object, -1 = none;  distance (n, k) : metres, inf = none"""

    rows: slice
    starts: ndarray
    directions: ndarray
    face: ndarray
    distance: ndarray


class ObjectRays:
    """The object as rays meet it, anchor axes, metres.

    mesh : all of it;  faces, part (f,) : what is seen of it
    corners (f, 3, 3) : triangles;  normals (f, 3) : unit, of their front sides;  opacity,
    metallic (f,) : 0..1
    extent_m : largest side"""

    def __init__(self, scene: Scene) -> None:
        mesh = anchor_mesh(scene)
        opacity = np.array([part.opacity for part in scene.model.parts])[mesh.part]
        seen = opacity > _UNSEEN
        seen |= ~seen.any()
        self.mesh, self.faces, self.part = mesh, mesh.faces[seen], mesh.part[seen]
        self.corners = mesh.corners_m[seen] + mesh.centre_m
        a, b, c = np.moveaxis(self.corners, 1, 0)
        self.across = np.cross(b - a, c - a)
        self.normals = normalise(self.across)
        self.opacity = opacity[seen]
        self.metallic = np.array([_metallic(m) for m in mesh.materials])[self.part]
        self.extent_m = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        self.lift_m = _LIFT_EXTENTS * self.extent_m

    @cached_property
    def triangles(self) -> Triangles:
        return Triangles(self.corners)

    def first_hits(
        self, starts: ndarray, directions: ndarray
    ) -> tuple[ndarray, ndarray]:
        """(face (n,), -1 = none; distance (n,)) of rays (n, 3), through what lets them pass."""
        face, distance, chance = self._first(starts, directions)
        for _ in range(_PASSES):
            through = np.flatnonzero((face >= 0) & (self.opacity[face] < _OPAQUE))
            through = through[chance[through] > self.opacity[face[through]]]
            if not len(through):
                break
            behind = distance[through] + self.lift_m
            moved = starts[through] + behind[:, None] * directions[through]
            face[through], more, chance[through] = self._first(
                moved, directions[through]
            )
            distance[through] = behind + more
        return face, distance

    def _first(
        self, starts: ndarray, directions: ndarray
    ) -> tuple[ndarray, ndarray, ndarray]:
        """(face, distance, a number in 0..1 that depends on the place that is met alone),
        each (n,).
        """
        hits = self.triangles.first_hits(starts, directions)
        place = (
            np.asarray(hits["u"], float) * 12.9898
            + np.asarray(hits["v"], float) * 78.233
        )
        chance = (np.sin(place) * 43758.5453) % 1
        return (
            np.array(hits["primID"], np.int64),
            np.array(hits["tfar"], np.float32),
            chance,
        )

    def open_fraction(self, points: ndarray, directions: ndarray) -> ndarray:
        """(n,) share of `directions` (k, 3) in which nothing stops a ray from points (n, 3)."""
        count = len(directions)
        out = np.zeros(len(points))
        if (self.opacity >= _OPAQUE).all():
            return self.triangles.visible_fraction(points, directions)
        for direction in directions:
            face, _ = self.first_hits(
                points, np.broadcast_to(direction, points.shape)
            )
            out += (face < 0) / count
        return out

    def over(
        self, points: ndarray, normals: ndarray, count: int, turned: bool = True
    ) -> Iterator[Hits]:
        """Rays over the hemispheres of points (n, 3), as dense as the cosine, `count` of each.

        turned : each point turns their pattern by its number, so that what few rays leave
        is noise and no bands
        """
        step = max(_RAYS_IN_FLIGHT // count, 1)
        local = hemisphere(count).astype(np.float32)

        def part(first: int) -> Hits:
            rows = slice(first, min(first + step, len(points)))
            numbers = turned * np.arange(rows.start, rows.stop)
            angle = (numbers * GOLDEN_RAD)[:, None].astype(np.float32)
            x = np.cos(angle) * local[:, 0] - np.sin(angle) * local[:, 1]
            y = np.sin(angle) * local[:, 0] + np.cos(angle) * local[:, 1]
            n = normals[rows].astype(np.float32)
            u, v = frame_about(n)
            directions = x[..., None] * u[:, None] + y[..., None] * v[:, None]
            directions = (directions + local[:, 2:] * n[:, None]).astype(np.float32)
            starts = (points[rows] + self.lift_m * normals[rows]).astype(np.float32)[
                :, None
            ]
            origins = np.broadcast_to(starts, directions.shape).reshape(-1, 3)
            face, distance = self.first_hits(origins, directions.reshape(-1, 3))
            distance = np.where(face >= 0, distance, np.float32(np.inf))
            shape = directions.shape[:2]
            return Hits(
                rows, starts, directions, face.reshape(shape), distance.reshape(shape)
            )

        yield from parallel_map(part, range(0, len(points), step))


@dataclass(frozen=True, eq=False)
class Surfels:
    """Points of the object, each of the side that it is seen from. Anchor axes.

    points, normals (n, 3) : metres, unit, of their triangles: rays over a smooth normal
    would pass under them face (n,) : the triangle albedo, matt, emission (n, 3) : of light
    that leaves in all directions, mirrored light counted as such, and without
    area (n,) : of the surface that each stands for, the largest 1"""

    points: ndarray
    normals: ndarray
    face: ndarray
    area: ndarray
    albedo: ndarray
    matt: ndarray
    emission: ndarray


def surfels_of(rays: ObjectRays, count: int) -> Surfels:
    """About `count`, evenly over the surface, more on thin faces: on both sides, but for
    the inside of what is closed.
    """
    edges = np.linalg.norm(rays.corners - np.roll(rays.corners, 1, 1), axis=2).max(1)
    # thin faces have some along all of their length
    area = np.linalg.norm(rays.across, axis=1) / 2
    counted = area + _STRIP * rays.extent_m * edges
    upto = np.cumsum(counted)
    i = np.arange(count) + 0.5
    face = np.minimum(np.searchsorted(upto, i / count * upto[-1]), len(upto) - 1)
    u, v = r2(count).T
    folded = u + v > 1
    u, v = np.where(folded, 1 - u, u), np.where(folded, 1 - v, v)
    weights = np.column_stack([1 - u - v, u, v])
    points = (weights[:, :, None] * rays.corners[face]).sum(1)
    normals = rays.normals[face]
    colours = _colours(rays, face, weights)
    front, back = (
        _seen_from_outside(rays, points, side * normals) for side in (1, -1)
    )
    through = rays.opacity[face] < _OPAQUE  # its inside shows
    front, back = front | through, back | through
    front |= ~(front | back)  # a sliver between others: counted once
    keep = np.concatenate([np.flatnonzero(front), np.flatnonzero(back)])
    side = np.repeat([1.0, -1.0], [front.sum(), back.sum()])[:, None]
    share = (area / counted)[face[keep]]
    return Surfels(
        points[keep],
        side * normals[keep],
        face[keep],
        share,
        *(c[keep] for c in colours),
    )


def _seen_from_outside(
    rays: ObjectRays, points: ndarray, normals: ndarray
) -> ndarray:
    """(n,) whether the rays of a side meet fewer back faces than they would inside of something."""
    out = np.empty(len(points), bool)
    for hits in rays.over(points, normals, _PROBES):
        facing = (rays.normals[hits.face] * hits.directions).sum(-1)
        backs = ((hits.face >= 0) & (facing > 0)).mean(1)
        out[hits.rows] = backs < _INSIDE
    return out


def _colours(
    rays: ObjectRays, face: ndarray, weights: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """(albedo, matt, emission) (n, 3) at places in faces, by their corners' weights (n, 3)."""
    mesh, part = rays.mesh, rays.part[face]
    colour, emission, _ = shown_colours(mesh, rays.faces[face], part, weights)
    metallic = rays.metallic[face, None]
    specular = np.array([m.specular for m in mesh.materials])[part, None]
    mirrored = 0.08 * specular * (1 - metallic)
    matt = colour * (1 - metallic) * (1 - mirrored)
    return matt + colour * metallic + mirrored, matt, emission


def shown_colours(
    mesh: SceneMesh, corners: ndarray, part: ndarray, weights: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """(base colour (n, 3), emission (n, 3), texture coordinates (n, 4)) at places of parts
    (n,), by their corners (n, 3) and the weights of these (n, 3)."""
    colour, uv = (
        np.einsum("nk,nkc->nc", weights, rows[corners])
        for rows in (mesh.colours[:, :3], mesh.uv)
    )
    materials = mesh.materials
    colour *= np.array([m.base_colour[:3] for m in materials])[part]
    emission = np.array([m.emissive for m in materials])[part]
    base, glow = (
        SRGB.decode(texels_of(mesh, name, part, uv)[:, :3] / 255)
        for name in ("base_texture", "emissive_texture")
    )
    return colour * base, emission * glow, uv


def _metallic(material: Material) -> float:
    """Mean of a part, 0..1."""
    texture = material.metallic_roughness_texture
    mean = 1.0 if texture is None else float(texture.picture[..., 2].mean()) / 255
    return material.metallic * mean


def texels_of(mesh: SceneMesh, name: str, part: ndarray, uv: ndarray) -> ndarray:
    """(n, 4) uint8 nearest texels of the texture `name` at places of parts (n,), by their
    coordinates uv (n, 4); 255 where a part has none."""
    out = np.full((len(part), 4), 255, np.uint8)
    for k, material in enumerate(mesh.materials):
        texture = material.textures.get(name)
        if texture is not None and mesh.has_uv[k, texture.uv_set]:
            rows, first = part == k, 2 * texture.uv_set
            matrix, size = texture.picture_from_uv, texture.picture.shape[1::-1]
            places = uv[rows, first : first + 2] @ matrix[:, :2].T + matrix[:, 2]
            column, row = (
                np.minimum(wrapped(t, wrap) * n, n - 1).astype(int)
                for t, wrap, n in zip(places.T, texture.wrap, size, strict=True)
            )
            out[rows] = texture.picture[row, column]
    return out


def wrapped(t: ndarray, wrap: str) -> ndarray:
    """(n,) 0..1 where a picture is read that is laid at t (n,)."""
    if wrap == CLAMP:
        return np.clip(t, 0, 1)
    if wrap == MIRROR:
        return 1 - np.abs(1 - t % 2)
    return t % 1
