"""The scene as rows for the tracer: what stands where at a moment, with which texture,
under which light; exact poses by time.
"""

import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy import ndarray
from scipy.interpolate import CubicHermiteSpline

from arfx.core.camera import Camera
from arfx.core.numerics import direction_of, divide, normalise, smoothstep
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.synth.description import (
    Box,
    CameraPath,
    Key,
    Marker,
    Plane,
    SceneFile,
    SceneObject,
    Sphere,
)
from arfx.synth.rays import Room
from arfx.synth.textures import (
    environment_lights,
    environment_picture,
    sheet_albedo,
    texture_albedo,
)

_X, _Y, _Z = np.eye(3)
# (u, v) of a box's sides; a plane or a sheet is the first of them
_UP = (_X, _Y)
_SIDES = ((_X, -_Y), _UP, (-_Y, _Z), (_Y, _Z), (_X, _Z), (-_X, _Z))


class World:
    """Everything of a scene that does not depend on time, made once.
    camera : the true one;  frame_times_s : (frames,) from 0 at the first frame;  shots :
    (frames,) shot of each frame
    room : each thing in its own axes, and the lights of a panorama
    """

    def __init__(self, scene: SceneFile, folder: Path | None = None) -> None:
        self.scene = scene
        self.camera = true_camera(scene)
        n = np.arange(scene.frames, dtype=float)
        if scene.clip.frame_times == "variable":
            n[1:-1] += np.random.default_rng([scene.seed, 90_000]).uniform(
                -0.35, 0.35, n[1:-1].shape
            )
        # on the clip's 1/90000 s clock
        self.frame_times_s = np.round(n / scene.clip.fps * 90_000) / 90_000
        self.shots = np.repeat(
            np.arange(len(scene.shot)), [s.frames for s in scene.shot]
        )
        self.room = _room(scene, folder)

    @property
    def duration_s(self) -> float:
        return float(self.frame_times_s[-1])

    def lights_at(self, time_s: float) -> ndarray:
        """(n, 7) tracer lights at a time."""
        if self.scene.light.environment:
            return self.room.lights
        rows = []
        for li in self.scene.light.lamps:
            swing = np.sin(2 * np.pi * time_s / li.period_s) * np.array(li.swing_deg)
            angles = np.radians(np.add(swing, (li.azimuth_deg, li.elevation_deg)))
            # of two keys at one time the later holds from then on
            keys = np.array(li.brightness or [(0.0, 1.0)])
            rgb = np.interp(time_s, *keys.T) * np.array(li.rgb)
            disc = np.tan(np.radians(li.angular_size_deg) / 2)
            rows.append([*direction_of(*angles), *rgb, disc])
        return np.array(rows).reshape(-1, 7)

    def poses(self, time_s: float) -> tuple[Pose, ...]:
        """room_from_object of every object."""
        own, by_name = [], {}
        for i, p in enumerate(self.scene.objects):
            name = p.label or f"object {i}"
            pose = room_from_object(p, time_s, self.duration_s, self.scene.seed, name)
            own.append(pose)
            by_name[name] = by_name[p.key or name] = pose
        return tuple(
            by_name[p.attached_to] @ pose if p.attached_to else pose
            for p, pose in zip(self.scene.objects, own, strict=True)
        )

    def at(self, time_s: float) -> Room:
        """What stands where at a time."""
        poses = self.poses(time_s)
        turns = np.array([p.rotation for p in poses]).reshape(-1, 3, 3)
        shifts = np.array([p.translation_m for p in poses]).reshape(-1, 3)

        def moved(rows: ndarray, vectors: int, number: int) -> ndarray:
            """Rows in the room. vectors : the first is a place, the others directions"""
            rows, owner = rows.copy(), rows[:, number].astype(int) - 1
            own = rows[:, : 3 * vectors].reshape(-1, vectors, 3)  # of the copy
            own[:] = own @ turns[owner].swapaxes(1, 2)
            own[:, 0] += shifts[owner]
            return rows

        return self.room._replace(
            rects=moved(self.room.rects, 4, 15),
            spheres=moved(self.room.spheres, 1, 7),
            lights=self.lights_at(time_s),
        )

    def camera_at(self, frame: int, time_s: float) -> Pose:
        """camera_from_room at a time during (or next to) a frame, on the path of the
        frame's shot.
        """
        shot = int(self.shots[frame])
        times = self.frame_times_s[self.shots == shot]
        path, since = self.scene.shot[shot].path, time_s - times[0]
        seed, lasts = self.scene.seed, times[-1] - times[0]
        return camera_from_room(path, since, lasts, seed, f"shot {shot}")


