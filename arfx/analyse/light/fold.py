"""The light of every frame: from the markers in the picture if they tell it, else the next
best cue, out loud.

Whatever the cue, brightness and colour of each frame are those that the markers show
(exposure and light together). The frame in which lights are fixed is the static frame: the
camera's where the camera stands still, else the marker map's.
Source: docs/methods/light.md#cues."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np

from arfx.analyse.fold import (
    Analysis,
    AnalysisFrame,
    AnalysisJob,
    Fold,
    Picture,
    Stateful,
    shifted,
)
from arfx.analyse.light import patches
from arfx.analyse.light.brightness import background_change, small_luma
from arfx.analyse.light.hypotheses import LIKELY, REFUSED
from arfx.analyse.light.photometry import LightReading, Photometry
from arfx.analyse.light.photometry import solve as photometry_of
from arfx.analyse.light.samples import place_samples
from arfx.analyse.light.seen import LOOK_PX, Look, given_everywhere, with_seen
from arfx.analyse.light.static_frame import (
    Readings,
    StaticFrameLight,
    light_from_direction,
    light_from_panorama,
)
from arfx.analyse.light.surroundings import (
    EnvironmentSample,
    environment_sample,
    with_environment,
)
from arfx.analyse.markers.fold import Markers
from arfx.analyse.params import LightParams
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.light import Light, triple
from arfx.core.marker import MarkerSpec
from arfx.core.rect import Rect
from arfx.core.stage import Check

Reading = tuple[int, str, patches.Patches]
# intensity, variance, clipped share and albedo of the patches
Solve = Callable[
    [np.ndarray, np.ndarray, np.ndarray, np.ndarray, LightParams],
    tuple[Photometry, LightReading | None],
]
SURROUNDINGS_S = 0.5  # between two looks at the surroundings
SURROUNDINGS_PX = 96  # width of the picture that is looked at
MOST_ENVIRONMENT_SAMPLES = (
    240  # about: in a clip that would give more the interval is longer
)
SHARP_PX = 0.7  # blur assumed where it could not be measured
_AROUND_PX = 2
# width of an interval for one of three questions at .95 of all (Bonferroni), over the width
# for one
THREE_ASKED = 1.221
_OF_SPAN = ("verdict", "lights", "ambient_rgb", "reason")
# cosine to the line of sight: flatter views show gloss and neighbours' light, not the print
LEAST_FACING = 0.15


class LightOfMarkers(Fold):
    """readings : (frame, marker key, Patches) in order;  changes : (frame, of the background
    from the frame before)
    """

    name = "light"
    needs: ClassVar[tuple[str, ...]] = ("markers", "pose")
    given = frozenset({"job", "_meters"})
    carried = frozenset({"_small"})

    def __init__(self, job: AnalysisJob, markers: Markers | None, pose: Fold) -> None:
        super().__init__(job)
        self._markers = markers
        ink, paper = job.light.ink, job.light.paper
        self._meters = {
            m.key: [patches.marker_meter(m)]
            for m in job.markers
            if isinstance(m, MarkerSpec)
        }
        for key, print_ in job.prints.items():
            self._meters[key] = [
                patches.pattern_meter(print_, ink, paper, soft) for soft in patches.SOFT
            ]
        self.readings: list[Reading] = []
        self.changes: list[tuple[int, float]] = []
        self._small: np.ndarray | None = None
        self._surroundings = EnvironmentSamples(job.length_s)

    @property
    def samples(self) -> list[Any]:
        return self._surroundings.samples

    def step(self, frame: AnalysisFrame) -> None:
        picture = frame.picture
        if picture is None or self._markers is None:
            return
        before, self._small = self._small, small_luma(frame.luma)
        if before is not None:
            self.changes.append((frame.index, background_change(before, self._small)))
        seen = self._markers.detections
        for s in seen:
            if Rect.around(s.corners_px, _AROUND_PX).clip(picture.rect).empty:
                continue
            blur = s.blur_px if np.isfinite(s.blur_px) else SHARP_PX
            cells, albedo, scale = patches.meter_for(self._meters[s.key], s.side_px, blur)
            shape = (picture.rect.height, picture.rect.width)
            points = place_samples(s.corners_px, cells, s.inverted, blur, shape, scale)
            self.readings.append(
                (
                    frame.index,
                    s.key,
                    patches.reduced(picture.linear_at(points.pixels()), points, albedo),
                )
            )
        if seen:
            quad, width = max(seen, key=lambda s: s.side_px).corners_px, picture.rect.width
            self._surroundings.step(
                frame.time_s,
                picture,
                lambda small: environment_sample(frame.index, small, quad, width),
            )

    def join(self, later: Self, shift: int) -> None:
        self.readings += shifted(later.readings, shift)
        self.changes += shifted(later.changes, shift)
        self._surroundings.join(later._surroundings, shift)

    def finish(self, clip: Analysis) -> Analysis:
        return with_light(
            clip,
            self.readings,
            self.samples,
            self.job.light,
            self.job.panorama,
            changes=dict(self.changes),
        )

    @staticmethod
    def health(facts: Sequence[FrameFacts], summary: Mapping[str, Any]) -> Iterator[Check]:
        light = summary["light"]
        photometry = light["photometry"]
        yield Check(
            "photometry condition number",
            max((c for c in photometry["condition"] if c is not None), default=None),
            1e6,
            photometry["verdict"] == "measured",
            f"bias taken for 0: {photometry['reason']}",
        )
        if "verdict" not in light:  # no frame with a pose that lasts
            return
        # what the markers' normals say of a direction beside ambient light; a given light
        # does not need it
        known = light["verdict"] != REFUSED
        yield Check(
            "light direction", light["verdict"], "measured or given", known, light["reason"]
        )
        if light["normals_seen"]:
            yield Check(
                "light fit condition number",
                light["condition"],
                1e3,
                known,
                "no direction claimed",
            )
        yield Check(
            "clipped share of the markers",
            light["clipped_fraction"],
            0.5,
            light["clipped_fraction"] <= 0.5,
            "clipped samples left out: brightness rests on the others",
        )


class LightOnPlane(LightOfMarkers):
    """Where there is no marker: small pictures are kept until it is known where in them the
    plane is."""

    needs = ("pose",)
    given = LightOfMarkers.given | {"_markers", "readings"}

    def __init__(self, job: AnalysisJob, pose: Fold) -> None:
        super().__init__(job, None, pose)

    def step(self, frame: AnalysisFrame) -> None:
        if frame.picture is not None:
            self._surroundings.step(
                frame.time_s, frame.picture, lambda small: (frame.index, small)
            )

    def finish(self, clip: Analysis) -> Analysis:
        camera, pictures = self.job.camera, self.samples
        self._surroundings.samples = []
        for k, small in pictures:
            if (pose := clip.facts[k].camera_from_world) is not None:
                quad = camera.project(pose.apply(clip.anchor.corners_m))
                if np.isfinite(quad).all():
                    self.samples.append(environment_sample(k, small, quad, camera.width))
        return super().finish(clip)


class EnvironmentSamples(Stateful):
    """What is made of the frames' small pictures at some times, evenly over the clip.

    length_s : of all frames
    """

    given = frozenset({"_interval_s"})
    carried = frozenset({"_next_s"})

    def __init__(self, length_s: float = 0.0) -> None:
        self.samples: list[Any] = []
        self._next_s: float | None = None
        self._interval_s = max(SURROUNDINGS_S, length_s / MOST_ENVIRONMENT_SAMPLES)

    def step(
        self,
        time_s: float,
        picture: Picture,
        sample: Callable[[np.ndarray], Any],
        width: int = SURROUNDINGS_PX,
    ) -> None:
        """width : of the small picture, at most"""
        if self._next_s is None:  # at once, unless not every stretch has one
            self._next_s = time_s
            if self._interval_s > SURROUNDINGS_S:
                self._next_s = self._interval_s * np.ceil(time_s / self._interval_s)
        if time_s < self._next_s:
            return
        self._next_s = time_s + self._interval_s
        small = picture.reduced(width)
        if min(small.shape[:2]) >= 3:
            self.samples.append(sample(small))

    def join(self, later: EnvironmentSamples, shift: int) -> None:
        self.samples += shifted(later.samples, shift)


class Environment(Fold):
    """The surroundings, for reflections: a guess of all of them, and what was seen of them."""

    name = "environment"
    needs = ("light",)

    def __init__(self, job: AnalysisJob, light: LightOfMarkers) -> None:
        super().__init__(job)
        self._light = light
        self._looks = EnvironmentSamples(job.length_s)

    def step(self, frame: AnalysisFrame) -> None:
        if frame.picture is not None:
            self._looks.step(
                frame.time_s,
                frame.picture,
                lambda small: Look(frame.index, small.astype(np.float16)),
                LOOK_PX,
            )

    def join(self, later: Self, shift: int) -> None:
        self._looks.join(later._looks, shift)

    def finish(self, clip: Analysis) -> Analysis:
        job, anchor, still_camera = (
            self.job,
            clip.world_from_anchor,
            clip.static == "camera",
        )
        clip = clip.adding(
            with_environment(
                clip.facts, self._light.samples, still_camera, job.panorama, anchor.rotation
            )
        )
        if job.panorama is not None:
            facts, maps = given_everywhere(clip.facts, job.panorama, anchor.rotation)
        else:
            facts, maps = with_seen(
                clip.facts,
                self._looks.samples,
                job.camera,
                still_camera,
                anchor.translation_m,
                anchor.rotation[:, 2],
            )
        return replace(clip.adding(facts), environment_maps=maps)


def solve_patches(
    intensity: np.ndarray,
    variance: np.ndarray,
    clipped: np.ndarray,
    albedo: np.ndarray,
    params: LightParams,
) -> tuple[Photometry, LightReading | None]:
    """Bias and light out of patches, and another reading of them where prints are overexposed."""
    photometry = photometry_of(intensity, variance, albedo, clipped)
    return photometry, patches.comparable(photometry, intensity, variance, clipped, albedo)


def with_light(
    analysis: Analysis,
    patch_readings: Sequence[Reading],
    samples: Sequence[EnvironmentSample],
    params: LightParams,
    panorama: np.ndarray | None = None,
    solve: Solve = solve_patches,
    static_frame_light: Callable[..., StaticFrameLight] = StaticFrameLight,
    changes: Mapping[int, float] = MappingProxyType({}),
) -> Analysis:
    """The analysis with `light` and `bias_rgb` in every frame that has a pose, and what was
    found in summary["light"].

    panorama : (h, w, 3) linear radiance, of LightParams.environment;  solve : bias and
    light out of patches;  changes : of the background, by frame (Readings.change)
    """
    facts, turns = analysis.facts, analysis.static == "camera"
    posed = {
        k: f.camera_from_world
        for k, f in enumerate(facts)
        if f.camera_from_world is not None
    }
    static_from_world = {
        k: pose.rotation if turns else np.eye(3) for k, pose in posed.items()
    }  # (3, 3)
    readings, photometry = _readings(
        analysis, patch_readings, static_from_world, params, solve
    )
    readings = replace(readings, change=changes)
    anchor = analysis.anchor
    out: dict[int, Light] = {}
    reports: list[tuple[int, dict[str, Any]]] = []
    spans: list[dict[str, Any]] = []
    known: set[int] = (
        set()
    )  # frames whose lamps are known: what they do not light lies in a real shadow
    # frames that share one static frame: the whole clip, or each shot where the camera's
    # axes are the static ones
    for _, group in groupby(posed, lambda k: facts[k].shot if turns else 0):
        shots = [*group]
        part = static_frame_light(shots, facts, static_from_world, readings, params)
        light, stated, why = None, False, f"environment {params.environment} given"
        if panorama is not None:
            light = light_from_panorama(panorama)
        elif params.given:
            light, stated = light_from_direction(params.given, params.size_deg)
            why = (
                f"light given: azimuth {params.given[0]:g}, elevation {params.given[1]:g}"
                " degrees"
            )
        if light is None:
            lights, report = part.from_markers(analysis.static != "both", samples)
        else:
            static_from_anchor = (
                static_from_world[shots[0]] @ analysis.world_from_anchor.rotation
            )
            lights, report = part.from_given(light.turned(static_from_anchor), stated, why)
        out |= lights
        ends = {"start_s": facts[shots[0]].time_s, "end_s": facts[shots[-1]].time_s}
        reports.append((len(shots), report))
        spans += report.pop("spans", None) or [ends | {k: report[k] for k in _OF_SPAN}]
        if report["verdict"] in (MEASURED, LIKELY):
            known |= {k for k, one in lights.items() if one.lights}
    report = max(reports, key=lambda r: r[0])[1] if reports else {}
    bias = _certain_bias(photometry)
    shaded = {}
    for frame, key, cells in patch_readings:
        if frame in known and key == anchor.key:
            radiance = patches.quadrant_radiance(cells, bias)
            if found := patches.real_shadow(radiance, anchor.corners_m):
                shaded[frame] = found
    lit = list(facts)
    for k, light in out.items():
        lit[k] = facts[k].with_(
            light=light.turned(static_from_world[k].T) if turns else light,
            bias_rgb=triple(bias),
            plane_shadow=shaded.get(k),
        )
    known_bias, p = bool(photometry.determined.all()), photometry
    summary = {
        "frames_with_real_shadow": len(shaded),
        "formula": params.formula,
        # it and the light are known as a product only; over time, where they change together:
        # static_frame.py
        "gain": None,
        "bias": p.bias.tolist() if known_bias else None,
        "bias_ci95": p.bias_95.tolist() if known_bias else None,
        "clipped_fraction": p.clipped,
        "photometry": {
            "verdict": p.verdict,
            "reason": p.reason,
            "rank": p.rank.tolist(),
            "unknowns": p.unknowns.tolist(),
            "condition": p.condition.tolist(),
            "misfit": p.misfit.tolist(),
            "readings": len(p.seen),
            "readings_used": int(p.seen.sum()),
            "not_finite": p.ignored,
        },
        "frame": "camera" if turns else "marker",
        **report,
        "spans": spans,
    }
    notice = None
    if report and report["verdict"] == REFUSED:
        one = (
            " or, if there is one lamp only, --set light.most_lights=1"
            if report["rank"] == 4
            else ""
        )
        notice = (
            f"light: no direction is known: {report['reason']}. --light AZ,EL or"
            f" --environment FILE gives one{one}"
        )
    elif report and report["verdict"] == LIKELY:
        notice = (
            f"light: likely, not certain: {report['reason']}. --set light.claims=measured"
            " claims only what is certain"
        )
    return analysis.adding(lit, notice, light=summary)


def _certain_bias(photometry: Photometry) -> np.ndarray:
    """(3,) bias of the channels that have one for certain, else 0: what may be none is not
    added to what is drawn.

    Three channels are asked: a tint that one of them shows by chance is no haze."""
    away = np.abs(photometry.bias_95 - photometry.bias[:, None]) * THREE_ASKED
    low, high = photometry.bias - away[:, 0], photometry.bias + away[:, 1]
    certain = photometry.determined.all() and ((low > 0) | (high < 0))
    return np.where(certain, photometry.bias, 0.0)


def _readings(
    analysis: Analysis,
    patch_readings: Sequence[Reading],
    static_from_world: dict[int, np.ndarray],
    params: LightParams,
    solve: Solve,
) -> tuple[Readings, Photometry]:
    """The markers' light in frames whose pose was measured, normals in STATIC axes, and how
    it was solved.
    """
    rows = []
    for frame, key, cells in patch_readings:
        fact, marker = analysis.facts[frame], analysis.world_from_marker.get(key)
        if fact.status != MEASURED or fact.camera_from_world is None or marker is None:
            continue
        stands = fact.camera_from_world @ marker
        facing = -float(stands.rotation[:, 2] @ stands.translation_m) / max(
            float(np.linalg.norm(stands.translation_m)), 1e-9
        )
        if facing >= LEAST_FACING:
            normal = static_from_world[frame] @ marker.rotation[:, 2]
            rows.append((frame, normal, cells, key))
    # a print partly in a real shadow does not show the lamps' light; where most prints are,
    # nothing else is left
    lit = [
        row
        for row in rows
        if not patches.clearly_shadowed(patches.quadrant_radiance(row[2], np.zeros(3)))
    ]
    rows = lit if 2 * len(lit) > len(rows) else rows
    seen = [row[2] for row in rows]
    photometry, other = solve(
        *patches.stack(seen), patches.albedos(seen, params.ink, params.paper), params
    )
    frames, normals = (
        np.array([r[0] for r in rows], int),
        np.array([r[1] for r in rows]).reshape(-1, 3),
    )
    keys = np.array([r[3] for r in rows], dtype=object)
    numbers = np.unique(keys.astype(str), return_inverse=True)[1].ravel()
    stood_on = keys == analysis.anchor.key
    used = photometry.seen
    light = [r.at(used) for r in (photometry.reading, other) if r is not None]
    return Readings(
        frames[used], normals[used], numbers[used], stood_on[used], light
    ), photometry
