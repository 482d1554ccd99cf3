"""The light of the frames that share one static frame: read off the markers, given, or
taken from the surroundings.

A light that the user gives is a direction, or a high dynamic range picture of the
surroundings, in the anchor marker's axes: x right, y up the print, z out of it. Panoramas
are equirectangular, z up: the middle column looks along x, the left half holds +y."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from arfx.analyse.light.brightness import brightness, common_level, steps
from arfx.analyse.light.fit import best_verdict, span_deg
from arfx.analyse.light.hypotheses import LIKELY, MEASURED, REFUSED
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
from arfx.analyse.light.photometry import LightReading
from arfx.analyse.light.sphere import DEG_8, nearest_cell
from arfx.analyse.light.surroundings import (
    OUTSTANDING,
    EnvironmentSample,
    matched,
    soft_light,
)
from arfx.analyse.params import LightParams
from arfx.core.facts import FrameFacts
from arfx.core.light import DIFFUSE, DirectionalLight, Light, harmonics, triple
from arfx.core.numerics import angle_between, divide, normalise

ROWS = 64  # a panorama is reduced to: 2.8 degrees a pixel
LEAST_FRACTION = 0.1  # of all light that a lamp gives
AMBIENT, DIRECT = (
    0.45,
    0.5,
)  # radiance of a white surface without, and from a facing light, where only a direction is given
ASSUMED = "assumed"
LEAST_FACTOR, MOST_FACTOR = 1 / 16, 16.0  # of a frame's brightness to its model's
MOST_GAINS = 200  # in the report
ALIKE_DEG = 15.0  # lights before and after a span that is refused, to be used in it
MODEL_ERROR = (
    0.003  # of a model's irradiance, relative: a reading of one normal is no better
)
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


def light_from_direction(given: tuple[float, ...], size_deg: float) -> tuple[Light, bool]:
    """(light in anchor axes, whether its brightness is stated).

    given : azimuth, elevation, and perhaps R, G, B.
    """
    a, e = np.radians(given[:2])  # azimuth from x towards y, elevation above the plane
    d = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    rgb = given[2:] if len(given) == 5 else (DIRECT,) * 3
    lamp = DirectionalLight(triple(d), (rgb[0], rgb[1], rgb[2]), size_deg)
    return Light((AMBIENT,) * 3, (lamp,), "given"), len(given) == 5


def light_from_panorama(picture: np.ndarray) -> Light:
    """Light in anchor axes: up to two lamps that stand out, everything else as soft light.

    picture : (h, w, 3) linear radiance, finite and >= 0. rgb are those of core.light:
    radiance of a white surface.
    """
    small = cv2.resize(
        np.asarray(picture, np.float32), (2 * ROWS, ROWS), interpolation=cv2.INTER_AREA
    ).astype(float)
    elevation = np.pi / 2 - (np.arange(ROWS) + 0.5) / ROWS * np.pi
    azimuth = np.pi - (np.arange(2 * ROWS) + 0.5) / ROWS * np.pi
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    direction = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    # steradians of the pixels
    solid = 2 * np.pi / ROWS * np.sin(np.pi / 2 / ROWS) * np.cos(e)
    grey = small.mean(-1)
    power = grey * solid
    bright = grey > OUTSTANDING * power.sum() / solid.sum()
    count, labels = cv2.connectedComponents(bright.astype(np.uint8), connectivity=8)
    # connected over the panorama's left and right edge too
    for left, right in labels[:, [0, -1]]:
        if left and right and left != right:
            labels[labels == right] = left
    shares = np.bincount(labels.ravel(), power.ravel(), count) / max(power.sum(), 1e-300)
    base, lamps, rest = np.median(small[~bright], axis=0), [], small.copy()
    for k in 1 + np.argsort(-shares[1:], kind="stable")[:2]:
        if shares[k] < LEAST_FRACTION:
            break
        on = labels == k
        above = np.clip(small[on] - base, 0, None)
        d = normalise((direction[on] * power[on][:, None]).sum(0))
        facing = np.clip(direction[on] @ d, 0, None)
        rgb = (above * (solid[on] * facing)[:, None]).sum(0) / np.pi
        size = 2 * np.degrees(np.arccos(np.clip(1 - solid[on].sum() / (2 * np.pi), -1, 1)))
        lamps.append(DirectionalLight(triple(d), triple(rgb), float(min(size, 90.0))))
        rest[on] = np.minimum(small[on], base)
    basis = harmonics(direction.reshape(-1, 3)) * solid.reshape(-1, 1)
    soft = DIFFUSE[:, None] * (
        basis.T @ rest.reshape(-1, 3)
    )  # of a white diffuse surface over its normal
    return Light.of_soft(soft, tuple(lamps), "environment file")


def fitted_to(
    light: Light, normals: np.ndarray, radiance: np.ndarray, keep_lamps: bool
) -> Light:
    """The light, with white surfaces of `normals` as bright as measured, on average.

    normals : (k, 3), radiance : (k, 3) of white surfaces, axes of the light. keep_lamps :
    their brightness is stated, and
    what they leave is ambient light (none is left where they are brighter than what was
    measured); else all of the light is scaled, channel by channel."""
    n, want = normals, radiance.mean(0)
    if keep_lamps:
        lit = (light.radiance(n) - light.soft_radiance(n)).mean(0)
        return Light(triple(np.clip(want - lit, 0, None)), light.lights, light.source)
    factor = divide(want, light.radiance(n).mean(0), where_zero=1.0)
    return light.scaled(factor)


@dataclass(frozen=True, eq=False)
class Readings:
    """k markers in frames. frame : (k,) its number;  normal : (k, 3) unit, STATIC axes
    print_ : (k,) int, which one;  stood_on : (k,) bool, the anchor
    light : what a white surface shows there; behind it the same of one kind of cells alone
    (patches.comparable), where prints are overexposed
    change : of the background from the frame before, by frame (brightness.background_change)
    """

    frame: np.ndarray
    normal: np.ndarray
    print_: np.ndarray
    stood_on: np.ndarray
    light: Sequence[LightReading]
    change: Mapping[int, float] = field(default_factory=dict)


class StaticFrameLight:
    """Frames that share one static frame, with their readings."""

    def __init__(
        self,
        frames: Sequence[int],
        facts: Sequence[FrameFacts],
        static_from_world: dict[int, np.ndarray],
        readings: Readings,
        params: LightParams,
    ) -> None:
        """frames : numbers of those that share it;  static_from_world : (3, 3) by number"""
        self.frames, self.facts, self.static_from_world, self.params = (
            list(frames),
            facts,
            static_from_world,
            params,
        )
        mine = np.flatnonzero(np.isin(readings.frame, self.frames))
        mine = mine[np.argsort(readings.frame[mine], kind="stable")]
        self.numbers, self.normals = readings.frame[mine], readings.normal[mine]
        self.readings = [light.at(mine) for light in readings.light]
        self.reading = self.readings[0]
        self.print_, self.stood_on = readings.print_[mine], readings.stood_on[mine]
        self.lit = np.unique(self.numbers).tolist()
        self.change = np.array([readings.change.get(k, np.nan) for k in self.frames])

    def times_s(self, frames: Iterable[int]) -> np.ndarray:
        return np.array([self.facts[k].time_s for k in frames])

    def from_markers(
        self, rests: bool, samples: Sequence[EnvironmentSample]
    ) -> tuple[Lights, dict[str, Any]]:
        """The light that the markers tell, or the softer cue that takes its place.

        rests : a light can rest in it
        """
        if not self.lit:
            soft, source = self._surroundings(samples)
            why = "no marker is seen well enough: too small, too flat, clipped or covered"
            return dict.fromkeys(self.frames, soft), self.report(REFUSED, source, why, soft)
        breaks = self._steps_s().tolist()
        fit_params = FitParams(self.params.most_lights, likely=self.params.claims == LIKELY)
        model, spans, self.reading = fit_temporal_model(
            self.times_s(self.numbers), self.normals, self.readings, breaks, fit_params
        )
        longest = max(spans, key=lambda s: s.stop_s - s.start_s).fit
        soft, source = self._surroundings(samples)
        if rests and any(s.fit.claimed for s in spans):
            starts = [s.start_s for s in spans]
            at = np.searchsorted(starts, self.times_s(self.frames), side="right") - 1
            use = used_spans(spans)
            lights = self._follow(
                [soft, *(s.fit.light(s.group) for s in spans)],
                use[np.clip(at, 0, None)] + 1,
            )
            best = max(
                (s for s in spans if s.fit.claimed),
                key=lambda s: (s.fit.told(s.group)[0] != REFUSED, s.stop_s - s.start_s),
            )
            verdict, why = best.fit.told(best.group)
            why += f"; {_TEMPORAL_MODELS[model]}"
            light = best.fit.light(best.group)
            report = self.report(verdict, "marker", why, light, longest.span_deg)
            return lights, report | {
                "gamma": best.fit.gamma,
                "account": model,
                "gain": self._relative_gain(lights) if model == SHARED else None,
                "spans": [span_report(s, k >= 0) for s, k in zip(spans, use, strict=True)],
            }
        why = (
            longest.reason
            if rests
            else "camera and marker both move: no frame is known in which a light rests"
        )
        lights = self._follow([soft])
        shaped = "soft light from the picture's surroundings, brighter from above"
        used = shaped if source == "environment" else "ambient light alone"
        middle = lights[self.lit[len(self.lit) // 2]]
        why += f"; used instead: {used}"
        return lights, self.report(REFUSED, source, why, middle, longest.span_deg)

    def _relative_gain(self, lights: Lights) -> list[dict[str, float]]:
        """Brightness of at most MOST_GAINS frames, over its median."""
        frames = [
            self.frames[i]
            for i in np.unique(np.linspace(0, len(self.frames) - 1, MOST_GAINS).astype(int))
        ]
        bright = np.array([float(lights[k].mean_radiance.mean()) for k in frames])
        relative = divide(bright, float(np.median(bright)), where_zero=1.0)
        return [
            {"time_s": self.facts[k].time_s, "relative": float(g)}
            for k, g in zip(frames, relative, strict=True)
        ]

    def from_given(
        self, light: Light, stated: bool, why: str
    ) -> tuple[Lights, dict[str, Any]]:
        """A light that the user gave, as bright in each frame as the markers show."""
        if not self.lit:
            lights, typical = dict.fromkeys(self.frames, light), light
        else:
            typical = fitted_to(light, self.normals, self.reading.y, stated)
            lights = self._follow([typical])
        return lights, self.report(ASSUMED, light.source, why, typical)

    def _surroundings(self, samples: Sequence[EnvironmentSample]) -> tuple[Light, str]:
        """(soft light of this static frame, "environment" or "ambient"): mean of all
        samples, as bright as the markers show.
        """
        mine = set(self.frames)
        samples = [sample for sample in samples if sample.frame in mine]
        shows = self.reading.y.sum(1) > 0
        measured = self.reading.y[shows]
        if not samples:
            level = (
                np.median(measured, 0) if len(measured) else np.array(Light().ambient_rgb)
            )
            return Light(triple(level), (), "ambient"), "ambient"
        turns = [
            self.static_from_world[k] @ self.facts[k].pose.rotation.T
            for k in (sample.frame for sample in samples)
        ]
        n = self.normals[shows]
        up = normalise((n if len(n) else -np.array([t[:, 2] for t in turns])).sum(0))
        light = soft_light(
            samples, turns, up, np.median(measured, 0) if len(measured) else None
        )
        return (matched(light, n, measured) if len(n) else light), "environment"

    def _steps_s(self) -> np.ndarray:
        """(s,) times at which the light steps, beside what turning prints show."""
        even = Light.of_soft(
            np.outer(np.eye(9)[0], self.reading.y.mean(0) * np.sqrt(4 * np.pi)), (), ""
        )
        shape = matched(even, self.normals, self.reading.y)
        used, level, variance = self._levels(shape.radiance(self.normals))
        if not used.any():
            return np.zeros(0)
        frame = self.numbers[used]
        common, _ = common_level(frame, self.print_[used], level, variance)
        return steps(self.times_s(np.unique(frame)), common)

    def _levels(self, made: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(readings (k,) bool that say how bright their frames are; of these the logarithm
        (n, 3) of what they show over what was made, and its variance (n,)).

        made : (k, 3) of a model
        """
        y, variance = self.reading.y, self.reading.variance
        bright = float(np.percentile(y.max(1), 90))
        used = np.asarray((made > LEAST_SEEN * bright).all(1))
        made, y, variance = made[used], y[used], variance[used]
        factor = np.clip(divide(y, made), LEAST_FACTOR, MOST_FACTOR)
        relative = (variance / made**2).mean(1) + MODEL_ERROR**2
        return used, np.log(factor), relative / factor.mean(1) ** 2

    def _follow(
        self, models: Sequence[Light], of_frame: np.ndarray | None = None
    ) -> Lights:
        """Each frame's model, times a factor per channel so that the markers look as they
        were measured (brightness.brightness).

        of_frame : (frames,) number of each frame's model, None = all have the first.
        """
        of_frame = np.zeros(len(self.frames), int) if of_frame is None else of_frame
        position = np.searchsorted(self.frames, self.numbers)
        of_reading = of_frame[position]
        made = np.zeros(self.reading.y.shape)
        for i, model in enumerate(models):
            made[of_reading == i] = model.radiance(self.normals[of_reading == i])
        used, level, variance = self._levels(made)
        if not used.any():
            return {k: models[i] for k, i in zip(self.frames, of_frame, strict=True)}
        factors = np.exp(
            brightness(
                self.times_s(self.frames),
                position[used],
                self.print_[used],
                level,
                variance,
                self.stood_on[used],
                self.change,
            )
        )
        return {
            self.frames[r]: models[i].scaled(factors[r]) for r, i in enumerate(of_frame)
        }

    def report(
        self,
        verdict: str,
        source: str,
        reason: str,
        light: Light,
        normal_span_deg: float | None = None,
    ) -> dict[str, Any]:
        """What the summary says of a light: also what was seen, and how well it separates
        ambient light from a direction.
        """
        n = self.normals
        rows = np.column_stack([np.ones(len(n)), n])
        size = np.linalg.svd(divide(rows, np.linalg.norm(rows, axis=0)), compute_uv=False)
        condition = float(divide(size[0], size[-1])) if len(size) == 4 else 0.0
        document = light.to_json()
        return {
            "source": source,
            "normals_seen": len(np.unique(nearest_cell(n, DEG_8))),
            "normal_span_deg": span_deg(n) if normal_span_deg is None else normal_span_deg,
            "rank": int((size > 1e-2 * size.max(initial=0)).sum()),
            "condition": condition if 0 < condition < 1e12 else None,
            "ambient_rgb": document["ambient_rgb"],
            "lights": document["lights"],
            "verdict": verdict,
            "reason": reason,
        }


def fit_temporal_model(
    times_s: np.ndarray,
    normals: np.ndarray,
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
        if verdict == MEASURED or not on.any():
            break
        account, spans = fit_over_time(
            times_s[on], normals[on], reading.y[on], reading.variance[on], breaks_s, params
        )
        better = best_verdict(s.fit for s in spans)
        if better == MEASURED or (verdict in ("", REFUSED) and better != verdict):
            found, verdict = (account, spans, reading), better
    return found


def used_spans(spans: Sequence[Span]) -> np.ndarray:
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
    verdict, why = span.fit.told(span.group)
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
