"""Which pixels need more than one sample: those that an outline or a sharp edge passes through.

Outlines come from the geometry, so that features thinner than a pixel are not missed; what geometry
does not tell (cut-outs, parts that pass through each other) comes from neighbours that differ.
"""

from __future__ import annotations

import numpy as np

from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.rect import Rect
from arfx.core.scene_mesh import SceneMesh
from arfx.stages.raster.record import View

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
    face: np.ndarray,
    depth: np.ndarray,
) -> np.ndarray:
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
    _add_jumps(mask, mesh, view, face, depth)
    return mask


def _visible_edges(mesh: SceneMesh, view: View) -> np.ndarray:
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
    mesh: SceneMesh, camera: Camera, view: View, ends: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 2) px, counted from the corner of pixel 0, along edges (e, 2) and their depths."""
    z = view.points[ends, 2]
    xy = divide(view.points[ends, :2], z[..., None])
    low = np.array([np.nanmin(view.x, initial=np.inf), np.nanmin(view.y, initial=np.inf)])
    high = np.array(
        [np.nanmax(view.x, initial=-np.inf), np.nanmax(view.y, initial=-np.inf)]
    )
    near = (xy.max(1) >= low).all(1) & (xy.min(1) <= high).all(1) & (z > EPS_DEPTH_M).all(1)
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


def _add_jumps(
    mask: np.ndarray, mesh: SceneMesh, view: View, face: np.ndarray, depth: np.ndarray
) -> None:
    """Mark both pixels of neighbours that differ in a way no marked edge between them explains."""
    before = mask.copy()
    x, y = view.x[1:-1, 1:-1], view.y[1:-1, 1:-1]
    part = np.where(face >= 0, mesh.part[face], -1)
    parts = part.min() < part.max()
    least_jump = _JUMP_PX * view.pixel
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        with np.errstate(invalid="ignore"):
            gap = np.abs(depth[there] - depth[here])
        deep = gap > least_jump * np.minimum(depth[here], depth[there])
        may = deep | (part[here] != part[there]) if parts else deep
        k = np.nonzero(may & (face[here] != face[there]))
        one, other = face[here][k], face[there][k]
        nothing = (one < 0) | (other < 0)
        other_part = part[here][k] != part[there][k]
        normal = mesh.face_normal[one] @ view.rotation.T
        slope = _slope(normal, (x[here][k], y[here][k]), (x[there][k], y[there][k]))
        jump = gap[k] > depth[here][k] * (_SLOPES * slope + least_jump)
        marked = before[here][k] | before[there][k]
        explained = before[here][k] & before[there][k]
        differ = (
            np.where(marked, other_part & ~nothing, nothing | other_part | jump)
            & ~explained
        )
        mask[here][k] |= differ
        mask[there][k] |= differ


def _slope(
    normal: np.ndarray, here: tuple[np.ndarray, ...], there: tuple[np.ndarray, ...]
) -> np.ndarray:
    """How much of its depth a plane gains between two directions. normal : (n, 3), camera axes"""
    along = [normal[:, 0] * x + normal[:, 1] * y + normal[:, 2] for x, y in (here, there)]
    return np.asarray(np.abs(along[0] - along[1]) / np.maximum(np.abs(along[1]), 1e-3))
