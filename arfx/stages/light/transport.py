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

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from arfx.core.cube import on_cube
from arfx.core.light import Light
from arfx.core.numerics import divide, normalise
from arfx.core.sampling import disc, frame_about
from arfx.core.scene import Scene
from arfx.stages.light.planes import BEHIND, Planes, texel_positions, warped
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

    received: np.ndarray
    sent: np.ndarray
    gain: np.ndarray
    spread: np.ndarray
    total: np.ndarray
    left: np.ndarray


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
        met = np.concatenate([(hits.face >= 0).mean(1) for hits in traced])
        # over the anchor's plane, as cameras see a surfel, which counts by that
        seen = np.concatenate(
            [
                ((hits.face < 0) & (hits.directions[..., 2] > 0)).mean(1)
                for hits in traced
            ]
        )
        weights = self.surfels.area * np.maximum(seen, _LEAST_SEEN)
        self.grid = SurfaceGrid(points, normals, weights, level.cells)
        self._node_count = int(np.prod(self.grid.shape))
        self.occluded = self.grid.nodes(met[:, None])
        self.colours = self.grid.nodes(self.surfels.albedo)
        everything = self._node_count + len(self.texels) + 6 * SKY * SKY
        row, met, *_ = self._met(traced, None)
        self._of_surfels = self._shares(row, met, (len(points), everything))
        self._from_around = self._of_surfels[:, self._node_count :]
        count, side = len(self.texels), level.side
        lifted = rays.over(self.texels, self._texel_normals, level.rays)
        own = np.repeat(np.arange(len(planes.axes)), side**2)
        row, met, behind, nearer, of_plane = self._met(lifted, own)
        shape = count, everything
        self._to_object = self._shares(row[nearer], met[nearer], shape)
        self._past_object = self._shares(row[nearer], behind[nearer], shape)
        self._beside = self._without = None
        if len(planes.axes) > 1:
            other = of_plane & ~nearer
            self._beside = self._shares(row[other], behind[other], shape)
            self._without = self._shares(row, behind, shape)
        shares = np.bincount(row[nearer], minlength=count) / level.rays
        self.hidden = shares.reshape(-1, side, side)

    def _met(
        self, traced: Iterable[Hits], own: np.ndarray | None
    ) -> list[np.ndarray]:
        """Of every ray, (rays,) each: its place's row; the column of what it meets, and of
        what it would meet without the object; whether it meets the object, and whether a
        plane is behind. own : as of `_beyond`, of all rows
        """
        parts = []
        for hits in traced:
            behind, distance = self._beyond(
                hits, None if own is None else own[hits.rows]
            )
            nearer, met = hits.distance < distance, behind.copy()
            met[nearer] = self._nodes_met(hits, nearer)
            row = np.repeat(np.arange(hits.rows.start, hits.rows.stop), met.shape[1])
            fields = met, behind, nearer, np.isfinite(distance)
            parts.append([row, *(a.ravel() for a in fields)])
        return [np.concatenate(a) for a in zip(*parts, strict=True)]

    def _shares(
        self, row: np.ndarray, column: np.ndarray, shape: tuple[int, int]
    ) -> csr_array:
        from scipy.sparse import csr_array

        share = np.full(len(row), 1 / self.level.rays, np.float32)
        return csr_array((share, (row, column)), shape=shape)

    def _nodes_met(self, hits: Hits, nearer: np.ndarray) -> np.ndarray:
        """Node of the grid beside each place of the object that rays meet."""
        directions = hits.directions[nearer]
        starts = np.broadcast_to(hits.starts, hits.directions.shape)[nearer]
        normals = self.rays.normals[hits.face[nearer]]
        facing = np.where((normals * directions).sum(1, keepdims=True) > 0, -1.0, 1.0)
        return self.grid.nearest(
            starts + hits.distance[nearer][:, None] * directions, facing * normals
        )

    def _beyond(
        self, hits: Hits, own: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(column (n, k), distance (n, k)) of the plane or sky that rays meet without the object.

        own (n,) : the plane on which a place lies, which its rays do not meet"""
        first_sky = self._node_count + len(self.texels)
        column = first_sky + sky_texels(hits.directions)
        nearest = np.full(column.shape, np.inf, np.float32)
        for k, axes in enumerate(self.planes.axes):
            down = -(hits.directions @ axes[3])
            height = (hits.starts - axes[0]) @ axes[3]
            distance = np.maximum(height, 0) / np.maximum(down, 1e-6)
            meets = (down > 1e-6) & (distance < nearest)
            meets &= height > -BEHIND * self.planes.half_m
            if own is not None:
                meets &= (own != k)[:, None]
            row, ray = np.nonzero(meets)
            place = hits.starts[row, 0] - axes[0]
            place = place + distance[row, ray][:, None] * hits.directions[row, ray]
            u, v = place @ axes[1], place @ axes[2]
            x0, y0, x1, y1 = self.planes.bounds[k]
            inside = (u >= x0) & (v >= y0) & (u <= x1) & (v <= y1)
            row, ray, u, v = row[inside], ray[inside], u[inside], v[inside]
            column[row, ray] = self._node_count + self._texel(k, u, v)
            nearest[row, ray] = distance[row, ray]
        return column, nearest

    def _texel(self, plane: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Number of the texel of a plane at places, metres along its axes; the outermost
        beyond it.
        """
        side, half = self.level.side, self.planes.half_m
        x, y = (warped(np.clip(a / half, -1, 1)) for a in (u, v))
        column = np.minimum((x + 1) / 2 * side, side - 1).astype(int)
        row = np.minimum((y + 1) / 2 * side, side - 1).astype(int)
        return np.asarray((plane * side + row) * side + column)

    def solve(
        self, scene: Scene, light: Light, picture: np.ndarray, sky: np.ndarray
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
        undisturbed = _stacked(unseen, picture, sky)
        if self._without is not None:
            soft = light.soft_radiance(normals)
            total = np.maximum(
                alone + self._without @ undisturbed - soft, _LEAST_TOTAL
            )
            # a lamp's shadow on the first plane is drawn as if no other plane hid soft
            # light that is left in it
            first = np.arange(len(total)) < self.level.side**2
            extra = np.where(first[:, None], shadow * (total / alone - 1), 0)
        base = 1 - np.minimum(shadow / total, 1)
        lost = self._past_object @ undisturbed
        direct = surfels.matt * on_surfels + surfels.emission
        sent, left, gain = direct, base, -lost
        received = np.zeros_like(sent)
        for _ in range(self.level.bounces + 1):
            nodes = self.grid.nodes(sent).reshape(-1, 3)
            arriving = _stacked(nodes, picture * left, sky)
            received = self._of_surfels @ arriving
            gain = self._to_object @ arriving - lost
            if self._beside is not None:
                beside = self._beside @ _stacked(
                    unseen, picture * (left - 1), np.zeros_like(sky)
                )
            left = np.clip(base + divide(gain + beside, total), 0, None)
            before, sent = sent, surfels.albedo * received + direct
            if np.abs(sent - before).max() <= _SETTLED * sent.max():
                break
        fields = (gain, beside + extra, total, left)
        return Indirect(
            received, sent, *(np.reshape(field, shape) for field in fields)
        )

    def more_from_around(self, picture: np.ndarray, sky: np.ndarray) -> np.ndarray:
        """(n, 3) light on surfels by changes of the planes' radiance and of the sky's; as `solve`
        takes them."""
        return np.asarray(
            self._from_around @ np.concatenate([picture, sky], dtype=np.float32)
        )

    def _lamps(self, scene: Scene, light: Light) -> tuple[np.ndarray, np.ndarray]:
        """(light on surfels (n, 3), light that texels lose (m, 3)), of white surfaces, by
        lamps alone.
        """
        turn, rays, surfels = (
            scene.world_from_anchor.rotation.T,
            self.rays,
            self.surfels,
        )
        points = surfels.points + rays.lift_m * surfels.normals
        texels = self.texels + rays.lift_m * self._texel_normals
        on_surfels, shadow = (
            np.zeros(surfels.points.shape),
            np.zeros(self.texels.shape),
        )
        for lamp in light.lights:
            towards, rgb = turn @ lamp.unit, np.clip(lamp.rgb, 0, None)
            if not np.isfinite(rgb).all() or not rgb.any() or towards[2] <= 0:
                continue
            radius = np.tan(
                np.radians(np.clip(np.nan_to_num(lamp.angular_size_deg), 0, 90) / 2)
            )
            u, v = frame_about(towards)
            spots = radius * disc(_LAMP_RAYS)
            many = normalise(towards + spots[:, :1] * u + spots[:, 1:] * v)
            facing = np.clip(surfels.normals @ towards, 0, None)
            lit = np.flatnonzero(facing)
            facing[lit] *= rays.open_fraction(points[lit], many)
            on_surfels += facing[:, None] * rgb
            rise = np.clip(self._texel_normals @ towards, 0, None)
            shadow += (rise * (1 - rays.open_fraction(texels, many)))[:, None] * rgb
        return on_surfels, shadow


def _stacked(*parts: np.ndarray) -> np.ndarray:
    return np.concatenate(parts).astype(np.float32)


def sky_texels(directions: np.ndarray) -> np.ndarray:
    """(...) number of the texel of a cube of SKY texels a side that directions (..., 3)
    point to.
    """
    face, u, v = on_cube(directions.reshape(-1, 3))
    column = np.minimum((u + 1) / 2 * SKY, SKY - 1).astype(int)
    row = np.minimum((v + 1) / 2 * SKY, SKY - 1).astype(int)
    return np.asarray((face * SKY + row) * SKY + column).reshape(
        directions.shape[:-1]
    )
