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

    search_interval_s : while a marker is missing, the whole frame is searched at full
    resolution at least this often
    loss_search_frames : after a marker is lost, the whole frame is searched at full
    resolution for this many frames
    reduced_search_every : while some markers are tracked and others are missing, the
    reduced image is searched every n-th frame
    reduced_px : largest number of pixels of the reduced image; smaller frames are always
    searched whole
    min_side_px : smallest side of a marker that is looked for
    max_gap_s : a marker missing for at most this long is bridged; for longer, the object is absent
    fade_frames : frames over which the object fades in and out around an absence; 0 = at once
    smoothing : factor on the time scale of smoothing: 0 = none, 1 = as the clip's own
    motion suggests, larger = smoother
    static : which of camera and marker stands still: auto (decided from the background),
    camera or marker
    detect_inverted : also detect white-on-black prints
    transfer : how luma relates to light (srgb, gamma:2.2, ...), because blurred edges are
    located in linear light. auto takes
        sRGB unless the first edges are symmetric in coded values, as after sharpening in the camera
    """

    search_interval_s: float = 1.0
    loss_search_frames: int = 5
    reduced_search_every: int = 3
    reduced_px: int = 240_000
    min_side_px: float = 9.0
    max_gap_s: float = 0.5
    fade_frames: int = 5
    smoothing: float = 1.0
    static: str = "auto"
    detect_inverted: bool = True
    transfer: str = "auto"

    def __post_init__(self) -> None:
        if self.static not in STATIC:
            raise ConfigError(f"static is {self.static!r}", "one of " + ", ".join(STATIC))
        require_within(
            "analyse",
            self,
            search_interval_s=(1e-6, 1e6),
            loss_search_frames=(0, 1e6),
            reduced_search_every=(1, 1e6),
            reduced_px=(1000, 1e9),
            min_side_px=(1e-3, 8192),
            max_gap_s=(0, 1e6),
            fade_frames=(0, 1e6),
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
    albedos : known (ink and paper hold), normalised (light from each frame's own contrast)
    or unknown (ink is estimated);
        as printed: known, or brightness, the default there (each patch as bright as in the
        first picture of the print)
    most_lights : most directional lights that are looked for, 0 to 2; 1 if there is only
    one lamp. This and the next four
        settings have no effect with formula = "paper"
    claims : likely (the simplest light that explains what was seen is used, its shadow as
    soft as it is uncertain) or measured
        (only a light that nothing else explains as well)
    limit_deg : widest confidence cone with which a direction counts as measured
    drift_per_s : relative change of the light that is expected in one second
    window_s : longest interval over which changing light is treated as constant
    map_level : resolution of the light map, 2 to 5 (16, 8, 4, 2 degrees between directions)
    map_blur_rad : s of the light map's update (8)"""

    ALBEDOS: ClassVar[tuple[str, ...]] = ("known", "normalised", "unknown")
    CLAIMS: ClassVar[tuple[str, ...]] = ("likely", "measured")

    formula: str = field(default="corrected", init=False)
    given: tuple[float, ...] = ()
    size_deg: float = 5.0
    environment: Path | None = None
    ink: float = 0.05
    paper: float = 0.88
    albedos: str = "known"
    most_lights: int = 2
    claims: str = "likely"
    limit_deg: float = 15.0
    drift_per_s: float = 0.05
    window_s: float = 2.0
    map_level: int = 3
    map_blur_rad: float = 0.2

    def __post_init__(self) -> None:
        if self.albedos not in self.ALBEDOS:
            raise ConfigError(
                f"light.albedos {self.albedos!r} is unknown with formula ="
                f' "{self.formula}"',
                f"one of {', '.join(self.ALBEDOS)}",
            )
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
            map_level=(2, 5),
            size_deg=(0, 90),
            limit_deg=(1, 90),
            map_blur_rad=(0.01, 3),
            window_s=(0.1, 1e6),
            drift_per_s=(0, 100),
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
