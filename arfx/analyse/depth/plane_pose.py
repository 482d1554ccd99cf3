"""The planes of a clip with poses and depth, and the one that the object stands on where no
marker says it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.analyse.depth.planes import facing_up, scene_planes
from arfx.analyse.job import PLANE, PLANE_MARKER, Analysis, AnalysisJob
from arfx.analyse.pose.at_rest import RestMotion, Snapshot, rests
from arfx.analyse.pose.figures import figures
from arfx.core.facts import INTERPOLATED, MEASURED, FrameFacts
from arfx.core.pose import Pose
from arfx.errors import NothingToDoError

MAPS = 4  # that planes are looked for in, over the clip


def plane_poses(
    clip: Analysis,
    job: AnalysisJob,
    pictures: Sequence[Snapshot],
    motions: Sequence[RestMotion],
) -> Analysis:
    """The clip with every frame's pose over the dominant plane, whose middle is the world's
    origin: of a camera at rest, or of given poses. pictures, motions : of RestCheck

    Raises NothingToDoError: no plane, or a camera that moves and no poses."""
    maps, camera, given = job.depth, job.camera, job.poses
    assert maps is not None
    times_s = clip.frame_span[0]
    still, moved_px = rests(pictures, motions)
    if given is None and not still:
        raise NothingToDoError(
            f"--anchor plane: the camera moves ({moved_px:.1f} px), and no poses are given",
            "--poses FILE (tx ty tz qx qy qz qw a frame), a camera at rest, or a marker",
        )
    poses: list[tuple[Pose, bool] | None] = [(Pose.identity(), True)] * len(times_s)
    if given is not None:
        poses = given.of_frames(*clip.frame_span, job.params.max_gap_s)
    if not any(poses):
        raise NothingToDoError(
            "--anchor plane: no pose is of the clip's time",
            "--poses FILE with times that begin with the clip",
        )
    numbers = maps.of_frames(*clip.frame_span)
    known = [
        (k, *p)
        for k, p in zip(numbers, poses, strict=True)
        if k is not None and p is not None
    ]
    both = [p for p in known if p[2]] or known
    if maps.still and given is None:
        both = both[:1]
    planes = scene_planes(
        [(maps.load(k, camera.width, camera.height), p) for k, p, _ in spread(both)],
        camera,
    )
    level = facing_up(planes, [p[0] for p in poses if p is not None])
    if not level:
        found = (
            f"{len(planes)} planes, none of which faces up" if planes else "no plane"
        )
        raise NothingToDoError(
            f"--anchor plane: the depth shows {found}",
            "a table or floor has to be seen from above, by a camera held upright; or"
            " use a marker",
        )
    plane = level[0].real_plane()
    facts = [FrameFacts(k, t) for k, t in enumerate(times_s)]
    for k, pose in enumerate(poses):
        if pose is not None:
            stands = pose[0] @ plane.world_from_plane
            facts[k] = facts[k].with_(
                status=MEASURED if pose[1] else INTERPOLATED,
                camera_from_world=stands,
                raw_camera_from_world=stands,
                opacity=1.0,
            )
    evidence = {"moved_px": moved_px} if given is None else {}
    about = {
        "kind": PLANE,
        "poses": "a camera at rest" if given is None else "given",
        **plane.to_json(),
    }
    bridged = sum(f.status == INTERPOLATED for f in facts)
    notice = (
        f"{bridged} frames without a pose at their time bridged: interpolated between poses"
        if bridged
        else None
    )
    return replace(clip, anchor=PLANE_MARKER).adding(
        facts, notice, **figures(facts, (), static_evidence=evidence, anchor=about)
    )


def with_real_planes(clip: Analysis, job: AnalysisJob) -> Analysis:
    """The clip with the planes of the real scene, where its depth is known."""
    maps = job.depth
    if maps is None or not clip.summary["depth"]["known"]:
        return clip
    camera, sparse = job.camera, list[tuple[ndarray, Pose]]()
    known = [(f.real_depth, f.camera_from_world) for f in clip.facts]
    for depth, pose in spread([pair for pair in known if None not in pair]):
        if maps.still and sparse and pose == sparse[0][1]:
            continue
        map_ = maps.load(depth.map, camera.width, camera.height)
        sparse.append((map_ * np.float32(depth.scale), pose))
    planes = scene_planes(sparse, camera)
    return replace(clip, real_planes=tuple(p.real_plane() for p in planes))


def spread(items: Sequence[Any]) -> list[Any]:
    """MAPS of them, evenly."""
    return [
        items[k]
        for k in np.linspace(0, len(items) - 1, min(MAPS, len(items))).astype(int)
    ]
