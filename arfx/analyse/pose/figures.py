"""What the report says of the poses, and the checks of their health."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED, FrameFacts
from arfx.core.numerics import divide
from arfx.core.stage import Check

_UNKNOWN = {"median": None, "p95": None}


def figures(
    facts: Sequence[FrameFacts], keys: Sequence[str], **more: Any
) -> dict[str, Any]:
    """For the report: of the frames' facts, and what the caller knows beside them.

    keys : of the markers
    """
    count = Counter(f.status for f in facts)
    seen = Counter(m.key for f in facts for m in f.markers)
    return {
        "frames": len(facts),
        "frames_measured": count[MEASURED],
        "frames_interpolated": count[INTERPOLATED],
        "frames_absent": count[ABSENT],
        "cuts": [b.index for a, b in pairwise(facts) if a.shot != b.shot],
        "flips_resolved": 0,
        "reprojection_px": {"raw": _UNKNOWN, "smoothed": _UNKNOWN},
        "ambiguous_sightings": sum(
            m.ambiguity < 4.0 for f in facts for m in f.markers
        ),
        "markers_seen": {k: seen[k] for k in keys},
        **more,
    }


def quantiles(values: ndarray) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "p95": float(np.quantile(values, 0.95)),
    }


def pose_checks(
    facts: Sequence[FrameFacts], summary: Mapping[str, Any]
) -> Iterator[Check]:
    turn_deg, shift_percent = _deviations(facts)
    spread = "pose standard deviation, 95th percentile"
    weak = "pose is weak: larger or more tilted marker"
    for name, value, limit, action in (
        (
            "reprojection median (px)",
            summary["reprojection_px"]["smoothed"]["median"],
            1.0,
            "check marker size, calibration and lens mode",
        ),
        (
            "ambiguous sightings",
            summary["ambiguous_sightings"],
            sum(summary["markers_seen"].values()) // 2,
            "two planar poses fit almost equally: chosen by the motion of the whole clip",
        ),
        (f"{spread} (deg)", turn_deg, 2.0, weak),
        (f"{spread} (% of distance)", shift_percent, 2.0, weak),
        (
            "marker map condition number",
            summary.get("map", {}).get("condition"),
            1e6,
            "show the markers together in more frames",
        ),
    ):
        if value is not None:
            yield Check(name, value, limit, value <= limit, action)


def _deviations(
    facts: Sequence[FrameFacts],
) -> tuple[float, float] | tuple[None, None]:
    """95th percentiles of (degrees, percent of the distance), the largest axis of each; None
    where no frame has a pose and its covariance.
    """
    known = [f for f in facts if f.pose_covariance is not None]
    if not known:
        return None, None
    covariance = np.array([f.pose_covariance for f in known])
    away_m = np.linalg.norm([f.pose.translation_m for f in known], axis=1)
    turn, shift = (
        np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[:, s, s])[:, -1], 0.0))
        for s in (slice(0, 3), slice(3, 6))
    )
    both = np.degrees(turn), divide(100 * shift, away_m)
    turn_deg, percent = np.percentile(both, 95, axis=1).tolist()
    return turn_deg, percent
