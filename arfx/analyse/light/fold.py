"""The light of every frame: from the markers in the picture if they tell it, else the next best cue, out loud.

`LightMeter`, a fold, keeps what each frame tells: patches of the markers' cells, and now and then a small picture of the
surroundings; some hundred numbers per marker and frame, and no pixels. `lighted` makes the light of it.
Cues in order: a light that is given (`assumed`); a direction that the markers' normals tell (`measured`); else `refused`:
the surroundings folded from the picture, as soft light without a direction; ambient light alone. Whatever the cue,
brightness and colour of each frame are those that the markers show (exposure and light together: from one normal the two
cannot be told apart, and only their product is used).
The frame in which lights are fixed is the room's: the camera's where the camera stands still, else the marker map's.
Source: docs/methods/light.md#cues.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from arfx.analyse.fold import Fold
from arfx.analyse.light import given as given_light
from arfx.analyse.light.fit import MEASURED as LIT
from arfx.analyse.light.fit import REFUSED
from arfx.analyse.light.patches import (
    WHITE,
    Patches,
    cells,
    clearly_blocked,
    comparable,
    place,
    quarters,
    real_shadow,
    reduced,
    stack,
)
from arfx.analyse.light.photometry import Photometry, solve
from arfx.analyse.light.photometry_paper import solve_paper
from arfx.analyse.light.static_frame import Readings, RoomLight, Told
from arfx.analyse.light.surroundings import Look, look, with_environment
from arfx.analyse.params import LightParams
from arfx.analyse.records import Analysis, Seen
from arfx.core.cube import CubeMap
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.light import Light
from arfx.core.marker import MarkerSpec, anchor_marker
from arfx.core.rect import Rect

SURROUNDINGS_S = 0.5  # between two looks at the surroundings
SURROUNDINGS_PX = 96  # width of the picture that is looked at
MOST_LOOKS = 240  # beyond that every second one is dropped, and the interval doubled
SHARP_PX = 0.7  # blur assumed where it could not be measured
_AROUND_PX = 2
THREE_ASKED = 1.221  # width of an interval for one of three questions at .95 of all (Bonferroni), over the width for one
LEAST_FACING = 0.15  # cosine to the line of sight: flatter views show gloss and neighbours' light, not the print


class Picture(Protocol):
    """One frame's pixels, as the meter reads them (media.frame.Frame is one)."""

    @property
    def rect(self) -> Rect: ...

    def linear_at(self, pixels: np.ndarray) -> np.ndarray: ...

    def reduced(self, width: int) -> np.ndarray: ...


class LightMeter(Fold):
    """readings : (frame, marker key, Patches) in order;  looks : of the surroundings

    formula : "corrected" or "paper", how the surroundings are folded
    """

    given = frozenset({"_formula"})

    def __init__(self, formula: str = "corrected") -> None:
        self._formula = formula
        self.readings: list[tuple[int, str, Patches]] = []
        self.looks: list[Look] = []
        self._next_s, self._interval_s = -np.inf, SURROUNDINGS_S

    def step(self, frame: int, time_s: float, seen: Sequence[Seen], picture: Picture) -> None:
        """frame : its number;  seen : configured markers in it;  picture : its pixels"""
        for s in seen:
            if Rect.around(s.corners_px, _AROUND_PX).clip(picture.rect).empty:
                continue
            family, _, number = s.key.rpartition(":")
            blur = s.blur_px if np.isfinite(s.blur_px) else SHARP_PX
            shape = (picture.rect.height, picture.rect.width)
            spots = place(s.corners_px, cells(family, int(number)), s.inverted, blur, shape)
            self.readings.append((frame, s.key, reduced(picture.linear_at(spots.pixels()), spots)))
        if seen and time_s >= self._next_s:
            self._next_s = time_s + self._interval_s
            small = picture.reduced(SURROUNDINGS_PX)
            if min(small.shape[:2]) >= 3:
                shrink = small.shape[1] / picture.rect.width
                largest = max(seen, key=lambda s: s.side_px)
                self.looks.append(look(frame, small, (largest.corners_px + 0.5) * shrink - 0.5, self._formula))
            if len(self.looks) > MOST_LOOKS:
                self.looks, self._interval_s = self.looks[::2], 2 * self._interval_s


