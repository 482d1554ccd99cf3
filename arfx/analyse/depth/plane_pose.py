"""The planes of a clip with poses and depth, and the one that the object stands on where no marker says it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from arfx.analyse.depth.scale import Maps
from arfx.analyse.depth.scene_planes import ScenePlane, facing_up, scene_planes
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.pose import Pose
from arfx.core.real_plane import RealPlane
from arfx.errors import NothingToDoError

MAPS = 4  # that planes are looked for in, over the clip


def measured_planes(maps: Maps, facts: Sequence[FrameFacts], camera: Camera) -> list[RealPlane]:
    """The real scene's planes in the world of facts that have poses and depth; those seen most first."""
    with_both = [f for f in facts if f.camera_from_world is not None and f.real_depth is not None]
    some: list[tuple[np.ndarray, Pose]] = []
    used: set[int] = set()
    for f in spread(with_both):
        depth, pose = f.real_depth, f.camera_from_world
        assert depth is not None and pose is not None
        if maps.still and depth.map in used and f.camera_from_world == some[0][1]:
            continue
        used.add(depth.map)
        some.append((maps.load(depth.map, camera.width, camera.height) * np.float32(depth.scale), pose))
    return [p.meshed()[0] for p in scene_planes(some, camera)]


def spread(items: Sequence[Any]) -> list[Any]:
    """MAPS of them, evenly."""
    if len(items) <= MAPS:
        return list(items)
    return [items[k] for k in np.linspace(0, len(items) - 1, MAPS).astype(int)]


@dataclass(frozen=True, eq=False)
class Stand:
    """given_from_plane : where the object stands;  plane : as found"""

    given_from_plane: Pose
    plane: RealPlane


def stand_on(planes: Sequence[ScenePlane], poses: Sequence[Pose]) -> Stand:
    """The dominant plane that faces up. Raises NothingToDoError where there is none."""
    level = facing_up(planes, poses)
    if not level:
        found = f"{len(planes)} planes, none of which faces up" if planes else "no plane"
        raise NothingToDoError(
            f"--anchor plane: the depth shows {found}",
            "a table or floor has to be seen from above, by a camera held upright; or use a marker",
        )
    plane = level[0].meshed()[0]
    return Stand(plane.world_from_plane, plane)
