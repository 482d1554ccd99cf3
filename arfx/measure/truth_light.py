"""The light that was read from a synthetic clip against its truth: direction, irradiance, bias, false confidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.facts import FrameFacts
from arfx.core.numerics import angle_between, divide
from arfx.core.pose import Pose
from arfx.synth.truth import FrameTruth, Truth

MEASURED = "marker"  # Light.source of a light that the markers tell
OPEN = 0.9  # visible share of a marker from which its normal counts as seen
FALSE_FACTOR, FALSE_DEG = 2.0, 3.0  # a direction is falsely claimed where it is off by more than twice its cone and 3 degrees


def light_errors(
    facts: Sequence[FrameFacts], world_from_marker: Mapping[str, Pose], truth: Truth
) -> dict[str, Any] | None:  # fmt: skip
    """None where no frame carries a light.

    frames; measured : frames with a claimed direction
    direction_deg : angle between the strongest claimed light and the true lamp nearest to it
    false : frames whose claim is off by more than twice its own confidence cone and FALSE_DEG, or that claim where no lamp is
    irradiance : relative error of a white surface's radiance over the seen markers' normals, all channels
    bias_grey : error of the camera's bias in 8-bit sRGB steps above its true value, worst channel
    size_deg : claimed less true angular size, median
    """
    angles, sizes, irradiance, bias, false, frames = [], [], [], [], 0, 0
    for fact, frame in zip(facts, truth.frames, strict=True):
        if fact.light is None:
            continue
        frames += 1
        bias.append(_grey_steps(np.array(fact.bias_rgb), frame.bias))
        irradiance += _irradiance(fact, frame, world_from_marker)
        if fact.light.source != MEASURED or not fact.light.lights:
            continue
        key = next(k for k in world_from_marker if k in frame.markers)
        turn = world_from_marker[key].rotation
        claimed = max(fact.light.lights, key=lambda li: sum(li.rgb))
        lamps = frame.lights
        off = [float(np.degrees(angle_between(claimed.unit, turn @ np.array(li["marker"][key])))) for li in lamps]
        if not off:
            false += 1
            continue
        nearest = int(np.argmin(off))
        angles.append(off[nearest])
        sizes.append(claimed.angular_size_deg - lamps[nearest]["angular_size_deg"])
        false += off[nearest] > max(FALSE_FACTOR * claimed.confidence_deg, FALSE_DEG)
    if not frames:
        return None
    out: dict[str, Any] = {"frames": frames, "measured": len(angles) + false * (not angles), "false": int(false)}
    out["bias_grey"] = float(np.median(bias))
    if irradiance:
        out["irradiance"] = {"median": float(np.median(irradiance)), "p95": float(np.percentile(irradiance, 95))}
    if angles:
        spread = (float(np.percentile(angles, q)) for q in (50, 90, 100))
        out["direction_deg"] = dict(zip(("median", "p90", "max"), spread, strict=True))
        out["size_deg"] = float(np.median(sizes))
    return out


def _irradiance(fact: FrameFacts, frame: FrameTruth, world_from_marker: Mapping[str, Pose]) -> list[float]:
    assert fact.light is not None
    out = []
    for key, marker in frame.markers.items():
        if key not in world_from_marker or marker.visible < OPEN or marker.facing < 0.3:
            continue
        exact = np.array(frame.ambient_rgb, float)
        for lamp in frame.lights:
            exact = exact + max(float(np.array(lamp["marker"][key])[2]), 0.0) * np.array(lamp["rgb"])
        told = fact.light.radiance(world_from_marker[key].rotation[:, 2])
        out += divide(np.abs(told - frame.gain * exact), max(float(frame.gain * exact.max()), 1e-6)).tolist()
    return out


def _grey_steps(bias: np.ndarray, exact: float) -> float:
    """Largest difference of two biases in 8-bit steps of the coded value at the dark end."""
    return float(255 * np.abs(SRGB.encode(bias) - SRGB.encode(np.array(exact))).max())
