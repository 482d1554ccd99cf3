"""The camera's path over the markers: hypotheses, marker map, path, gaps, smoothing. Solved
when the clip's end is known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median
from typing import Any, ClassVar

import numpy as np

from arfx.analyse.fold import Analysis, AnalysisFrame, AnalysisJob, Fold
from arfx.analyse.markers.corners import shared_px
from arfx.analyse.markers.detect import Record
from arfx.analyse.markers.fold import Markers
from arfx.analyse.markers.inner_edges import AGREE_CELLS
from arfx.analyse.params import AnalyseParams
from arfx.analyse.pose.at_rest import BackgroundFlow, FlowSample, decide_static
from arfx.analyse.pose.marker_map import MarkerMap, View, map_markers
from arfx.analyse.pose.path import world_path
from arfx.analyse.pose.planar import (
    Observed,
    hypotheses,
    information,
    lens_scale,
    residuals,
    rms_px,
    stack,
)
from arfx.analyse.pose.shots import find_cuts, unlikeness
from arfx.analyse.pose.smooth import smooth_poses
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
    MarkerSighting,
)
from arfx.core.marker import Marker, MarkerSpec, anchor_marker
from arfx.core.marker_codes import cells_per_side
from arfx.core.numerics import divide
from arfx.core.pose import Pose
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
    rows: ClassVar[Mapping[str, type]] = {"samples": FlowSample}

    def __init__(self, job: AnalysisJob, markers: Markers) -> None:
        super().__init__(job)
        self.markers = markers
        self.flow = BackgroundFlow(job.length_s)
        self.samples = self.flow.samples

    def step(self, frame: AnalysisFrame) -> None:
        if self.job.params.static == "auto":
            shown = self.markers.shown
            boxes = (Rect.around(s.print.corners_px) for s in shown)  # rarely asked for
            self.flow.step(frame.index, frame.time_s, frame.luma, boxes, bool(shown))

    def finish(self, clip: Analysis) -> Analysis:
        """Raises NothingToDoError where no frame has a pose."""
        job, records = self.job, self.markers.records
        found = solve(
            records,
            job.markers,
            self.markers.camera,
            job.params,
            job.marker_map,
            self.samples,
        )
        if all(f.status == ABSENT for f in found.facts):
            seen = sum(bool(r.detections) for r in records)
            raise NothingToDoError(
                f"markers were seen in {seen} of {len(records)} frames, but no pose fits,"
                " or none lasts for three frames",
                "are the marker's size and the camera calibration right, and of this clip?",
            )
        return replace(
            found,
            frame_span=clip.frame_span,
            summary={**found.summary, **clip.summary},
            notices=(*clip.notices, *found.notices),
        )

    @staticmethod
    def health(facts: Sequence[FrameFacts], summary: Mapping[str, Any]) -> Iterator[Check]:
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


class Views:
    """All sightings with their geometry, frame by frame.

    common_px : (frames,) error of a frame's corners that its neighbours' have too
    sigma_factor : on the predicted sigma"""

    def __init__(
        self, records: Sequence[Record], markers: Sequence[Marker], camera: Camera
    ) -> None:
        spec = {m.key: m for m in markers}
        seen = [(k, s) for k, r in enumerate(records) for s in r.detections]
        frame = np.array([k for k, _ in seen], int)
        corners, misplaced, blur, sigma = (
            np.array([getattr(s, name) for _, s in seen], float)
            for name in ("corners_px", "misplaced_px", "blur_px", "sigma_px")
        )
        corners = corners.reshape(-1, 4, 2)
        sigma = np.hypot(sigma, misplaced)
        kinds = [spec[s.key] for _, s in seen]
        cells = np.array(
            [cells_per_side(m.family) if isinstance(m, MarkerSpec) else 1 for m in kinds]
        )
        points = np.array([m.corners_m for m in kinds]).reshape(-1, 4, 3)
        ideal = camera.normalised(corners)
        scale = lens_scale(camera, np.where(np.isfinite(ideal), ideal, 0.0))
        shared = shared_px(corners, blur, cells)
        rough = np.hypot(np.maximum(sigma, _LEAST_SIGMA_PX), shared)
        candidates = hypotheses(points, ideal, scale, rough)
        told = np.array([i for i, c in enumerate(candidates) if c and sigma[i] < 1.0], int)
        poses = stack([candidates[i][0].camera_from_marker for i in told])
        every = Observed(points, ideal, scale, np.ones((len(seen), 4)))
        keys = np.array([s.key for _, s in seen])
        self.sigma_factor = _sigma_factor(
            residuals(*poses, every.take(told)), sigma[told], frame[told], keys[told]
        )
        px = np.hypot(np.maximum(sigma * self.sigma_factor, _LEAST_SIGMA_PX), shared)
        every = every._replace(weight=np.repeat(px[:, None] ** -2.0, 4, 1))
        self.common_px = np.full(len(records), _COMMON_PX)
        np.maximum.at(self.common_px, frame, shared)
        untold = AGREE_CELLS * np.array([s.side_px for _, s in seen]) / cells
        # of the corners' weights; with the square of misplaced_px, of what is not told
        whole, off, hidden = (
            np.bincount(frame, w / px**2, len(records))
            for w in (np.ones(len(seen)), misplaced**2, untold**2)
        )
        gap_s = _gaps(np.array([r.time_s for r in records]), off > 0)
        off = np.where(off > 0, off, hidden * 0.5 ** (2 * gap_s / _COVERS_S))
        self.common_px = np.hypot(self.common_px, np.sqrt(divide(off, whole)))
        self.frames: list[list[View]] = [[] for _ in records]
        self.sightings: list[list[MarkerSighting]] = [[] for _ in records]
        for i, (k, s) in enumerate(seen):
            solutions = tuple(h.camera_from_marker for h in candidates[i])
            if solutions:
                self.frames[k].append(View(s.key, every.take(i), solutions))
            self.sightings[k].append(
                MarkerSighting(
                    s.key, s.corners_px, float(px[i]), candidates[i], 0, s.inverted
                )
            )


def _sigma_factor(
    misfit: np.ndarray, sigma: np.ndarray, frame: np.ndarray, keys: np.ndarray
) -> float:
    """Factor on the predicted sigma (n,), from how residuals (n, 4, 2) change from one
    sighting of a marker to its next.

    What stays (a bent print, an imperfect lens model) is no noise: taken for noise it
    would let the smoother drag the object away from a picture that shakes. 8
    coordinates minus 6 unknowns leave 2 degrees of freedom."""
    order = np.lexsort((frame, keys))
    a, b = order[:-1], order[1:]
    follows = (keys[a] == keys[b]) & (frame[a] + 1 == frame[b])
    change = ((misfit[b] - misfit[a]) ** 2).sum((1, 2))
    chi2 = (change / (sigma[a] ** 2 + sigma[b] ** 2))[follows]
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
    keys = [m.key for m in markers]
    times = np.array([r.time_s for r in records])
    views = Views(records, markers, camera)
    shot = _shots(records)
    layout = MarkerMap(dict(marker_map)) if marker_map else map_markers(views.frames, keys)
    path = world_path(views.frames, layout.world_from_marker, keys, shot, times)
    every = visible_intervals(path.measured, shot, times, params.max_gap_s)
    present = without_flickers(every, path.measured, shot)
    opacity = opacities(present, shot, times)
    told = np.where(path.measured, MEASURED, INTERPOLATED)
    status = np.where(opacity > 0, told, ABSENT).tolist()
    rotation, translation = path.rotation.copy(), path.translation.copy()
    covariance = np.zeros((len(records), 6, 6))
    density = []
    for first, end in present:
        at = np.arange(first, end)
        on = at[path.measured[at]]
        # bridged frames start between their neighbours
        for a, b in pairwise(on):
            before, after = (Pose(rotation[k], translation[k]) for k in (a, b))
            for k in range(a + 1, b):
                pose = before.towards(after, (times[k] - times[a]) / (times[b] - times[a]))
                rotation[k], translation[k] = pose.rotation, pose.translation_m
        part = path.observed.take(at)
        if params.smoothing > 0 and len(at) > 1:
            rotation[at], translation[at], covariance[at], noise = smooth_poses(
                rotation[at], translation[at], part, times[at], params.smoothing
            )
            density.append(noise.tolist())
        else:
            info = information(rotation[at], translation[at], part)
            covariance[at] = np.linalg.pinv(info, hermitian=True)
        weight = (path.observed.weight[on] > 0) / views.common_px[on, None] ** 2
        known = path.observed.take(on)._replace(weight=weight)
        common = np.linalg.pinv(
            information(rotation[on], translation[on], known), hermitian=True
        ).reshape(-1, 36)
        # frames that are bridged have that of their neighbours
        covariance[at] += np.stack(
            [np.interp(times[at], times[on], entry) for entry in common.T], -1
        ).reshape(-1, 6, 6)
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
                tuple(
                    _with_choice(m, layout.world_from_marker, raw)
                    for m in views.sightings[k]
                ),
                r.whole,
                blur_px=float(median(blur)) if blur else None,
            )
        )
    info = information(path.rotation[on], path.translation[on], seen.take(on))
    d = np.sqrt(
        np.maximum(np.einsum("nii->ni", info), 1e-30)
    )  # each parameter in units of its own precision
    condition = np.linalg.cond(info / d[:, :, None] / d[:, None])
    static: str = params.static
    evidence: dict[str, float] = {}
    if static == "auto":
        poses = {
            f.index: f.camera_from_world for f in facts if f.camera_from_world is not None
        }
        static, evidence = decide_static(flow, poses, camera)
    again = [s.key for r in records for s in r.duplicates]
    placed = {
        "given": marker_map is not None,
        "frames": layout.frames,
        "rms_px": layout.rms_px,
        "condition": layout.condition if np.isfinite(layout.condition) else None,
        "unmapped": list(layout.unmapped),
        "sd_m": dict(layout.standard_deviation_m or {}),
    }
    raw_errors = _quantiles(raw_px[on])
    summary = figures(
        facts,
        keys,
        reprojection_px={"raw": raw_errors, "smoothed": _quantiles(smooth_px[on])},
        pose_condition=_quantiles(condition),
        flips_resolved=path.flips,
        sigma_factor=views.sigma_factor,
        duplicates=len(again),
        dropped=path.dropped,
        static_evidence=evidence,
        map=placed,
        motion_noise=density,
    )
    misfit, usual = (
        raw_errors["median"] or 0.0,
        max(USUAL_PX, 1e-3 * max(camera.width, camera.height)),
    )
    flickers, bridged = len(every) - len(present), status.count(INTERPOLATED)
    notices = (
        (
            layout.unmapped,
            "never seen together with a mapped marker, so not used:"
            f" {', '.join(layout.unmapped)}",
        ),
        (flickers, f"{flickers} sightings of only one or two frames are not shown"),
        (
            again,
            f"two prints of the same id in a frame ({', '.join(sorted({*again}))},"
            f" {len(again)} times): the one that moves on from the frame before is followed",
        ),
        (
            path.dropped,
            f"{path.dropped} sightings contradict the other markers of their frame and"
            " are not used",
        ),
        (bridged, f"{bridged} frames without a marker bridged"),
        (
            misfit > usual,
            f"the markers' corners miss their pose by {misfit:.3g} px (below 1 is usual):"
            " does the camera calibration fit this clip, and are the sizes of the prints"
            " right?",
        ),
    )
    return Analysis(
        tuple(facts),
        layout.world_from_marker,
        static,
        summary,
        tuple(words for told, words in notices if told),
        anchor_marker(markers, layout.world_from_marker),
    )


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
        "reprojection_px": {"raw": _quantiles([]), "smoothed": _quantiles([])},
        "pose_condition": _quantiles([]),
        "sigma_px": _quantiles([m.sigma_px for f in facts for m in f.markers]),
        "ambiguity_ratio": _quantiles(ratios),
        "ambiguous_sightings": int((ratios < 4.0).sum()),
        "markers_seen": {k: seen[k] for k in keys},
        "rivals": 0,
        "dropped": 0,
        "map": {"given": True, "frames": 0, "unmapped": []},
        **more,
    }


def _ambiguities(facts: Sequence[FrameFacts]) -> np.ndarray:
    every = np.array([m.ambiguity for f in facts for m in f.markers])
    return every[np.isfinite(every)]


def _shots(records: Sequence[Record]) -> np.ndarray:
    followed = [False]
    for a, b in pairwise(records):
        known = {s.key: s for s in a.detections}
        # no corner moved by more than a quarter of the side: one marker, one shot
        followed.append(
            any(
                ((s.corners_px - old.corners_px) ** 2).sum(1).max()
                < (0.25 * old.side_px) ** 2
                for s in b.detections
                if (old := known.get(s.key)) is not None
            )
        )
    thumbnails = [r.thumbnail for r in records]
    cuts = find_cuts(unlikeness(thumbnails, 1), unlikeness(thumbnails, 2), followed)
    return np.cumsum(np.isin(np.arange(len(records)), cuts))


def _with_choice(
    m: MarkerSighting, world_from_marker: Mapping[str, Pose], raw: Pose | None
) -> MarkerSighting:
    if raw is None or m.key not in world_from_marker or not m.hypotheses:
        return m
    want = (raw @ world_from_marker[m.key]).rotation
    away = [
        float(((want - h.camera_from_marker.rotation) ** 2).sum()) for h in m.hypotheses
    ]
    return replace(m, chosen=int(np.argmin(away)))


def _quantiles(values: Sequence[float] | np.ndarray) -> dict[str, float | None]:
    v = np.asarray(values, float)
    v = v[np.isfinite(v)]
    return (
        {"median": float(np.median(v)), "p95": float(np.quantile(v, 0.95))}
        if len(v)
        else {"median": None, "p95": None}
    )
