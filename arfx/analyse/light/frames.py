"""Every frame's light, out of the readings of the whole clip: from the markers in the picture
if they tell it, else the next best cue, out loud.

Whatever the cue, brightness and colour of each frame are those that the markers show
(exposure and light together). The frame in which lights are fixed is the static frame: the
camera's where the camera stands still, else the marker map's.
Source: docs/methods/light.md#cues."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.job import Analysis
from arfx.analyse.light import patches
from arfx.analyse.light.given import light_from_direction, light_from_panorama
from arfx.analyse.light.hypotheses import LIKELY, REFUSED
from arfx.analyse.light.photometry import Photometry
from arfx.analyse.light.photometry import solve as photometry_of
from arfx.analyse.light.shadow import edge_clue, real_shadow
from arfx.analyse.light.static_frame import Readings, StaticFrameLight
from arfx.analyse.light.surroundings import EnvironmentSample
from arfx.analyse.params import LightParams
from arfx.core.facts import MEASURED
from arfx.core.light import Light, triple
from arfx.core.numerics import divide, normalise


class Reading(NamedTuple):
    """A print's cells in one frame."""

    frame: int
    key: str
    cells: patches.Patches


# width of an interval for one of three questions at .95 of all (Bonferroni), over the width
# for one
THREE_ASKED = 1.221
UNSEEN = 0.025  # of white's light, which looks the same
# cosine to the line of sight: flatter views show gloss and neighbours' light, not the print
LEAST_FACING = 0.15


def solve_patches(
    intensity: ndarray,
    variance: ndarray,
    clipped: ndarray,
    albedo: ndarray,
    most_bias: ndarray | None,
    print_: ndarray,
) -> Photometry:
    """Bias and light out of patches.

    A bias that is not certain is not drawn: then the light holds it, so that white looks as
    the paper does. But for what of it is beyond its doubt, by a difference that nobody sees.
    """
    found = photometry_of(
        intensity, variance, albedo, most_bias=most_bias, print_=print_
    )
    found = patches.of_one_scale(found, intensity, variance, clipped, albedo)
    sigma = np.ptp(found.bias_95, 1) / (2 * 1.96)
    of_light, unseen = found.bias / albedo.max(1), UNSEEN * np.abs(found.y)
    known = of_light * divide(found.bias**2, sigma**2 + found.bias**2)
    held = np.where(
        _certain_bias(found), 0, of_light - np.clip(known, -unseen, unseen)
    )
    return replace(found, y=found.y + held)


def with_light(
    analysis: Analysis,
    patch_readings: Sequence[Reading],
    samples: Sequence[EnvironmentSample],
    params: LightParams,
    panorama: ndarray | None = None,
    solve: Callable[..., Photometry] = solve_patches,
    static_frame_light: Callable[..., StaticFrameLight] = StaticFrameLight,
    changes: Mapping[int, float] = MappingProxyType({}),
    place_m: Callable[[], ndarray] = lambda: np.zeros(2),
) -> Analysis:
    """The analysis with `light` and `bias_rgb` in every frame that has a pose, and what was
    found in summary["light"].

    panorama : (h, w, 3) linear radiance, of LightParams.environment;  solve : bias and
    light out of patches, as solve_patches;  changes : of the background, by frame
    place_m : (2,) where the object stands, anchor axes
    """
    facts, turns = analysis.facts, analysis.static == "camera"
    static_from_world = {
        k: f.pose.rotation if turns else np.eye(3)
        for k, f in enumerate(facts)
        if f.camera_from_world is not None
    }
    corners_m = analysis.anchor.corners_m
    shaded = {
        row.frame: row.cells.cells
        for row in patch_readings
        if row.key == analysis.anchor.key
        and row.frame in static_from_world
        and row.cells.cells is not None
    }
    place = divide(place_m(), corners_m[:, :2].max(0)) if shaded else np.zeros(2)
    rows, even = _usable(analysis, patch_readings, static_from_world, place)
    keys = np.array([row.key for row, _ in rows], str)
    print_ = np.unique(keys, return_inverse=True)[1].ravel()
    seen = patches.stack([row.cells for row, _ in rows], params.ink, params.paper)
    intensity, _, clipped, _ = seen
    darkest = np.min([s.darkest for s in samples], axis=0) if samples else None
    photometry = solve(*seen, darkest, print_)
    readings = Readings(
        np.array([row.frame for row, _ in rows], int),
        np.reshape([normal for _, normal in rows], (-1, 3)),
        print_,
        keys == analysis.anchor.key,
        photometry.y,
        photometry.var_y_own,
        even,
    )[photometry.seen]
    given = _given(params, panorama)
    out: dict[int, Light] = {}
    reports: list[tuple[int, dict[str, Any]]] = []
    spans: list[dict[str, Any]] = []
    # frames that share one static frame: the whole clip, or each shot where the camera's
    # axes are the static ones
    for _, group in groupby(
        static_from_world, lambda k: facts[k].shot if turns else 0
    ):
        frames = [*group]
        mine = readings[np.isin(readings.frame, frames)]
        part = static_frame_light(
            frames, facts, static_from_world, mine, params, changes
        )
        if given is None:
            lights, report = part.from_markers(analysis.static != "both", samples)
        else:
            turn = static_from_world[frames[0]] @ analysis.world_from_anchor.rotation
            lights, report = part.from_given(given[0].turned(turn), *given[1:])
        out |= lights
        reports.append((len(frames), report))
        spans += report["spans"]
    report = max(reports, key=lambda r: r[0])[1] if reports else {}
    bias = _certain_bias(photometry)
    lit = list(facts)
    for k, light in out.items():
        lit[k] = facts[k].with_(
            light=light.turned(static_from_world[k].T) if turns else light,
            bias_rgb=triple(bias),
        )
    for k, cells in shaded.items():
        lit[k] = lit[k].with_(
            plane_shadow=real_shadow(cells - bias.mean(), corners_m)
        )
    p = photometry
    known_bias = p.determined.all()
    summary = {
        "frames_with_real_shadow": len(shaded),
        "shadow_edge": edge_clue([*shaded.values()], corners_m),
        "formula": params.formula,
        # it and the light are known as a product only; over time, where they change together:
        # static_frame.py
        "gain": None,
        "bias": p.bias.tolist() if known_bias else None,
        "bias_ci95": p.bias_95.tolist() if known_bias else None,
        "clipped_fraction": float(clipped.mean()) if len(rows) else 0.0,
        "photometry": {
            "verdict": p.verdict,
            "reason": p.reason,
            "condition": p.condition.tolist(),
            "misfit": p.misfit.tolist(),
            "readings": len(p.seen),
            "readings_used": int(p.seen.sum()),
            "not_finite": int(np.isnan(intensity).any(-1).sum()),
        },
        "frame": "camera" if turns else "marker",
        **report,
        "spans": spans,
    }
    return analysis.adding(lit, _notice(report), light=summary)


