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
from arfx.stages.raster.record import View, bounds_of

_POINTS_PER_PX = 1.5
# Along all edges of a frame: bounds time and memory where the camera is inside the model.
_MAX_POINTS = 400_000
# An edge this much behind the surface that the centre sees, as a fraction of its depth, is hidden.
# Outlines always lie behind: the surface beside them is seen at a grazing angle.
_BEHIND = 2e-2


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
    _add_jumps(mask, mesh.part, face)
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


@kernel()
def _add_jumps(mask, part, face):  # pragma: no cover - compiled
    """Mark both pixels of neighbours that show two parts, or a part and nothing without a marked
    edge between them.

    part : of the mesh's faces;  face : as of `edge_pixels`"""
    before = mask.copy()
    one, height, width = np.uintp(1), np.uintp(face.shape[0]), np.uintp(face.shape[1])
    for y in range(height):
        for x in range(width):
            for v, u in (
                (y, min(x + one, width - one)),
                (min(y + one, height - one), x),
            ):
                here, there = face[y, x], face[v, u]
                if here == there or (before[y, x] and before[v, u]):
                    continue
                if min(here, there) < 0:
                    differ = not (before[y, x] or before[v, u])
                else:
                    differ = part[here] != part[there]
                if differ:
                    mask[y, x], mask[v, u] = True, True
