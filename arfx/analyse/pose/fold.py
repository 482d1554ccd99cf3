"""The camera's path over the markers: hypotheses, marker map, path, gaps, smoothing. Solved
when the clip's end is known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median
from typing import Any, Self

import numpy as np

from arfx.analyse.fold import Analysis, AnalysisFrame, AnalysisJob, Fold, shifted
from arfx.analyse.markers.corners import shared_px
from arfx.analyse.markers.detect import Detection, Record
from arfx.analyse.markers.fold import Markers
from arfx.analyse.markers.inner_edges import AGREE_CELLS
from arfx.analyse.params import AnalyseParams
from arfx.analyse.pose.at_rest import BackgroundFlow, FlowSample, decide_static
from arfx.analyse.pose.marker_map import MarkerMap, View, map_markers
from arfx.analyse.pose.path import WorldPath, world_path
from arfx.analyse.pose.planar import (
    Observed,
    hypotheses,
    information,
    lens_scale,
    residuals,
    rms_px,
    stack,
)
from arfx.analyse.pose.smooth import smooth_poses
from arfx.analyse.pose.visibility import (
    find_cuts,
    frame_statuses,
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
    Hypothesis,
    MarkerSighting,
)
from arfx.core.marker import Marker, MarkerSpec, anchor_marker
from arfx.core.marker_codes import cells_per_side
from arfx.core.numerics import divide
from arfx.core.pose import Pose, rotation_from_rotvec, rotvec_from_rotation
from arfx.core.rect import Rect
from arfx.core.stage import Check
from arfx.errors import NothingToDoError

# of a corner, at least, that no smoothing averages away: the print's edges, the optics
_COMMON_PX = 0.005
# What covers a print comes and goes. Beside a frame where it is told, what is not told may
# be left; half of it so far away.
_COVERS_S = 1 / 30
USUAL_PX = 2.0  # of reprojection, at most; of pictures longer than 2000 px a thousandth
_LEAST_SIGMA_PX = 0.015  # no corner of a real print in a real picture is known better


class MarkerPose(Fold):
    """flow : corners of the background, which tell what stands still"""

    name = "pose"
    needs = ("markers",)

    def __init__(self, job: AnalysisJob, markers: Markers) -> None:
        super().__init__(job)
        self.markers = markers
        self.flow = BackgroundFlow(job.length_s)

    def step(self, frame: AnalysisFrame) -> None:
        if self.job.params.static == "auto":
            boxes = (
                Rect.around(s.corners_px) for s in self.markers.prints
            )  # rarely asked for
            self.flow.step(
                frame.index, frame.time_s, frame.luma, boxes, bool(self.markers.detections)
            )

    def join(self, later: Self, shift: int) -> None:
        self.flow.samples += shifted(later.flow.samples, shift)

    def finish(self, clip: Analysis) -> Analysis:
        """Raises NothingToDoError where no frame has a pose."""
        job, records = self.job, self.markers.records
        found = solve(
            records,
            job.markers,
            self.markers.camera,
            job.params,
            job.marker_map,
            self.flow.samples,
        )
        if all(f.status == ABSENT for f in found.facts):
            seen = sum(bool(r.detections) for r in records)
            raise NothingToDoError(
                f"markers were seen in {seen} of {len(records)} frames, but no pose fits,"
                " or none lasts for three frames",
                "are the marker's size and the camera calibration right, and of this clip?",
            )
        return replace(
            found, frame_span=clip.frame_span, summary={**found.summary, **clip.summary}
        )

    @staticmethod
    def health(facts: Sequence[FrameFacts], summary: Mapping[str, Any]) -> Iterator[Check]:
        reprojection = summary["reprojection_px"]["smoothed"]["median"]
        if reprojection is not None:
            action = "check marker size, calibration and lens mode"
            yield Check(
                "reprojection median (px)", reprojection, 1.0, reprojection <= 1.0, action
            )
        ambiguous, sightings = (
            summary["ambiguous_sightings"],
            sum(summary["markers_seen"].values()),
        )
        action = (
            "two planar poses fit almost equally: chosen by the motion of the whole clip"
        )
        yield Check(
            "ambiguous sightings",
            ambiguous,
            sightings // 2,
            ambiguous <= sightings // 2,
            action,
        )
        ratios = [m.ambiguity for f in facts for m in f.markers if np.isfinite(m.ambiguity)]
        if ratios:
            low = float(np.percentile(ratios, 5))
            yield Check(
                "pose hypotheses: second error / first, 5th percentile",
                low,
                3.0,
                low >= 3.0,
                action,
            )
        condition = summary["pose_condition"]["median"]
        if condition is not None:
            weak = "pose is weak: larger or more tilted marker"
            yield Check("pose condition number", condition, 1e6, condition <= 1e6, weak)
        spread = [s for s in map(_deviation, facts) if s is not None]
        if spread:
            turn, shift = (float(np.percentile([s[k] for s in spread], 95)) for k in (0, 1))
            name, action = (
                "pose standard deviation, 95th percentile",
                "smoothed over more frames",
            )
            yield Check(f"{name} (deg)", turn, 2.0, turn <= 2.0, action)
            yield Check(f"{name} (% of distance)", shift, 2.0, shift <= 2.0, action)
        value = summary["map"].get("condition")
        if not summary["map"]["given"] and value is not None:
            yield Check(
                "marker map condition number",
                value,
                1e6,
                value <= 1e6,
                "show the markers together in more frames",
            )


def _deviation(f: FrameFacts) -> tuple[float, float] | None:
    """(degrees, percent of the distance), the largest axis of each; None without a pose or
    covariance.
    """
    if f.pose_covariance is None or f.camera_from_world is None:
        return None
    c = np.asarray(f.pose_covariance, float)
    if c.shape != (6, 6) or not np.isfinite(c).all():
        return float("inf"), float("inf")
    turn, shift = (
        float(np.sqrt(max(np.linalg.eigvalsh(c[s, s])[-1], 0.0)))
        for s in (slice(0, 3), slice(3, 6))
    )
    away = float(np.linalg.norm(f.camera_from_world.translation_m))
    return float(np.degrees(turn)), float(divide(100 * shift, away))


class Views:
    """All sightings with their geometry, frame by frame."""

    def __init__(
        self, records: Sequence[Record], markers: Sequence[Marker], camera: Camera
    ) -> None:
        spec = {m.key: m for m in markers}
        cells = {
            m.key: cells_per_side(m.family) if isinstance(m, MarkerSpec) else 1
            for m in markers
        }
        seen = [(k, s) for k, r in enumerate(records) for s in r.detections]
        corners = np.array([s.corners_px for _, s in seen]).reshape(-1, 4, 2)
        ideal = camera.normalised(corners)
        scale = lens_scale(camera, np.where(np.isfinite(ideal), ideal, 0.0))
        misplaced = np.array([s.misplaced_px for _, s in seen])
        sigma = np.hypot(np.array([s.sigma_px for _, s in seen]), misplaced)
        good = np.isfinite(ideal).all((1, 2))
        points = [spec[s.key].corners_m for _, s in seen]
        shared = shared_px(
            corners,
            np.array([s.blur_px for _, s in seen]),
            np.array([cells[s.key] for _, s in seen]),
        )
        candidates = (
            hypotheses(
                points, ideal, scale, np.hypot(np.maximum(sigma, _LEAST_SIGMA_PX), shared)
            )
            if seen
            else []
        )
        self.sigma_factor = self._calibrate(seen, candidates, sigma, ideal, scale, points)
        self.common_px = np.full(
            len(records), _COMMON_PX
        )  # error of a frame's corners that its neighbours' have too
        sums = np.zeros(
            (3, len(records))
        )  # of the corners' weights; with the square of misplaced_px, of what is not told
        self.frames: list[list[View]] = [[] for _ in records]
        self.sightings: list[list[MarkerSighting]] = [[] for _ in records]
        for i, (k, s) in enumerate(seen):
            px = float(
                np.hypot(max(sigma[i] * self.sigma_factor, _LEAST_SIGMA_PX), shared[i])
            )
            self.common_px[k] = max(self.common_px[k], shared[i])
            untold = AGREE_CELLS * s.side_px / cells[s.key]
            sums[:, k] += np.array([1.0, misplaced[i] ** 2, untold**2]) / px**2
            if good[i] and candidates[i]:
                poses = tuple(h.camera_from_marker for h in candidates[i])
                self.frames[k].append(View(s.key, points[i], ideal[i], scale[i], px, poses))
            self.sightings[k].append(
                MarkerSighting(s.key, s.corners_px, px, candidates[i], 0, s.inverted)
            )
        told = sums[1] > 0
        gap_s = _gaps(np.array([r.time_s for r in records]), told)
        off = np.where(told, sums[1], sums[2] * 0.5 ** (2 * gap_s / _COVERS_S))
        self.common_px = np.hypot(self.common_px, np.sqrt(divide(off, sums[0])))

    def _calibrate(
        self,
        seen: Sequence[tuple[int, Detection]],
        candidates: Sequence[tuple[Hypothesis, ...]],
        sigma: np.ndarray,
        ideal: np.ndarray,
        scale: np.ndarray,
        points: Sequence[np.ndarray],
    ) -> float:
        """Factor on the predicted sigma, from how residuals change from one sighting of a
        marker to its next.

        What stays (a bent print, an imperfect lens model) is no noise: taken for noise it
        would let the smoother drag the object away from a picture that shakes. 8
        coordinates minus 6 unknowns leave 2 degrees of freedom."""
        at = [i for i in range(len(seen)) if candidates[i] and sigma[i] < 1.0]
        rotation, translation = stack([candidates[i][0].camera_from_marker for i in at])
        these = np.array(at, int)
        one = Observed(
            np.array([points[i] for i in at]).reshape(-1, 4, 3),
            ideal[these],
            scale[these],
            np.ones((len(at), 4)),
        )
        misfit = residuals(rotation, translation, one)
        last: dict[str, int] = {}
        chi2 = []
        for j, i in enumerate(at):
            k, key = seen[i][0], seen[i][1].key
            if key in last and seen[at[last[key]]][0] == k - 1:
                before = last[key]
                change = misfit[j] - misfit[before]
                chi2.append(
                    float((change**2).sum() / (sigma[i] ** 2 + sigma[at[before]] ** 2))
                )
            last[key] = j
        if len(chi2) < 5:
            return 1.0
        return float(
            np.clip(np.sqrt(np.median(chi2) / 1.386), 0.5, 20.0)
        )  # median of chi squared with two degrees


def _gaps(times: np.ndarray, marked: np.ndarray) -> np.ndarray:
    """(n,) s from each of times (n,), rising, to the nearest one that is marked, (n,) bool;
    infinite where none is.
    """
    at = np.concatenate([[-np.inf], times[marked], [np.inf]])
    after = np.clip(np.searchsorted(at, times), 1, None)
    return np.minimum(times - at[after - 1], at[after] - times)


def solve(
    records: Sequence[Record],
    markers: Sequence[Marker],
    camera: Camera,
    params: AnalyseParams,
    marker_map: Mapping[str, Pose] | None,
    flow: Sequence[FlowSample],
) -> Analysis:
    """All facts of a clip in which at least one configured marker was seen."""
    notices: list[str] = []
    keys = [m.key for m in markers]
    times = np.array([r.time_s for r in records])
    views = Views(records, markers, camera)
    shot = _shots(records)
    layout = MarkerMap(dict(marker_map)) if marker_map else map_markers(views.frames, keys)
    if layout.unmapped:
        notices.append(
            "never seen together with a mapped marker, so not used:"
            f" {', '.join(layout.unmapped)}"
        )
    path = world_path(views.frames, layout.world_from_marker, keys, shot, times)
    every = visible_intervals(path.measured, shot, times, params.max_gap_s)
    present = without_flickers(every, path.measured, shot)
    if len(present) < len(every):
        notices.append(
            f"{len(every) - len(present)} sightings of only one or two frames are not shown"
        )
    status = frame_statuses(path.measured, present)
    opacity = opacities(present, shot)
    rotation, translation = _filled(path, present, times)
    covariance = np.zeros((len(records), 6, 6))
    density = []
    for first, end in present:
        at = np.arange(first, end)
        part = path.observed.take(at)
        if params.smoothing > 0 and len(at) > 1:
            s = smooth_poses(
                rotation[at], translation[at], part, times[at], params.smoothing
            )
            rotation[at], translation[at], covariance[at] = (
                s.rotation,
                s.translation_m,
                s.covariance,
            )
            density.append(s.density)
        else:
            info = information(rotation[at], translation[at], part)
            covariance[at] = np.linalg.pinv(info, hermitian=True)
        known = replace(part, weight=(part.weight > 0) / views.common_px[at, None] ** 2)
        common = np.linalg.pinv(
            information(rotation[at], translation[at], known), hermitian=True
        ).reshape(-1, 36)
        on = path.measured[at]
        # frames that are bridged have that of their neighbours
        covariance[at] += np.stack(
            [np.interp(times[at], times[at[on]], entry[on]) for entry in common.T], -1
        ).reshape(-1, 6, 6)
    facts, errors = _facts(
        records,
        views,
        path,
        layout,
        rotation,
        translation,
        covariance,
        shot,
        status,
        opacity,
    )
    static, evidence = params.static, dict[str, float]()
    if static == "auto":
        poses = {
            f.index: f.camera_from_world for f in facts if f.camera_from_world is not None
        }
        static, evidence = decide_static(flow, poses, camera)
    duplicates = sum(len(r.duplicates) for r in records)
    if duplicates:
        names = sorted({s.key for r in records for s in r.duplicates})
        notices.append(
            f"two prints of the same id in a frame ({', '.join(names)}, {duplicates}"
            " times): the one that moves on from the frame before is followed"
        )
    if path.dropped:
        notices.append(
            f"{len(path.dropped)} sightings contradict the other markers of their frame and"
            " are not used"
        )
    gap = status.count(INTERPOLATED)
    if gap:
        notices.append(f"{gap} frames without a marker bridged")
    placed = {
        "given": marker_map is not None,
        "frames": layout.frames,
        "rms_px": layout.rms_px,
        "condition": layout.condition if np.isfinite(layout.condition) else None,
        "unmapped": list(layout.unmapped),
        "sd_m": dict(layout.standard_deviation_m or {}),
    }
    summary = figures(
        facts,
        keys,
        **errors,
        flips_resolved=int(path.flips),
        sigma_factor=views.sigma_factor,
        duplicates=duplicates,
        dropped=len(path.dropped),
        static_evidence=evidence,
        map=placed,
        motion_noise=[d.tolist() for d in density],
    )
    misfit, usual = (
        summary["reprojection_px"]["raw"]["median"],
        max(USUAL_PX, 1e-3 * max(camera.width, camera.height)),
    )
    if misfit is not None and misfit > usual:
        notices.append(
            f"the markers' corners miss their pose by {misfit:.3g} px (below 1 is usual):"
            " does the camera calibration fit this clip, and are the sizes of the prints"
            " right?"
        )
    anchor = anchor_marker(markers, layout.world_from_marker)
    return Analysis(
        facts, layout.world_from_marker, static, summary, tuple(notices), anchor
    )


def figures(
    facts: Sequence[FrameFacts], keys: Sequence[str], **more: Any
) -> dict[str, Any]:
    """For the report: of the frames' facts, and what the caller knows beside them.

    keys : of the markers
    """
    count = Counter(f.status for f in facts)
    ratios = np.array(
        [m.ambiguity for f in facts for m in f.markers if np.isfinite(m.ambiguity)]
    )
    return {
        "frames": len(facts),
        "frames_measured": count[MEASURED],
        "frames_interpolated": count[INTERPOLATED],
        "frames_absent": count[ABSENT],
        "shots": facts[-1].shot + 1,
        "cuts": [b.index for a, b in pairwise(facts) if a.shot != b.shot],
        "flips_resolved": 0,
        "whole_frame_searches": sum(f.whole_frame_search for f in facts),
        "reprojection_px": {"raw": _quantiles([]), "smoothed": _quantiles([])},
        "pose_condition": _quantiles([]),
        "sigma_px": _quantiles([m.sigma_px for f in facts for m in f.markers]),
        "ambiguity_ratio": _quantiles(ratios),
        "ambiguous_sightings": int((ratios < 4.0).sum()),
        "markers_seen": {
            k: sum(any(m.key == k for m in f.markers) for f in facts) for k in keys
        },
        "rivals": 0,
        "dropped": 0,
        "map": {"given": True, "frames": 0, "unmapped": []},
        **more,
    }


def _shots(records: Sequence[Record]) -> np.ndarray:
    pairs = []
    for k, (a, b) in enumerate(pairwise(records), 1):
        before = {s.key: s.corners_px for s in a.detections}
        pairs += [(k, before[s.key], s.corners_px) for s in b.detections if s.key in before]
    last, now = (np.array([pair[i] for pair in pairs]).reshape(-1, 4, 2) for i in (1, 2))
    side_px = np.linalg.norm(last - np.roll(last, -1, 1), axis=2).mean(1)
    # no corner moved by more than a quarter of the side: one marker, one shot
    still = np.linalg.norm(now - last, axis=2).max(1) < 0.25 * side_px
    followed = np.isin(
        np.arange(len(records)),
        [k for (k, _, _), at_rest in zip(pairs, still, strict=True) if at_rest],
    ).tolist()
    cuts = find_cuts(
        [r.dissimilarity[0] for r in records],
        [r.dissimilarity[1] for r in records],
        followed,
    )
    return np.cumsum(np.isin(np.arange(len(records)), cuts).astype(int))


def _filled(
    path: WorldPath, present: Sequence[tuple[int, int]], times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Start values for bridged frames: the shortest rotation, and the straight line,
    between their neighbours.
    """
    rotation, translation = path.rotation.copy(), path.translation.copy()
    for first, end in present:
        on = first + np.flatnonzero(path.measured[first:end])
        for a, b in ((a, b) for a, b in pairwise(on) if b > a + 1):
            turn = rotvec_from_rotation(rotation[b] @ rotation[a].T)
            for k in range(a + 1, b):
                fraction = (times[k] - times[a]) / (times[b] - times[a])
                rotation[k] = rotation_from_rotvec(turn * fraction) @ rotation[a]
                translation[k] = translation[a] + fraction * (
                    translation[b] - translation[a]
                )
    return rotation, translation


