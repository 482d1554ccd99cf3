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


def figures(
    facts: Sequence[FrameFacts], keys: Sequence[str], **more: Any
) -> dict[str, Any]:
    """For the report: of the frames' facts, and what the caller knows beside them.

    keys : of the markers
    """
    count = Counter(f.status for f in facts)
    seen = Counter(m.key for f in facts for m in f.markers)
    ratios = _ambiguities(facts)
    return {
        "frames": len(facts),
        "frames_measured": count[MEASURED],
        "frames_interpolated": count[INTERPOLATED],
        "frames_absent": count[ABSENT],
        "shots": facts[-1].shot + 1,
        "cuts": [b.index for a, b in pairwise(facts) if a.shot != b.shot],
        "flips_resolved": 0,
        "whole_frame_searches": sum(f.whole_frame_search for f in facts),
        "reprojection_px": {"raw": quantiles([]), "smoothed": quantiles([])},
        "pose_condition": quantiles([]),
        "sigma_px": quantiles([m.sigma_px for f in facts for m in f.markers]),
        "ambiguity_ratio": quantiles(ratios),
        "ambiguous_sightings": int((ratios < 4.0).sum()),
        "markers_seen": {k: seen[k] for k in keys},
        "rivals": 0,
        "dropped": 0,
        "map": {"given": True, "frames": 0, "unmapped": []},
        **more,
    }


def _ambiguities(facts: Sequence[FrameFacts]) -> ndarray:
    every = np.array([m.ambiguity for f in facts for m in f.markers])
    return every[np.isfinite(every)]


def quantiles(values: Sequence[float] | ndarray) -> dict[str, float | None]:
    v = np.asarray(values, float)
    v = v[np.isfinite(v)]
    return (
        {"median": float(np.median(v)), "p95": float(np.quantile(v, 0.95))}
        if len(v)
        else {"median": None, "p95": None}
    )


def pose_checks(
    facts: Sequence[FrameFacts], summary: Mapping[str, Any]
) -> Iterator[Check]:
    def at_most(
        name: str, value: float | None, limit: float, action: str
    ) -> Iterator[Check]:
        if value is not None:
            yield Check(name, value, limit, value <= limit, action)

    yield from at_most(
        "reprojection median (px)",
        summary["reprojection_px"]["smoothed"]["median"],
        1.0,
        "check marker size, calibration and lens mode",
    )
    action = (
        "two planar poses fit almost equally: chosen by the motion of the whole clip"
    )
    half = sum(summary["markers_seen"].values()) // 2
    yield from at_most(
        "ambiguous sightings", summary["ambiguous_sightings"], half, action
    )
    ratios = _ambiguities(facts)
    if len(ratios):
        low = float(np.percentile(ratios, 5))
        name = "pose hypotheses: second error / first, 5th percentile"
        yield Check(name, low, 3.0, low >= 3.0, action)
    weak = "pose is weak: larger or more tilted marker"
    condition = summary["pose_condition"]["median"]
    yield from at_most("pose condition number", condition, 1e6, weak)
    spread = [s for s in map(_deviation, facts) if s is not None]
    if spread:
        turn, shift = np.percentile(spread, 95, axis=0).tolist()
        name, action = (
            "pose standard deviation, 95th percentile",
            "smoothed over more frames",
        )
        yield from at_most(f"{name} (deg)", turn, 2.0, action)
        yield from at_most(f"{name} (% of distance)", shift, 2.0, action)
    if not summary["map"]["given"]:
        yield from at_most(
            "marker map condition number",
            summary["map"].get("condition"),
            1e6,
            "show the markers together in more frames",
        )


def _deviation(f: FrameFacts) -> tuple[float, float] | None:
    """(degrees, percent of the distance), the largest axis of each; None without a pose or
    covariance.
    """
    if f.pose_covariance is None or f.camera_from_world is None:
        return None
    c = f.pose_covariance
    if not np.isfinite(c).all():
        return np.inf, np.inf
    turn, shift = (
        float(np.sqrt(max(np.linalg.eigvalsh(c[s, s])[-1], 0.0)))
        for s in (slice(0, 3), slice(3, 6))
    )
    away = float(np.linalg.norm(f.camera_from_world.translation_m))
    return float(np.degrees(turn)), float(divide(100 * shift, away))
