"""Light between the object, the real planes and the sky: what each place gets from each
other, by rays, once a clip.

Places are surfels of the object and texels of the planes. Rays over a place's hemisphere,
as dense as the cosine, meet the object, a plane or the sky: each adds its share to a sparse
matrix whose rows sum to 1. A light is then a few products with it. What the object sends is
read at the nodes of a grid over its surface.
Cost: O(rays) a clip, O(entries x bounces) for a new light. Leaves out: caustics, but that
metal sends its mirrored light in
all directions; what lamps light on planes other than by the picture.
Source: Sillion and Puech 1994 (radiosity by Monte Carlo form factors),
docs/methods/gi.md#transport.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from arfx.core.cube import on_cube
from arfx.core.light import Light
from arfx.core.numerics import divide
from arfx.core.sampling import disc
from arfx.core.scene import Scene
from arfx.stages.light.beams import disc_directions, frame_light
from arfx.stages.light.planes import Planes, texel_positions, warped
from arfx.stages.light.surface_grid import SurfaceGrid
from arfx.stages.light.surfels import Hits, ObjectRays, surfels_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

SKY = 8  # texels a side of the cube by which surfels see the sky
_LAMP_RAYS = 8  # of a place to a lamp's disc
_LEAST_SEEN = 0.1  # of the sky: a surfel counts by what it sees, as cameras see it
_SETTLED = 3e-3  # of the brightest surfel: a bounce that brings less is the last
_LEAST_TOTAL = 1e-4  # radiance of a white plane under which it has no light


@dataclass(frozen=True)
class TransportLevel:
    """surfels : of the object, about;  rays : of each place;  side : texels of a plane;
    cells : of the surface's grid
    bounces : of light from place to place, at most"""

    surfels: int
    rays: int
    side: int
    cells: int
    bounces: int


@dataclass(frozen=True, eq=False)
class Indirect:
    """Of one light. received, sent (n, 3) : radiance of white surfels from all but the
    lamps, and what surfels send gain (p, side, side, 3) : radiance that white planes gain
    or lose by the object, but for the lamps' shadow
    spread : the same, by what the object changes on other planes and by the light that these hide
    total : of white planes without the object;  left : share of it that is left, lamps counted too
    """

    received: ndarray
    sent: ndarray
    gain: ndarray
    spread: ndarray
    total: ndarray
    left: ndarray


class Transport:
    """planes : real ones;  rays : of the object

    occluded (z, y, x, 1), colours (z, y, x, 3) : nodes of `grid`, share of the hemisphere
    that the object hides, albedo hidden (p, side, side) : share of a texel's hemisphere in
    which the object is nearest"""

    def __init__(
        self, scene: Scene, planes: Planes, rays: ObjectRays, level: TransportLevel
    ) -> None:
        self.planes, self.rays, self.level = planes, rays, level
        self.surfels = surfels_of(rays, level.surfels)
        points, normals = self.surfels.points, self.surfels.normals
        self.texels = texel_positions(planes, level.side).reshape(-1, 3)
        self._texel_normals = np.repeat(
            planes.axes[:, 3].astype(float), level.side**2, 0
        )
        traced = [*rays.over(points, normals, level.rays)]
        met = np.concatenate([hits.face for hits in traced]) >= 0
        up = np.concatenate([hits.directions[..., 2] for hits in traced]) > 0
        # over the anchor's plane, as cameras see a surfel, which counts by that
        seen = (up & ~met).mean(1)
        weights = self.surfels.area * np.maximum(seen, _LEAST_SEEN)
        self.grid = SurfaceGrid(points, normals, weights, level.cells)
        self._node_count = int(np.prod(self.grid.shape))
        self.occluded = self.grid.nodes(met.mean(1)[:, None])
        self.colours = self.grid.nodes(self.surfels.albedo)
        everything = self._node_count + len(self.texels) + 6 * SKY * SKY
        row, met, *_ = self._met(traced)
        self._of_surfels = self._shares([met], row, (len(points), everything))
        self._from_around = self._of_surfels[:, self._node_count :]
        shape, side = (len(self.texels), everything), level.side
        lifted = rays.over(self.texels, self._texel_normals, level.rays)
        row, met, behind, nearer = self._met(lifted)
        ends = met[nearer], behind[nearer]
        self._change = self._shares(ends, row[nearer], shape)
        self._without = None
        if len(planes.axes) > 1:
            self._without = self._shares([behind], row, shape)
        shares = np.bincount(row[nearer], minlength=shape[0]) / level.rays
        self.hidden = shares.reshape(-1, side, side)

    def _met(self, traced: Iterable[Hits]) -> list[ndarray]:
        """Of every ray, (rays,) each: its place's row; the column of what it meets, and of
        what it would meet without the object; whether it meets the object."""
        parts = []
        for hits in traced:
            behind, distance = self._beyond(hits)
            nearer, met = hits.distance < distance, behind.copy()
            met[nearer] = self._nodes_met(hits, nearer)
            row = np.repeat(np.arange(hits.rows.start, hits.rows.stop), met.shape[1])
            parts.append([row, *(a.ravel() for a in (met, behind, nearer))])
        return [np.concatenate(a) for a in zip(*parts, strict=True)]

    def _shares(
        self, columns: Sequence[ndarray], row: ndarray, shape: tuple[int, int]
    ) -> csr_array:
        """Of rays (n,): the share of each, at the first of `columns`, less it at the second."""
        from scipy.sparse import csr_array

        share = np.full(len(row), 1 / self.level.rays, np.float32)
        shares = np.concatenate([share, -share][: len(columns)])
        entries = np.tile(row, len(columns)), np.concatenate(columns)
        return csr_array((shares, entries), shape=shape)

    def _nodes_met(self, hits: Hits, nearer: ndarray) -> ndarray:
        """Node of the grid beside each place of the object that rays meet."""
        normals = self.rays.normals[hits.face[nearer]]
        facing = (normals * hits.directions[nearer]).sum(1, keepdims=True)
        outer = np.where(facing > 0, -1.0, 1.0) * normals
        return self.grid.nearest(hits.places(nearer, hits.distance), outer)

    def _beyond(self, hits: Hits) -> tuple[ndarray, ndarray]:
        """(column (n, k), distance (n, k)) of the plane or sky that rays meet without the
        object.
        """
        plane, distance = self.planes.first_met(hits.starts, hits.directions)
        column = self._node_count + len(self.texels) + sky_texels(hits.directions)
        met = plane >= 0
        places = self.planes.texture_places(hits.places(met, distance), plane[met])
        # the outermost texel beyond a texture
        side = self.level.side
        across = (warped(np.clip(places, -1, 1)) + 1) / 2 * side
        x, y = np.minimum(across, side - 1).astype(int).T
        column[met] = self._node_count + (plane[met] * side + y) * side + x
        return column, distance

    def solve(
        self, scene: Scene, light: Light, picture: ndarray, sky: ndarray
    ) -> Indirect:
        """picture (p side^2, 3) : radiance of the planes without the object;  sky (6 SKY^2,
        3) : WORLD axes turned to
        the anchor's, as `sky_texels` numbers them"""
        surfels, shape = self.surfels, (*self.hidden.shape, 3)
        on_surfels, shadow = self._lamps(scene, light)
        normals = self._texel_normals @ scene.world_from_anchor.rotation.T
        alone = np.maximum(light.radiance(normals), _LEAST_TOTAL)
        total, extra, beside = alone, np.zeros_like(alone), np.zeros_like(alone)
        unseen = np.zeros((self._node_count, 3), np.float32)
        if self._without is not None:
            soft = light.soft_radiance(normals)
            around = self._without @ _stacked(unseen, picture, sky)
            total = np.maximum(alone + around - soft, _LEAST_TOTAL)
            # a lamp's shadow on the first plane is drawn as if no other plane hid soft
            # light that is left in it
            first = np.arange(len(total)) < self.level.side**2
            extra = np.where(first[:, None], shadow * (total / alone - 1), 0)
        base = 1 - np.minimum(shadow / total, 1)
        direct = surfels.matt * on_surfels + surfels.emission
        sent, left = direct, base
        for _ in range(self.level.bounces + 1):
            nodes = self.grid.nodes(sent).reshape(-1, 3)
            arriving = _stacked(nodes, picture * left, sky)
            received = self._of_surfels @ arriving
            gain = self._change @ arriving
            if self._without is not None:
                change = _stacked(unseen, picture * (left - 1), 0 * sky)
                beside = self._without @ change
            left = np.clip(base + divide(gain + beside, total), 0, None)
            before, sent = sent, surfels.albedo * received + direct
            if np.abs(sent - before).max() <= _SETTLED * sent.max():
                break
        fields = (gain, beside + extra, total, left)
        return Indirect(
            received, sent, *(np.reshape(field, shape) for field in fields)
        )

    def more_from_around(self, picture: ndarray, sky: ndarray) -> ndarray:
        """(n, 3) light on surfels by changes of the planes' radiance and of the sky's; as `solve`
        takes them."""
        return np.asarray(
            self._from_around @ np.concatenate([picture, sky], dtype=np.float32)
        )

    def _lamps(self, scene: Scene, light: Light) -> tuple[ndarray, ndarray]:
        """(light on surfels (n, 3), light that texels lose (m, 3)), of white surfaces, by
        lamps alone.
        """
        rays, surfels = self.rays, self.surfels
        points = surfels.points + rays.lift_m * surfels.normals
        texels = self.texels + rays.lift_m * self._texel_normals
        on_surfels, shadow = np.zeros(points.shape), np.zeros(texels.shape)
        lamps = frame_light(light, scene.world_from_anchor, False, True)
        for beam, rgb in zip(lamps.beams, lamps.rgb, strict=True):
            towards = np.array(beam.direction)
            if towards[2] <= 0:
                continue
            many = disc_directions(beam, disc(_LAMP_RAYS), over_plane=False)
            facing = np.clip(surfels.normals @ towards, 0, None)
            lit = np.flatnonzero(facing)
            facing[lit] *= rays.open_fraction(points[lit], many)
            on_surfels += facing[:, None] * rgb
            rise = np.clip(self._texel_normals @ towards, 0, None)
            shadow += (rise * (1 - rays.open_fraction(texels, many)))[:, None] * rgb
        return on_surfels, shadow


def _stacked(*parts: ndarray) -> ndarray:
    return np.concatenate(parts).astype(np.float32)


def sky_texels(directions: ndarray) -> ndarray:
    """(...) number of the texel of a cube of SKY texels a side that directions (..., 3)
    point to.
    """
    face, *across = on_cube(directions.reshape(-1, 3))
    column, row = np.minimum((np.stack(across) + 1) / 2 * SKY, SKY - 1).astype(int)
    return np.asarray((face * SKY + row) * SKY + column).reshape(
        directions.shape[:-1]
    )
