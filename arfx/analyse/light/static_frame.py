"""The light of the frames that share one static frame: read off the markers, given, or
taken from the surroundings."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.analyse.light.brightness import brightness, common_level, steps
from arfx.analyse.light.fit import span_deg
from arfx.analyse.light.hypotheses import LIKELY, REFUSED
from arfx.analyse.light.hypotheses import Params as FitParams
from arfx.analyse.light.over_time import (
    CONSTANT,
    SEGMENTS,
    SHARED,
    SWITCHED,
    WINDOWS,
    Span,
    fit_over_time,
)
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
    SWITCHED: "its lamps are switched",
    SEGMENTS: "constant between its steps",
    SHARED: "its direction rests, its brightness or the exposure changes",
    WINDOWS: "its direction changes",
}
Lights = dict[int, Light]


@dataclass(frozen=True, eq=False)
class Readings:
    """k markers in frames, in order. frame : (k,) its number;  normal : (k, 3) unit, STATIC axes
    print_ : (k,) int, which one;  stood_on : (k,) bool, the anchor
    radiance, variance : (k, 3) of a white surface there;  even : (k,) bool, no real shadow
    lies on a part of it
    """

    frame: ndarray
    normal: ndarray
    print_: ndarray
    stood_on: ndarray
    radiance: ndarray
    variance: ndarray
    even: ndarray

    def __getitem__(self, rows: ndarray) -> "Readings":
        return Readings(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(eq=False)
class StaticFrameLight:
    """Frames that share one static frame, with their readings.

    frames : their numbers;  static_from_world : (3, 3) by number;  changes : of the
    background from the frame before, by number (brightness.background_change)"""

    frames: Sequence[int]
    facts: Sequence[FrameFacts]
    static_from_world: Mapping[int, ndarray]
    readings: Readings
    params: LightParams
    changes: Mapping[int, float]

    @property
    def lit(self) -> list[int]:
        """Frames that have a reading."""
        return np.unique(self.readings.frame).tolist()

    def times_s(self, frames: Iterable[int]) -> ndarray:
        return np.array([self.facts[k].time_s for k in frames])

    def from_markers(
        self, rests: bool, samples: Sequence[EnvironmentSample]
    ) -> tuple[Lights, dict[str, Any]]:
        """The light that the markers tell, or the softer cue that takes its place.

        rests : a light can rest in it
        """
        soft = self._surroundings(samples)
        if not self.lit:
            why = "no marker is seen well enough: too small, too flat, clipped or covered"
            return dict.fromkeys(self.frames, soft), self.report(REFUSED, why, soft)
        even = self.readings[self.readings.even | ~self.readings.even.any()]
        model, spans = fit_over_time(
            self.times_s(even.frame),
            even.normal,
            even.radiance,
            even.variance,
            self._steps_s(),
            FitParams(self.params.most_lights, likely=self.params.claims == LIKELY),
        )

        def worth(span: Span) -> tuple[bool, bool, float]:
            verdict, _ = span.fit.verdict_of(span.group)
            return span.fit.claimed, verdict != REFUSED, span.stop_s - span.start_s

        best = max(spans, key=worth)
        verdict, why = best.fit.verdict_of(best.group)
        if rests and best.fit.claimed:
            use, starts = used_spans(spans), [s.start_s for s in spans[1:]]
            times_s = self.times_s(self.frames)
            of_frame = use[np.searchsorted(starts, times_s, side="right")]
            models = [*(s.fit.light(s.group) for s in spans), soft]
            lights = self._follow(models, of_frame)
            why += f"; {_TEMPORAL_MODELS[model]}"
            told_of = [
                span_report(s, k >= 0) for s, k in zip(spans, use, strict=True)
            ]
            light = best.fit.light(best.group)
            return lights, self.report(verdict, why, light, told_of) | {
                "account": model,
                "gain": self._relative_gain(lights) if model == SHARED else None,
            }
        if not rests:
            why = "camera and marker both move: no frame is known in which a light rests"
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
            n, shown = self.readings.normal, self.readings.radiance
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
        shows = self.readings[self.readings.radiance.sum(1) > 0]
        n, known = shows.normal, len(shows.normal) > 0
        level = np.median(shows.radiance, 0) if known else None
        if not mine:
            ambient = Light().ambient_rgb if level is None else triple(level)
            return Light(ambient, (), "ambient")
        turns = [
            self.static_from_world[s.frame] @ self.facts[s.frame].pose.rotation.T
            for s in mine
        ]
        up = normalise((n if known else -np.array(turns)[:, :, 2]).sum(0))
        light = soft_light(mine, turns, up, level)
        return matched(light, n, shows.radiance) if known else light

    def _steps_s(self) -> list[float]:
        """Times at which the light steps, beside what turning prints show."""
        dark, n = Light.of_soft(np.zeros((9, 3)), (), ""), self.readings.normal
        shape = matched(dark, n, self.readings.radiance)
        used, level, variance = self._levels(shape.radiance(n))
        if not len(level):
            return []
        common, _ = common_level(used.frame, used.print_, level, variance)
        return steps(self.times_s(np.unique(used.frame)), common).tolist()

    def _levels(self, made: ndarray) -> tuple[Readings, ndarray, ndarray]:
        """(those that say how bright their frames are; the logarithm (n, 3) of what they show
        over what was made, and its variance (n,)).

        made : (k, 3) of a model
        """
        bright = float(np.percentile(self.readings.radiance.max(1), 90))
        rows = np.asarray((made > max(LEAST_SEEN * bright, 1e-9)).all(1))
        used, made = self.readings[rows], made[rows]
        factor = np.clip(divide(used.radiance, made), LEAST_FACTOR, MOST_FACTOR)
        relative = (used.variance / made**2).mean(1) + MODEL_ERROR**2
        return used, np.log(factor), relative / factor.mean(1) ** 2

    def _follow(
        self, models: Sequence[Light], of_frame: ndarray | None = None
    ) -> Lights:
        """Each frame's model, times a factor per channel so that the markers look as they
        were measured (brightness.brightness).

        of_frame : (frames,) number of each frame's model, None = all have the first.
        """
        of_frame = np.zeros(len(self.frames), int) if of_frame is None else of_frame
        row, n = (
            np.searchsorted(self.frames, self.readings.frame),
            self.readings.normal,
        )
        shown = np.zeros(n.shape)
        for i in np.unique(of_frame[row]):
            mine = of_frame[row] == i
            shown[mine] = models[i].radiance(n[mine])
        used, level, variance = self._levels(shown)
        lights = [models[i] for i in of_frame]
        if not len(level):
            return dict(zip(self.frames, lights, strict=True))
        # what the model does not change already
        bright = [np.log(max(light.mean_radiance.mean(), 1e-9)) for light in lights]
        change = np.array([self.changes.get(k, np.nan) for k in self.frames])
        factors = brightness(
            self.times_s(self.frames),
            np.searchsorted(self.frames, used.frame),
            used.print_,
            level,
            variance,
            used.stood_on,
            change - np.diff(bright, prepend=bright[0]),
            self._turns(row) * [light.source != "marker" for light in lights],
        )
        every = zip(self.frames, lights, np.exp(factors), strict=True)
        return {k: light.scaled(factor) for k, light, factor in every}

    def _turns(self, row: ndarray) -> ndarray:
        """(frames,) radians by which the most turned print turned since it was seen before.

        row : (k,) of the frame of each reading"""
        out = np.zeros(len(self.frames))
        for one in np.unique(self.readings.print_):
            mine = self.readings.print_ == one
            n, at = self.readings.normal[mine], row[mine]
            np.maximum.at(out, at[1:], angle_between(n[1:], n[:-1]))
        return out

    def report(
        self,
        verdict: str,
        reason: str,
        light: Light,
        spans: Sequence[dict[str, Any]] = (),
    ) -> dict[str, Any]:
        """What the summary says of a light: also what was seen, and how well it separates
        ambient light from a direction.

        spans : of `span_report`, none = the light is that of all frames
        """
        n = self.readings.normal
        rows = np.column_stack([np.ones(len(n)), n])
        rows = divide(rows, np.linalg.norm(rows, axis=0))
        separates = condition(rows) if len(n) >= 4 else 0.0
        own = _told(verdict, reason, light)
        first, last = self.facts[self.frames[0]], self.facts[self.frames[-1]]
        whole = {"start_s": first.time_s, "end_s": last.time_s, **own}
        return {
            "source": light.source,
            "normals_seen": len(np.unique(nearest_cell(n, DEG_8))),
            "normal_span_deg": span_deg(n),
            "rank": int(np.linalg.matrix_rank(rows, rtol=1e-2)) if len(n) else 0,
            "condition": separates if 0 < separates < 1e12 else None,
            "spans": spans or [whole],
            **own,
        }


def _told(verdict: str, reason: str, light: Light) -> dict[str, Any]:
    """What the summary says of a light and of a span's."""
    document = light.to_json()
    shown = {name: document[name] for name in ("ambient_rgb", "lights")}
    return {"verdict": verdict, "reason": reason, **shown}


def used_spans(spans: Sequence[Span]) -> ndarray:
    """(s,) int: which span's light is used in each, -1 = soft light.

    One that is refused takes the one before it, where the one after it agrees.
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
            out[before + 1 : after] = before
    return out


def span_report(span: Span, used: bool) -> dict[str, Any]:
    """What the summary says of one span of a clip in which some light is known.

    used : whether some direction is used in it
    """
    verdict, why = span.fit.verdict_of(span.group)
    if not span.fit.claimed:
        why += "; used instead: " + ("the light before it" if used else "soft light")
    light = span.fit.light(span.group)
    ends = {"start_s": span.start_s, "end_s": span.stop_s}
    return ends | _told(verdict, why, light)
