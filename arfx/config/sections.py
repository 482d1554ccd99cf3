"""The sections of a job file, as typed, frozen models: everything about a setting is stated
on its field. And a job as plain data, which the job folder keeps and chunk keys are made of.

Options of the commands, and which settings are paths, follow from `settings`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from arfx.core.marker import Marker, MarkerSpec, PatternSpec
from arfx.core.units import length_m, time_s
from arfx.errors import ConfigError, on_one_line


def _parsed_by(parse: Any) -> BeforeValidator:
    def read(value: Any) -> Any:
        try:
            return None if value is None else parse(f"{value}")
        except ConfigError as e:
            raise ValueError(on_one_line(str(e))) from None

    return BeforeValidator(read)


Length = Annotated[float, _parsed_by(length_m)]
Turn = Annotated[float, Field(ge=-1e6, le=1e6)]
Time = Annotated[float, _parsed_by(time_s)]


def _transfer(value: Any) -> str:
    from arfx.core.colour import Transfer

    return Transfer(str(value)).name


def _listed(value: Any) -> Any:
    """A list as it is written after an option."""
    return [part.strip() for part in value.split(",")] if isinstance(value, str) else value


def _names(value: Any) -> Any:
    names = _listed(value)
    if isinstance(value, str):
        names = [name for name in names if name]
    return "auto" if names == ["auto"] and isinstance(value, str) else names


def _three(value: Any) -> Any:
    parts = _listed(value)
    if isinstance(value, str) and len(parts) != 3:
        raise ValueError(f"{value!r} is not three values, X,Y,Z with commas")
    return parts


class Section(BaseModel):
    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        arbitrary_types_allowed=True,
        allow_inf_nan=False,
        defer_build=True,
    )


def _field(default: Any, text: str, option: str = "", help: str = "", **limits: Any) -> Any:
    """A setting and what it does.
    option : its option as in help, "-o --output PATH"; FILE is no folder, PATH may be one;
    CLIP alone is an argument.
    What a bool's option gives is not the default;  help : where the option says something
    else than `text`
    """
    return Field(
        default=default,
        description=text,
        json_schema_extra={"option": option, "help": help or text},
        **limits,
    )


class InputSection(Section):
    clip: Path | None = _field(None, "The video to process.", "CLIP")
    camera: Path | None = _field(
        None,
        "Calibration: OpenCV, ROS, COLMAP, Kalibr, WPILib. Without it the focal length is"
        " guessed.",
        "--camera FILE",
    )
    marker_map: Path | None = _field(  # TOML, or WPILib field JSON
        None,
        "Known layout of several markers; without it they are mapped from the clip.",
        "--marker-map FILE",
    )
    poses: Path | None = _field(  # or with the time before the pose
        None,
        "Camera poses for --anchor plane: a line tx ty tz qx qy qz qw for each frame.",
        "--poses FILE",
    )
    depth: Path | None = _field(
        None, "Real depth: maps (16-bit PNG, PGM, EXR, TIFF), video (FFV1).", "--depth PATH"
    )
    depth_scale: float | None = _field(
        None,
        "Depth steps to a metre; default 1000 (mm), EXR 1.",
        "--depth-scale N",
        ge=1e-6,
        le=1e9,
    )
    depth_start: Time | None = _field(
        None, "When the first map was taken, from the clip's first frame."
    )
    depth_align: Literal["marker", "none"] = _field(
        "marker",
        "marker: the maps' scale is what makes the markers' planes true; none: as stated.",
    )
    start: Time | None = _field(
        None,
        "First moment to process, from the clip's first frame: 1.5s, 0:10.",
        "--start T",
    )
    end: Time | None = _field(None, "Last moment to process.", "--end T")
    transfer: Annotated[str, BeforeValidator(_transfer)] = _field(
        "srgb",
        "How coded values become light: srgb, bt709, bt1886, hlg, pq, gamma:X; a clip's tag"
        " of HLG or PQ goes before it.",
    )


class MarkerSection(Section):
    spec: Annotated[MarkerSpec, _parsed_by(MarkerSpec.parse)] = _field(
        ...,
        "FAMILY:ID:SIZE, such as 36h11:3:165mm.",
        "--marker FAMILY:ID:SIZE",
        "Repeatable: 36h11:3:165mm.",
    )


class PatternSection(Section):
    spec: Annotated[PatternSpec, _parsed_by(PatternSpec.parse)] = _field(
        ...,
        "IMAGE:SIZE, a print whose picture is known, and its width, such as"
        " poster.png:20cm.",
        "--pattern IMAGE:SIZE",
        "A print without code as marker: its picture and width, poster.png:20cm."
        " Repeatable.",
    )


class ModelSection(Section):
    file: Path | None = _field(
        None,
        "glTF/GLB, OBJ, PLY, STL …; the middle of its base stands on the marker's centre.",
        "--model FILE",
    )
    anchor: Literal["marker", "plane"] = _field(
        "marker", "Stand on the marker, or on the depth's main plane.", "--anchor"
    )
    scale: float = _field(1.0, "Metres per file unit.", "--scale", ge=1e-12, le=1e12)
    fit: Length | None = _field(  # after scaling: it overrides scale
        None, "Scale the model's largest extent to this length: 15cm.", "--fit SIZE"
    )
    rotate: Annotated[tuple[Turn, Turn, Turn], BeforeValidator(_three)] = _field(
        (0.0, 0.0, 0.0), "Degrees about the marker's axes, in this order.", "--rotate X,Y,Z"
    )
    offset: Annotated[tuple[Length, Length, Length], BeforeValidator(_three)] = _field(
        (0.0, 0.0, 0.0),
        "Lengths along the marker's axes (x right, y up, z out): 0cm,2cm,0cm.",
        "--offset X,Y,Z",
    )
    up: Literal["x", "y", "z"] | None = _field(
        None, "Which axis of the file points up; default by file type.", "--up"
    )


class PipelineSection(Section):
    stages: Annotated[list[str] | Literal["auto"], BeforeValidator(_names)] = _field(
        "auto",
        "Effects to run, in order. Default auto: those that the job has a setting for."
        " Light and shadow always run.",
        "--pipeline A,B,C",
    )
    quality: Literal["draft", "standard", "high", "reference"] = _field(
        "standard", "Level of every effect.", "--quality"
    )
    budget: Time | None = _field(
        None,
        "Choose the best levels whose predicted time fits: 90s, 1:30.",
        "--budget TIME",
        gt=0,
    )
    fps: float | None = _field(
        None, "The same, as frames per second.", "--fps", gt=0, le=1e6
    )
    max_error: float | None = _field(
        None,
        "Choose the fastest levels within this error, mean grey levels of 255.",
        "--max-error E",
        ge=0,
        le=255,
    )
    tradeoff: Path | None = _field(
        None,
        "Errors of this clip's levels, by `arfx tradeoff`; default: a shipped table.",
        "--tradeoff FILE",
    )
    skip: bool = _field(
        True,
        "Leave out stages that would change nothing in a frame; false runs every stage.",
        "--no-skip",
        "Run every stage on every frame that has a pose.",
    )
    seed: int = _field(0, "Seed of all random numbers.", ge=0, lt=2**63)


class OutputSection(Section):
    path: Path | None = _field(
        None, "out.mp4 .mkv .mov .webm, or frames/%06d.png|exr.", "-o --output PATH"
    )
    codec: str | None = _field(
        None,
        "h264, h265, av1, prores, ffv1, png, exr; default by the output's name.",
        "--codec NAME",
    )
    crf: float | None = _field(
        None,
        "Constant rate factor of the codec: lower is better and larger.",
        "--crf",
        ge=-1e3,
        le=1e3,
    )
    preset: str | None = _field(None, "Encoder preset.")
    pixel_format: str | None = _field(
        None, "FFmpeg pixel format, such as yuv444p10le.", "--pixel-format NAME"
    )


class JobConfig(Section):
    """A whole job: what `arfx process` needs to know. `params` holds one frozen dataclass
    per stage and `analyse`; `sources` are the job files that it was read from."""

    input: InputSection = Field(default_factory=InputSection)
    marker: tuple[MarkerSection, ...] = ()
    pattern: tuple[PatternSection, ...] = ()
    model: ModelSection = Field(default_factory=ModelSection)
    pipeline: PipelineSection = Field(default_factory=PipelineSection)
    output: OutputSection = Field(default_factory=OutputSection)
    params: dict[str, Any] = Field(default_factory=dict)
    sources: tuple[Path, ...] = ()

    @property
    def markers(self) -> tuple[Marker, ...]:
        """All prints that tell a pose, coded ones first."""
        return (*(m.spec for m in self.marker), *self.patterns)

    @property
    def patterns(self) -> tuple[PatternSpec, ...]:
        return tuple(p.spec for p in self.pattern)


class Setting(NamedTuple):
    """A setting of a job file. kinds : its type and what that is made of;  repeated : its
    section is an array of tables;
    limits : of pydantic;  flags, metavar, help : of its option; no flags: it has none;
    messages name the first
    text : what it does"""

    section: str
    key: str
    kinds: tuple[Any, ...]
    repeated: bool
    default: Any
    limits: list[Any]
    flags: list[str]
    metavar: str | None
    help: str
    text: str

    @property
    def name(self) -> str:
        """Of its option in Python, marker_map of --marker-map."""
        return self.flags[-1].lower().lstrip("-").replace("-", "_")


@cache
def settings() -> tuple[Setting, ...]:
    """Every setting of a job file but those of the stages."""
    return tuple(_settings())


def _settings() -> Iterator[Setting]:
    for section, outer in JobConfig.model_fields.items():
        repeated = get_origin(outer.annotation) is tuple
        for key, field in getattr(
            kinds(outer.annotation)[int(repeated)], "model_fields", {}
        ).items():
            option = field.json_schema_extra["option"].split()
            flags = [word for word in option if word.startswith("-")] or option
            metavar = option[-1] if len(option) > len(flags) else None
            about = (
                field.default,
                field.metadata,
                flags,
                metavar,
                field.json_schema_extra["help"],
                field.description,
            )
            yield Setting(section, key, kinds(field.annotation), repeated, *about)


def kinds(annotation: Any) -> tuple[Any, ...]:
    """A type and what it is made of: of Path | None itself, Path and None."""
    return (annotation, *get_args(annotation))


def plain(value: Any) -> Any:
    """Nested dicts, lists, strings and numbers only; None left out; paths absolute."""
    if isinstance(value, PatternSpec):
        return str(dataclasses.replace(value, image=value.image.absolute()))
    if isinstance(value, MarkerSpec):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain(dataclasses.asdict(value))
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, Path):
        return str(value.absolute())
    return value


def frozen(config: JobConfig) -> dict[str, Any]:
    """The job as plain data that `load` reads back to the same job (paths absolute)."""
    tree = config.model_dump(include={"input", "model", "pipeline", "output"})
    tree |= {
        "marker": [{"spec": m.spec} for m in config.marker],
        "pattern": [{"spec": p.spec} for p in config.pattern],
    }
    if tree["model"]["fit"] is not None:
        tree["model"]["fit"] = f"{float(tree['model']['fit'])!r}m"
    tree["model"]["offset"] = [f"{float(v)!r}m" for v in tree["model"]["offset"]]
    return {**plain(tree), **plain(config.params)}