def true_camera(scene: SceneFile) -> Camera:
    """The camera that the frames are rendered with.

    Raises InputError for a wrong number of coefficients.
    """
    w, h, lens = scene.clip.width, scene.clip.height, scene.lens
    f = w / 2 / np.tan(np.radians(lens.fov_deg) / 2)
    cx, cy = np.add(((w - 1) / 2, (h - 1) / 2), lens.centre_offset_px)
    return Camera(
        w,
        h,
        np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]),
        np.array(lens.distortion),
        lens.model,
        "scene",
    )


def _room(scene: SceneFile, folder: Path | None) -> Room:
    """Each thing in its own axes, and the lights of a panorama."""
    hidden = scene.hidden
    rects, spheres, textures = list[Any](), list[Any](), list[Any]()
    tables = [np.zeros((1, 3))]
    for number, p in enumerate(scene.objects, 1):
        if isinstance(p, Sphere):
            spheres.append([0, 0, 0, p.radius_m, *p.colour, number])
            continue
        size_m, smallest, gloss = np.zeros(3), 0.0, 0.0  # smallest: box in texels
        if isinstance(p, Marker):
            picture, size_m[:2] = sheet_albedo(p, hidden.worn_ink)
            gloss = hidden.gloss
        else:
            assert isinstance(p, (Plane, Box))
            size_m[: len(p.size_m)] = p.size_m
            x, y, z = size_m.tolist()
            picture = texture_albedo(
                p.texture,
                (max(x, y), max(y, z)) if isinstance(p, Box) else (x, y),
                scene.seed * 1000 + number - 1,
                folder,
            )
            smallest = float(isinstance(p, Box) or p.texture.kind != "checker")
        half = size_m / 2
        for u, v in _SIDES if isinstance(p, Box) else (_UP,):
            n = np.cross(u, v)
            sides = half @ abs(u), half @ abs(v)
            about = (*sides, len(textures), number, gloss)
            rects.append([*(half * n + half * _Z), *u, *v, *n, *about])
        h, w = picture.shape[:2]
        rgb = np.broadcast_to(picture, (h, w, 3)).astype(float)
        textures.append([sum(map(len, tables)), w, h, smallest])
        tables.append(np.asarray(cv2.integral(rgb), float).reshape(-1, 3))
    ambient = np.array(scene.light.ambient_rgb, float)
    sky, lights = np.zeros((0, 0, 3)), np.zeros((0, 7))
    if scene.light.environment:
        sky = environment_picture(scene.light.environment, folder)
        sky = sky * scene.light.environment_scale
        lights = environment_lights(sky, scene.light.environment_lights)
        ambient = np.zeros(3)
    return Room(
        np.array(rects, float).reshape(-1, 17),
        np.array(spheres, float).reshape(-1, 8),
        lights,
        ambient,
        np.array(textures, float).reshape(-1, 4),
        np.concatenate(tables),
        sky,
    )


def marker_points(marker: Marker) -> ndarray:
    """(144, 3) points spread evenly over the marker's black square, marker axes, metres."""
    grid = ((np.arange(12) + 0.5) / 12 - 0.5) * marker.spec.size_m
    x, y = np.meshgrid(grid, grid)
    return np.stack([x, y, 0 * x], -1).reshape(-1, 3)


def smooth_noise(seed: int, name: str, time_s: float, rate_hz: float) -> ndarray:
    """(6,) band-limited noise with unit rms over time: six sinusoids around
    `rate_hz`, phases from the seed.
    """
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    hz = rate_hz * rng.uniform(0.4, 1.6, (6, 6))
    return np.sin(2 * np.pi * hz * time_s + rng.uniform(0, 2 * np.pi, (6, 6))).sum(
        1
    ) / np.sqrt(3.0)


