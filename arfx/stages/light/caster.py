"""The model as something that casts shadows: triangles in the axes of the plane that it
stands on.
"""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.numerics import arccos, divide, normalise, same_rows
from arfx.core.sampling import sphere
from arfx.core.scene import Scene
from arfx.stages.triangles import anchor_mesh

_SUNK = 1e-6  # of the extent: what lies less than this below the plane is rounding
_WELD_DISTANCE = 1e-6  # of the extent: a seam's two vertices differ by rounding
# of the extent; facets that stand off further are not taken for a smooth surface
_COARSEST_SAG = 0.02
_HULL_POINTS = 64
_FREED = 2000  # vertices of a hull, at most, that are freed of those on its faces


@dataclass(frozen=True, eq=False)
class Caster:
    """Axes of the anchor: z out of the plane, metres.

    vertices (n, 3) float32, faces (m, 3) int32 : every triangle
    above (m', 3) int32, above_vertices (n', 3) : those over the plane, cut where they pass
    through it
    edges (e, 5) int32 : of those, see `_edges`;  across (3, m') float32 : their normals, as
    long as twice their area
    outline (k, 3) float64 : points whose hull holds everything above the plane
    extent_m : largest side;  height_m : highest point over the plane, >= 0
    sag_m, facet_slope : how far flat facets lie below the smooth surface of their normals,
    and by what slope
    opacity : of its shadow"""

    vertices: ndarray
    faces: ndarray
    above_vertices: ndarray
    above: ndarray
    edges: ndarray
    across: ndarray
    outline: ndarray
    extent_m: float
    height_m: float
    sag_m: float
    facet_slope: float
    opacity: float = 1.0

    def cast(self, towards: ndarray) -> ndarray:
        """(k n, 2) metres on the plane: the outline's shadows by lights in directions (k, 3)."""
        slopes = towards[:, None, :2] / towards[:, None, 2:]
        return (self.outline[:, :2] - slopes * self.outline[:, 2:]).reshape(-1, 2)


def make_caster(scene: Scene) -> Caster:
    """All parts of the scene's model together, less those that are less than half as opaque
    as the most opaque one.
    """
    mesh = anchor_mesh(scene)
    vertices = mesh.vertices + mesh.centre_m
    opacities = np.array([p.opacity for p in scene.model.parts])
    opacity = float(opacities.max())
    every = mesh.faces[opacities[mesh.part] >= opacity / 2]
    used = vertices[np.unique(every)]
    extent = float(np.ptp(used, axis=0).max())
    sunk = (used[:, 2] < -_SUNK * extent).any()
    over, over_faces = vertices, every
    if sunk:
        from trimesh.intersections import slice_faces_plane

        up = np.array([0.0, 0.0, 1.0])
        over, over_faces, _ = slice_faces_plane(vertices, every, up, np.zeros(3))
        over[:, 2] = np.maximum(over[:, 2], 0)
        over_faces = over_faces.astype(np.int32)
    a, b, c = (over[over_faces[:, i]] for i in range(3))
    top = float(over[:, 2].max(initial=0.0))
    sag, slope = _faceting(vertices, every, mesh.normals, extent)
    return Caster(
        vertices.astype(np.float32),
        every,
        over.astype(np.float32),
        over_faces,
        _edges(over, over_faces),
        np.cross(b - a, c - a).T.astype(np.float32),
        _outline(over[np.unique(over_faces)]),
        extent,
        max(top, 0.0),
        sag,
        slope,
        opacity,
    )


def _edges(vertices: ndarray, faces: ndarray) -> ndarray:
    """(e, 5) int32: two vertices, the face that runs from the first to the second, another
    or -1, and +1 where that one runs the same way, -1 where against it. Vertices at the
    same place count as one; of more than two faces some pair up."""
    if not len(faces):
        return np.zeros((0, 5), np.int32)
    low, size = vertices.min(0), float(np.ptp(vertices, axis=0).max())
    grid = np.round(divide(vertices - low, _WELD_DISTANCE * size))
    first, vertex = same_rows(grid)
    at = first[vertex[faces]]
    run = np.concatenate([at[:, [0, 1]], at[:, [1, 2]], at[:, [2, 0]]])
    face = np.tile(np.arange(len(faces)), 3)
    keep = run[:, 0] != run[:, 1]
    run, face = run[keep], face[keep]
    way = np.where(run[:, 0] < run[:, 1], 1, -1)
    run = np.sort(run, 1)
    order = np.lexsort((way, run[:, 1], run[:, 0]))
    run, face, way = run[order], face[order], way[order]
    new = np.r_[True, (run[1:] != run[:-1]).any(1)]
    start = np.flatnonzero(new)
    rank = np.arange(len(run)) - np.repeat(start, np.diff(np.r_[start, len(run)]))
    one = np.flatnonzero(rank % 2 == 0)
    paired = np.r_[rank[1:], 0][one] % 2 == 1
    two = np.where(paired, np.minimum(one + 1, len(run) - 1), one)
    ends = np.where(way[one, None] > 0, run[one], run[one, ::-1])
    return np.column_stack(
        [ends, face[one], np.where(paired, face[two], -1), way[one] * way[two]]
    ).astype(np.int32)


def _outline(points: ndarray) -> ndarray:
    """Vertices of the convex hull; the corners of the box where the points are few, many or
    flat.
    """
    from scipy.spatial import ConvexHull, QhullError

    if not len(points):
        return np.zeros((1, 3))
    try:
        # moved by rounding (QJ): else Qhull takes the square of points on a circle, 0.2 s
        # for _FREED of them
        hull = points[ConvexHull(points, qhull_options="QJ").vertices]
        if len(hull) <= _FREED:
            hull = hull[ConvexHull(hull).vertices]
    except QhullError:
        hull = points
    if len(hull) <= _HULL_POINTS:
        return hull
    # extreme points in 400 even directions, pushed out to the planes that bound the rest: a
    # slightly larger hull
    middle = (hull.min(0) + hull.max(0)) / 2
    extreme = np.unique(((hull - middle) @ sphere(400).T).argmax(0))
    grown = middle + (hull[extreme] - middle) * 1.02
    grown[:, 2] = np.maximum(grown[:, 2], 0)
    return grown


def _faceting(
    vertices: ndarray, faces: ndarray, normals: ndarray, extent: float
) -> tuple[float, float]:
    """95 % of the facets lie less than this below their smooth surface (metres), and lean
    from it by less than this slope.
    """
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    face = normalise(np.cross(b - a, c - a))
    cosine = np.abs((normals[faces] * face[:, None]).sum(-1)).min(1)
    angle = np.minimum(arccos(cosine), np.radians(45))
    side = np.linalg.norm([a - b, b - c, c - a], axis=2).max(0)
    # a chord of length L that leans by the angle from the arc's tangent at its end lies L /
    # 2 tan(angle / 2) below the arc
    sag = (
        float(np.quantile(side / 2 * np.tan(angle / 2), 0.95)) if len(faces) else 0.0
    )
    slope = float(np.quantile(np.tan(angle), 0.95)) if len(faces) else 0.0
    return min(sag, _COARSEST_SAG * extent), slope