def _given(
    params: LightParams, panorama: ndarray | None
) -> tuple[Light, bool, str] | None:
    """(the user's light, anchor axes; whether its brightness is stated; why), None = none."""
    if panorama is not None:
        why = f"environment {params.environment} given"
        return light_from_panorama(panorama), False, why
    if not params.given:
        return None
    azimuth, elevation = params.given[:2]
    why = f"light given: azimuth {azimuth:g}, elevation {elevation:g} degrees"
    light = light_from_direction(params.given, params.size_deg)
    return light, len(params.given) == 5, why


def _notice(report: Mapping[str, Any]) -> str | None:
    verdict = report.get("verdict")
    if verdict == REFUSED:
        one = " or, if there is one lamp only, --set light.most_lights=1"
        return (
            f"light: no direction is known: {report['reason']}. --light AZ,EL or"
            f" --environment FILE gives one{one if report['rank'] == 4 else ''}"
        )
    if verdict == LIKELY:
        return (
            f"light: likely, not certain: {report['reason']}. --set light.claims=measured"
            " claims only what is certain"
        )
    return None


def _certain_bias(photometry: Photometry) -> ndarray:
    """(3,) bias of the channels that have one for certain, else 0: what may be none is not
    added to what is drawn.

    Three channels are asked: a tint that one of them shows by chance is no haze."""
    bias = photometry.bias
    low, high = bias + THREE_ASKED * (photometry.bias_95.T - bias)
    certain = photometry.determined.all() & (low * high > 0)
    return np.where(certain, bias, 0.0)


def _usable(
    analysis: Analysis,
    patch_readings: Sequence[Reading],
    static_from_world: Mapping[int, ndarray],
    place: ndarray,
) -> tuple[list[tuple[Reading, ndarray]], ndarray]:
    """([reading, normal in STATIC axes], which of them show the lamps' light), of prints that
    face the camera in frames whose pose was measured.

    A print partly in a real shadow does not show the lamps' light; that on which the object
    stands shows the object's, at its `place`. Where most are, nothing else is left."""
    rows = []
    for row in patch_readings:
        fact, marker = (
            analysis.facts[row.frame],
            analysis.world_from_marker.get(row.key),
        )
        if (
            fact.status != MEASURED
            or fact.camera_from_world is None
            or marker is None
        ):
            continue
        stands = fact.camera_from_world @ marker
        if -stands.rotation[:, 2] @ normalise(stands.translation_m) >= LEAST_FACING:
            normal = static_from_world[row.frame] @ marker.rotation[:, 2]
            if row.key == analysis.anchor.key:
                row = row._replace(cells=patches.standing(row.cells, place))
            rows.append((row, normal))
    even = np.array([row.cells.cells is None for row, _ in rows], bool)
    if 2 * even.sum() <= len(rows):
        return rows, np.ones(len(rows), bool)
    kept = [
        i
        for i, (row, _) in enumerate(rows)
        if even[i] or row.key == analysis.anchor.key
    ]
    return [rows[i] for i in kept], even[kept]
