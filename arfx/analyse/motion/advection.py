"""The advection field of every frame: motion steps chained over the clip, around the
markers through the known poses.

field(new epoch, node) = field(key frame, where the node lay then). A cut starts a new
field, elsewhere.
Source: docs/methods/watercolor.md#advection. Cost: O(nodes) per epoch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import numpy as np

from arfx.analyse.fold import Analysis, AnalysisFrame, AnalysisJob, Fold
from arfx.analyse.motion.flow import GRID_PX, BackgroundMotion, MotionStep, node_positions
from arfx.core.advection import AdvectionField, pack_detail, pack_positions
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import divide
from arfx.core.pose import Pose

# fraction of what is seen now in the detail of an epoch; the rest is what was there before
_NEW_DETAIL = 0.1
_RELAX = 0.02  # fraction of the field's bend that is taken out per epoch
_LEAST_DET = 0.15  # of the field's own mean: triangles smaller than that are about to fold
_NEW_SHOT_PX = 7919.0  # the pattern of another shot comes from that far away
AROUND = (
    2.4  # sizes of the marker: within this, its pose gives the motion better than the flow
)
Field = tuple[np.ndarray, np.ndarray]


class Advection(Fold):
    """How the background moves, for what is to lie still on it."""

    name = "flow"
    needs = ("pose",)

    def __init__(self, job: AnalysisJob, pose: Fold) -> None:
        super().__init__(job)
        self._motion = BackgroundMotion()

    def step(self, frame: AnalysisFrame) -> None:
        self._motion.step(frame.index, frame.luma)

    def end(self, frame: AnalysisFrame) -> None:
        self._motion.end(frame.index, frame.luma)

    def join(self, later: Self, shift: int) -> None:
        self._motion.join(later._motion, shift)

    def finish(self, clip: Analysis) -> Analysis:
        camera = self.job.camera.scaled_to(*self._motion.size)
        reach_m = AROUND * clip.anchor.size_m
        return clip.adding(
            with_advection(
                clip.facts, self._motion.steps, camera, clip.world_from_anchor, reach_m
            )
        )


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
    gx, gy = node_positions(camera.width, camera.height)
    rays = camera.directions(np.stack([gx, gy], -1)) if reach_m > 0 else None
    number, u, v = 0, gx, gy
    last: FrameFacts | None = None
    key: tuple[np.ndarray, np.ndarray, Pose | None] = gx, gy, None
    detail, last_back = np.zeros(gx.shape), np.zeros((*gx.shape, 2))
    fields: list[AdvectionField] = []
    of_frame = []
    for f in facts:
        step = by_index.get(f.index)
        cut = last is not None and f.shot != last.shot
        if last is None or cut or step is not None:
            number += last is not None
            back = (
                None
                if step is None or step.back is None or last is None or cut
                else step.back.astype(float)
            )
            if back is None:
                u, v = gx + _NEW_SHOT_PX * number, gy
            else:
                if rays is not None:
                    back = _with_pose(
                        back,
                        gx,
                        gy,
                        rays,
                        f.camera_from_world,
                        key[2],
                        camera,
                        world_from_anchor,
                        reach_m,
                    )
                u, v = relaxed(*_at(key[:2], gx + back[..., 0], gy + back[..., 1], gx, gy))
            if step is not None:
                seen = step.detail.astype(float)
                if (
                    back is not None
                ):  # carried along with the things, a little of what is seen now each time
                    x, y = (
                        gx + back[..., 0] - last_back[..., 0],
                        gy + back[..., 1] - last_back[..., 1],
                    )
                    seen = _NEW_DETAIL * seen + (1 - _NEW_DETAIL) * np.clip(
                        _sampled(detail, x, y, gx, gy), 0, 255
                    )
                detail = seen
                last_back = np.zeros_like(last_back) if step.key or back is None else back
            elif cut:  # unnoticed by the flow: there was nothing to see
                detail, last_back = np.zeros(gx.shape), np.zeros_like(last_back)
            if step is not None and step.key:
                key = u, v, f.camera_from_world
            elif back is None:
                # a cut that the flow did not notice: the key frame's nodes lie where this
                # frame's flow says
                key = (u, v, f.camera_from_world)
                if step is not None and step.back is not None:
                    key = (
                        *_at(
                            (u, v), gx - step.back[..., 0], gy - step.back[..., 1], gx, gy
                        ),
                        None,
                    )
            origin, shape = (int(gx[0, 0]), int(gy[0, 0])), (u.shape[0], u.shape[1])
            fields.append(
                AdvectionField(
                    number,
                    GRID_PX,
                    origin,
                    shape,
                    pack_positions(u, v),
                    pack_detail(detail),
                    f.camera_from_world,
                )
            )
        last = f
        of_frame.append(len(fields) - 1)
    return tuple(f.with_(advection=fields[k]) for f, k in zip(facts, of_frame, strict=True))


def _sampled(
    a: np.ndarray, x: np.ndarray, y: np.ndarray, gx: np.ndarray, gy: np.ndarray
) -> np.ndarray:
    """`a` at places between its nodes, bilinear, linear beyond its border."""
    from scipy.interpolate import RegularGridInterpolator

    nodes = gy[:, 0], gx[0]
    beyond = {"bounds_error": False, "fill_value": None}
    return RegularGridInterpolator(nodes, a, **beyond)((y, x))


def _at(
    field: Field, x: np.ndarray, y: np.ndarray, gx: np.ndarray, gy: np.ndarray
) -> Field:
    return _sampled(field[0], x, y, gx, gy), _sampled(field[1], x, y, gx, gy)


def _with_pose(
    back: np.ndarray,
    gx: np.ndarray,
    gy: np.ndarray,
    rays: np.ndarray,
    now: Pose | None,
    then: Pose | None,
    camera: Camera,
    world_from_anchor: Pose,
    reach_m: float,
) -> np.ndarray:
    """The steps back, near the anchor those of points of its plane."""
    if now is None or then is None:
        return back
    anchor_from_camera = (now @ world_from_anchor).inverse()
    eye, d = anchor_from_camera.translation_m, rays @ anchor_from_camera.rotation.T
    far = divide(np.full(d.shape[:-1], -eye[2]), d[..., 2], where_zero=np.nan)
    on_plane = eye + d * np.where(far > 0, far, np.nan)[..., None]
    distance = np.linalg.norm(on_plane[..., :2], axis=-1)
    before = camera.project(
        (then @ world_from_anchor).apply(np.where(np.isfinite(on_plane), on_plane, 0.0))
    )
    step = before - np.stack([gx, gy], -1)
    known = np.isfinite(distance) & np.isfinite(step).all(-1)
    share = np.where(known, np.clip(2 - np.where(known, distance, 0) / reach_m, 0, 1), 0)[
        ..., None
    ]
    return back + share * (np.where(known[..., None], step, back) - back)


def relaxed(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The field without folds and a little straighter. Linear fields stay as they are."""
    u, v = u + _RELAX * _bend(u), v + _RELAX * _bend(v)
    for _ in range(40):
        det = np.stack(determinants(u, v))
        if det.min() > _LEAST_DET * max(float(np.median(det)), 1e-6):
            return u, v
        u, v = u + 0.5 * _bend(u), v + 0.5 * _bend(v)
    return _straight(u), _straight(v)


