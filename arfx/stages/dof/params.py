"""Settings of the stage, and values that are key-framed over time."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, model_validator

from arfx.core.settings import Settings, setting
from arfx.core.units import length_m, time_s
from arfx.errors import ConfigError

OBJECT, MARKER = "object", "marker"
_T = TypeVar("_T")


def focal_keys(value: float | str) -> list[tuple[float, float]]:
    """[(time s, focal length mm, 0 = the calibration's)] in order of time. Raises ConfigError."""
    return _keys(
        value,
        lambda text: _number(text.lower().removesuffix("mm"), "35@0s, 85@2s", 0, 1e6),
    )


def fnumber_keys(value: float | str) -> list[tuple[float, float]]:
    """[(time s, f-number)] in order of time. Raises ConfigError."""
    return _keys(
        value,
        lambda text: _number(
            text.lower().removeprefix("f/"), "2.8@0s, 11@3s", 1e-3, math.inf
        ),
    )


def _number(text: str, example: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ConfigError(
            f"{text!r} is not a number", f"such as 50, or key frames {example}"
        ) from None
    _require(low <= value <= high, f"between {low:g} and {high:g}", value)
    return value


def focus_keys(value: int | float | str) -> list[tuple[float, str | float]]:
    """[(time s, "object" | "marker" | "id:..." | distance in metres)] in order of time. Raises
    ConfigError."""
    return _keys(value, _focus)


def _focus(text: str) -> str | float:
    if text in (OBJECT, MARKER):
        return text
    if re.fullmatch(r"\d+", text) or re.fullmatch(r"[^:\s]+:\d+", text):
        return f"id:{text}"
    if text in ("inf", "infinity"):
        return math.inf
    try:
        distance = length_m(text)
    except ConfigError:
        raise ConfigError(
            f"{text!r} is neither object, marker, a marker's id nor a length",
            "such as object, 36h11:3 or 60cm",
        ) from None
    _require(distance > 0, "a distance above 0", distance)
    return distance


def _keys(value: float | str, read: Callable[[str], _T]) -> list[tuple[float, _T]]:
    keys, text = [], str(value)
    for part in text.split(","):
        words, at, moment = part.strip().partition("@")
        if not at and "," in text:
            raise ConfigError(
                f"key frame {part.strip()!r} has no time",
                f"write it as VALUE@TIME: {part.strip()}@2s",
            )
        keys.append((time_s(moment) if at else 0.0, read(words.strip())))
    times = [t for t, _ in keys]
    if times != sorted(set(times)):
        raise ConfigError("the key frames' times must rise")
    return keys


def _polygon(blades: int) -> None:
    _require(blades not in (1, 2), "0 (round) or 3 to 32", blades)


def _valid(check: Callable[[Any], object]) -> AfterValidator:
    """Refuses what `check` refuses."""

    def checked(value: Any) -> Any:
        check(value)
        return value

    return AfterValidator(checked)


def _require(right: bool, what: str, value: float) -> None:
    if not right:
        raise ConfigError(f"must be {what}, is {value:g}")


class DofParams(Settings):
    formula: str = setting(
        "corrected",
        "corrected, or paper: Zhao et al. 2012 as printed, or gaussian: their Figure 12, a"
        " Gaussian filter, with the settings of paper",
    )
    scope: Literal["all", "virtual"] = setting(
        "all",
        "all (the lens blurs the whole picture) or virtual (the footage is blurred already;"
        " the lens blurs only the object)",
    )
    lens: Literal["given", "footage"] = setting(
        "given",
        "given (by the settings below) or footage (the lens that the analysis measured; needs"
        " scope virtual)",
    )
    focal_mm: Annotated[float | str, _valid(focal_keys)] = setting(
        0.0,
        'focal length, or key frames such as "35@0s, 85@2s" (interpolated evenly in ratio);'
        " 0 = from the calibration and sensor_width_mm. It changes the blur, not what the"
        " picture shows",
    )
    fnumber: Annotated[float | str, _valid(fnumber_keys)] = setting(
        2.8,
        'f-number, or key frames such as "2.8@0s, 11@3s" (interpolated evenly in stops)',
    )
    sensor_width_mm: float = setting(
        36.0, "width of the part of the sensor that the picture shows", gt=0, le=1e4
    )
    aperture_px: float = setting(
        0.0,
        "blur circle's diameter for something infinitely far, in place of focal length and"
        " f-number; 0 = use those",
        ge=0,
        le=1e6,
    )
    focus: Annotated[int | float | str, _valid(focus_keys)] = setting(
        OBJECT,
        "what is in focus: object, marker (the one under the model), a marker's id (3 or"
        ' 36h11:3), a distance such as 60cm, or key frames such as "object@0s, marker@2s,'
        ' 1.5m@3s" (interpolated evenly in dioptres)',
    )
    background_m: float = setting(
        0.0,
        "distance of whatever is behind the real plane, which ends there; 0 = endless",
        ge=0,
        le=1e6,
    )
    blades: Annotated[int, _valid(_polygon)] = setting(
        0, "blades of the aperture, 3 or more; 0 = round", ge=0, le=32
    )
    blade_turn_deg: float = setting(
        0.0,
        "direction of the aperture's first corner, clockwise from the picture's right",
        ge=-1e6,
        le=1e6,
    )
    highlight_boost: float = setting(
        0.0,
        "how much brighter than stored a clipped pixel is taken to be; 0 = as stored",
        ge=0,
        le=1e6,
    )

    @model_validator(mode="after")
    def _footage(self) -> DofParams:
        if self.lens == "footage" and self.scope == "all":
            raise ConfigError(
                "dof.lens = footage would blur the footage twice",
                "use it with dof.scope = virtual",
            )
        return self


def interpolate(keys: list[tuple[float, float]], time: float) -> float:
    """Value at `time`: linear between key frames, constant before the first and after the last."""
    times, values = np.array(keys).T
    return float(np.interp(time, times, values))


def interpolate_ratio(keys: list[tuple[float, float]], time: float) -> float:
    """The same, evenly in the logarithm: by the same factor in the same time. Values above 0."""
    return 2.0 ** interpolate([(t, math.log2(value)) for t, value in keys], time)
