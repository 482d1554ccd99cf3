"""The site field of a frame: of the advection in its facts, or a still one whose cells are finer where the plane is near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import divide
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.stages.watercolor.sites import GRID_PX, SiteField, still_field

_MUCH = 0.35  # detail that counts as all
_EVEN_LEVELS, _DETAIL_LEVELS = 0.3, 0.9  # by how many doublings cells grow and shrink with it
_FINEST, _COARSEST = 0.6, 1.8  # factors on the size of cells that depth may give


def pad_px(cell_px: float) -> int:
    """How far outside the picture sites are still needed."""
    return int(np.ceil(2.5 * _COARSEST * cell_px))


def advection_directions(facts: FrameFacts, anchored: bool, both: bool) -> tuple[tuple[str, float], ...]:
    """(name of the field in the facts, its weight) of those to paint: one, or the two carried forward and backward."""
    found = facts.advection if anchored and both else None
    if found is None or not found.backward:
        return (("nodes", 1.0),)
    pairs = ("forward", 1 - found.share), ("backward", found.share)
    return tuple((name, weight) for name, weight in pairs if weight > 0)


def frame_field(
    facts: FrameFacts, scene: Scene, cell_px: float, nearer_finer: float, anchored: bool, direction: str = "nodes",
    detail: float = 0.0,
) -> tuple[SiteField, Pose | None]:  # fmt: skip
    """The field, and the pose that goes with it: the same as long as the field is. direction : of `advection_directions`"""
    camera, pose = scene.camera, facts.camera_from_world
    found = facts.advection if anchored else None
    if found is None or found.pitch != GRID_PX:
        field = still_field(camera.width, camera.height, cell_px, pad_px(cell_px))
    else:
        size = np.full(found.shape, float(cell_px))
        if detail > 0 and found.detail:
            size *= detail_factor(found.detail_at_nodes(), detail)
        field = SiteField(*found.origin, *found.places(direction), size)
        pose = found.pose
    if pose is not None and nearer_finer > 0:
        field = replace(field, size=field.size * depth_factor(field, camera, pose, scene, nearer_finer))
    return field, pose


def detail_factor(detail: np.ndarray, strength: float) -> np.ndarray:
    """(gh, gw) factor on the size of cells: larger where there is little to see, smaller where there is much. detail : 0..255"""
    fraction = np.minimum(detail / (255 * _MUCH), 1.0)
    out: np.ndarray = 2.0 ** (strength * (_EVEN_LEVELS - (_EVEN_LEVELS + _DETAIL_LEVELS) * fraction))
    return out


def depth_factor(field: SiteField, camera: Camera, pose: Pose, scene: Scene, strength: float) -> np.ndarray:
    """(gh, gw) factor on the size of cells: (depth of the marker's plane / depth of the marker) ^ strength, within bounds.

    Where the plane is not seen it is taken for far."""
    camera_from_anchor = pose @ scene.world_from_anchor
    normal, at = camera_from_anchor.rotation[:, 2], camera_from_anchor.translation_m
    gh, gw = field.u.shape
    # normal . ray of each node: linear along the picture
    across = (field.x0 + GRID_PX * np.arange(gw) - camera.cx) * (normal[0] / camera.fx)
    down = (field.y0 + GRID_PX * np.arange(gh) - camera.cy) * (normal[1] / camera.fy) + normal[2]
    facing = across + down[:, None]
    # depth of the plane over that of the marker, upside down: 0 = as far as can be, or behind the camera
    nearness = facing * float(divide(max(float(at[2]), 1e-6), float(normal @ at)))
    low, high = (b ** min(1 / strength, 100.0) for b in (_FINEST, _COARSEST))  # below a strength of 0.01 sizes hardly differ
    out: np.ndarray = np.clip(nearness, 1 / high, 1 / low) ** -strength
    return out