def _bend(a: np.ndarray) -> np.ndarray:
    """How much the mean of a node's neighbours differs from it; at the border only along
    it, at corners nothing.
    """
    out = np.zeros_like(a)
    out[:, 1:-1] += (a[:, :-2] + a[:, 2:]) / 2 - a[:, 1:-1]
    out[1:-1] += (a[:-2] + a[2:]) / 2 - a[1:-1]
    return out / 2


def _straight(a: np.ndarray) -> np.ndarray:
    """The plane through a."""
    y, x = np.indices(a.shape)
    terms = np.stack([np.ones(a.size), x.ravel(), y.ravel()], -1)
    fit, *_ = np.linalg.lstsq(terms, a.ravel(), rcond=None)
    return (terms @ fit).reshape(a.shape)


def determinants(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the two triangles of every quad, in units of GRID_PX^2: how many px of the thing
    lie in one of the picture.
    """
    a = (u[:-1, 1:] - u[:-1, :-1]) * (v[1:, :-1] - v[:-1, :-1]) - (
        v[:-1, 1:] - v[:-1, :-1]
    ) * (u[1:, :-1] - u[:-1, :-1])
    b = (u[1:, 1:] - u[1:, :-1]) * (v[1:, 1:] - v[:-1, 1:]) - (v[1:, 1:] - v[1:, :-1]) * (
        u[1:, 1:] - u[:-1, 1:]
    )
    return a / GRID_PX**2, b / GRID_PX**2
