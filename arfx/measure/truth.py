"""Estimates against the truth of a synthetic clip: pose, flips, lag, trembling, presence,
cuts, marker map, light.

All figures are for the world marker's pose in the camera, frame by frame; frames in which
either side has none are left out."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.colour import SRGB
from arfx.core.facts import ABSENT, INTERPOLATED, FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.numerics import angle_between, divide, normalise
from arfx.core.pose import Pose, rotation_angle_rad
from arfx.synth.truth import FrameTruth, Truth

# nearer to the mirrored solution but off by less: at a frontal view both are the same to
# the eye
FLIP_DEG = 3.0
SEEN, HIDDEN = (
    0.97,
    0.5,
)  # visible fraction from which a marker must be found / below which it cannot be
_MOVING_PX = 0.5  # slower corners say nothing about lag


def pose_errors(
    estimates: Sequence[Pose | None], truth: Truth, key: str, size_m: float
) -> dict[str, Any]:
    """Errors of camera_from_marker estimates, one per frame (None = no estimate), against
    the truth.

    rotation_deg, position_mm : median, p95, max
    flips : frames whose normal lies nearer to the true one mirrored at the line of sight
    than to the true one, and that are
    turned by more than FLIP_DEG. (A fixed angle alone would miss the flips of a frontal
    print: they measure twice its tilt.)
    corner_px : the marker's corners projected through the true camera with the estimate and
    with the truth, rms
    tremble_px : rms second difference of that corner error, frames that follow each other only
    lag_frames : regression of the corner error on the true corner velocity, > 0 = the
    estimate is late; None when the
    marker hardly moves in the picture"""
    camera = Camera.from_json(truth.header["camera"])
    corners_m = MarkerSpec("", 0, size_m).corners_m
    exact = [f.markers[key].camera_from_marker for f in truth.frames]
    projected = np.array([camera.project(pose.apply(corners_m)) for pose in exact])
    error = np.full_like(projected, np.nan)
    shots = np.array([f.shot for f in truth.frames])
    rows = []
    for i, (estimate, true) in enumerate(zip(estimates, exact, strict=True)):
        if estimate is None:
            continue
        error[i] = camera.project(estimate.apply(corners_m)) - projected[i]
        off_deg, off_mm = _apart(estimate, true)
        view, normal = normalise(true.translation_m), true.rotation[:, 2]
        twin = 2 * (normal @ view) * view - normal
        mirrored = estimate.rotation[:, 2] @ (twin - normal) > 0
        rows.append((off_deg, off_mm, mirrored and off_deg > FLIP_DEG))
    if not rows:
        return {"frames": 0}
    rotation_deg, position_mm, flips = np.transpose(rows)
    return {
        "frames": len(rows),
        "rotation_deg": quantiles(rotation_deg, median=50, p95=95, max=100),
        "position_mm": quantiles(position_mm, median=50, p95=95, max=100),
        "corner_px": float(np.sqrt(np.nanmean((error**2).sum(-1)))),
        "tremble_px": _jitter(error, shots),
        "lag_frames": _lag(error, projected, shots),
        "flips": int(flips.sum()),
    }


def _apart(a: Pose, b: Pose) -> tuple[float, float]:
    """Degrees and millimetres."""
    off_m = np.linalg.norm(a.translation_m - b.translation_m)
    return float(np.degrees(rotation_angle_rad(a, b))), float(1e3 * off_m)


def quantiles(
    values: Sequence[float] | ndarray, **percent: float
) -> dict[str, float]:
    """By name, at so many percent of the values."""
    return {name: float(np.percentile(values, q)) for name, q in percent.items()}


def _jitter(error: ndarray, shots: ndarray) -> float | None:
    second = error[2:] - 2 * error[1:-1] + error[:-2]
    second = second[(shots[2:] == shots[:-2]) & np.isfinite(second).all((1, 2))]
    return float(np.sqrt((second**2).sum(-1).mean())) if len(second) else None


def _lag(error: ndarray, projected: ndarray, shots: ndarray) -> float | None:
    """est(t) = true(t - lag) gives error = -lag * velocity; least squares over all corners
    and frames.
    """
    velocity = (projected[2:] - projected[:-2]) / 2
    middle = error[1:-1]
    ok = (
        (shots[2:] == shots[:-2])
        & np.isfinite(velocity).all((1, 2))
        & np.isfinite(middle).all((1, 2))
    )
    v, e = velocity[ok], middle[ok]
    if not len(v):
        return None
    v = v - v.mean(0)  # a standing offset of the error is no lag
    power = float((v**2).sum())
    if np.sqrt(power / v[..., 0].size) < _MOVING_PX:
        return None
    return float(-(e * v).sum() / power)


def presence(
    facts: Sequence[FrameFacts], truth: Truth, keys: Sequence[str]
) -> dict[str, int]:
    """Frames in which a configured marker could be seen or not, against what the analysis says.

    missed : some marker is in full view, the analysis says absent;  invented : measured
    where none can be seen
    bridged : interpolated frames;  unclear : markers cut or covered in part, not judged"""
    best = [
        max((f.markers[k].visible for k in keys), default=0.0) for f in truth.frames
    ]
    seen, hidden = np.array(best) >= SEEN, np.array(best) < HIDDEN
    status = np.array([f.status for f in facts])
    found = {
        "seen": seen,
        "missed": seen & (status == ABSENT),
        "hidden": hidden,
        "invented": hidden & ~np.isin(status, (ABSENT, INTERPOLATED)),
        "bridged": status == INTERPOLATED,
        "unclear": ~seen & ~hidden,
    }
    return {kind: int(frames.sum()) for kind, frames in found.items()}


def cuts(facts: Sequence[FrameFacts], truth: Truth) -> dict[str, int]:
    """Cuts found at their true frame, missed, and invented."""
    found, exact = (
        set(np.flatnonzero(np.diff([f.shot for f in frames])))
        for frames in (facts, truth.frames)
    )
    return {
        "found": len(found & exact),
        "missed": len(exact - found),
        "invented": len(found - exact),
    }


def map_errors(
    world_from_marker: Mapping[str, Pose], truth: Truth, world: str
) -> dict[str, Any] | None:
    """Position (mm) and rotation (deg) errors of the mapped markers in the world marker's
    axes; None with one marker.
    """
    others = [k for k in world_from_marker if k != world]
    if not others or world not in world_from_marker:
        return None
    mapped = world_from_marker[world].inverse()
    room = truth.frames[0].room_from_marker
    out: dict[str, dict[str, float]] = {}
    for k in others:
        exact = room[world].inverse() @ room[k]
        turned_deg, off_mm = _apart(mapped @ world_from_marker[k], exact)
        out[k] = {"position_mm": off_mm, "rotation_deg": turned_deg}
    worst = {
        f"{figure}_max": max(errors[figure] for errors in out.values())
        for figure in ("position_mm", "rotation_deg")
    }
    return {"markers": out, **worst}


def compare(
    facts: Sequence[FrameFacts],
    world_from_marker: Mapping[str, Pose],
    truth: Truth,
    single_frame: Sequence[Pose | None] | None = None,
) -> dict[str, Any]:
    """Every comparison at once; arfx's figures under "arfx", unsmoothed "raw", plain OpenCV
    under "single_frame".
    """
    world = world_key(world_from_marker, truth)
    world_from = world_from_marker[world]

    def errors(poses: Iterable[Pose | None]) -> dict[str, Any]:
        """poses : of the camera from the world"""
        seen = [None if pose is None else pose @ world_from for pose in poses]
        return pose_errors(seen, truth, world, truth.header["markers"][world])

    out: dict[str, Any] = {
        "frames": len(truth.frames),
        "world": world,
        "arfx": errors(f.camera_from_world for f in facts),
        "raw": errors(f.raw_camera_from_world for f in facts),
        "presence": presence(facts, truth, list(truth.header["markers"])),
        "cuts": cuts(facts, truth),
        "single_frame": single_frame
        and pose_errors(single_frame, truth, world, truth.header["markers"][world]),
        "map": map_errors(world_from_marker, truth, world),
        "light": light_errors(facts, world_from_marker, truth),
    }
    return {name: figures for name, figures in out.items() if figures is not None}


def world_key(world_from_marker: Mapping[str, Pose], truth: Truth) -> str:
    """The marker whose axes are the world's, or else the first configured one that was mapped."""
    for key, pose in world_from_marker.items():
        if (
            key in truth.header["markers"]
            and np.linalg.norm(pose.rotvec) < 1e-9
            and np.linalg.norm(pose.translation_m) < 1e-9
        ):
            return key
    return next(k for k in truth.header["markers"] if k in world_from_marker)


