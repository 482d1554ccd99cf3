"""A whole synthetic clip: frames, camera.yaml, job.toml, model.glb, truth, and a depth
input where the scene has one.

Its folder appears when it is complete."""

import dataclasses
import os
import re
import shutil
import tomllib
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.camera import Camera
from arfx.core.guard import check_file_name, part_name
from arfx.core.numerics import divide, normalise
from arfx.core.opener import why
from arfx.core.pose import Pose
from arfx.core.toml_text import to_toml
from arfx.errors import ConfigError, RenderError
from arfx.media.cameras import save_camera
from arfx.media.images import write_png
from arfx.synth.description import Marker, SceneFile
from arfx.synth.encode import ClipFile, VideoFile, measured_steps
from arfx.synth.picture import Picture, expose, gain_at
from arfx.synth.rays import LIFT_M, surfaces
from arfx.synth.shapes import write_model
from arfx.synth.truth import (
    DEPTH_UNIT_M,
    FLOW_UNIT_PX,
    FrameTruth,
    MarkerTruth,
    Truth,
    write_depth,
    write_flow,
    write_truth,
)
from arfx.synth.world import World, marker_points

# what a clip's folder holds beside the clip and its depth
_MADE = re.compile(
    r"camera\.yaml|model\.glb|job\.toml|truth\.jsonl"
    r"|truth(/(depth|mask|flow)(/\d{6,}\.png)?)?"
)
Progress = Callable[[str, int, int | None], None]


def make_clip(
    scene: SceneFile,
    folder: Path,
    scene_folder: Path | None = None,
    progress: Progress = lambda *_: None,
    overwrite: bool = False,
    truth_pictures: bool = True,
) -> Truth:
    """Render a scene into a new folder.

    folder : made anew; it appears by rename when everything in it is complete
    scene_folder : where picture files that the scene names are
    truth_pictures : False leaves out depth, masks and flow
    Raises ConfigError if the folder exists (without overwrite), RenderError if it cannot be
    written."""
    check_file_name(folder)
    check_replaceable(folder, overwrite)
    part = part_name(folder.absolute())
    try:
        part.mkdir(parents=True)
    except OSError as e:
        raise RenderError(
            f"cannot write into {folder.parent}: {e.strerror}",
            "name another place with -o",
        ) from None
    try:
        truth = _fill(scene, part, scene_folder, progress, truth_pictures)
        if os.path.lexists(folder):
            check_replaceable(
                folder, overwrite
            )  # again: all the time since the first look
            shutil.rmtree(folder)
        part.rename(folder)
    except OSError as e:
        raise RenderError(
            f"cannot write {folder}: {why(e)}", "name another place with -o"
        ) from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return truth


def check_replaceable(folder: Path, overwrite: bool = True) -> None:
    """Raises ConfigError if `folder` is there, and `overwrite` is not set or it holds
    anything that `make_clip` does not write: that would be lost."""
    if not os.path.lexists(folder):
        return
    if not overwrite:
        raise ConfigError(
            f"{folder} exists", "--overwrite replaces it; or name another with -o"
        )
    if folder.is_symlink() or not folder.is_dir():
        raise ConfigError(f"{folder} is not a folder", "name another with -o")
    try:
        (folder / "truth.jsonl").stat()
        job = tomllib.loads((folder / "job.toml").read_text(encoding="utf-8"))[
            "input"
        ]
        own = {job["clip"], job.get("depth")}
    except (OSError, ValueError, KeyError, TypeError):
        own = set()
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if not own or (name not in own and not _MADE.fullmatch(name)):
            raise ConfigError(
                f"{folder} holds {name!r}, it was not created by arfx synth",
                "name another with -o",
            )


