"""Where the sites of a frame come from: the field of its facts, or a still one whose cells are finer where the plane is near.

The facts hold it as {"set", "pitch", "origin", "shape", "nodes", "pose"} (by arfx.analyse.motion.advection): nodes is base64 of
zlib of int32 [u, v] in 1/16 px, each the difference to the node before it in its row; pose is camera_from_world of the
frame for which the set was made, null where there is none. {"forward", "backward"} are nodes of two more patterns that begin
unbent at both ends of a stretch of the clip, "share" is that of the second in this frame. "detail" is base64 of zlib of uint16,
how much there is to see around each node, 255 * 16 = all.
"""

from __future__ import annotations

import base64
import zlib
from functools import lru_cache

import numpy as np

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import divide
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.stages.watercolor.sites import GRID_PX, Field, still_field

FACT = "watercolor"
_MUCH = 0.35  # detail that counts as all
_EVEN_LEVELS, _DETAIL_LEVELS = 0.3, 0.9  # by how many doublings cells grow and shrink with it
_FINEST, _COARSEST = 0.6, 1.8  # factors on the size of cells that depth may give


def pad_px(cell_px: float) -> int:
    """How far outside the picture sites are still needed."""
    return int(np.ceil(2.5 * _COARSEST * cell_px))


def ways(facts: FrameFacts, anchored: bool, both: bool) -> tuple[tuple[str, float], ...]:
    """(name of the field in the facts, its share) of those to paint: one, or the two carried forward and backward."""
    found = facts.extra.get(FACT) if anchored and both else None
    if found is None or "backward" not in found:
        return (("nodes", 1.0),)
    pairs = ("forward", 1 - found["share"]), ("backward", found["share"])
    return tuple((name, share) for name, share in pairs if share > 0)


def frame_field(
    facts: FrameFacts,
    scene: Scene,
    cell_px: float,
    nearer_finer: float,
    anchored: bool,
    way: str = "nodes",
    detail: float = 0.0,
) -> tuple[Field, Pose | None]:
    """The field, and the pose that goes with it: the same as long as the set of sites is. way : of `ways`"""
    camera, pose = scene.camera, facts.camera_from_world
    found = facts.extra.get(FACT) if anchored else None
    if found is None or found["pitch"] != GRID_PX:
        field = _still(camera.width, camera.height, cell_px, pad_px(cell_px))
    else:
        x0, y0 = found["origin"]
        gh, gw = found["shape"]
        u, v = decoded(found[way], gh, gw)
        size = np.full((gh, gw), float(cell_px))
        if detail > 0 and "detail" in found:
            size *= detail_factor(decoded_detail(found["detail"], gh, gw), detail)
        field = Field(x0, y0, u, v, size)
        pose = None if found["pose"] is None else Pose.from_json(found["pose"])
    if pose is not None and nearer_finer > 0:
        field = Field(field.x0, field.y0, field.u, field.v, field.size * depth_factor(field, camera, pose, scene, nearer_finer))
    return field, pose


@lru_cache(maxsize=4)
def _still(width: int, height: int, cell_px: float, pad: int) -> Field:
    return still_field(width, height, cell_px, pad)


def decoded(text: str, gh: int, gw: int) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) (gh, gw) float64, px."""
    steps = np.frombuffer(zlib.decompress(base64.b64decode(text)), "<i4").reshape(2, gh, gw)
    u, v = np.cumsum(steps.astype(np.int64), axis=2) / 16.0
    return u, v


def decoded_detail(text: str, gh: int, gw: int) -> np.ndarray:
    """(gh, gw) float64, 0..255."""
    out: np.ndarray = np.frombuffer(zlib.decompress(base64.b64decode(text)), "<u2").reshape(gh, gw) / 16.0
    return out


def detail_factor(detail: np.ndarray, strength: float) -> np.ndarray:
    """(gh, gw) factor on the size of cells: larger where there is little to see, smaller where there is much. detail : 0..255"""
    share = np.minimum(detail / (255 * _MUCH), 1.0)
    out: np.ndarray = 2.0 ** (strength * (_EVEN_LEVELS - (_EVEN_LEVELS + _DETAIL_LEVELS) * share))
    return out


def depth_factor(field: Field, camera: Camera, pose: Pose, scene: Scene, strength: float) -> np.ndarray:
    """(gh, gw) factor on the size of cells: (depth of the marker's plane / depth of the marker) ^ strength, within bounds.

    Where the plane is not seen it is taken for far.
    """
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
