"""The camera's path over the markers: planar poses, marker map, path, gaps, smoothing. Solved
when the clip's end is known."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.analyse.job import Analysis
from arfx.analyse.markers.detect import Record
from arfx.analyse.params import AnalyseParams
from arfx.analyse.pose.at_rest import FlowSample, decide_static
from arfx.analyse.pose.figures import figures, quantiles
from arfx.analyse.pose.marker_map import MarkerMap, map_markers
from arfx.analyse.pose.path import WorldPath, world_path
from arfx.analyse.pose.planar import information, residuals, rms_px
from arfx.analyse.pose.shots import shot_numbers
from arfx.analyse.pose.sightings import Sightings
from arfx.analyse.pose.smooth import blended, smooth_poses
from arfx.analyse.pose.visibility import (
    opacities,
    visible_intervals,
    without_flickers,
)
from arfx.core.camera import Camera
from arfx.core.facts import (
    ABSENT,
    INTERPOLATED,
    MEASURED,
    FrameFacts,
)
from arfx.core.marker import Marker, anchor_marker
from arfx.core.pose import Pose
from arfx.errors import NothingToDoError

USUAL_PX = (
    2.0  # of reprojection, at most; of pictures longer than 2000 px a thousandth
)


def solve_poses(
    records: Sequence[Record],
    markers: Sequence[Marker],
    camera: Camera,
    params: AnalyseParams,
    marker_map: Mapping[str, Pose] | None,
    flow: Sequence[FlowSample],
) -> Analysis:
    """All facts of a clip in which at least one configured marker was seen.

    Raises NothingToDoError where no frame has a pose."""
    keys = [m.key for m in markers]
    times = np.array([r.time_s for r in records])
    sightings = Sightings(records, markers, camera)
    shot = shot_numbers(records)
    layout = (
        MarkerMap(dict(marker_map))
        if marker_map
        else map_markers(sightings.prints, len(records), keys)
    )
    path = world_path(sightings.prints, layout.world_from_marker, keys, shot, times)
    every = visible_intervals(path.measured, shot, times, params.max_gap_s)
    present = without_flickers(every, path.measured, shot)
    opacity = opacities(present, shot, times)
    known = np.where(path.measured, MEASURED, INTERPOLATED)
    status = np.where(opacity > 0, known, ABSENT).tolist()
    if not opacity.any():
        showing = sum(bool(r.detections) for r in records)
        raise NothingToDoError(
            f"markers were seen in {showing} of {len(records)} frames, but no pose fits,"
            " or none lasts for three frames",
            "are the marker's size and the camera calibration right, and of this clip?",
        )
    rotation, translation, covariance, noise = smoothed(
        path, present, times, params.smoothing, sightings.common_px
    )
    seen, on = path.observed, path.measured
    raw_px = rms_px(residuals(path.rotation, path.translation, seen), seen.weight)
    smooth_px = rms_px(residuals(rotation, translation, seen), seen.weight)
    facts = []
    for k, r in enumerate(records):
        here = status[k] != ABSENT
        raw = Pose(path.rotation[k], path.translation[k]) if on[k] else None
        blur = [s.blur_px for s in r.detections if np.isfinite(s.blur_px)]
        facts.append(
            FrameFacts(
                r.index,
                r.time_s,
                int(shot[k]),
                status[k],
                Pose(rotation[k], translation[k]) if here else None,
                raw,
                covariance[k] if here else None,
                float(smooth_px[k]) if on[k] else None,
                float(opacity[k]),
                tuple(sightings.facts[k]),
                r.whole,
                blur_px=float(median(blur)) if blur else None,
            )
        )
    static: str = params.static
    evidence: dict[str, float] = {}
    if static == "auto":
        poses = {
            f.index: f.camera_from_world
            for f in facts
            if f.camera_from_world is not None
        }
        static, evidence = decide_static(flow, poses, camera)
    again = [s.key for r in records for s in r.duplicates]
    summary = figures(
        facts,
        keys,
        reprojection_px={
            "raw": quantiles(raw_px[on]),
            "smoothed": quantiles(smooth_px[on]),
        },
        pose_condition=quantiles(_conditions(path)),
        flips_resolved=path.flips,
        sigma_factor=sightings.sigma_factor,
        duplicates=len(again),
        dropped=path.dropped,
        static_evidence=evidence,
        map={"given": marker_map is not None, **layout.to_json()},
        motion_noise=noise,
    )
    usual_px = max(USUAL_PX, 1e-3 * max(camera.width, camera.height))
    return Analysis(
        tuple(facts),
        layout.world_from_marker,
        static,
        summary,
        _notices(summary, again, len(every) - len(present), usual_px),
        anchor_marker(markers, layout.world_from_marker),
    )


def smoothed(
    path: WorldPath,
    present: Sequence[tuple[int, int]],
    times_s: ndarray,
    strength: float,
    common_px: ndarray,
) -> tuple[ndarray, ndarray, ndarray, list[list[float]]]:
    """The path over each interval of `present` frames, as it is where strength is 0: rotation
    (n, 3, 3), translation (n, 3), covariance (n, 6, 6) of every frame that is present; the
    noise learned of each interval.

    common_px : of Sightings"""
    rotation, translation = path.rotation.copy(), path.translation.copy()
    covariance = np.zeros((len(rotation), 6, 6))
    noise = []
    for interval in present:
        at = np.arange(*interval)
        on = at[path.measured[at]]
        # bridged frames start between their neighbours
        gap = at[~path.measured[at]]
        after = np.searchsorted(on, gap)
        a, b = on[after - 1], on[after]
        share = (times_s[gap] - times_s[a]) / (times_s[b] - times_s[a])
        poses = rotation, translation, covariance
        start, end = ([part[k] for part in poses] for k in (a, b))
        rotation[gap], translation[gap], _ = blended(start, end, share)
        part = path.observed.take(at)
        if strength > 0 and len(at) > 1:
            rotation[at], translation[at], covariance[at], learned = smooth_poses(
                rotation[at], translation[at], part, times_s[at], strength
            )
            noise.append(learned.tolist())
        else:
            info = information(rotation[at], translation[at], part)
            covariance[at] = np.linalg.pinv(info, hermitian=True)
        weight = (path.observed.weight[on] > 0) / common_px[on, None] ** 2
        known = path.observed.take(on)._replace(weight=weight)
        info = information(rotation[on], translation[on], known)
        common = np.linalg.pinv(info, hermitian=True).reshape(-1, 36)
        # frames that are bridged have that of their neighbours
        covariance[at] += np.stack(
            [np.interp(times_s[at], times_s[on], entry) for entry in common.T], -1
        ).reshape(-1, 6, 6)
    return rotation, translation, covariance, noise


def _conditions(path: WorldPath) -> ndarray:
    """Condition number of every measured pose, each parameter in units of its precision."""
    on = path.measured
    info = information(
        path.rotation[on], path.translation[on], path.observed.take(on)
    )
    d = np.sqrt(np.maximum(np.einsum("nii->ni", info), 1e-30))
    return np.linalg.cond(info / d[:, :, None] / d[:, None])


def _notices(
    summary: Mapping[str, Any], again: Sequence[str], flickers: int, usual_px: float
) -> tuple[str, ...]:
    """again : keys of prints that were there twice, one each time"""
    unmapped, dropped = summary["map"]["unmapped"], summary["dropped"]
    bridged = summary["frames_interpolated"]
    misfit_px = summary["reprojection_px"]["raw"]["median"] or 0.0
    notices = (
        (
            unmapped,
            "never seen together with a mapped marker, so not used:"
            f" {', '.join(unmapped)}",
        ),
        (flickers, f"{flickers} sightings of only one or two frames are not shown"),
        (
            again,
            f"two prints of the same id in a frame ({', '.join(sorted({*again}))},"
            f" {len(again)} times): the one that moves on from the frame before is followed",
        ),
        (
            dropped,
            f"{dropped} sightings contradict the other markers of their frame and"
            " are not used",
        ),
        (bridged, f"{bridged} frames without a marker bridged"),
        (
            misfit_px > usual_px,
            f"the markers' corners miss their pose by {misfit_px:.3g} px (below 1 is usual):"
            " does the camera calibration fit this clip, and are the sizes of the prints"
            " right?",
        ),
    )
    return tuple(words for applies, words in notices if applies)
