"""Which pixels need more than one sample: those that an outline or a sharp edge passes through.

Outlines come from the geometry, so that features thinner than a pixel are not missed; what geometry
does not tell (cut-outs, parts that pass through each other) comes from neighbours that differ.
"""

# mypy: disable-error-code="no-untyped-def"

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.compiled import kernel
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.rect import Rect
from arfx.core.scene_mesh import SceneMesh
from arfx.core.vectors import dot, shifted, vector
from arfx.stages.raster.record import View, bounds_of

_POINTS_PER_PX = 1.5
# Along all edges of a frame: bounds time and memory where the camera is inside the model.
_MAX_POINTS = 400_000
# An edge this much behind the surface that the centre sees, as a fraction of its depth, is hidden.
# Outlines always lie behind: the surface beside them is seen at a grazing angle.
_BEHIND = 2e-2
# Of depth, in pixels' sides, beyond what the faces' slope explains, that makes two pixels differ.
_JUMP_PX = 8.0
_SLOPES = 3.0


def edge_pixels(
    mesh: SceneMesh,
    camera: Camera,
    view: View,
    rect: Rect,
    face: ndarray,
    depth: ndarray,
) -> ndarray:
    """(h, w) bool, pixels of `rect` with more than one surface in them.

    face, depth : (h, w), what their centres see, -1 and inf = nothing
    view : of `rect` with one pixel of margin"""
    mask = np.zeros(face.shape, bool)
    px, z = _points_along(mesh, camera, view, _visible_edges(mesh, view))
    column, row = np.floor(px - [rect.x0, rect.y0]).astype(int).T
    inside = (column >= 0) & (column < rect.width) & (row >= 0) & (row < rect.height)
    column, row, z = column[inside], row[inside], z[inside]
    seen = z <= depth[row, column] * np.float32(1 + _BEHIND)
    mask[row[seen], column[seen]] = True
    _add_jumps(mask, mesh.part, mesh.face_normal, view, face, depth)
    return mask


def _visible_edges(mesh: SceneMesh, view: View) -> ndarray:
    """(e, 2) vertices of edges that are an outline, or sharp with a side that is seen."""
    normal = mesh.face_normal @ view.rotation.T
    front = (normal * view.points[mesh.faces[:, 0]]).sum(1) < 0
    seen = front | ~mesh.hidden_behind
    edges = mesh.edges
    a, b = edges.faces.T
    outline = front[a] != front[b]
    shows = np.where(b < 0, seen[a], outline | (edges.sharp & (seen[a] | seen[b])))
    return edges.vertices[shows]


def _points_along(
    mesh: SceneMesh, camera: Camera, view: View, ends: ndarray
) -> tuple[ndarray, ndarray]:
    """Places (n, 2) px, counted from the corner of pixel 0, along edges (e, 2) and their depths."""
    z = view.points[ends, 2]
    xy = divide(view.points[ends, :2], z[..., None])
    low, high = bounds_of(view)
    near = (
        (xy.max(1) >= low).all(1)
        & (xy.min(1) <= high).all(1)
        & (z > EPS_DEPTH_M).all(1)
    )
    xy, z = xy[near], z[near]
    length = (np.abs(xy[:, 1] - xy[:, 0]) * [camera.fx, camera.fy]).max(1, initial=0)
    longest = 4.0 * sum(view.x.shape)
    steps = np.minimum(np.ceil(length * _POINTS_PER_PX), longest).astype(int) + 1
    fraction = min(_MAX_POINTS / max(steps.sum(), 1), 1.0)
    steps = np.maximum((steps * fraction).astype(int), 1)
    edge = np.repeat(np.arange(len(steps)), steps)
    step = np.arange(len(edge)) - (np.cumsum(steps) - steps)[edge]
    t = ((step + 0.5) / steps[edge])[:, None]
    # straight in the ideal picture, bent by the lens after
    place = xy[edge, 0] * (1 - t) + xy[edge, 1] * t
    depth = 1 / ((1 - t[:, 0]) / z[edge, 0] + t[:, 0] / z[edge, 1])
    seen = (place**2).sum(1) <= camera.max_radius**2
    focal, corner = [camera.fx, camera.fy], [camera.cx + 0.5, camera.cy + 0.5]
    return camera.distort(place[seen]) * focal + corner, depth[seen]


@kernel(error_model="numpy")
def _add_jumps(mask, part, face_normal, view: View, face, depth):  # pragma: no cover
    """Mark both pixels of neighbours that differ in a way no marked edge between them explains.

    part, face_normal : of the mesh's faces;  face, depth : as of `edge_pixels`"""
    before = mask.copy()
    one, height, width = np.uintp(1), np.uintp(face.shape[0]), np.uintp(face.shape[1])
    for y in range(height):
        for x in range(width):
            for v, u in (
                (y, min(x + one, width - one)),
                (min(y + one, height - one), x),
            ):
                if face[y, x] == face[v, u] or (before[y, x] and before[v, u]):
                    continue
                marked, nothing = (
                    before[y, x] or before[v, u],
                    min(face[y, x], face[v, u]) < 0,
                )
                if nothing or part[face[y, x]] != part[face[v, u]]:
                    differ = not (marked and nothing)
                else:
                    gap = (
                        abs(depth[v, u] - depth[y, x]) / depth[y, x]
                        - _JUMP_PX * view.pixel
                    )
                    differ = not marked and gap > 0
                    if differ:
                        normal = vector(face_normal[face[y, x]])
                        here, there = (
                            _towards(view, normal, y, x),
                            _towards(view, normal, v, u),
                        )
                        differ = gap > _SLOPES * abs(here - there) / max(
                            abs(there), 1e-3
                        )
                if differ:
                    mask[y, x], mask[v, u] = True, True


@kernel(inline="always")
def _towards(view, normal, y, x):  # pragma: no cover - compiled
    """How far a face's normal leans along the direction, z = 1, of a pixel."""
    row, column = y + np.uintp(1), x + np.uintp(1)
    down = shifted(view.rotation[2], view.y[row, column], view.rotation[1])
    return dot(normal, shifted(down, view.x[row, column], view.rotation[0]))
