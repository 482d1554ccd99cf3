"""The light of the frames that share one room: told by the markers, given, or taken from the surroundings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from arfx.analyse.light import light_map
from arfx.analyse.light.explain import Params as FitParams
from arfx.analyse.light.fit import MEASURED, REFUSED
from arfx.analyse.light.given import fitted_to
from arfx.analyse.light.icosphere import icosphere
from arfx.analyse.light.light_map import walked
from arfx.analyse.light.over_time import CONSTANT, SEGMENTS, SHARED, SWITCHED, WINDOWS, Span, fit_over_time
from arfx.analyse.light.surroundings import Look, matched, soft_light
from arfx.analyse.params import LightParams
from arfx.core.facts import FrameFacts
from arfx.core.light import Light, triple
from arfx.core.numerics import divide, normalise

ASSUMED = "assumed"
LEAST_FACTOR, MOST_FACTOR = 1 / 16, 16.0  # of a frame's brightness to its model's
JUMP = 0.15  # of the factor's logarithm from one frame to the next: a switch, not a drift
UNKNOWN = light_map.UNKNOWN  # variance
MODEL_ERROR = 0.003  # of a model's irradiance, relative: a reading of one normal is no better
LEAST_SEEN = 0.02  # of the brightest irradiance seen: darker normals say nothing about a frame's brightness
_ACCOUNTS = {
    CONSTANT: "constant over the clip",
    SWITCHED: "its lamps are switched",
    SEGMENTS: "constant between its steps",
    SHARED: "its direction rests, its brightness or the exposure changes",
    WINDOWS: "its direction changes",
}
Lights = dict[int, Light]


@dataclass(frozen=True, eq=False)
class Told:
    """Another reading of the same light. y, variance : (k, 3);  fit : (k,) where it can be compared with the others"""

    y: np.ndarray
    variance: np.ndarray
    fit: np.ndarray


@dataclass(frozen=True, eq=False)
class Readings:
    """k markers in frames. frame : (k,) its number;  normal : (k, 3) unit, ROOM axes
    y : (k, 3) radiance of a white surface there;  variance : (k, 3) of it
    alone : of one kind of cells alone (patches.comparable), where prints are overexposed"""

    frame: np.ndarray
    normal: np.ndarray
    y: np.ndarray
    variance: np.ndarray
    alone: Told | None = None


class RoomLight:
    """Frames that share one room, with their readings."""

    def __init__(
        self, frames: Sequence[int], facts: Sequence[FrameFacts], room: dict[int, np.ndarray], readings: Readings,
        params: LightParams,
    ) -> None:  # fmt: skip
        """frames : numbers of those that share the room;  room : by number, (3, 3) to ROOM axes from the world's"""
        self.frames, self.facts, self.room, self.params = list(frames), facts, room, params
        mine = np.flatnonzero(np.isin(readings.frame, self.frames))
        mine = mine[np.argsort(readings.frame[mine], kind="stable")]
        self.numbers, self.normals = readings.frame[mine], readings.normal[mine]
        self.y, self.variance, alone = readings.y[mine], readings.variance[mine], readings.alone
        self.alone = None if alone is None else Told(alone.y[mine], alone.variance[mine], alone.fit[mine])
        lit, first, self.which = np.unique(self.numbers, return_index=True, return_inverse=True)  # which : reading's row of lit
        self.lit = lit.tolist()
        self.observations = [
            light_map.Observation(facts[k].time_s, self.normals[a:b], self.y[a:b], self.variance[a:b])
            for k, (a, b) in zip(self.lit, pairwise([*first.tolist(), len(mine)]), strict=True)
        ]
        self.kinds = light_map.changes(self.observations, params.map_level, params.map_blur_rad, params.drift_per_s)

    def told(self, rests: bool, looks: Sequence[Look]) -> tuple[Lights, dict[str, Any]]:
        """The light that the markers tell, or the softer cue that takes its place. rests : a light can rest in the room"""
        if not self.lit:
            soft, source = self._surroundings(looks)
            why = "no marker is seen well enough: too small, too flat, clipped or covered"
            return dict.fromkeys(self.frames, soft), report_of(REFUSED, source, why, soft)
        breaks = [self.facts[k].time_s for k, kind in zip(self.lit, self.kinds, strict=True) if kind == light_map.STEP]
        times = np.array([self.facts[k].time_s for k in self.numbers])
        account, spans, better = explained(
            times, self.normals, Told(self.y, self.variance, np.ones(len(times), bool)), self.alone, breaks, self.params.window_s,
            FitParams(most_lights=self.params.most_lights, limit_deg=self.params.limit_deg),
        )  # fmt: skip
        if better is not None:
            self.y, self.variance = better.y, better.variance
        told = spans[np.argmax([s.stop_s - s.start_s for s in spans])].fit
        normals = self.about_normals(told.span_deg)
        known = [s for s in spans if s.fit.verdict == MEASURED]
        if known and rests:
            at = np.array([self.facts[k].time_s for k in self.frames])
            lights = self._follow([s.fit.light(s.group) for s in known], _span_at(known, at))
            best = max(known, key=lambda s: s.stop_s - s.start_s)
            why = f"{best.fit.reason}; {_ACCOUNTS[account]}"
            report = report_of(MEASURED, "marker", why, best.fit.light(best.group), **normals)
            return lights, report | {"gamma": best.fit.gamma, "account": account}
        why = told.reason
        if not rests:
            why = "camera and marker both move: no frame is known in which a light rests"
        soft, source = self._surroundings(looks)
        lights = self._follow([soft])
        used = "soft light from the picture's surroundings" if source == "environment" else "ambient light alone"
        middle = lights[self.lit[len(self.lit) // 2]]
        return lights, report_of(REFUSED, source, f"{why}; used instead: {used}", middle, **normals)

    def given(self, light: Light, stated: bool, why: str) -> tuple[Lights, dict[str, Any]]:
        """A light that the user gave, as bright in each frame as the markers show."""
        if not self.lit:
            return dict.fromkeys(self.frames, light), report_of(ASSUMED, light.source, why, light)
        typical = fitted_to(light, self.normals, self.y, stated)
        lights = self._follow([typical])
        return lights, report_of(ASSUMED, light.source, why, typical, **self.about_normals())

    def _surroundings(self, looks: Sequence[Look]) -> tuple[Light, str]:
        """(soft light of this room, "environment" or "ambient"): mean of all looks, as bright as the markers show."""
        mine = set(self.frames)
        looks = [look for look in looks if look.frame in mine]
        shows = self.y.sum(1) > 0
        measured = self.y[shows]
        if not looks:
            level = np.median(measured, 0) if len(measured) else np.array(Light().ambient_rgb)
            return Light(triple(level), (), "ambient"), "ambient"
        turns = []
        for one in looks:
            pose = self.facts[one.frame].camera_from_world
            assert pose is not None
            turns.append(self.room[one.frame] @ pose.rotation.T)
        n = self.normals[shows]
        up = normalise((n if len(n) else -np.array([t[:, 2] for t in turns])).sum(0))
        light = soft_light(looks, turns, up, np.median(measured, 0) if len(measured) else None)
        return (matched(light, n, measured) if len(n) else light), "environment"

    def _follow(self, models: Sequence[Light], of_frame: np.ndarray | None = None) -> Lights:
        """Each frame's model, times a factor per channel so that the markers look as they were measured.

        of_frame : (frames,) number of each frame's model, None = all have the first. Factors are smoothed over both past and
        future, but never over a step of the light; frames without a reading take that between those before and after, up
        to a step.
        """
        count = len(self.lit)
        of_frame = np.zeros(len(self.frames), int) if of_frame is None else of_frame
        of_reading = of_frame[np.searchsorted(self.frames, self.numbers)]
        bright = float(np.percentile(self.y.max(1), 90)) if len(self.y) else 0.0
        made = np.zeros(self.y.shape)
        for i, model in enumerate(models):
            made[of_reading == i] = model.radiance(self.normals[of_reading == i])
        weight = np.where(made > LEAST_SEEN * bright, divide(made, self.variance + (MODEL_ERROR * made) ** 2), 0)
        share, shown = (
            np.stack([np.bincount(self.which, (weight * a)[:, c], count) for c in range(3)], -1) for a in (made, self.y)
        )
        factors, variance = divide(shown, share, where_zero=1.0), divide(1.0, share, where_zero=UNKNOWN)
        at = np.array([self.facts[k].time_s for k in self.lit])
        stepped = (self.kinds == light_map.STEP) | jumps(factors)
        variance[(self.kinds == light_map.STRAY) & ~stepped] = UNKNOWN
        factors = smoothed(at, factors, variance, stepped, self.params.drift_per_s)
        factors = np.clip(factors, LEAST_FACTOR, MOST_FACTOR)
        after = np.searchsorted(self.lit, self.frames)
        last, first = np.minimum(after, count - 1), np.clip(after - 1, 0, count - 1)
        now = np.array([self.facts[k].time_s for k in self.frames])
        share = np.clip(divide(now - at[first], at[last] - at[first], where_zero=1.0), 0, 1)
        share[(at[last] > now) & stepped[last]] = 0.0
        every = factors[first] + share[:, None] * (factors[last] - factors[first])
        out: Lights = {}
        for i, model in enumerate(models):
            rows = np.flatnonzero(of_frame == i)
            out |= {self.frames[r]: model.scaled(every[r]) for r in rows}
        return out

    def about_normals(self, span_deg: float | None = None) -> dict[str, Any]:
        """What was seen, and how well it tells an ambient light and a direction apart."""
        n = self.normals
        if span_deg is None:
            span_deg = float(np.degrees(np.arccos(np.clip((n[:: max(1, len(n) // 500)] @ n.T).min(), -1, 1)))) if len(n) else 0.0
        cells = icosphere(3).nearest(n)
        rows = np.column_stack([np.ones(len(n)), n])
        size = np.linalg.svd(divide(rows, np.linalg.norm(rows, axis=0)), compute_uv=False)
        condition = float(divide(size[0], size[-1], where_zero=np.inf)) if len(size) == 4 else np.inf
        return {
            "normals_seen": len(set(cells.tolist())), "normal_span_deg": span_deg,
            "rank": int((size > 1e-2 * size[0]).sum()), "condition": condition if condition < 1e12 else None,
        }  # fmt: skip


def explained(
    times_s: np.ndarray, normals: np.ndarray, told: Told, alone: Told | None, breaks_s: Sequence[float],
    window_s: float = 2.0, params: FitParams = FitParams(),  # noqa: B008 - frozen
) -> tuple[str, list[Span], Told | None]:  # fmt: skip
    """(account, spans, the readings that tell it if not the first): `alone` where the light is refused by what all cells tell."""
    account, spans = fit_over_time(times_s, normals, told.y, told.variance, breaks_s, window_s, params)
    if alone is None or not alone.fit.any() or any(s.fit.verdict == MEASURED for s in spans):
        return account, spans, None
    on = alone.fit
    again, other = fit_over_time(times_s[on], normals[on], alone.y[on], alone.variance[on], breaks_s, window_s, params)
    if any(s.fit.verdict == MEASURED for s in other):
        return again, other, alone
    return account, spans, None


def jumps(factors: np.ndarray) -> np.ndarray:
    """(n,) True where factors (n, 3) change by more than JUMP from one to the next, in all channels, and stay so."""
    out = np.zeros(len(factors), bool)
    size = np.log(np.maximum(np.abs(factors), 1e-6))
    before, here, after = size[:-1], size[1:], np.concatenate([size[2:], size[-1:]])
    stays = (np.abs(after - here) < np.abs(after - before)).all(1)
    out[1:] = stays & (np.abs(here - before) > JUMP).all(1)
    return out


def smoothed(
    time_s: np.ndarray, value: np.ndarray, variance: np.ndarray, step: np.ndarray, drift_per_s: float
) -> np.ndarray:  # fmt: skip
    """(n, 3) values of a random walk seen with noise, from all of the past and the future (Kalman filters from both ends).

    time_s : (n,);  value, variance : (n, 3), UNKNOWN = not seen;  step : (n,) the walk begins anew there
    drift_per_s : its relative standard deviation over one second
    """

    order = np.arange(len(value))
    m0, v0, m1, v1 = (np.zeros(value.shape) for _ in range(4))
    walked(time_s, value, variance, step, order, drift_per_s, m0, v0)
    walked(time_s, value, variance, np.append(step[1:], False), order[::-1].copy(), drift_per_s, m1, v1)
    weights = np.stack([divide(1.0, v) * (v < UNKNOWN) for v in (v0, v1, variance)])
    total = weights.sum(0)
    return np.where(total > 0, divide((weights * np.stack([m0, m1, value])).sum(0), total), value)


def _span_at(spans: Sequence[Span], times_s: np.ndarray) -> np.ndarray:
    """(n,) number of the span that holds each time, or is nearest to it."""
    start, stop = np.array([s.start_s for s in spans]), np.array([s.stop_s for s in spans])
    away = np.maximum(np.maximum(start - times_s[:, None], times_s[:, None] - stop), 0)
    return np.asarray(away.argmin(1))


def report_of(verdict: str, source: str, reason: str, light: Light, **more: Any) -> dict[str, Any]:
    """What the summary says of a light."""
    document = light.to_json()
    normals = {"normals_seen": 0, "normal_span_deg": 0.0, "rank": 0, "condition": None}
    return {
        "source": source, **normals, **more, "ambient_rgb": document["ambient_rgb"], "lights": document["lights"],
        "verdict": verdict, "reason": reason,
    }  # fmt: skip
