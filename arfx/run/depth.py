"""Real depth in a job: its maps to the facts before planning, and a frame's depth for the stages while rendering."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from arfx.analyse.depth_scale import DepthScale, depth_scale, print_ratios
from arfx.config.sections import JobConfig
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.machine import usable_cores
from arfx.core.pose import Pose
from arfx.core.real_depth import KEY, RealDepth, real_depth_of, tile_ranges
from arfx.core.rect import Rect
from arfx.errors import InputError
from arfx.media.depth_fill import filled
from arfx.media.depth_maps import DepthMaps, open_depth
from arfx.media.frames import Frame

Progress = Callable[[str, int, int | None], None]


def job_depth(config: JobConfig) -> DepthMaps | None:
    """The job's depth maps, listed; None where it has none. Raises InputError."""
    section = config.input
    if section.depth is None:
        return None
    return open_depth(section.depth, section.depth_scale, float(section.depth_start or 0.0))


@dataclass(frozen=True)
class _Told:
    """What one map tells. tiles : as `tile_ranges`, before scaling; None = nothing was measured in it"""

    digest: str
    tiles: np.ndarray | None
    holes: float


def with_depth(
    facts: Sequence[FrameFacts],
    maps: DepthMaps,
    of_frames: Sequence[int | None],
    world_from_marker: Mapping[str, Pose],
    camera: Camera,
    align: bool,
    progress: Progress,
) -> tuple[tuple[FrameFacts, ...], dict[str, Any]]:
    """The facts with `extra["real_depth"]`, and a summary for the report.

    of_frames : number of each frame's map;  align : scale the maps to the markers' planes, else take them at their word
    Raises InputError for a map that cannot be read, and where no map holds a valid pixel.
    """
    used = sorted({k for k in of_frames if k is not None})
    if not used:
        raise InputError(f"depth {maps.path}: no map was taken near the time of any frame", "--set input.depth_start shifts them")
    size = camera.width, camera.height
    frames_of: dict[int, list[int]] = {}
    for n, k in enumerate(of_frames):
        if k is not None:
            frames_of.setdefault(k, []).append(n)

    def read(number: int) -> tuple[_Told, list[np.ndarray]]:
        depth = maps.load(number, *size)
        known = float((depth > 0).mean())
        tiles = tile_ranges(depth, size) if known > 0 else None
        ratios = [print_ratios(depth, facts[n], world_from_marker, camera) for n in frames_of[number]]
        return _Told(maps.digest(number), tiles, 1 - known), ratios

    told: dict[int, _Told] = {}
    ratios: list[np.ndarray] = []
    with ThreadPoolExecutor(min(usable_cores(), 4)) as pool:
        for done, (number, (what, some)) in enumerate(zip(used, pool.map(read, used), strict=True), 1):
            told[number] = what
            ratios += some
            progress("depth", done, len(used))
    if all(t.tiles is None for t in told.values()):
        raise InputError(f"depth {maps.path} holds no valid pixel: all are 0, not finite or the largest value", "is it depth?")
    scale = depth_scale(ratios) if align else DepthScale(True, "taken as stated")
    out, got = list(facts), 0
    if scale.known:
        for n, k in enumerate(of_frames):
            if k is None or (tiles := told[k].tiles) is None:
                continue
            depth = RealDepth(k, scale.scale, told[k].digest, (tiles / scale.scale).astype(np.float32), scale.noise)
            out[n] = replace(out[n], extra={**out[n].extra, KEY: depth.to_json()})
            got += 1
    summary = {
        "path": str(maps.path), "maps": maps.count, "paired_by": _paired(maps), "frames_with": got,
        "frames_without": len(facts) - got, "holes": float(np.mean([t.holes for t in told.values()])), **scale.to_json(),
    }  # fmt: skip
    return tuple(out), summary


def _paired(maps: DepthMaps) -> str:
    if maps.still:
        return "one map for all"
    return "order" if maps.times_s is None else "time"


def real_depth_layer(maps: DepthMaps, facts: FrameFacts, frame: Frame, camera: Camera, rect: Rect) -> np.ndarray | None:
    """REAL_DEPTH over `rect`: metres, > 0 everywhere, holes filled along the picture's edges; None where there is none.

    The whole map is filled whatever the rectangle, so that a pixel gets the same from any.
    Raises InputError where the map is not the one that was analysed.
    """
    told = real_depth_of(facts)
    if told is None:
        return None
    depth = maps.load(told.map, camera.width, camera.height)
    if not depth.any():
        raise InputError(f"depth map {maps.name(told.map)} has changed since the analysis", "start the job anew")
    whole = filled(depth, np.ascontiguousarray(frame.luma()))
    return np.ascontiguousarray(whole[rect.slices]) * np.float32(told.scale)
