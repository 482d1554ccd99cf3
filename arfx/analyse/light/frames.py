"""Every frame's light, out of the readings of the whole clip: from the markers in the picture
if they tell it, else the next best cue, out loud.

Whatever the cue, brightness and colour of each frame are those that the markers show
(exposure and light together). The frame in which lights are fixed is the static frame: the
camera's where the camera stands still, else the marker map's.
Source: docs/methods/light.md#cues."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from arfx.analyse.fold import Analysis
from arfx.analyse.light import patches
from arfx.analyse.light.hypotheses import LIKELY, REFUSED
from arfx.analyse.light.photometry import LightReading, Photometry
from arfx.analyse.light.photometry import solve as photometry_of
from arfx.analyse.light.static_frame import (
    Readings,
    StaticFrameLight,
    light_from_direction,
    light_from_panorama,
)
from arfx.analyse.light.surroundings import EnvironmentSample
from arfx.analyse.params import LightParams
from arfx.core.facts import MEASURED
from arfx.core.light import Light, triple
from arfx.core.numerics import divide


class Reading(NamedTuple):
    """A print's cells in one frame."""

    frame: int
    key: str
    cells: patches.Patches


# intensity, variance, clipped share and albedo of the patches, and what the darkest pixels show
Solve = Callable[
    [np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray | None],
    tuple[Photometry, LightReading | None],
]
# width of an interval for one of three questions at .95 of all (Bonferroni), over the width
# for one
THREE_ASKED = 1.221
_OF_SPAN = ("verdict", "lights", "ambient_rgb", "reason")
# cosine to the line of sight: flatter views show gloss and neighbours' light, not the print
LEAST_FACING = 0.15


def solve_patches(
    intensity: np.ndarray,
    variance: np.ndarray,
    clipped: np.ndarray,
    albedo: np.ndarray,
    most_bias: np.ndarray | None,
) -> tuple[Photometry, LightReading | None]:
    """Bias and light out of patches, and another reading of them where prints are overexposed.

    A bias that is not certain is not drawn: then the bright patches' light holds it.
    """
    found = photometry_of(intensity, variance, albedo, clipped, most_bias=most_bias)
    other = patches.comparable(found, intensity, variance, clipped, albedo)
    sigma = (found.bias_95[:, 1] - found.bias_95[:, 0]) / 3.92
    doubt = divide(sigma**2, sigma**2 + found.bias**2)
    held = found.bias * np.where(_certain_bias(found), 0, doubt) / albedo.max(1)
    if other is not None:
        other = replace(other, y=other.y + held)
    return replace(found, y=found.y + held), other


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
    most_bias = np.min([s.darkest for s in samples], axis=0) if samples else None
    readings, photometry = _readings(
        analysis, patch_readings, static_from_world, params, solve, most_bias
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
    most_bias: np.ndarray | None,
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
        *patches.stack(seen), patches.albedos(seen, params.ink, params.paper), most_bias
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
