"""Settings of the stage, and values that are key-framed over time."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

from arfx.core.units import length_m, time_s
from arfx.errors import ConfigError, require_within

OBJECT, MARKER = "object", "marker"
_T = TypeVar("_T")


@dataclass(frozen=True)
class DofParams:
    """formula : corrected, or paper: Zhao et al. 2012 as printed, or gaussian: their Figure 12, a
    Gaussian filter, with the
        settings of paper
    scope : all (the lens blurs the whole picture) or virtual (the footage is blurred already; the
        lens blurs only the object)
    lens : given (by the settings below) or footage (the lens that the analysis measured; needs
        scope virtual)
    focal_mm : focal length, or key frames such as "35@0s, 85@2s" (interpolated evenly in ratio); 0
        = from the calibration and
        sensor_width_mm. It changes the blur, not what the picture shows
    fnumber : f-number, or key frames such as "2.8@0s, 11@3s" (interpolated evenly in stops)
    sensor_width_mm : width of the part of the sensor that the picture shows
    aperture_px : blur circle's diameter for something infinitely far, in place of focal length and
        f-number; 0 = use those
    focus : what is in focus: object, marker (the one under the model), a marker's id (3 or
        36h11:3), a distance such as
        60cm, or key frames such as "object@0s, marker@2s, 1.5m@3s" (interpolated evenly in
        dioptres)
    background_m : distance of whatever is behind the real plane, which ends there; 0 = endless
    blades : blades of the aperture, 3 or more; 0 = round
    blade_turn_deg : direction of the aperture's first corner, clockwise from the picture's right
    highlight_boost : how much brighter than stored a clipped pixel is taken to be; 0 = as stored
    """

    formula: str = field(default="corrected", init=False)
    scope: str = "all"
    lens: str = "given"
    focal_mm: float | str = 0.0
    fnumber: float | str = 2.8
    sensor_width_mm: float = 36.0
    aperture_px: float = 0.0
    focus: int | float | str = OBJECT
    background_m: float = 0.0
    blades: int = 0
    blade_turn_deg: float = 0.0
    highlight_boost: float = 0.0

    def __post_init__(self) -> None:
        _one_of("scope", self.scope, ("all", "virtual"))
        _one_of("lens", self.lens, ("given", "footage"))
        if self.lens == "footage" and self.scope == "all":
            raise ConfigError(
                "dof.lens = footage would blur the footage twice",
                "use it with dof.scope = virtual",
            )
        if not 0 < self.sensor_width_mm <= 1e4:
            raise ConfigError(
                "dof.sensor_width_mm must be above 0 and at most 10000, is"
                f" {self.sensor_width_mm:g}"
            )
        lengths = ("aperture_px", "background_m", "highlight_boost")
        require_within("dof", self, **dict.fromkeys(lengths, (0, 1e6)))
        if self.blades < 0 or self.blades in (1, 2) or self.blades > 32:
            raise ConfigError(f"dof.blades must be 0 (round) or 3 to 32, is {self.blades}")
        for time, focal_mm in focal_keys(self.focal_mm):
            if not 0 <= focal_mm <= 1e6:
                raise ConfigError(
                    f"dof.focal_mm must be between 0 and 1000000, is {focal_mm:g} at"
                    f" {time:g} s"
                )
        for time, fnumber in fnumber_keys(self.fnumber):
            if not fnumber >= 1e-3:
                raise ConfigError(
                    f"dof.fnumber must be above 0 (0.001 or more), is {fnumber:g} at"
                    f" {time:g} s"
                )
        focus_keys(self.focus)


def _one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise ConfigError(
            f"dof.{name} {value!r} is unknown", "one of " + ", ".join(allowed)
        )


def focal_keys(value: float | str) -> list[tuple[float, float]]:
    """[(time s, focal length mm, 0 = the calibration's)] in order of time. Raises ConfigError."""
    return _keys(
        str(value),
        "focal_mm",
        lambda text: _number(
            text, text.lower().removesuffix("mm"), "focal_mm", "35@0s, 85@2s"
        ),
    )


def fnumber_keys(value: float | str) -> list[tuple[float, float]]:
    """[(time s, f-number)] in order of time. Raises ConfigError."""
    return _keys(
        str(value),
        "fnumber",
        lambda text: _number(
            text, text.lower().removeprefix("f/"), "fnumber", "2.8@0s, 11@3s"
        ),
    )


def _number(text: str, bare: str, name: str, example: str) -> float:
    try:
        return float(bare)
    except ValueError:
        raise ConfigError(
            f"dof.{name}: {text!r} is not a number", f"such as 50, or key frames {example}"
        ) from None


def focus_keys(value: int | float | str) -> list[tuple[float, str | float]]:
    """[(time s, "object" | "marker" | "id:..." | distance in metres)] in order of time. Raises
    ConfigError."""

    def read(text: str) -> str | float:
        if text in (OBJECT, MARKER):
            return text
        if re.fullmatch(r"\d+", text) or re.fullmatch(r"[^:\s]+:\d+", text):
            return f"id:{text}"
        if text in ("inf", "infinity"):
            return math.inf
        try:
            distance = length_m(text, "dof.focus")
        except ConfigError:
            raise ConfigError(
                f"dof.focus: {text!r} is neither object, marker, a marker's id nor a"
                " length",
                "such as object, 36h11:3 or 60cm",
            ) from None
        if distance <= 0:
            raise ConfigError(f"dof.focus must be a distance above 0, is {text}")
        return distance

    return _keys(str(value), "focus", read)


def _keys(text: str, name: str, read: Callable[[str], _T]) -> list[tuple[float, _T]]:
    keys = []
    for part in text.split(","):
        value, at, moment = part.strip().partition("@")
        if not at and "," in text:
            raise ConfigError(
                f"dof.{name}: key frame {part.strip()!r} has no time",
                f"write it as VALUE@TIME: {part.strip()}@2s",
            )
        keys.append((time_s(moment, f"dof.{name}") if at else 0.0, read(value.strip())))
    times = [t for t, _ in keys]
    if times != sorted(set(times)):
        raise ConfigError(f"dof.{name}: the key frames' times must rise")
    return keys


def interpolate(keys: list[tuple[float, float]], time: float) -> float:
    """Value at `time`: linear between key frames, constant before the first and after the last."""
    if time <= keys[0][0]:
        return keys[0][1]
    for (t0, a), (t1, b) in pairwise(keys):
        if time < t1:
            return a + (b - a) * (time - t0) / (t1 - t0)
    return keys[-1][1]


def interpolate_ratio(keys: list[tuple[float, float]], time: float) -> float:
    """The same, evenly in the logarithm: by the same factor in the same time. Values above 0."""
    return 2.0 ** interpolate([(t, math.log2(value)) for t, value in keys], time)
