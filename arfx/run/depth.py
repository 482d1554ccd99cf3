"""Real depth in a job: its maps, and a frame's depth for the stages while rendering."""

from __future__ import annotations

import numpy as np

from arfx.config.sections import JobConfig
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.errors import InputError
from arfx.media.depth_maps import DepthMaps, fill_holes, open_depth
from arfx.media.frame import Frame


def job_depth(config: JobConfig) -> DepthMaps | None:
    """The job's depth maps, listed; None where it has none. Raises InputError."""
    section = config.input
    if section.depth is None:
        return None
    return open_depth(section.depth, section.depth_scale, float(section.depth_start or 0.0))


def real_depth_layer(maps: DepthMaps, facts: FrameFacts, frame: Frame, camera: Camera, rect: Rect) -> np.ndarray | None:
    """REAL_DEPTH over `rect`: metres, > 0 everywhere, holes filled along the picture's edges; None where there is none.

    The whole map is filled whatever the rectangle, so that a pixel gets the same from any.
    Raises InputError where the map is not the one that was analysed.
    """
    told = facts.real_depth
    if told is None:
        return None
    depth = maps.load(told.map, camera.width, camera.height)
    if not depth.any():
        raise InputError(f"depth map {maps.name(told.map)} has changed since the analysis", "start the job again")
    whole = fill_holes(depth, np.ascontiguousarray(frame.luma()))
    return np.ascontiguousarray(whole[rect.slices]) * np.float32(told.scale)