def lighted(
    analysis: Analysis, meter: LightMeter, markers: Sequence[MarkerSpec], params: LightParams,
    panorama: np.ndarray | None = None, environment: bool = False,
) -> Analysis:  # fmt: skip
    """The analysis with `light` and `bias_rgb` in every frame that has a pose, and what was found in summary["light"].

    panorama : (h, w, 3) linear radiance, of LightParams.environment
    environment : write the surroundings' picture into the facts too
    """
    facts = analysis.facts
    room = _rooms(analysis)
    readings, photometry = _readings(analysis, meter, room, params)
    stands_on = anchor_marker(markers, analysis.world_from_marker)
    anchor = stands_on.key
    out: dict[int, Light] = {}
    reports: list[tuple[int, dict[str, Any]]] = []
    maps: dict[int, np.ndarray] = {}
    known: set[int] = set()  # frames whose lamps are known: what they do not light lies in a real shadow
    for shots in _parts(facts, analysis.static):
        part = RoomLight(shots, facts, room, readings, params)
        given = _given(analysis, anchor, room, shots, params, panorama)
        lights, report = part.given(*given) if given else part.told(analysis.static != "both", meter.looks)
        out |= lights
        maps |= part.maps
        reports.append((len(shots), report))
        if report["verdict"] == LIT:
            known |= set(lights)
    report = max(reports, key=lambda r: r[0])[1] if reports else {}
    bias = _certain_bias(photometry)
    turns = analysis.static == "camera"
    lit = tuple(
        f.with_(light=out[k].turned(room[k].T) if turns else out[k], bias_rgb=tuple(float(b) for b in bias)) if k in out else f
        for k, f in enumerate(facts)
    )
    shaded = {
        frame: found
        for frame, key, patches in meter.readings
        if frame in known
        and key == anchor
        and (found := real_shadow(quarters(patches.mean, patches.count, bias), stands_on.size_m))
    }
    lit = tuple(f.with_(plane_shadow=shaded[k]) if k in shaded else f for k, f in enumerate(lit))
    lit = tuple(f.with_(light_map=CubeMap.of(maps[k], room[k])) if k in maps else f for k, f in enumerate(lit))
    marker = analysis.world_from_marker.get(anchor)
    upright = np.eye(3) if marker is None else marker.rotation
    if environment:
        lit = with_environment(lit, meter.looks, turns, panorama, upright, bias)
    about = (
        {"frames_shaded": len(shaded)}
        | _about_photometry(photometry, params)
        | {"frame": "camera" if analysis.static == "camera" else "marker"}
        | report
    )
    notices = list(analysis.notices)
    if report and report["verdict"] == REFUSED:
        notices.append(f"light: no direction is known: {report['reason']}. {_ways(report)}")
    return replace(analysis, facts=lit, summary={**analysis.summary, "light": about}, notices=tuple(notices))


def _ways(report: dict[str, Any]) -> str:
    """What a user can do about a light that is refused."""
    one = " or, if there is one lamp only, --set light.most_lights=1" if report["rank"] == 4 else ""
    return f"--light AZ,EL or --environment FILE gives one{one}"


def _certain_bias(photometry: Photometry) -> np.ndarray:
    """(3,) bias of the channels that have one for certain, else 0: what may be none is not added to what is drawn.

    Three channels are asked: a tint that one of them shows by chance is no haze.
    """
    away = np.abs(photometry.bias_95 - photometry.bias[:, None]) * THREE_ASKED
    low, high = photometry.bias - away[:, 0], photometry.bias + away[:, 1]
    certain = photometry.determined.all() and ((low > 0) | (high < 0))
    return np.where(certain, photometry.bias, 0.0)


def _rooms(analysis: Analysis) -> dict[int, np.ndarray]:
    """(3, 3) rotation to the room's axes from the world's, by frame number, of frames with a pose."""
    return {
        k: f.camera_from_world.rotation if analysis.static == "camera" else np.eye(3)
        for k, f in enumerate(analysis.facts)
        if f.camera_from_world is not None
    }


