"""Where the camera and every object are at any moment: exact poses as functions of time."""

from __future__ import annotations

import zlib

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.synth.description import CameraPath, Key, Motion, Placed


def smooth_noise(seed: int, name: str, time_s: float, rate_hz: float, channels: int) -> np.ndarray:
    """(channels,) band-limited noise with unit rms over time: six sinusoids around `rate_hz`, phases from the seed."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    hz = rate_hz * rng.uniform(0.4, 1.6, (channels, 6))
    phase = rng.uniform(0, 2 * np.pi, (channels, 6))
    return np.sin(2 * np.pi * hz * time_s + phase).sum(1) / np.sqrt(3.0)


def look_at(position_m: np.ndarray, target_m: np.ndarray) -> Pose:
    """camera_from_room of a camera that looks from one point at another, the room's z up in its picture.

    Straight up or down, the room's y is up instead.
    """
    forward = normalise(np.asarray(target_m, float) - position_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:  # looking along z to within a microradian: `up` gives no direction
        right = np.cross(forward, [0.0, 1.0, 0.0])
    right = normalise(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Pose(rotation, -rotation @ np.asarray(position_m, float))


def camera_from_room(path: CameraPath, time_s: float, duration_s: float, seed: int, name: str) -> Pose:
    """Pose of the camera, `time_s` after its shot began."""
    at = float(np.clip(divide(time_s, duration_s), 0.0, 1.0))
    target = np.asarray(path.target_m, float)
    if path.kind == "orbit":
        azimuth = np.radians(path.azimuth_deg[0] + (path.azimuth_deg[1] - path.azimuth_deg[0]) * at)
        elevation = np.radians(path.elevation_deg[0] + (path.elevation_deg[1] - path.elevation_deg[0]) * at)
        flat = np.cos(elevation)
        position = target + path.radius_m * np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    elif path.kind == "dolly":
        ease = at * at * (3 - 2 * at)
        position = (1 - ease) * np.asarray(path.position_m) + ease * np.asarray(path.end_m)
    elif path.kind == "keys":
        position = _between(path.keys, "position_m", time_s)
        target = _between(path.keys, "target_m", time_s)
    else:
        position = np.asarray(path.position_m, float)
    pose = look_at(position, target)
    if path.hand_deg or path.hand_m:
        shake = smooth_noise(seed, f"hand {name}", time_s, 4.0, 6)
        slow = smooth_noise(seed, f"drift {name}", time_s, 0.7, 6)
        both = (shake + 2 * slow) / np.sqrt(5.0)
        pose = Pose.from_rotvec(np.radians(path.hand_deg) * both[:3], path.hand_m * both[3:]) @ pose
    return pose


def room_from_object(placed: Placed, time_s: float, duration_s: float, seed: int, name: str) -> Pose:
    """Pose of an object in its parent's axes (the room's, if it is attached to nothing)."""
    rest = Pose(rotation_from_euler_deg(*placed.rotate_deg), np.asarray(placed.position_m, float))
    motion = placed.motion
    if motion.kind == "still":
        return rest
    if motion.kind == "keys":
        moved = Pose(
            rotation_from_euler_deg(*_between(motion.keys, "rotate_deg", time_s)), _between(motion.keys, "position_m", time_s)
        )
        return moved @ _tremor(motion, time_s, seed, name)
    if motion.kind == "turn":
        at = float(np.clip(divide(time_s, duration_s), 0.0, 1.0))
        angle = np.radians(motion.angle_deg[0] + (motion.angle_deg[1] - motion.angle_deg[0]) * at)
        own = Pose.from_rotvec(normalise(np.asarray(motion.axis, float)) * angle, np.zeros(3))
    else:
        own = _sway(motion, time_s)
    return rest @ own @ _tremor(motion, time_s, seed, name)


def _sway(motion: Motion, time_s: float) -> Pose:
    a = 2 * np.pi * time_s / motion.period_s
    golden = 0.6180339887498949  # incommensurate: the tilts never repeat together
    about_x = rotation_from_euler_deg(motion.tilt_deg * np.sin(a), 0.0, 0.0)
    rotation = about_x @ rotation_from_euler_deg(0.0, motion.tilt_deg * np.sin(golden * a + 1), 0.0)
    shift = motion.travel_m * np.array([np.sin(golden * a), np.sin(a + 2), 0.5 * np.sin(1.3 * a)])
    return Pose(rotation, shift)


def _tremor(motion: Motion, time_s: float, seed: int, name: str) -> Pose:
    if not (motion.tremor_deg or motion.tremor_m):
        return Pose.identity()
    n = smooth_noise(seed, f"tremor {name}", time_s, 6.0, 6)
    return Pose.from_rotvec(np.radians(motion.tremor_deg) * n[:3], motion.tremor_m * n[3:])


def _between(keys: tuple[Key, ...], name: str, time_s: float) -> np.ndarray:
    """Catmull-Rom through the keys' values, at rest in the first and the last, constant beyond them."""
    if len(keys) < 2:
        return np.array(getattr(keys[0], name), float) if keys else np.zeros(3)
    times = np.array([k.time_s for k in keys], float)
    values = np.array([getattr(k, name) for k in keys], float)
    slopes = np.zeros_like(values)
    slopes[1:-1] = (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None]
    return np.asarray(CubicHermiteSpline(times, values, slopes)(np.clip(time_s, times[0], times[-1])))