def _fill(
    scene: SceneFile,
    folder: Path,
    scene_folder: Path | None,
    progress: Progress,
    truth_pictures: bool,
) -> Truth:
    world = World(scene, scene_folder)
    picture, frames = Picture(world), []
    kinds = scene.truth if truth_pictures else ()
    for kind in kinds:
        (folder / "truth" / kind).mkdir(parents=True)
    with ExitStack() as files:
        clip = files.enter_context(closing(ClipFile(folder / scene.clip.file, scene)))
        maps = None
        if scene.depth.file:
            path, size = (
                folder / scene.depth.file,
                (scene.clip.width, scene.clip.height),
            )
            file = VideoFile(path, scene, "ffv1", size, "gray16le")
            maps = files.enter_context(closing(file))
        for n, time_s in enumerate(world.frame_times_s.tolist()):
            clip.write(expose(scene, picture.radiance(n), n, time_s), time_s)
            frames.append(frame_truth(world, n))
            progress("synth", n + 1, scene.frames)
            if maps is None and not kinds:
                continue
            depth, owner = picture.surfaces(n)
            if maps is not None:
                maps.put(measured_steps(scene, depth, n), time_s)
            for kind in kinds:
                path = folder / "truth" / kind / f"{n:06d}.png"
                if kind == "flow":
                    write_flow(path, picture.flow(n, depth, owner))
                elif kind == "depth":
                    write_depth(path, depth)
                else:
                    write_png(path, owner)
    stated = stated_camera(scene, world.camera)
    save_camera(folder / "camera.yaml", stated)
    write_model(scene.model.shape, folder / "model.glb")
    (folder / "job.toml").write_text(job_toml(scene), encoding="utf-8")
    configured = scene.configured
    header = {
        "arfx_truth": 1,
        "description": scene.description,
        "world": configured[0].spec.key if configured else None,
        "markers": {m.spec.key: m.spec.size_m for m in configured},
        "camera": world.camera.to_json(),
        "stated_camera": stated.to_json(),
        "depth_unit_m": DEPTH_UNIT_M,
        "flow_unit_px": FLOW_UNIT_PX,
        "objects": {i: p.label for i, p in enumerate(scene.objects, 1)},
        "hidden": scene.hidden.model_dump(),
    }
    truth = Truth(header, tuple(frames))
    write_truth(folder / "truth.jsonl", truth)
    return truth


def frame_truth(world: World, n: int) -> FrameTruth:
    """Everything that is known of a frame beside its pixels."""
    scene, time_s = world.scene, float(world.frame_times_s[n])
    room, camera_from_room = world.at(time_s), world.camera_at(n, time_s)
    room_from_marker: dict[str, Pose] = {}
    markers: dict[str, MarkerTruth] = {}
    for placed, pose in zip(scene.objects, world.poses(time_s), strict=True):
        if (
            not isinstance(placed, Marker) or placed.spec.key in markers
        ):  # of two prints of one marker the first
            continue
        camera_from_marker = camera_from_room @ pose
        corners = world.camera.project(
            camera_from_marker.apply(placed.spec.corners_m)
        )
        points = camera_from_marker.apply(marker_points(placed))
        pixels = world.camera.project(points)
        size = world.camera.width, world.camera.height
        inside = ((pixels >= -0.5) & (pixels + 0.5 < size)).all(-1)
        ahead = normalise(camera_from_marker.translation_m)
        facing = float(-camera_from_marker.rotation[:, 2] @ ahead)
        rays = divide(points[None, :, :2], points[:, 2:])
        depth, _ = surfaces(rays, room, camera_from_room.inverse())
        before = LIFT_M * points[:, 2] / np.linalg.norm(points, axis=1)
        seen = inside & (depth[0] >= points[:, 2] - before) & (facing > 0)
        side = float(np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1).mean())
        room_from_marker[placed.spec.key] = pose
        markers[placed.spec.key] = MarkerTruth(
            camera_from_marker, corners, float(seen.mean()), side, facing
        )
    lights = [
        {
            "room": row[:3].tolist(),
            "camera": (camera_from_room.rotation @ row[:3]).tolist(),
            "marker": {
                k: (p.rotation.T @ row[:3]).tolist()
                for k, p in room_from_marker.items()
            },
            "rgb": row[3:6].tolist(),
            "angular_size_deg": float(2 * np.degrees(np.arctan(row[6]))),
        }
        for row in ([] if scene.light.environment else room.lights)
    ]
    return FrameTruth(
        n,
        time_s + scene.clip.start_s,
        int(world.shots[n]),
        camera_from_room,
        room_from_marker,
        markers,
        gain_at(scene, time_s),
        scene.exposure.bias,
        world.room.ambient.tolist(),
        lights,
    )


def stated_camera(scene: SceneFile, camera: Camera) -> Camera:
    """The camera that camera.yaml states."""
    error = 1 + scene.hidden.focal_error_percent / 100
    matrix = camera.matrix * [[error, 1, 1], [1, error, 1], [1, 1, 1]]
    return dataclasses.replace(camera, matrix=matrix, source="synth")


def job_toml(scene: SceneFile) -> str:
    """The job file beside the clip, with paths relative to it."""
    given: dict[str, Any] = {"clip": scene.clip.file, "camera": "camera.yaml"}
    if scene.depth.file:
        given |= {"depth": scene.depth.file, "depth_scale": round(1 / DEPTH_UNIT_M)}
    return to_toml(
        {
            "input": given,
            "marker": [{"spec": str(marker.spec)} for marker in scene.configured],
            "model": {"file": "model.glb", "fit": scene.model.fit},
            "pipeline": {"stages": scene.job.stages, "quality": scene.job.quality},
            "output": {"codec": scene.job.codec},
            **scene.job.settings,
        }
    )