def _facts(
    records: Sequence[Record],
    views: Views,
    path: WorldPath,
    layout: MarkerMap,
    rotation: np.ndarray,
    translation: np.ndarray,
    covariance: np.ndarray,
    shot: np.ndarray,
    status: Sequence[str],
    opacity: np.ndarray,
) -> tuple[tuple[FrameFacts, ...], dict[str, Any]]:
    seen: Observed = path.observed
    raw_px = rms_px(residuals(path.rotation, path.translation, seen), seen.weight)
    smooth_px = rms_px(residuals(rotation, translation, seen), seen.weight)
    on = path.measured
    facts = []
    for k, r in enumerate(records):
        here = status[k] != ABSENT
        pose = Pose(rotation[k], translation[k]) if here else None
        raw = Pose(path.rotation[k], path.translation[k]) if on[k] else None
        markers = tuple(
            _with_choice(m, layout.world_from_marker, raw) for m in views.sightings[k]
        )
        blur = [s.blur_px for s in r.detections if np.isfinite(s.blur_px)]
        facts.append(
            FrameFacts(
                r.index,
                r.time_s,
                int(shot[k]),
                status[k],
                pose,
                raw,
                covariance[k] if here else None,
                float(smooth_px[k]) if on[k] else None,
                float(opacity[k]),
                markers,
                r.whole,
                blur_px=float(median(blur)) if blur else None,
            )
        )
    info = information(
        path.rotation[on], path.translation[on], seen.take(np.flatnonzero(on))
    )
    d = np.sqrt(
        np.maximum(np.einsum("nii->ni", info), 1e-30)
    )  # each parameter in units of its own precision
    size = np.linalg.svd(info / d[:, :, None] / d[:, None], compute_uv=False)
    errors = {
        "reprojection_px": {
            "raw": _quantiles(raw_px[on]),
            "smoothed": _quantiles(smooth_px[on]),
        },
        "pose_condition": _quantiles(divide(size[:, 0], size[:, -1], where_zero=np.inf)),
    }
    return tuple(facts), errors


def _with_choice(
    m: MarkerSighting, world_from_marker: Mapping[str, Pose], raw: Pose | None
) -> MarkerSighting:
    if raw is None or m.key not in world_from_marker or not m.hypotheses:
        return m
    want = (raw @ world_from_marker[m.key]).rotation
    away = [
        float(((want - h.camera_from_marker.rotation) ** 2).sum()) for h in m.hypotheses
    ]
    return MarkerSighting(
        m.key, m.corners_px, m.sigma_px, m.hypotheses, int(np.argmin(away)), m.inverted
    )


def _quantiles(values: Sequence[float] | np.ndarray) -> dict[str, float | None]:
    v = np.asarray(values, float)
    v = v[np.isfinite(v)]
    return (
        {"median": float(np.median(v)), "p95": float(np.quantile(v, 0.95))}
        if len(v)
        else {"median": None, "p95": None}
    )
