"""Settings of the analysis: one frozen dataclass, each field with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass

from arfx.errors import ConfigError

STATIC = ("auto", "camera", "marker")


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
    refine : False keeps the detector's pixel-accurate corners (for comparisons)
    survey : look for other families while no configured marker was ever seen, for the error message
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
    refine: bool = True
    survey: bool = True

    def __post_init__(self) -> None:
        if self.static not in STATIC:
            raise ConfigError(f"static is {self.static!r}", "one of " + ", ".join(STATIC))
        for name, low, high in (
            ("search_interval_s", 1e-6, 1e6), ("loss_search_frames", 0, 1e6), ("reduced_search_every", 1, 1e6),
            ("reduced_px", 1000, 1e9), ("min_side_px", 1e-3, 8192), ("max_gap_s", 0, 1e6), ("fade_frames", 0, 1e6),
            ("smoothing", 0, 1000),
        ):  # fmt: skip
            if not low <= getattr(self, name) <= high:
                raise ConfigError(f"analyse.{name} must be between {low:g} and {high:g}, is {getattr(self, name):g}")
