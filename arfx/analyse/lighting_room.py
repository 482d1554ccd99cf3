"""The light of the frames that share one room: told by the markers, given, or taken from the surroundings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from arfx.analyse import light_map
from arfx.analyse.given_light import fitted_to
from arfx.analyse.icosphere import icosphere
from arfx.analyse.light_explain import Params as FitParams
from arfx.analyse.light_fit import MEASURED, REFUSED
from arfx.analyse.light_time import CONSTANT, SEGMENTS, SHARED, WINDOWS, Span, fit_over_time
from arfx.analyse.lighting_paper import paper_lights_of
from arfx.analyse.lighting_params import LightParams
from arfx.analyse.surroundings import Look, matched, soft_light
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
    SEGMENTS: "constant between its steps",
    SHARED: "its direction rests, its brightness or the exposure changes",
    WINDOWS: "its direction changes",
}
Lights = dict[int, Light]


@dataclass(frozen=True, eq=False)
class Readings:
    """k markers in frames. frame : (k,) its number;  normal : (k, 3) unit, ROOM axes
    y : (k, 3) radiance of a white surface there;  variance : (k, 3) of it"""

    frame: np.ndarray
    normal: np.ndarray
    y: np.ndarray
    variance: np.ndarray


class RoomLight:
    """Frames that share one room, with their readings."""

    def __init__(
        self, frames: Sequence[int], facts: Sequence[FrameFacts], room: dict[int, np.ndarray], readings: Readings,
        params: LightParams,
    ) -> None:  # fmt: skip
        """frames : numbers of those that share the room;  room : by number, (3, 3) to ROOM axes from the world's"""
        self.frames, self.facts, self.room, self.params = list(frames), facts, room, params
        mine = np.isin(readings.frame, self.frames)
        self.numbers, self.normals = readings.frame[mine], readings.normal[mine]
        self.y, self.variance = readings.y[mine], readings.variance[mine]
        self.lit = sorted(set(self.numbers.tolist()))
        self.observations = []
        for k in self.lit:
            on = self.numbers == k
            self.observations.append(light_map.Observation(facts[k].time_s, self.normals[on], self.y[on], self.variance[on]))
        self.map_params = light_map.Params(params.formula, params.map_level, params.map_blur_rad, drift_per_s=params.drift_per_s)
        self.kinds = light_map.changes(self.observations, self.map_params) if self.lit else np.zeros(0, int)

    def told(self, rests: bool, looks: Sequence[Look]) -> tuple[Lights, dict[str, Any]]:
        """The light that the markers tell, or the softer cue that takes its place. rests : a light can rest in the room"""
        if not self.lit:
            soft, source = self._surroundings(looks)
            why = "no marker is seen well enough: too small, too flat, clipped or covered"
            return dict.fromkeys(self.frames, soft), _report(REFUSED, source, why, soft)
        if self.params.formula == "paper":
            return self._as_printed(paper_lights_of(self.observations, self.map_params, self.params))
        breaks = [self.facts[k].time_s for k, kind in zip(self.lit, self.kinds, strict=True) if kind == light_map.STEP]
        times = np.array([self.facts[k].time_s for k in self.numbers])
        account, spans = fit_over_time(
            times, self.normals, self.y, self.variance, breaks, self.params.window_s,
            FitParams(most_lights=self.params.most_lights, limit_deg=self.params.limit_deg),
        )  # fmt: skip
        told = spans[np.argmax([s.stop_s - s.start_s for s in spans])].fit
        normals = self._normals(told.span_deg)
        known = [s for s in spans if s.fit.verdict == MEASURED]
        if known and rests:
            lights = self._follow(lambda k: _span_at(known, self.facts[k].time_s))
            best = max(known, key=lambda s: s.stop_s - s.start_s)
            why = f"{best.fit.reason}; {_ACCOUNTS[account]}"
            report = _report(MEASURED, "marker", why, best.fit.light(best.group), **normals)
            return lights, report | {"gamma": best.fit.gamma, "account": account}
        why = told.reason
        if not rests:
            why = "camera and marker both move: no frame is known in which a light rests"
        soft, source = self._surroundings(looks)
        lights = self._follow(lambda _: soft)
        used = "soft light from the picture's surroundings" if source == "environment" else "ambient light alone"
        middle = lights[self.lit[len(self.lit) // 2]]
        return lights, _report(REFUSED, source, f"{why}; used instead: {used}", middle, **normals)

    def _as_printed(self, found: Sequence[Light]) -> tuple[Lights, dict[str, Any]]:
        """The paper's own: each frame's light map and its peaks; frames without a reading have those before them."""
        at = {k: light for k, light in zip(self.lit, found, strict=True)}
        lights, last = {}, found[0]
        for k in self.frames:
            last = at.get(k, last)
            lights[k] = last
        middle = found[len(found) // 2]
        peaks = f"{len(middle.lights)} peak{'s' * (len(middle.lights) != 1)} of the light map, as printed: no confidence is known"
        report = _report(MEASURED if middle.lights else REFUSED, "marker", peaks, middle, **self._normals(None))
        return lights, report

    def given(self, light: Light, stated: bool, why: str) -> tuple[Lights, dict[str, Any]]:
        """A light that the user gave, as bright in each frame as the markers show."""
        if not self.lit:
            return dict.fromkeys(self.frames, light), _report(ASSUMED, light.source, why, light)
        typical = fitted_to(light, self.normals, self.y, stated)
        lights = self._follow(lambda _: typical)
        return lights, _report(ASSUMED, light.source, why, typical, **self._normals(None))

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

    def _follow(self, model: Callable[[int], Light]) -> Lights:
        """`model` of each frame, times a factor per channel so that the markers look as they were measured.

        model(frame number). Factors are smoothed over both past and future, but never over a step of the light; frames
        without a reading take that between those before and after, up to a step.
        """
        count = len(self.lit)
        factors, variance = np.ones((count, 3)), np.full((count, 3), UNKNOWN)
        bright = float(np.percentile(self.y.max(1), 90)) if len(self.y) else 0.0
        for i, (k, o) in enumerate(zip(self.lit, self.observations, strict=True)):
            made = model(k).radiance(o.normals)
            weight = np.where(made > LEAST_SEEN * bright, divide(made, o.variance + (MODEL_ERROR * made) ** 2), 0)
            share = (weight * made).sum(0)
            factors[i] = divide((weight * o.irradiance).sum(0), share, where_zero=1.0)
            variance[i] = divide(1.0, share, where_zero=UNKNOWN)
        at = np.array([self.facts[k].time_s for k in self.lit])
        stepped = (self.kinds == light_map.STEP) | jumps(factors)
        variance[(self.kinds == light_map.STRAY) & ~stepped] = UNKNOWN
        factors = smoothed(at, factors, variance, stepped, self.params.drift_per_s)
        factors = np.clip(factors, LEAST_FACTOR, MOST_FACTOR)
        out = {}
        before = np.searchsorted(self.lit, self.frames)
        for k, i in zip(self.frames, before, strict=True):
            if i < len(self.lit) and self.lit[i] == k:
                factor = factors[i]
            elif i == 0 or i == len(self.lit):
                factor = factors[min(i, len(self.lit) - 1)]
            elif stepped[i]:
                factor = factors[i - 1]
            else:
                share = (self.facts[k].time_s - at[i - 1]) / (at[i] - at[i - 1])
                factor = factors[i - 1] + share * (factors[i] - factors[i - 1])
            out[k] = model(k).scaled(factor)
        return out

    def _normals(self, span_deg: float | None) -> dict[str, Any]:
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


def jumps(factors: np.ndarray) -> np.ndarray:
    """(n,) True where factors (n, 3) change by more than JUMP from one to the next, in all channels, and stay so."""
    out = np.zeros(len(factors), bool)
    low = np.maximum(np.abs(factors), 1e-6)
    for i in range(1, len(factors)):
        before, here, after = low[i - 1], low[i], low[min(i + 1, len(low) - 1)]
        stays = (np.abs(np.log(after / here)) < np.abs(np.log(after / before))).all()
        out[i] = stays and (np.abs(np.log(here / before)) > JUMP).all()
    return out


def smoothed(
    time_s: np.ndarray, value: np.ndarray, variance: np.ndarray, step: np.ndarray, drift_per_s: float
) -> np.ndarray:  # fmt: skip
    """(n, 3) values of a random walk seen with noise, from all of the past and the future (Kalman filters from both ends).

    time_s : (n,);  value, variance : (n, 3), UNKNOWN = not seen;  step : (n,) the walk begins anew there
    drift_per_s : its relative standard deviation over one second
    """

    def filtered(order: np.ndarray, begins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means and variances before each value is taken in."""
        mean, spread = np.zeros(value.shape), np.full(value.shape, UNKNOWN)
        m, v = np.zeros(3), np.full(3, UNKNOWN)
        for i, k in enumerate(order):
            if begins[k]:
                v = np.full(3, UNKNOWN)
            elif i:
                v = np.minimum(v + drift_per_s**2 * abs(time_s[k] - time_s[order[i - 1]]) * m * m, UNKNOWN)
            mean[k], spread[k] = m, v
            gain = divide(v, v + variance[k])
            known = variance[k] < UNKNOWN
            m = np.where(known, m + gain * (value[k] - m), m)
            v = np.where(known, divide(v * variance[k], v + variance[k]), v)
        return mean, spread

    order = np.arange(len(value))
    m0, v0 = filtered(order, step)
    m1, v1 = filtered(order[::-1], np.append(step[1:], False))
    weights = np.stack([divide(1.0, v) * (v < UNKNOWN) for v in (v0, v1, variance)])
    total = weights.sum(0)
    return np.where(total > 0, divide((weights * np.stack([m0, m1, value])).sum(0), total), value)


def _span_at(spans: Sequence[Span], time_s: float) -> Light:
    """The light of the span that holds a time, or is nearest to it."""
    away = [max(s.start_s - time_s, time_s - s.stop_s, 0.0) for s in spans]
    span = spans[int(np.argmin(away))]
    return span.fit.light(span.group)


def _report(verdict: str, source: str, reason: str, light: Light, **more: Any) -> dict[str, Any]:
    document = light.to_json()
    normals = {"normals_seen": 0, "normal_span_deg": 0.0, "rank": 0, "condition": None}
    return {
        "source": source, **normals, **more, "ambient_rgb": document["ambient_rgb"], "lights": document["lights"],
        "verdict": verdict, "reason": reason,
    }  # fmt: skip
