"""Settings of the analysis, and of the light that it reads or is given: each field with its
unit and reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from arfx.errors import ConfigError, require_within

STATIC = ("auto", "camera", "marker")


@dataclass(frozen=True)
class AnalyseParams:
    """How a clip is analysed.

    max_gap_s : a marker missing for at most this long is bridged; for longer, the object is absent
    smoothing : factor on the time scale of smoothing: 0 = none, 1 = as the clip's own
    motion suggests, larger = smoother
    static : which of camera and marker stands still: auto (decided from the background),
    camera or marker
    detect_inverted : also detect white-on-black prints
    """

    max_gap_s: float = 0.5
    smoothing: float = 1.0
    static: str = "auto"
    detect_inverted: bool = True

    def __post_init__(self) -> None:
        if self.static not in STATIC:
            raise ConfigError(f"static is {self.static!r}", "one of " + ", ".join(STATIC))
        require_within(
            "analyse",
            self,
            max_gap_s=(0, 1e6),
            smoothing=(0, 1000),
        )


@dataclass(frozen=True)
class LightParams:
    """Where the light comes from.

    formula : corrected, or paper: Tan, Chen, Sun 2009 as printed
    given : a known light: azimuth from the anchor marker's x and elevation above its plane,
    degrees; optionally the linear RGB
        that it gives a surface facing it (default: as bright as the marker shows). If the
        camera rests and the marker moves, the angles hold in the first frame that shows the
        marker
    size_deg : angular diameter of the given light
    environment : HDR picture of the surroundings, equirectangular: its top is the anchor
    marker's z, its middle column is x
    ink : linear albedo of a print's dark cells;  paper : linear albedo of a print's bright cells
    most_lights : most directional lights that are looked for, 0 to 2; 1 if there is only
    one lamp. This and the next have no effect with formula = "paper"
    claims : likely (the simplest light that explains what was seen is used, its shadow as
    soft as it is uncertain) or measured
        (only a light that nothing else explains as well)"""

    CLAIMS: ClassVar[tuple[str, ...]] = ("likely", "measured")

    formula: str = field(default="corrected", init=False)
    given: tuple[float, ...] = ()
    size_deg: float = 5.0
    environment: Path | None = None
    ink: float = 0.05
    paper: float = 0.88
    most_lights: int = 2
    claims: str = "likely"

    def __post_init__(self) -> None:
        if self.claims not in self.CLAIMS:
            raise ConfigError(
                f"light.claims {self.claims!r} is unknown",
                f"one of {', '.join(self.CLAIMS)}",
            )
        if self.given and len(self.given) not in (2, 5):
            raise ConfigError(
                f"light.given has {len(self.given)} numbers",
                "azimuth, elevation in degrees; or these and R, G, B",
            )
        if self.given and not abs(self.given[0]) <= 1e6:
            raise ConfigError(f"a light's azimuth is in degrees, not {self.given[0]:g}")
        if self.given and not -90 <= self.given[1] <= 90:
            raise ConfigError(
                f"a light's elevation is between -90 and 90 degrees, not {self.given[1]:g}"
            )
        if not all(0 <= c <= 1e6 for c in self.given[2:]) or (
            len(self.given) == 5 and not any(self.given[2:])
        ):
            raise ConfigError(
                "a light's colour has a value above 0 and none below, at most a million",
                "for example 45,60,1,0.9,0.8",
            )
        if self.given and self.environment is not None:
            raise ConfigError(
                "a light and an environment are given", "one of --light and --environment"
            )
        if not 0 <= self.ink < self.paper <= 1:
            raise ConfigError(
                f"albedos: 0 <= light.ink < light.paper <= 1, not {self.ink:g} and"
                f" {self.paper:g}"
            )
        require_within(
            "light",
            self,
            most_lights=(0, 2),
            size_deg=(0, 90),
        )


def parse_light(text: str) -> list[float]:
    """AZ,EL or AZ,EL,R,G,B. Raises ConfigError."""
    try:
        values = [float(v) for v in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 5):
        raise ConfigError(
            f"--light {text!r} is not AZ,EL or AZ,EL,R,G,B",
            "degrees and linear colour: 45,60 or 45,60,1,0.9,0.8",
        )
    return values
