"""The advection field of every frame: motion steps chained over the clip, around the
markers through the known poses.

field(new epoch, node) = field(key frame, where the node lay then). A cut starts a new
field, elsewhere.
Source: docs/methods/watercolor.md#advection. Cost: O(nodes) per epoch."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.analyse.motion.flow import (
    GRID_PX,
    MotionStep,
    node_positions,
)
from arfx.core.advection import AdvectionField, pack_detail, pack_positions
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import divide
from arfx.core.pose import Pose

# fraction of what is seen now in the detail of an epoch; the rest is what was there before
_NEW_DETAIL = 0.1
_RELAX = 0.02  # fraction of the field's bend that is taken out per epoch
_LEAST_DET = (
    0.15  # of the field's own mean: triangles smaller than that are about to fold
)
_NEW_SHOT_PX = 7919.0  # the pattern of another shot comes from that far away
AROUND = 2.4  # sizes of the marker: within this, its pose gives the motion better than the flow


def with_advection(
    facts: Sequence[FrameFacts],
    steps: Sequence[MotionStep],
    camera: Camera,
    world_from_anchor: Pose,
    reach_m: float,
) -> tuple[FrameFacts, ...]:
    """The facts with `advection`.

    steps : of BackgroundMotion, of the same frames;  reach_m : around the anchor's origin
    on its plane the poses are
    believed more than the flow, up to this far, and less and less up to twice as far; 0 = flow only
    """
    by_index = {s.index: s for s in steps}
    nodes = node_positions(camera.width, camera.height)
    rays = camera.directions(nodes) if reach_m > 0 else None
    number, key, then, shot, out = 0, nodes, None, None, []
    last_back: Any = 0.0
    detail = np.zeros((*nodes.shape[:2], 1))
    unknown = MotionStep(-1, None, True, detail[..., 0])
    for f in facts:
        step = by_index.get(f.index, unknown)
        begins = f.shot != shot
        if begins or step is not unknown:
            number += shot is not None
            pose = f.camera_from_world
            now = None if pose is None else pose @ world_from_anchor
            back = None if begins else step.back
            seen = step.detail[..., None].astype(float)
            if back is None:
                field = nodes + np.array([_NEW_SHOT_PX * number, 0.0])
            else:
                if rays is not None and now is not None and then is not None:
                    back = _with_pose(back, nodes, rays, now, then, camera, reach_m)
                field = relaxed(_sampled(key, nodes + back, nodes))
                # carried along with the things, a little of what is seen now each time
                carried = _sampled(detail, nodes + back - last_back, nodes)
                seen = _NEW_DETAIL * seen + (1 - _NEW_DETAIL) * np.clip(
                    carried, 0, 255
                )
            detail, last_back = seen, back
            if back is None or step.key:
                last_back, key, then = 0.0, field, now
                if step.back is not None and not step.key:
                    # a cut that the flow did not notice: the key frame's nodes lie where
                    # this frame's flow says
                    key, then = _sampled(field, nodes - step.back, nodes), None
            x, y = nodes[0, 0].astype(int).tolist()
            rows, columns, _ = nodes.shape
            made = AdvectionField(
                number,
                GRID_PX,
                (x, y),
                (rows, columns),
                pack_positions(*np.moveaxis(field, -1, 0)),
                pack_detail(detail[..., 0]),
                pose,
            )
        shot = f.shot
        out.append(f.with_(advection=made))
    return tuple(out)


def _sampled(a: ndarray, places: ndarray, nodes: ndarray) -> ndarray:
    """`a` (gh, gw, k) at places (gh, gw, 2) between its nodes, bilinear, linear beyond its
    border."""
    from scipy.interpolate import RegularGridInterpolator

    axes = nodes[:, 0, 1], nodes[0, :, 0]
    read = RegularGridInterpolator(axes, a, bounds_error=False, fill_value=None)
    return read(places[..., ::-1])


def _with_pose(
    back: ndarray,
    nodes: ndarray,
    rays: ndarray,
    now: Pose,
    then: Pose,
    camera: Camera,
    reach_m: float,
) -> ndarray:
    """The steps back, near the anchor those of points of its plane. now, then :
    camera_from_anchor"""
    anchor_from_camera = now.inverse()
    eye, d = anchor_from_camera.translation_m, rays @ anchor_from_camera.rotation.T
    far = divide(-eye[2], d[..., 2], where_zero=np.nan)
    on_plane = eye + d * np.where(far > 0, far, np.nan)[..., None]
    distance = np.linalg.norm(on_plane[..., :2], axis=-1)[..., None]
    step = camera.project(then.apply(on_plane)) - nodes
    pull = np.clip(2 - distance / reach_m, 0, 1) * (step - back)
    return back + np.where(np.isfinite(pull), pull, 0)


def relaxed(field: ndarray) -> ndarray:
    """The field (gh, gw, 2) without folds and a little straighter. Linear fields stay as
    they are."""
    field = field + _RELAX * _bend(field)
    for _ in range(40):
        det = determinants(field)
        if det.min() > _LEAST_DET * max(float(np.median(det)), 1e-6):
            return field
        field = field + 0.5 * _bend(field)
    # the nearest linear one
    y, x = np.mgrid[0 : field.shape[0], 0 : field.shape[1]]
    terms = np.stack([np.ones(x.size), x.ravel(), y.ravel()], -1)
    fit, *_ = np.linalg.lstsq(terms, field.reshape(-1, 2), rcond=None)
    return (terms @ fit).reshape(field.shape)


def _bend(a: ndarray) -> ndarray:
    """How much the mean of a node's neighbours differs from it; at the border only along
    it, at corners nothing.
    """
    out = np.zeros_like(a)
    out[:, 1:-1] += (a[:, :-2] + a[:, 2:]) / 2 - a[:, 1:-1]
    out[1:-1] += (a[:-2] + a[2:]) / 2 - a[1:-1]
    return out / 2


def determinants(field: ndarray) -> ndarray:
    """(2, gh - 1, gw - 1) of the two triangles of every quad, in units of GRID_PX^2: how
    many px of the thing lie in one of the picture.
    """
    right, down = np.diff(field, axis=1), np.diff(field, axis=0)
    upper, lower = (right[:-1], down[:, :-1]), (right[1:], down[:, 1:])
    return np.linalg.det(np.moveaxis(np.array([upper, lower]), 1, -2)) / GRID_PX**2
