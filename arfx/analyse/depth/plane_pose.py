"""The planes of a clip with poses and depth, and the one that the object stands on where no
marker says it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from arfx.analyse.depth.planes import facing_up, scene_planes
from arfx.analyse.job import PLANE, PLANE_MARKER, Analysis, AnalysisJob
from arfx.analyse.pose.at_rest import RestPicture, rests
from arfx.analyse.pose.figures import figures
from arfx.core.facts import INTERPOLATED, MEASURED, FrameFacts
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane
from arfx.errors import NothingToDoError

MAPS = 4  # that planes are looked for in, over the clip


def plane_poses(
    clip: Analysis,
    job: AnalysisJob,
    pictures: Sequence[RestPicture],
) -> Analysis:
    """The clip with every frame's pose over the dominant plane, whose middle is the world's
    origin: of a camera at rest, or of given poses. pictures : of RestCheck

    Raises NothingToDoError: no plane, or a camera that moves and no poses."""
    maps, given = job.depth, job.poses
    assert maps is not None
    times_s = clip.frame_span[0]
    if given is None:
        still, moved_px = rests(pictures)
        if not still:
            raise NothingToDoError(
                f"--anchor plane: the camera moves ({moved_px:.1f} px), and no poses are"
                " given",
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
    pairs = zip(numbers, poses, strict=True)
    known = [(k, p) for k, p in pairs if k is not None and p is not None]
    taken = [(k, p) for k, p in known if p[1]] or known
    planes = _planes_seen([(k, 1.0, p) for k, (p, _) in taken], job)
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
    plane = level[0]
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
        facts, notice, **figures(facts, (), anchor=about)
    )


def with_real_planes(clip: Analysis, job: AnalysisJob) -> Analysis:
    """The clip with the planes of the real scene, where its depth is known."""
    if job.depth is None or not clip.summary["depth"]["known"]:
        return clip
    known = [
        (f.real_depth.map, f.real_depth.scale, f.camera_from_world)
        for f in clip.facts
        if f.real_depth is not None and f.camera_from_world is not None
    ]
    return replace(clip, real_planes=tuple(_planes_seen(known, job)))


def _planes_seen(
    known: Sequence[tuple[int, float, Pose]], job: AnalysisJob
) -> list[RealPlane]:
    """In MAPS of these, evenly. known : number of each map, scale and camera_from_world"""
    at = np.linspace(0, len(known) - 1, min(MAPS, len(known))).astype(int)
    taken = list[tuple[int, float, Pose]]()
    for k in at.tolist():
        if known[k] not in taken:
            taken.append(known[k])
    camera = job.camera
    maps = [
        (job.depth.load(k, camera.width, camera.height) * np.float32(scale), pose)
        for k, scale, pose in taken
    ]
    return scene_planes(maps, camera)