def look_at(position_m: ndarray, target_m: ndarray) -> Pose:
    """camera_from_room of a camera that looks from one point at another, the room's z up in
    its picture. Straight up or down, the room's y is up instead."""
    forward = normalise(np.asarray(target_m, float) - position_m)
    right = np.cross(forward, _Z)
    if np.linalg.norm(right) < 1e-6:  # along z to within a microradian: no direction
        right = np.cross(forward, _Y)
    right = normalise(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Pose(rotation, -rotation @ np.asarray(position_m, float))


def camera_from_room(
    path: CameraPath, time_s: float, duration_s: float, seed: int, name: str
) -> Pose:
    """Pose of the camera, `time_s` after its shot began."""
    target, position = np.array([path.target_m, path.position_m], float)
    share = _share(time_s, duration_s)
    if path.kind == "orbit":
        position = target + path.radius_m * direction_of(
            *(np.radians([path.azimuth_deg, path.elevation_deg]) @ (1 - share, share))
        )
    elif path.kind == "dolly":
        ease = smoothstep(share)
        position = (1 - ease) * position + ease * np.asarray(path.end_m)
    elif path.kind == "keys":
        position = _between(path.keys, "position_m", time_s)
        target = _between(path.keys, "target_m", time_s)
    both = (
        smooth_noise(seed, f"hand {name}", time_s, 4.0)
        + 2 * smooth_noise(seed, f"drift {name}", time_s, 0.7)
    ) / np.sqrt(5.0)
    return _trembling(both, path.hand_deg, path.hand_m) @ look_at(position, target)


def _share(time_s: float, duration_s: float) -> float:
    """0 at the beginning and before, 1 at the end and after."""
    return float(np.clip(divide(time_s, duration_s), 0.0, 1.0))


def _trembling(noise: ndarray, turn_deg: float, travel_m: float) -> Pose:
    """A small motion from unit noise (6,): a turn, then a shift."""
    return Pose.from_rotvec(np.radians(turn_deg) * noise[:3], travel_m * noise[3:])


def room_from_object(
    placed: SceneObject, time_s: float, duration_s: float, seed: int, name: str
) -> Pose:
    """Pose of an object in its parent's axes (the room's, if it is attached to nothing)."""
    motion = placed.motion
    pose = Pose(
        rotation_from_euler_deg(*placed.rotate_deg),
        np.asarray(placed.position_m, float),
    )
    if motion.kind == "still":
        return pose
    if motion.kind == "keys":
        rotation = rotation_from_euler_deg(
            *_between(motion.keys, "rotate_deg", time_s)
        )
        pose = Pose(rotation, _between(motion.keys, "position_m", time_s))
    elif motion.kind == "turn":
        share = _share(time_s, duration_s)
        angle = np.radians(motion.angle_deg) @ (1 - share, share)
        axis = normalise(np.asarray(motion.axis, float))
        pose = pose @ Pose.from_rotvec(axis * angle, np.zeros(3))
    else:
        a = 2 * np.pi * time_s / motion.period_s
        golden = (
            0.6180339887498949 * a
        )  # incommensurate: the tilts never repeat together
        about_x = rotation_from_euler_deg(motion.tilt_deg * np.sin(a), 0.0, 0.0)
        about_y = rotation_from_euler_deg(
            0.0, motion.tilt_deg * np.sin(golden + 1), 0.0
        )
        pose = pose @ Pose(
            about_x @ about_y,
            motion.travel_m
            * np.array([np.sin(golden), np.sin(a + 2), 0.5 * np.sin(1.3 * a)]),
        )
    return pose @ _trembling(
        smooth_noise(seed, f"tremor {name}", time_s, 6.0),
        motion.tremor_deg,
        motion.tremor_m,
    )


def _between(keys: tuple[Key, ...], name: str, time_s: float) -> ndarray:
    """Catmull-Rom through the keys' values, at rest in the first and the last, constant
    beyond them.
    """
    if len(keys) < 2:
        return np.array(getattr(keys[0], name), float) if keys else np.zeros(3)
    times = np.array([k.time_s for k in keys], float)
    values = np.array([getattr(k, name) for k in keys], float)
    slopes = np.zeros_like(values)
    slopes[1:-1] = (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None]
    return np.asarray(
        CubicHermiteSpline(times, values, slopes)(
            np.clip(time_s, times[0], times[-1])
        )
    )
