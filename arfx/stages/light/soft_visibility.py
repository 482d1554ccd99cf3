"""What the object, and its own shadow on the plane, hide of the soft light from each place
of the object.

The soft light's radiance rises evenly towards one side, 1 + shape . d (`beams.FrameLight`),
so what is hidden is the sum of four parts, of 1 and of the three coordinates of d. Rays
from surfels find them once a clip; a light sums the parts.
Cost: O(surfels x rays) a clip, O(covered pixels) a frame. Leaves out: light from the object
onto itself.
`reference` sends rays from every pixel. Source: docs/methods/light.md#shading."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.memo import memo_of
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.stages.light.plane_lookup import PlaneTexture
from arfx.stages.light.surface_grid import SurfaceGrid
from arfx.stages.light.surfels import Hits, ObjectRays, surfels_of

DIFFUSE_RISE = (
    2 / 3
)  # of the light's rise towards one side that is left in the light on a surface
LEAST_SEEN = (
    1e-3  # of the hemisphere: a surfel counts by what it sees, as cameras see it
)
_CELLS, _SURFELS, _RAYS = 32, 16_000, 48
_PIXEL_RAYS = 400  # of level reference
_PLACEMENTS = 4  # of one model, whose grids are kept
_NOWHERE_M = 1e9


@dataclass(frozen=True, eq=False)
class SoftVisibility:
    """grid, parts (z, y, x, 4) : hidden light of 1 and of the three coordinates, anchor axes"""

    grid: SurfaceGrid
    parts: ndarray

    def under(self, shape: tuple[float, float, float]) -> ndarray:
        """(z, y, x, 1) float32: what is hidden of a soft light of this shape."""
        return np.ascontiguousarray(
            self.parts @ np.array([1.0, *shape], np.float32)[:, None]
        )


def hidden_parts(hits: Hits, plane: PlaneTexture) -> ndarray:
    """(n, 4) of the light on a surface that is hidden: of 1 and of the three coordinates.

    plane : what the plane is darkened by, as `soft_picture`"""
    directions, starts = hits.directions, hits.starts
    down = np.maximum(-directions[..., 2], 1e-6)
    # from under the plane, where it is not seen: no seam
    along = np.abs(starts[..., 2]) / down
    meets = (directions[..., 2] < 0)[..., None]
    places = starts[..., :2] + along[..., None] * directions[..., :2]
    (sx, _, x0), (_, sy, y0) = plane.texel_from_m
    texels = np.where(meets, places, _NOWHERE_M) * [sx, sy] + [x0, y0]
    x, y = np.moveaxis(texels.clip(-9, 9e3).astype(np.float32), -1, 0)
    dark = cv2.remap(
        plane.dark[0],
        x.copy(),
        y.copy(),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
    )
    weight = np.where(hits.face >= 0, 1, dark)
    count = directions.shape[1]
    moments = (weight[..., None] * directions).sum(1)
    return np.column_stack([weight.sum(1), moments]) / count


def soft_visibility(
    scene: Scene, rays: ObjectRays, plane: PlaneTexture
) -> SoftVisibility:
    """Kept with the model. plane : of `hidden_parts`"""

    def make() -> SoftVisibility:
        surfels = surfels_of(rays, _SURFELS)
        traced = rays.over(surfels.points, surfels.normals, _RAYS)
        parts = np.concatenate([hidden_parts(hits, plane) for hits in traced])
        seen = np.maximum(1 - parts[:, 0], LEAST_SEEN)
        grid = SurfaceGrid(
            surfels.points, surfels.normals, surfels.area * seen, _CELLS
        )
        return SoftVisibility(grid, grid.nodes(parts))

    kept: SoftVisibility = memo_of(scene.model).get(
        scene.placed_by, make, "soft visibility", _PLACEMENTS
    )
    return kept


def visible_fraction(
    layers: tuple[ndarray, ndarray, ndarray],
    kept: SoftVisibility,
    nodes: ndarray,
    anchor_from_world: Pose,
    shape: tuple[float, float, float],
) -> ndarray:
    """(h, w) float32, 0..1: the share of the soft light that is left; any where the pixel
    is not covered.

    layers : COVERAGE, NORMAL, POSITION;  nodes : `kept`, under a light of this shape"""
    hidden = kept.grid.read(nodes, *layers, anchor_from_world)[..., 0]
    rise = DIFFUSE_RISE * anchor_from_world.rotation.T @ np.array(shape)
    light = 1 + (layers[1].reshape(-1, 3) @ rise.astype(np.float32)).reshape(
        hidden.shape
    )
    return np.asarray(
        np.clip(1 - hidden / np.maximum(light, LEAST_SEEN), 0, 1), np.float32
    )


def visible_fraction_by_rays(
    layers: tuple[ndarray, ndarray, ndarray],
    rays: ObjectRays,
    plane: PlaneTexture,
    anchor_from_world: Pose,
    shape: tuple[float, float, float],
) -> ndarray:
    """The same, with rays from every pixel."""
    coverage, normal, position = layers
    out = np.ones(coverage.shape, np.float32)
    y, x = np.nonzero((coverage > 0) & (normal != 0).any(-1))
    n = normalise(normal[y, x].astype(float) @ anchor_from_world.rotation.T)
    points = anchor_from_world.apply(position[y, x].astype(float))
    traced = rays.over(points, n, _PIXEL_RAYS, turned=False)
    parts = np.concatenate(
        [np.zeros((0, 4)), *(hidden_parts(hits, plane) for hits in traced)]
    )
    light = 1 + DIFFUSE_RISE * n @ np.array(shape)
    out[y, x] = np.clip(1 - divide(parts @ [1.0, *shape], light), 0, 1)
    return out
