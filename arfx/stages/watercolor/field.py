"""The site field of a frame: of the advection in its facts, or a still one; its cells are finer
where things are near.

How near: by the measured depth of the scene around each node, else by the marker's plane. Noise and
holes of a depth map hardly move the mean around a node, and sizes follow it without a threshold: a
cell appears or goes slowly, as under a zoom."""

from dataclasses import replace

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.stages.watercolor.sites import GRID_PX, SiteField, still_field

_MUCH = 0.35  # detail that counts as all
# by how many doublings cells grow and shrink with it
_EVEN_LEVELS = 0.3
_DETAIL_LEVELS = 0.9
# factors on the size of cells that depth may give
_FINEST = 0.6
_COARSEST = 1.8
_EVERY_PX = 4  # of a depth map, in rows and columns


def pad_px(cell_px: float) -> int:
    """How far outside the picture sites are still needed."""
    return int(np.ceil(2.5 * _COARSEST * cell_px))


def real_dioptre(depth_m: ndarray, field: SiteField) -> ndarray:
    """(gh, gw) 1/m, as far as the next nodes around each; outside the picture that of its border.

    depth_m : (h, w) over the whole frame; what is not finite is infinitely far"""
    h, w = (max(n // _EVERY_PX, 1) for n in depth_m.shape)
    few = cv2.resize(depth_m, (w, h), interpolation=cv2.INTER_AREA)
    dioptre = divide(1.0, np.maximum(few, EPS_DEPTH_M)).astype(np.float32)
    side = 2 * GRID_PX // _EVERY_PX + 1
    mean = cv2.blur(dioptre, (side, side), borderType=cv2.BORDER_REPLICATE).reshape(
        h, w
    )
    x, y = field.nodes()
    row = np.clip((y + 0.5) * h / depth_m.shape[0], 0, h - 1).astype(int)
    column = np.clip((x + 0.5) * w / depth_m.shape[1], 0, w - 1).astype(int)
    return mean[row, column].astype(float)


def frame_field(
    facts: FrameFacts,
    scene: Scene,
    cell_px: float,
    nearer_finer: float,
    real_m: ndarray | None = None,
) -> tuple[SiteField, Pose | None]:
    """The field, and the pose that goes with it: the same as long as the field is.

    real_m : (h, w) measured depth of the frame, None = that of the marker's plane is taken"""
    camera = scene.camera
    pose = facts.camera_from_world
    found = facts.advection
    if found is None or found.pitch != GRID_PX:
        field = still_field(camera.width, camera.height, cell_px, pad_px(cell_px))
    else:
        size = np.full(found.shape, float(cell_px))
        if found.detail:
            size *= detail_factor(found.detail_at_nodes())
        field = SiteField(*found.origin, *found.places(), size)
        pose = found.pose
    near = nearness(field, scene, pose, real_m) if nearer_finer > 0 else None
    if near is not None:
        field = replace(field, size=field.size * nearness_factor(near, nearer_finer))
    return field, pose


def detail_factor(detail: ndarray) -> ndarray:
    """(gh, gw) factor on the size of cells: larger where there is little to see, smaller where
    there is much. detail : (gh, gw) 0..255"""
    fraction = np.minimum(detail / (255 * _MUCH), 1.0)
    return np.asarray(
        2.0 ** (_EVEN_LEVELS - (_EVEN_LEVELS + _DETAIL_LEVELS) * fraction)
    )


def nearness(
    field: SiteField, scene: Scene, pose: Pose | None, real_m: ndarray | None
) -> ndarray | None:
    """(gh, gw) depth of the marker / depth at the nodes, without a marker their mean / depth; None
    where nothing is known."""
    dioptre = None if real_m is None else real_dioptre(real_m, field)
    if pose is None:
        return (
            None if dioptre is None else divide(dioptre, float(dioptre.mean()), 1.0)
        )
    camera_from_anchor = pose @ scene.world_from_anchor
    if dioptre is None:
        dioptre = plane_dioptre(*field.nodes(), scene.camera, camera_from_anchor)
    return dioptre * marker_depth_m(camera_from_anchor)


def marker_depth_m(camera_from_anchor: Pose) -> float:
    return max(float(camera_from_anchor.translation_m[2]), 1e-6)


def plane_dioptre(
    x: ndarray, y: ndarray, camera: Camera, camera_from_anchor: Pose
) -> ndarray:
    """(h, w) 1 / depth of the marker's plane at columns x (w,) and rows y (h, 1), not above 0 where
    it is not seen.

    Linear along the picture: lens distortion is left out."""
    normal = camera_from_anchor.rotation[:, 2]
    at = camera_from_anchor.translation_m
    facing = (x - camera.cx) * (normal[0] / camera.fx) + (
        (y - camera.cy) * (normal[1] / camera.fy) + normal[2]
    )
    return divide(facing, float(normal @ at))


def nearness_limits(strength: float) -> tuple[float, float]:
    """Least and greatest nearness that counts: a cell is _COARSEST and _FINEST times as large
    there."""
    power = min(1 / strength, 100.0)  # below a strength of 0.01 sizes hardly differ
    return 1 / _COARSEST**power, 1 / _FINEST**power


def nearness_factor(near: ndarray, strength: float) -> ndarray:
    """Factor on the size of cells. near : depth of the marker / depth;  strength : > 0, 1 = size in
    proportion to depth"""
    return np.asarray(np.clip(near, *nearness_limits(strength)) ** -strength)
