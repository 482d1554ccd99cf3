"""The surroundings of every frame for reflections: one cube per shot, in the facts.

Looks at the surroundings are brought to the axes in which the room stands still and averaged over their shot, so that
nothing flickers and what is seen from several sides adds up. A panorama that the user gave takes their place.
Source: S4 (environment map from the single camera); SYSTEMS.md S4 (smoothing in the analysis, analytic light apart).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arfx.analyse.environment import from_panorama, told, turned
from arfx.analyse.surroundings import Look
from arfx.core.facts import FrameFacts

KEY = "environment"
PLANE = "plane"  # beside a folded cube: radiance of the plane as seen, with which what is next to its horizon agrees
PANORAMA_PX = 16  # side of a face


def with_environment(
    facts: Sequence[FrameFacts], looks: Sequence[Look], still_camera: bool, panorama: np.ndarray | None,
    world_from_anchor: np.ndarray, bias: np.ndarray,
) -> tuple[FrameFacts, ...]:  # fmt: skip
    """The facts with `extra["environment"]` in every frame that has a pose and a look in its shot.

    still_camera : the room is the camera's, else the world's;  world_from_anchor : (3, 3);  bias (3,) : not light
    """
    given = None if panorama is None else turned(from_panorama(panorama, PANORAMA_PX), np.asarray(world_from_anchor).T)
    by_shot: dict[int, list[np.ndarray]] = {}
    for look in looks:
        f = facts[look.frame]
        if f.camera_from_world is None:
            continue
        cube = np.clip(look.cube - bias, 0, None)
        by_shot.setdefault(f.shot, []).append(cube if still_camera else turned(cube, f.camera_from_world.rotation))
    mean = {shot: np.mean(cubes, 0) for shot, cubes in by_shot.items()}
    plane = {
        shot: np.clip(np.mean([s.plane for s in looks if facts[s.frame].shot == shot], 0) - bias, 0, None) for shot in by_shot
    }
    beside = {shot: {PLANE: [float(v) for v in colour]} for shot, colour in plane.items()}
    whole = {shot: told(cube) | beside[shot] for shot, cube in mean.items()}
    out = []
    for f in facts:
        pose = f.camera_from_world
        if pose is None or (given is None and f.shot not in mean):
            out.append(f)
        elif given is not None:
            out.append(f.with_(extra={**f.extra, KEY: told(given)}))
        elif still_camera:
            out.append(f.with_(extra={**f.extra, KEY: told(turned(mean[f.shot], pose.rotation)) | beside[f.shot]}))
        else:
            out.append(f.with_(extra={**f.extra, KEY: whole[f.shot]}))
    return tuple(out)