def _readings(
    analysis: Analysis, meter: LightMeter, room: dict[int, np.ndarray], params: LightParams
) -> tuple[Readings, Photometry]:
    """The markers' light in frames whose pose was measured, normals in ROOM axes, and how it was solved."""
    rows = []
    for frame, key, patches in meter.readings:
        fact, marker = analysis.facts[frame], analysis.world_from_marker.get(key)
        if fact.status != MEASURED or fact.camera_from_world is None or marker is None:
            continue
        stands = fact.camera_from_world @ marker
        facing = -float(stands.rotation[:, 2] @ stands.translation_m) / max(float(np.linalg.norm(stands.translation_m)), 1e-9)
        if facing >= LEAST_FACING:
            rows.append((frame, room[frame] @ marker.rotation[:, 2], patches))
    # a print that lies partly in a real shadow tells the lamps' light of no frame; where most do, they are all there is
    intensity, variance, clipped = stack([p for _, _, p in rows])
    lit = np.flatnonzero(~clearly_blocked(quarters(intensity, np.isfinite(intensity[..., 0]), np.zeros(3))))
    if 2 * len(lit) > len(rows):
        rows, intensity, variance, clipped = [rows[k] for k in lit], intensity[lit], variance[lit], clipped[lit]
    if params.formula == "paper":
        photometry = solve_paper(intensity, WHITE, clipped=clipped, ink=params.ink, paper=params.paper)
    else:
        photometry = solve(intensity, variance, WHITE, None, clipped, params.albedos, params.ink, params.paper)
    frames, normals = np.array([r[0] for r in rows], int), np.array([r[1] for r in rows]).reshape(-1, 3)
    used = photometry.seen
    other = None
    if params.formula == "corrected":
        y, own, fit = comparable(photometry, intensity, variance, WHITE, clipped)
        other = None if y is photometry.y and fit is photometry.seen else Told(y[used], own[used], fit[used])
    return Readings(frames[used], normals[used], photometry.y[used], photometry.var_y_own[used], other), photometry


def _parts(facts: Sequence[FrameFacts], static: str) -> list[list[int]]:
    """Frame numbers that share one room: the whole clip, or each shot where the camera's axes are the room's."""
    posed = [k for k, f in enumerate(facts) if f.camera_from_world is not None]
    if static != "camera":
        return [posed] if posed else []
    shots = sorted({facts[k].shot for k in posed})
    return [[k for k in posed if facts[k].shot == s] for s in shots]


def _given(
    analysis: Analysis, anchor: str, room: dict[int, np.ndarray], frames: Sequence[int], params: LightParams,
    panorama: np.ndarray | None,
) -> tuple[Light, bool, str] | None:  # fmt: skip
    """(light in ROOM axes, whether its lamps' brightness is stated, why) of a light that the user gave, or None."""
    if panorama is not None:
        light, stated, why = given_light.from_panorama(panorama), False, f"environment {params.environment} given"
    elif params.given:
        light, stated = given_light.from_direction(params.given, params.size_deg)
        why = f"light given: azimuth {params.given[0]:g}, elevation {params.given[1]:g} degrees"
    else:
        return None
    marker = analysis.world_from_marker.get(anchor)
    turn = room[frames[0]] @ (marker.rotation if marker is not None else np.eye(3))
    return light.turned(turn), stated, why


def _about_photometry(p: Photometry, params: LightParams) -> dict[str, Any]:
    known = bool(p.determined.all())
    return {
        "formula": params.formula,
        "gain": [1.0, 1.0, 1.0],  # the free scale: gain and light are known as a product only
        "bias": p.bias.tolist() if known else None,
        "bias_ci95": p.bias_95.tolist() if known else None,
        "clipped_fraction": p.clipped,
        "photometry": {
            "verdict": p.verdict, "reason": p.reason, "rank": p.rank.tolist(), "unknowns": p.unknowns.tolist(),
            "condition": p.condition.tolist(), "misfit": p.misfit.tolist(), "readings": len(p.seen),
            "readings_used": int(p.seen.sum()), "not_finite": p.ignored,
        },
    }  # fmt: skip
