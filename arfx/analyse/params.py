"""Settings of the analysis, and of the light that it reads or is given: each field with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from arfx.errors import ConfigError, require_within

STATIC = ("auto", "camera", "marker")
ALBEDOS = ("known", "normalised", "unknown")


@dataclass(frozen=True)
class AnalyseParams:
    """How a clip is analysed.

    search_interval_s : a whole-frame, full-resolution search at least this often while a configured marker is missing
    loss_search_frames : frames after a loss that are searched whole, at full resolution
    reduced_search_every : while some markers are tracked and others missing, search the reduced image every n-th frame
    reduced_px : the reduced image has at most this many pixels; clips that small are always searched whole
    min_side_px : smallest marker side that is looked for
    max_gap_s : missing stretches up to this long are bridged, longer ones make the object absent
    fade_frames : frames over which opacity ramps at the ends of an absence; 0 = hard
    smoothing : factor on the motion's time scale; 1 = as the clip itself suggests, 0 = none, larger = smoother
    static : "auto" decides from the background which of camera and marker stands still; or "camera", "marker"
    detect_inverted : also find white-on-black prints
    transfer : how luma relates to light ("srgb", "gamma:2.2", ...): blurred edges are located in linear light. "auto"
        takes sRGB unless the first sightings show edges symmetric in coded values (sharpened in the camera)
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
            "analyse", self, search_interval_s=(1e-6, 1e6), loss_search_frames=(0, 1e6), reduced_search_every=(1, 1e6),
            reduced_px=(1000, 1e9), min_side_px=(1e-3, 8192), max_gap_s=(0, 1e6), fade_frames=(0, 1e6), smoothing=(0, 1000),
        )  # fmt: skip


@dataclass(frozen=True)
class LightParams:
    """Where the light comes from.

    formula : corrected, or paper: Tan, Chen, Sun 2009 as printed
    given : a light that is known: azimuth from the anchor marker's x and elevation above its plane, degrees, and perhaps
        its linear RGB on a surface that faces it; without it as bright as the marker shows. A camera at rest sees the
        marker move below it: then the angles hold in the first frame that shows the marker
    size_deg : full angle of the given light's disc
    environment : HDR picture of the surroundings, equirectangular, its top the anchor marker's z, its middle column x
    ink, paper : linear albedo of the print's dark and bright cells
    albedos : known (ink and paper hold), normalised (light from each frame's own contrast), unknown (ink is solved for)
    most_lights : directional lights that are looked for, 0 to 2; 1 where it is known that there is one lamp only
    limit_deg : widest confidence cone of a direction that counts as measured
    drift_per_s : relative change of the light that is expected over one second
    window_s : longest stretch over which a light that changes is taken for one
    map_level : light map's icosphere, 2 to 5 (16, 8, 4, 2 degrees between directions)
    map_blur_rad : s of the light map's update (8)
    """

    formula: str = field(default="corrected", init=False)
    given: tuple[float, ...] = ()
    size_deg: float = 5.0
    environment: Path | None = None
    ink: float = 0.05
    paper: float = 0.88
    albedos: str = "known"
    most_lights: int = 2
    limit_deg: float = 15.0
    drift_per_s: float = 0.05
    window_s: float = 2.0
    map_level: int = 3
    map_blur_rad: float = 0.2

    def __post_init__(self) -> None:
        if self.albedos not in ALBEDOS:
            raise ConfigError(f"light.albedos {self.albedos!r} is unknown", f"one of {', '.join(ALBEDOS)}")
        if self.given and len(self.given) not in (2, 5):
            raise ConfigError(f"light.given has {len(self.given)} numbers", "azimuth, elevation in degrees; or these and R, G, B")
        if self.given and not abs(self.given[0]) <= 1e6:
            raise ConfigError(f"a light's azimuth is in degrees, not {self.given[0]:g}")
        if self.given and not -90 <= self.given[1] <= 90:
            raise ConfigError(f"a light's elevation is between -90 and 90 degrees, not {self.given[1]:g}")
        if not all(0 <= c <= 1e6 for c in self.given[2:]) or (len(self.given) == 5 and not any(self.given[2:])):
            raise ConfigError(
                "a light's colour has a value above 0 and none below, at most a million", "for example 45,60,1,0.9,0.8"
            )
        if self.given and self.environment is not None:
            raise ConfigError("a light and an environment are given", "one of --light and --environment")
        if not 0 <= self.ink < self.paper <= 1:
            raise ConfigError(f"albedos: 0 <= light.ink < light.paper <= 1, not {self.ink:g} and {self.paper:g}")
        require_within(
            "light", self, most_lights=(0, 2), map_level=(2, 5), size_deg=(0, 90), limit_deg=(1, 90), map_blur_rad=(0.01, 3),
            window_s=(0.1, 1e6), drift_per_s=(0, 100),
        )  # fmt: skip


def parse_light(text: str) -> list[float]:
    """AZ,EL or AZ,EL,R,G,B. Raises ConfigError."""
    try:
        values = [float(v) for v in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 5):
        raise ConfigError(f"--light {text!r} is not AZ,EL or AZ,EL,R,G,B", "degrees and linear colour: 45,60 or 45,60,1,0.9,0.8")
    return values
