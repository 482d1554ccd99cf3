"""The sections of a job file, as typed, frozen models: everything about a setting is stated
on its field. And a job as plain data, which the job folder keeps and chunk keys are made of.

Options of the commands, and which settings are paths, follow from `settings`."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BeforeValidator, Field, PlainSerializer

from arfx.core.marker import Marker, MarkerSpec, PatternSpec
from arfx.core.settings import Settings, listed, setting
from arfx.core.units import length_m, time_s


def _parsed_by(parse: Callable[[str], Any]) -> BeforeValidator:
    return BeforeValidator(lambda value: parse(f"{value}"))


Length = Annotated[float, _parsed_by(length_m), PlainSerializer(lambda m: f"{m!r}m")]
Turn = Annotated[float, Field(ge=-1e6, le=1e6)]
Time = Annotated[float, _parsed_by(time_s)]


def _transfer(value: Any) -> str:
    from arfx.core.colour import Transfer

    return Transfer(str(value)).name


def _names(value: Any) -> Any:
    if not isinstance(value, str) or value == "auto":
        return value
    return [name for name in listed(value) if name]


def _three(value: Any) -> Any:
    parts = listed(value)
    if isinstance(value, str) and len(parts) != 3:
        raise ValueError(f"{value!r} is not three values, X,Y,Z with commas")
    return parts


class InputSection(Settings):
    clip: Path | None = setting(None, "The video to process.", "CLIP")
    camera: Path | None = setting(
        None,
        "Calibration: OpenCV, ROS, COLMAP, Kalibr, WPILib. Without it the focal length is"
        " guessed.",
        "--camera FILE",
    )
    marker_map: Path | None = setting(  # TOML, or WPILib field JSON
        None,
        "Known layout of several markers; without it they are mapped from the clip.",
        "--marker-map FILE",
    )
    poses: Path | None = setting(  # or with the time before the pose
        None,
        "Camera poses for --anchor plane: a line tx ty tz qx qy qz qw for each frame.",
        "--poses FILE",
    )
    depth: Path | None = setting(
        None,
        "Real depth: maps (16-bit PNG, PGM, EXR, TIFF), video (FFV1).",
        "--depth PATH",
    )
    depth_scale: float | None = setting(
        None,
        "Depth steps to a metre; default 1000 (mm), EXR 1.",
        "--depth-scale N",
        ge=1e-6,
        le=1e9,
    )
    depth_start: Time | None = setting(
        None, "When the first map was taken, from the clip's first frame."
    )
    depth_align: Literal["marker", "none"] = setting(
        "marker",
        "marker: the maps' scale is what makes the markers' planes true; none: as stated.",
    )
    start: Time | None = setting(
        None,
        "First moment to process, from the clip's first frame: 1.5s, 0:10.",
        "--start T",
    )
    end: Time | None = setting(None, "Last moment to process.", "--end T")
    transfer: Annotated[str, BeforeValidator(_transfer)] = setting(
        "srgb",
        "How coded values become light: srgb, bt709, bt1886, hlg, pq, gamma:X; a clip's tag"
        " of HLG or PQ goes before it.",
    )


class MarkerSection(Settings):
    spec: Annotated[
        MarkerSpec, _parsed_by(MarkerSpec.parse), PlainSerializer(str)
    ] = setting(
        ...,
        "FAMILY:ID:SIZE, such as 36h11:3:165mm.",
        "--marker FAMILY:ID:SIZE",
        "Repeatable: 36h11:3:165mm.",
    )


def _absolute(spec: PatternSpec) -> str:
    return str(dataclasses.replace(spec, image=spec.image.absolute()))


class PatternSection(Settings):
    spec: Annotated[
        PatternSpec, _parsed_by(PatternSpec.parse), PlainSerializer(_absolute)
    ] = setting(
        ...,
        "IMAGE:SIZE, a print whose picture is known, and its width, such as"
        " poster.png:20cm.",
        "--pattern IMAGE:SIZE",
        "A print without code as marker: its picture and width, poster.png:20cm."
        " Repeatable.",
    )


class ModelSection(Settings):
    file: Path | None = setting(
        None,
        "glTF/GLB, OBJ, PLY, STL …; the middle of its base stands on the marker's centre.",
        "--model FILE",
    )
    anchor: Literal["marker", "plane"] = setting(
        "marker", "Stand on the marker, or on the depth's main plane.", "--anchor"
    )
    scale: float = setting(1.0, "Metres per file unit.", "--scale", ge=1e-12, le=1e12)
    fit: Length | None = setting(  # after scaling: it overrides scale
        None,
        "Scale the model's largest extent to this length: 15cm.",
        "--fit SIZE",
        gt=0,
    )
    rotate: Annotated[tuple[Turn, Turn, Turn], BeforeValidator(_three)] = setting(
        (0.0, 0.0, 0.0),
        "Degrees about the marker's axes, in this order.",
        "--rotate X,Y,Z",
    )
    offset: Annotated[tuple[Length, Length, Length], BeforeValidator(_three)] = (
        setting(
            (0.0, 0.0, 0.0),
            "Lengths along the marker's axes (x right, y up, z out): 0cm,2cm,0cm.",
            "--offset X,Y,Z",
        )
    )
    up: Literal["x", "y", "z"] | None = setting(
        None, "Which axis of the file points up; default by file type.", "--up"
    )


class PipelineSection(Settings):
    stages: Annotated[list[str] | Literal["auto"], BeforeValidator(_names)] = setting(
        "auto",
        "Effects to run, in order. Default auto: those that the job has a setting for."
        " Light and shadow always run.",
        "--pipeline A,B,C",
    )
    quality: Literal["draft", "standard", "high", "reference"] = setting(
        "standard", "Level of every effect.", "--quality"
    )
    budget: Time | None = setting(
        None,
        "Choose the best levels whose predicted time fits: 90s, 1:30.",
        "--budget TIME",
        gt=0,
    )
    fps: float | None = setting(
        None, "The same, as frames per second.", "--fps", gt=0, le=1e6
    )
    max_error: float | None = setting(
        None,
        "Choose the fastest levels within this error, mean grey levels of 255.",
        "--max-error E",
        ge=0,
        le=255,
    )
    tradeoff: Path | None = setting(
        None,
        "Errors of this clip's levels, by `arfx tradeoff`; default: a shipped table.",
        "--tradeoff FILE",
    )
    skip: bool = setting(
        True,
        "Leave out stages that would change nothing in a frame; false runs every stage.",
        "--no-skip",
        "Run every stage on every frame that has a pose.",
    )
    seed: int = setting(0, "Seed of all random numbers.", ge=0, lt=2**63)


class OutputSection(Settings):
    path: Path | None = setting(
        None, "out.mp4 .mkv .mov .webm, or frames/%06d.png|exr.", "-o --output PATH"
    )
    codec: str | None = setting(
        None,
        "h264, h265, av1, prores, ffv1, png, exr; default by the output's name.",
        "--codec NAME",
    )
    crf: float | None = setting(
        None,
        "Constant rate factor of the codec: lower is better and larger.",
        "--crf",
        ge=-1e3,
        le=1e3,
    )
    preset: str | None = setting(None, "Encoder preset.")
    pixel_format: str | None = setting(
        None, "FFmpeg pixel format, such as yuv444p10le.", "--pixel-format NAME"
    )


class JobConfig(Settings):
    """A whole job: what `arfx process` needs to know. `load` adds a section for each stage, the
    analysis and the light."""

    input: InputSection = Field(default_factory=InputSection)
    marker: tuple[MarkerSection, ...] = ()
    pattern: tuple[PatternSection, ...] = ()
    model: ModelSection = Field(default_factory=ModelSection)
    pipeline: PipelineSection = Field(default_factory=PipelineSection)
    output: OutputSection = Field(default_factory=OutputSection)
    _sources: tuple[Path, ...] = ()

    @property
    def params(self) -> dict[str, Any]:
        """The sections that `load` added."""
        return {
            name: value for name, value in self if name not in JobConfig.model_fields
        }

    @property
    def sources(self) -> tuple[Path, ...]:
        """The job files that it was read from."""
        return self._sources

    @property
    def markers(self) -> tuple[Marker, ...]:
        """All prints that tell a pose, coded ones first."""
        return (*(m.spec for m in self.marker), *self.patterns)

    @property
    def patterns(self) -> tuple[PatternSpec, ...]:
        return tuple(p.spec for p in self.pattern)


class Setting(NamedTuple):
    """A setting of a job file that has an option. kinds : its type and what that is made of;
    repeated : its section is an array of tables;  flags, metavar, help : of the option;
    messages name the first flag"""

    section: str
    key: str
    kinds: tuple[Any, ...]
    repeated: bool
    default: Any
    flags: list[str]
    metavar: str | None
    help: str

    @property
    def name(self) -> str:
        """Of its option in Python, marker_map of --marker-map."""
        return self.flags[-1].lower().lstrip("-").replace("-", "_")


@cache
def settings() -> tuple[Setting, ...]:
    """Every setting of a job file that has an option, but for those of the stages."""
    return tuple(
        Setting(
            section,
            key,
            kinds(field.annotation),
            get_origin(JobConfig.model_fields[section].annotation) is tuple,
            field.default,
            *option,
        )
        for section, model in section_models().items()
        for key, field in model.model_fields.items()
        if (option := option_of(field))[0]
    )


def option_of(field: Any) -> tuple[list[str], str | None, str]:
    """Flags of a field's option, its metavar and help; no flags: it has none."""
    words: Any = {"option": "", "help": "", **(field.json_schema_extra or {})}
    option = words["option"].split()
    flags = [word for word in option if word.startswith("-")] or option
    return flags, option[-1] if len(option) > len(flags) else None, words["help"]


def section_models() -> dict[str, type[Settings]]:
    """Every section of a job file but those that `load` adds."""
    return {
        name: next(k for k in kinds(field.annotation) if isinstance(k, type))
        for name, field in JobConfig.model_fields.items()
    }


def kinds(annotation: Any) -> tuple[Any, ...]:
    """A type and what it is made of: of Path | None itself, Path and None."""
    return (annotation, *get_args(annotation))


def frozen(config: JobConfig) -> dict[str, Any]:
    """The job as plain data that `load` reads back to the same job (paths absolute)."""
    tree: dict[str, Any] = _plain(config.model_dump())
    return tree


def _plain(value: Any) -> Any:
    """Nested dicts, lists, strings and numbers only; None left out; paths absolute."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return str(value.absolute()) if isinstance(value, Path) else value
