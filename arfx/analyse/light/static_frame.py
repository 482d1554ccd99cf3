"""The light of the frames that share one static frame: read off the markers, given, or
taken from the surroundings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.analyse.light.brightness import brightness, common_level, steps
from arfx.analyse.light.fit import span_deg
from arfx.analyse.light.hypotheses import LIKELY, MEASURED, REFUSED
from arfx.analyse.light.hypotheses import Params as FitParams
from arfx.analyse.light.over_time import (
    CONSTANT,
    SEGMENTS,
    SHARED,
    WINDOWS,
    Span,
    fit_over_time,
)
from arfx.analyse.light.photometry import LightReading
from arfx.analyse.light.sphere import DEG_8, nearest_cell
from arfx.analyse.light.surroundings import (
    EnvironmentSample,
    matched,
    scaled_to,
    soft_light,
)
from arfx.analyse.params import LightParams
from arfx.core.facts import FrameFacts
from arfx.core.light import Light, triple
from arfx.core.numerics import angle_between, condition, divide, normalise

ASSUMED = "assumed"
LEAST_FACTOR, MOST_FACTOR = 1 / 16, 16.0  # of a frame's brightness to its model's
MOST_GAINS = 200  # in the report
ALIKE_DEG = 15.0  # lights before and after a span that is refused, to be used in it
# of a model's irradiance, relative: a reading of one normal is no better
MODEL_ERROR = 0.003
# of the brightest irradiance seen: darker normals say nothing about a frame's brightness
LEAST_SEEN = 0.02
_TEMPORAL_MODELS = {
    CONSTANT: "constant over the clip",
    SEGMENTS: "constant between its steps",
    SHARED: "its direction rests, its brightness or the exposure changes",
    WINDOWS: "its direction changes",
}
Lights = dict[int, Light]


@dataclass(frozen=True, eq=False)
class Readings:
    """k markers in frames, in order. frame : (k,) its number;  normal : (k, 3) unit, STATIC axes
    print_ : (k,) int, which one;  stood_on : (k,) bool, the anchor
    light : what a white surface shows there; behind it the same of one kind of cells alone
    (patches.comparable), where prints are overexposed
    change : of the background from the frame before, by frame (brightness.background_change)
    """

    frame: ndarray
    normal: ndarray
    print_: ndarray
    stood_on: ndarray
    light: Sequence[LightReading]
    change: Mapping[int, float] = field(default_factory=dict)


class StaticFrameLight:
    """Frames that share one static frame, with their readings."""

    def __init__(
        self,
        frames: Sequence[int],
        facts: Sequence[FrameFacts],
        static_from_world: dict[int, ndarray],
        readings: Readings,
        params: LightParams,
    ) -> None:
        """frames : numbers of those that share it;  static_from_world : (3, 3) by number"""
        self.frames, self.facts, self.params = list(frames), facts, params
        self.static_from_world = static_from_world
        mine = np.flatnonzero(np.isin(readings.frame, self.frames))
        self.numbers, self.normals = readings.frame[mine], readings.normal[mine]
        self.readings = [light.at(mine) for light in readings.light]
        self.reading = self.readings[0]
        self.print_, self.stood_on = readings.print_[mine], readings.stood_on[mine]
        self.lit = np.unique(self.numbers).tolist()
        self.change = np.array([readings.change.get(k, np.nan) for k in self.frames])

    def times_s(self, frames: Iterable[int]) -> ndarray:
        return np.array([self.facts[k].time_s for k in frames])

    def from_markers(
        self, rests: bool, samples: Sequence[EnvironmentSample]
    ) -> tuple[Lights, dict[str, Any]]:
        """The light that the markers tell, or the softer cue that takes its place.

        rests : a light can rest in it
        """
        if not self.lit:
            soft = self._surroundings(samples)
            why = "no marker is seen well enough: too small, too flat, clipped or covered"
            return dict.fromkeys(self.frames, soft), self.report(REFUSED, why, soft)
        model, spans, self.reading = fit_temporal_model(
            self.times_s(self.numbers),
            self.normals,
            self.readings,
            self._steps_s(),
            FitParams(self.params.most_lights, likely=self.params.claims == LIKELY),
        )
        soft = self._surroundings(samples)
        longest = max(spans, key=lambda s: s.stop_s - s.start_s)
        claimed = [s for s in spans if s.fit.claimed]
        if rests and claimed:
            best = max(
                claimed,
                key=lambda s: (
                    s.fit.verdict_of(s.group)[0] != REFUSED,
                    s.stop_s - s.start_s,
                ),
            )
            use = used_spans(spans)
            starts = [s.start_s for s in spans[1:]]
            of_frame = use[
                np.searchsorted(starts, self.times_s(self.frames), side="right")
            ]
            models = [*(s.fit.light(s.group) for s in spans), soft]
            lights = self._follow(models, of_frame)
            verdict, why = best.fit.verdict_of(best.group)
            why += f"; {_TEMPORAL_MODELS[model]}"
            light = best.fit.light(best.group)
            return lights, self.report(verdict, why, light) | {
                "account": model,
                "gain": self._relative_gain(lights) if model == SHARED else None,
                "spans": [
                    span_report(s, k >= 0) for s, k in zip(spans, use, strict=True)
                ],
            }
        why = (
            longest.fit.reason
            if rests
            else "camera and marker both move: no frame is known in which a light rests"
        )
        lights = self._follow([soft])
        shaped = "soft light from the picture's surroundings, brighter from above"
        used = shaped if soft.source == "environment" else "ambient light alone"
        middle = lights[self.lit[len(self.lit) // 2]]
        return lights, self.report(REFUSED, f"{why}; used instead: {used}", middle)

    def _relative_gain(self, lights: Lights) -> list[dict[str, float]]:
        """Brightness of at most MOST_GAINS frames, over its median."""
        frames = self.frames[:: len(self.frames) // MOST_GAINS + 1]
        bright = np.array([lights[k].mean_radiance.mean() for k in frames])
        relative = divide(bright, np.median(bright), where_zero=1.0)
        rows = np.stack([self.times_s(frames), relative], -1).tolist()
        return [{"time_s": time_s, "relative": gain} for time_s, gain in rows]

    def from_given(
        self, light: Light, stated: bool, why: str
    ) -> tuple[Lights, dict[str, Any]]:
        """A light that the user gave, as bright in each frame as the markers show.

        stated : the brightness of its lamps is, and what they leave is ambient light (none
        is left where they are brighter than what was measured)"""
        lights = dict.fromkeys(self.frames, light)
        if self.lit:
            n, shown = self.normals, self.reading.y
            if stated:
                left = (shown - light.radiance(n) + light.soft_radiance(n)).mean(0)
                light = Light(
                    triple(np.clip(left, 0, None)), light.lights, light.source
                )
            else:
                light = scaled_to(light, n, shown)
            lights = self._follow([light])
        return lights, self.report(ASSUMED, why, light)

    def _surroundings(self, samples: Sequence[EnvironmentSample]) -> Light:
        """Soft light of this static frame, of source "environment" or "ambient": mean of all
        samples, as bright as the markers show.
        """
        frames = set(self.frames)
        mine = [sample for sample in samples if sample.frame in frames]
        shows = self.reading.y.sum(1) > 0
        n, measured = self.normals[shows], self.reading.y[shows]
        level = np.median(measured, 0) if len(n) else None
        if not mine:
            ambient = Light().ambient_rgb if level is None else triple(level)
            return Light(ambient, (), "ambient")
        turns = [
            self.static_from_world[s.frame] @ self.facts[s.frame].pose.rotation.T
            for s in mine
        ]
        up = normalise((n if len(n) else -np.array(turns)[:, :, 2]).sum(0))
        light = soft_light(mine, turns, up, level)
        return matched(light, n, measured) if len(n) else light

    def _steps_s(self) -> list[float]:
        """Times at which the light steps, beside what turning prints show."""
        dark = Light.of_soft(np.zeros((9, 3)), (), "")
        shape = matched(dark, self.normals, self.reading.y)
        used, level, variance = self._levels(shape.radiance(self.normals))
        if not used.any():
            return []
        frame = self.numbers[used]
        common, _ = common_level(frame, self.print_[used], level, variance)
        return steps(self.times_s(np.unique(frame)), common).tolist()

    def _levels(self, made: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """(readings (k,) bool that say how bright their frames are; of these the logarithm
        (n, 3) of what they show over what was made, and its variance (n,)).

        made : (k, 3) of a model
        """
        y = self.reading.y
        least = max(LEAST_SEEN * float(np.percentile(y.max(1), 90)), 1e-9)
        used = np.asarray((made > least).all(1))
        made, variance = made[used], self.reading.variance[used]
        factor = np.clip(divide(y[used], made), LEAST_FACTOR, MOST_FACTOR)
        relative = (variance / made**2).mean(1) + MODEL_ERROR**2
        return used, np.log(factor), relative / factor.mean(1) ** 2

    def _follow(
        self, models: Sequence[Light], of_frame: ndarray | None = None
    ) -> Lights:
        """Each frame's model, times a factor per channel so that the markers look as they
        were measured (brightness.brightness).

        of_frame : (frames,) number of each frame's model, None = all have the first.
        """
        of_frame = np.zeros(len(self.frames), int) if of_frame is None else of_frame
        row = np.searchsorted(self.frames, self.numbers)
        shown = np.zeros(self.normals.shape)
        for i in np.unique(of_frame[row]):
            mine = of_frame[row] == i
            shown[mine] = models[i].radiance(self.normals[mine])
        used, level, variance = self._levels(shown)
        if not used.any():
            return {k: models[i] for k, i in zip(self.frames, of_frame, strict=True)}
        # what the model does not change already
        bright = np.array([max(m.mean_radiance.mean(), 1e-9) for m in models])[
            of_frame
        ]
        change = self.change - np.diff(np.log(bright), prepend=np.log(bright[0]))
        factors = np.exp(
            brightness(
                self.times_s(self.frames),
                row[used],
                self.print_[used],
                level,
                variance,
                self.stood_on[used],
                change,
                self._turns(row) * [models[i].source != "marker" for i in of_frame],
            )
        )
        return {
            k: models[i].scaled(f)
            for k, i, f in zip(self.frames, of_frame, factors, strict=True)
        }

    def _turns(self, row: ndarray) -> ndarray:
        """(frames,) radians by which the most turned print turned since it was seen before.

        row : (k,) of the frame of each reading"""
        out = np.zeros(len(self.frames))
        for one in np.unique(self.print_):
            n, at = self.normals[self.print_ == one], row[self.print_ == one]
            np.maximum.at(out, at[1:], angle_between(n[1:], n[:-1]))
        return out

    def report(self, verdict: str, reason: str, light: Light) -> dict[str, Any]:
        """What the summary says of a light: also what was seen, and how well it separates
        ambient light from a direction.
        """
        n = self.normals
        rows = np.column_stack([np.ones(len(n)), n])
        rows = divide(rows, np.linalg.norm(rows, axis=0))
        separates = condition(rows) if len(n) >= 4 else 0.0
        document = light.to_json()
        return {
            "source": light.source,
            "normals_seen": len(np.unique(nearest_cell(n, DEG_8))),
            "normal_span_deg": span_deg(n),
            "rank": int(np.linalg.matrix_rank(rows, rtol=1e-2)) if len(n) else 0,
            "condition": separates if 0 < separates < 1e12 else None,
            "ambient_rgb": document["ambient_rgb"],
            "lights": document["lights"],
            "verdict": verdict,
            "reason": reason,
        }


def fit_temporal_model(
    times_s: ndarray,
    normals: ndarray,
    readings: Sequence[LightReading],
    breaks_s: Sequence[float],
    params: FitParams = FitParams(),  # noqa: B008 - frozen
) -> tuple[str, list[Span], LightReading]:
    """(account, spans, the reading that tells it): a later one where it says more than the
    first.
    """
    verdict = ""  # so far
    for reading in readings:
        on = reading.fit
        if verdict == MEASURED or (verdict and not on.any()):
            break
        on = on if on.any() else np.ones_like(on)
        account, spans = fit_over_time(
            times_s[on],
            normals[on],
            reading.y[on],
            reading.variance[on],
            breaks_s,
            params,
        )
        verdicts = {s.fit.verdict for s in spans}
        better = next(v for v in (MEASURED, LIKELY, REFUSED) if v in verdicts)
        if better == MEASURED or (verdict in ("", REFUSED) and better != verdict):
            found, verdict = (account, spans, reading), better
    return found


def used_spans(spans: Sequence[Span]) -> ndarray:
    """(s,) int: which span's light is used in each, -1 = soft light.

    One that is refused takes what those around it agree on.
    """
    known = [i for i, s in enumerate(spans) if s.fit.claimed]
    out = np.full(len(spans), -1)
    out[known] = known
    for before, after in pairwise(known):
        first, second = spans[before].fit.lights, spans[after].fit.lights
        if (
            first
            and second
            and angle_between(first[0].direction, second[0].direction)
            < np.radians(ALIKE_DEG)
        ):
            middle = (spans[before].stop_s + spans[after].start_s) / 2
            for i in range(before + 1, after):
                out[i] = before if spans[i].stop_s <= middle else after
    return out


def span_report(span: Span, used: bool) -> dict[str, Any]:
    """What the summary says of one span of a clip in which some light is known.

    used : whether some direction is used in it
    """
    verdict, why = span.fit.verdict_of(span.group)
    if not span.fit.claimed:
        why += "; used instead: " + (
            "the light before and after it" if used else "soft light"
        )
    document = span.fit.light(span.group).to_json()
    return {
        "start_s": span.start_s,
        "end_s": span.stop_s,
        "verdict": verdict,
        "lights": document["lights"],
        "ambient_rgb": document["ambient_rgb"],
        "reason": why,
    }
