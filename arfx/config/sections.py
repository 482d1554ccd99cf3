"""The sections of a job file, as typed, frozen models. One docstring line per key: it is also the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from arfx.core.colour import Transfer
from arfx.core.marker import MarkerSpec
from arfx.core.units import length_m, time_s
from arfx.errors import ConfigError


def _via(parse: Any, kind: type) -> BeforeValidator:
    def read(value: Any) -> Any:
        if value is None or isinstance(value, kind):
            return value
        try:
            return parse(value if isinstance(value, str) else f"{value}")
        except ConfigError as e:
            raise ValueError(str(e).replace("\nhelp: ", "; ")) from None

    return BeforeValidator(read)


class _LengthValue(float):
    """A length that was read with its unit, so that a second validation keeps it."""


def _length(text: str) -> _LengthValue:
    return _LengthValue(length_m(text))


class _TimeValue(float):
    """A time that was read already."""


Length = Annotated[float, _via(_length, _LengthValue)]
Turn = Annotated[float, Field(ge=-1e6, le=1e6)]
Time = Annotated[float, _via(lambda t: _TimeValue(time_s(t)), _TimeValue)]


def _marker(value: Any) -> Any:
    return value if isinstance(value, MarkerSpec) else _parse_marker(value)


def _parse_marker(value: Any) -> MarkerSpec:
    try:
        return MarkerSpec.parse(str(value))
    except ConfigError as e:
        raise ValueError(str(e).replace("\nhelp: ", "; ")) from None


class Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False)


class InputSection(Section):
    clip: Path | None = Field(default=None, description="the video to process")
    camera: Path | None = Field(default=None, description="calibration file; missing: a stated guess, with a warning")
    marker_map: Path | None = Field(default=None, description="known layout of several markers (TOML, or WPILib field JSON)")
    poses: Path | None = Field(
        default=None, description="camera poses, a line tx ty tz qx qy qz qw for each frame, or with times"
    )
    depth: Path | None = Field(
        default=None, description="real depth: a folder of maps (16-bit PNG or PGM, TIFF, EXR), one map, or a file of many"
    )
    depth_scale: float | None = Field(
        default=None, ge=1e-6, le=1e9, description="stored values to a metre; default 1000, of EXR 1"
    )
    depth_start: Time | None = Field(default=None, description="when the first map was taken, from the clip's first frame")
    depth_align: Literal["marker", "none"] = Field(
        default="marker", description="marker: the maps' scale is what makes the markers' planes true; none: as stated"
    )
    start: Time | None = Field(default=None, description="first moment to process, from the clip's first frame")
    end: Time | None = Field(default=None, description="last moment to process, from the clip's first frame")
    transfer: Annotated[str, BeforeValidator(lambda v: Transfer(str(v)).name)] = Field(
        default="srgb", description="how coded values become light: srgb, bt709, bt1886, gamma:X"
    )


class MarkerSection(Section):
    spec: Annotated[MarkerSpec, BeforeValidator(_marker)] = Field(description="FAMILY:ID:SIZE, such as 36h11:3:165mm")


class ModelSection(Section):
    file: Path | None = Field(default=None, description="glTF/GLB, OBJ, PLY, STL or another format that trimesh reads")
    anchor: Literal["marker", "plane"] = Field(
        default="marker", description="what the model stands on: a marker, or the dominant level plane of the depth input"
    )
    scale: float = Field(default=1.0, ge=1e-12, le=1e12, description="metres per file unit")
    fit: Length | None = Field(default=None, description="largest extent after scaling; overrides scale")
    rotate: tuple[Turn, Turn, Turn] = Field(default=(0.0, 0.0, 0.0), description="degrees about marker x, y, z, in this order")
    offset: tuple[Length, Length, Length] = Field(default=(0.0, 0.0, 0.0), description="lengths along marker x, y, z")
    up: Literal["x", "y", "z"] | None = Field(default=None, description="file axis that points up; default by file type")


class PipelineSection(Section):
    stages: list[str] | Literal["auto"] = Field(default="auto", description="effects allowed, in order; auto = those that exist")
    quality: Literal["draft", "standard", "high", "reference"] = Field(default="standard", description="level of every effect")
    budget: Time | None = Field(default=None, gt=0, description="seconds for the whole job: levels are the best that keep it")
    fps: float | None = Field(default=None, gt=0, le=1e6, description="the same as a rate: frames of the clip per second of work")
    max_error: float | None = Field(default=None, ge=0, le=255, description="levels are the cheapest within it, mean grey levels")
    tradeoff: Path | None = Field(default=None, description="tradeoff.json of this clip, for its errors; default shipped ones")
    skip: bool = Field(default=True, description="leave out what a frame does not call for; false forces every stage")
    seed: int = Field(default=0, ge=0, lt=2**63, description="seed of all random numbers")


class OutputSection(Section):
    path: Path | None = Field(default=None, description="output file, or frames/%06d.png")
    codec: str | None = Field(default=None, description="h264, h265, av1, prores, ffv1, png, exr; default by file name")
    crf: float | None = Field(default=None, ge=-1e3, le=1e3, description="constant rate factor of the codec")
    preset: str | None = Field(default=None, description="encoder preset")
    pixel_format: str | None = Field(default=None, description="FFmpeg pixel format, such as yuv444p10le")


class JobConfig(Section):
    """A whole job: what `arfx process` needs to know. `params` holds one frozen dataclass per stage and `analyse`;
    `sources` are the job files that it was read from."""

    input: InputSection = InputSection()
    marker: tuple[MarkerSection, ...] = ()
    model: ModelSection = ModelSection()
    pipeline: PipelineSection = PipelineSection()
    output: OutputSection = OutputSection()
    params: dict[str, Any] = Field(default_factory=dict)
    sources: tuple[Path, ...] = ()

    @property
    def markers(self) -> tuple[MarkerSpec, ...]:
        return tuple(m.spec for m in self.marker)
