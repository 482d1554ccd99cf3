"""Settings of the analysis, and of the light that it reads or is given: each field with its
unit and reason.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, field_validator, model_validator

from arfx.core.settings import Fraction, Settings, listed, setting
from arfx.errors import ConfigError


class AnalyseParams(Settings):
    """How a clip is analysed."""

    max_gap_s: float = setting(
        0.5,
        "a marker missing for at most this long is bridged; for longer, the object is absent",
        ge=0,
        le=1e6,
    )
    smoothing: float = setting(
        1.0,
        "factor on the time scale of smoothing: 0 = none, 1 = as the clip's own motion"
        " suggests, larger = smoother",
        ge=0,
        le=1000,
    )
    static: Literal["auto", "camera", "marker"] = setting(
        "auto",
        "which of camera and marker stands still: auto (decided from the background), camera"
        " or marker",
    )
    detect_inverted: bool = setting(True, "also detect white-on-black prints")


class LightParams(Settings):
    """Where the light comes from."""

    formula: str = setting(
        "corrected", "corrected, or paper: Tan, Chen, Sun 2009 as printed"
    )
    given: Annotated[tuple[float, ...], BeforeValidator(listed)] = setting(
        (),
        "a known light: azimuth from the anchor marker's x and elevation above its plane,"
        " degrees; optionally the linear RGB that it gives a surface facing it (default: as"
        " bright as the marker shows). If the camera rests and the marker moves, the angles"
        " hold in the first frame that shows the marker",
    )
    size_deg: float = setting(5.0, "angular diameter of the given light", ge=0, le=90)
    environment: Path | None = setting(
        None,
        "HDR picture of the surroundings, equirectangular: its top is the anchor marker's z,"
        " its middle column is x",
    )
    ink: Fraction = setting(0.05, "linear albedo of a print's dark cells")
    paper: Fraction = setting(0.88, "linear albedo of a print's bright cells")
    most_lights: int = setting(
        2,
        "most directional lights that are looked for, 0 to 2; 1 if there is only one lamp."
        ' This and the next have no effect with formula = "paper"',
        ge=0,
        le=2,
    )
    claims: Literal["likely", "measured"] = setting(
        "likely",
        "likely (the simplest light that explains what was seen is used, its shadow as soft"
        " as it is uncertain) or measured (only a light that nothing else explains as well)",
    )

    @field_validator("given")
    @classmethod
    def _light(cls, given: tuple[float, ...]) -> tuple[float, ...]:
        direction, colour = given[:2], given[2:]
        if len(given) not in (0, 2, 5):
            raise ConfigError(
                f"a light of {len(given)} numbers",
                "AZ,EL or AZ,EL,R,G,B: degrees and linear colour: 45,60 or 45,60,1,0.9,0.8",
            )
        for angle, most in zip(direction, (1e6, 90), strict=False):
            if abs(angle) > most:
                raise ConfigError(
                    f"a light's azimuth and elevation are in degrees, not {angle:g}",
                    "an elevation between -90 and 90",
                )
        if colour and not (min(colour) >= 0 < max(colour) <= 1e6):
            raise ConfigError(
                "a light's colour has a value above 0 and none below, at most a million",
                "for example 45,60,1,0.9,0.8",
            )
        return given

    @model_validator(mode="after")
    def _fit(self) -> LightParams:
        if self.given and self.environment is not None:
            raise ConfigError(
                "a light and an environment are given",
                "one of --light and --environment",
            )
        if self.ink >= self.paper:
            raise ConfigError(
                f"light.ink must be below light.paper, not {self.ink:g} and {self.paper:g}"
            )
        return self