def exceeded(figures: Mapping[str, Any], bounds: Mapping[str, Any]) -> list[str]:
    """What breaks the bounds, one sentence each. bounds: {"max": {"arfx.flips": 0, …},
    "min": {…}, "is": {"static": "camera"}}.

    Keys are dotted. A figure that is bounded but missing breaks its bound."""
    broken = []
    for kind in ("max", "min", "is"):
        for dotted, limit in bounds.get(kind, {}).items():
            value: Any = figures
            for part in dotted.split("."):
                value = value.get(part) if isinstance(value, Mapping) else None
            if kind == "is":
                if value != limit:
                    broken.append(f"{dotted} is {value!r}, it should be {limit!r}")
            elif value is None:
                broken.append(
                    f"{dotted}: there is no such figure, its bound is {limit:g}"
                )
            elif not (value <= limit if kind == "max" else value >= limit):
                bound = "at most" if kind == "max" else "at least"
                broken.append(
                    f"{dotted} is {value:.4g}, {bound} {limit:g} is allowed"
                )
    return broken


MEASURED = "marker"  # Light.source of a light measured by markers
OPEN = 0.9  # visible fraction of a marker from which its normal counts as seen
FALSE_FACTOR, FALSE_DEG = (
    2.0,
    3.0,
)  # a direction is falsely claimed where it is off by more than twice its cone and 3 degrees


def light_errors(
    facts: Sequence[FrameFacts], world_from_marker: Mapping[str, Pose], truth: Truth
) -> dict[str, Any] | None:
    """None where no frame carries a light.

    frames; measured : frames with a claimed direction
    direction_deg : angle between the strongest claimed light and the true lamp nearest to it
    false : frames whose claim is off by more than twice its own confidence cone and
    FALSE_DEG, or that claim where no lamp is
    irradiance : relative error of a white surface's radiance over the seen markers'
    normals, all channels
    bias_grey : error of the camera's bias in 8-bit sRGB steps above its true value, worst channel
    size_deg : claimed less true angular size, median"""
    angles, sizes, irradiance, bias, false, frames = [], [], [], [], 0, 0
    for fact, frame in zip(facts, truth.frames, strict=True):
        if fact.light is None:
            continue
        frames += 1
        coded_bias = (
            SRGB.encode(np.array(rgb)) for rgb in (fact.bias_rgb, frame.bias)
        )
        bias.append(255 * np.abs(np.subtract(*coded_bias)).max())
        irradiance += _irradiance(fact, frame, world_from_marker)
        if fact.light.source != MEASURED or not fact.light.lights:
            continue
        key = next(k for k in world_from_marker if k in frame.markers)
        turn = world_from_marker[key].rotation
        claimed = max(fact.light.lights, key=lambda li: sum(li.rgb))
        lamps = frame.lights
        towards = [turn @ np.array(lamp["marker"][key]) for lamp in lamps]
        off = [float(np.degrees(angle_between(claimed.unit, d))) for d in towards]
        if not off:
            false += 1
            continue
        nearest = int(np.argmin(off))
        angles.append(off[nearest])
        sizes.append(claimed.angular_size_deg - lamps[nearest]["angular_size_deg"])
        false += off[nearest] > max(FALSE_FACTOR * claimed.confidence_deg, FALSE_DEG)
    if not frames:
        return None
    out: dict[str, Any] = {
        "frames": frames,
        "measured": len(angles) + false * (not angles),
        "false": int(false),
        "bias_grey": float(np.median(bias)),
    }
    if irradiance:
        out["irradiance"] = quantiles(irradiance, median=50, p95=95)
    if angles:
        out["direction_deg"] = quantiles(angles, median=50, p90=90, max=100)
        out["size_deg"] = float(np.median(sizes))
    return out


def _irradiance(
    fact: FrameFacts, frame: FrameTruth, world_from_marker: Mapping[str, Pose]
) -> list[float]:
    assert fact.light is not None
    out = []
    for key, marker in frame.markers.items():
        if (
            key not in world_from_marker
            or marker.visible < OPEN
            or marker.facing < 0.3
        ):
            continue
        exact = np.array(frame.ambient_rgb, float)
        for lamp in frame.lights:
            cosine = max(float(lamp["marker"][key][2]), 0.0)
            exact = exact + cosine * np.array(lamp["rgb"])
        claimed_rgb = fact.light.radiance(world_from_marker[key].rotation[:, 2])
        off = np.abs(claimed_rgb - frame.gain * exact)
        out += divide(off, max(float(frame.gain * exact.max()), 1e-6)).tolist()
    return out
