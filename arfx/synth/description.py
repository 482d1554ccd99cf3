"""What a scene file may say: typed, frozen, every key documented. `arfx synth` reads it from TOML.

Room axes: metres, z up. A marker or object without a pose stands at the room's origin,
facing up. Angles in degrees; lengths carry a unit when written as text ("120mm") and are
metres when written as a number."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    model_validator,
)

from arfx.core.colour import Transfer
from arfx.core.marker import MarkerSpec
from arfx.core.opener import parse_toml, read_text
from arfx.core.settings import Settings
from arfx.core.toml_text import line_of
from arfx.core.units import length_m
from arfx.errors import ConfigError, on_one_line


def _read(parse: Callable[[str], Any]) -> BeforeValidator:
    """Texts through `parse`, which raises ConfigError; other values as they are."""
    return BeforeValidator(lambda v: parse(v) if isinstance(v, str) else v)


# a desk with an AprilTag and a cube of markers, filmed hand-held on an orbit
DEMO_SCENE = Path(__file__).with_name("demo.toml")

ORIGIN = (0.0, 0.0, 0.0)
Length = Annotated[float, _read(length_m)]
NonNegativeLength = Annotated[Length, Field(ge=0)]
PositiveLength = Annotated[Length, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Side = Annotated[int, Field(ge=16, le=8192)]
Share = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[Length, Length, Length]
Angles = tuple[float, float, float]
Colour = tuple[float, float, float]
Pair = tuple[float, float]
TransferName = Annotated[str, _read(lambda text: Transfer(text).name)]


class Clip(Settings):
    # .mp4 = H.264, .mkv = lossless FFV1
    file: str = Field(default="clip.mp4", pattern=r"^[\w.-]+\.(mp4|mkv)$")
    width: Side = 640
    height: Side = 360
    fps: float = Field(default=24.0, gt=0, le=1000)
    # H.264 quality
    crf: float = Field(default=12.0, ge=0, le=51)
    # variable: ±35 % of a frame, from the seed
    frame_times: Literal["constant", "variable"] = "constant"
    # presentation time of the first frame
    start_s: NonNegative = 0.0
    # stored turned, with a display rotation that undoes it
    rotation_deg: Literal[0, 90, 180, 270] = 0
    # adds an audio stream with this tone
    tone_hz: Positive | None = None


class Key(Settings):
    """One key frame of a motion; between keys position and rotation follow a smooth
    (Catmull-Rom) curve."""

    time_s: float
    position_m: Vector = ORIGIN
    rotate_deg: Angles = ORIGIN
    target_m: Vector = ORIGIN


def _rising(keys: tuple[Key, ...]) -> tuple[Key, ...]:
    for before, after in itertools.pairwise(keys):
        if not before.time_s < after.time_s:
            raise ValueError(
                f"the times of keys must increase: {after.time_s:g} s stands behind"
                f" {before.time_s:g} s"
            )
    return keys


Keys = Annotated[tuple[Key, ...], AfterValidator(_rising)]


class Motion(Settings):
    """How an object moves; added to its pose.

    sway acts in the object's own axes, keys replace the pose."""

    kind: Literal["still", "sway", "keys"] = "still"
    # sway: largest tilt about x and y, in two incommensurate periods
    tilt_deg: float = 0.0
    # sway: largest displacement
    travel_m: Length = 0.0
    period_s: Positive = 2.0
    # rms of a hand's tremor, smooth noise
    tremor_deg: NonNegative = 0.0
    tremor_m: NonNegativeLength = 0.0
    keys: Keys = ()


class CameraPath(Settings):
    """How the camera moves in one shot.

    It looks at `target_m` with the room's z up, unless keys turn it."""

    kind: Literal["static", "orbit", "dolly", "keys"] = "static"
    target_m: Vector = ORIGIN
    # static, and where a dolly starts
    position_m: Vector = (0.0, -0.4, 0.4)
    # where a dolly ends
    end_m: Vector = (0.0, -0.4, 0.4)
    radius_m: PositiveLength = 0.5
    azimuth_deg: Pair = (-120.0, -60.0)
    elevation_deg: Pair = (45.0, 45.0)
    # rms of hand-held shake, smooth noise about 4 Hz
    hand_deg: NonNegative = 0.0
    hand_m: NonNegativeLength = 0.0
    # position_m and target_m are used
    keys: Keys = ()


class Shot(Settings):
    """A cut-free stretch. Its path's time runs from 0 at its first frame."""

    frames: int = Field(default=48, ge=1, le=100_000)
    path: CameraPath = CameraPath()


class Lens(Settings):
    # horizontal field of view of the undistorted picture
    fov_deg: float = Field(default=60.0, gt=5, lt=160)
    centre_offset_px: Pair = (0.0, 0.0)
    model: Literal["brown", "fisheye"] = "brown"
    distortion: tuple[float, ...] = ()
    # diameter of the lens's opening; 0 = pinhole
    aperture_m: NonNegativeLength = 0.0
    # distance of sharp focus along the axis; needed with an aperture
    focus_m: PositiveLength | None = None
    # sigma of the lens's own blur; good lenses have 0.4 to 0.6
    softness_px: float = Field(default=0.0, ge=0, le=5)
    # time the shutter is open, centred on the frame's time
    shutter_s: NonNegative = 0.0


class Texture(Settings):
    kind: Literal["plain", "wood", "carpet", "noise", "checker", "poster"] = "plain"
    # linear albedo 0..1, or the darker of two
    colour: Colour = (0.5, 0.5, 0.5)
    second: Colour = (0.7, 0.7, 0.7)
    # size of the pattern's features
    feature_m: PositiveLength = 0.02


class SceneObject(Settings):
    name: str = ""
    position_m: Vector = ORIGIN
    # about x, then y, then z (fixed axes)
    rotate_deg: Angles = ORIGIN
    motion: Motion = Motion()
    # marker spec key or name whose axes and motion it follows
    attached_to: str = ""

    @property
    def key(self) -> str:
        """Of its marker; empty for what is none."""
        return ""

    @property
    def label(self) -> str:
        """Its name, or else its marker."""
        return self.name or self.key


class Plane(SceneObject):
    size_m: tuple[Length, Length] = (2.0, 2.0)
    texture: Texture = Texture()


class Box(SceneObject):
    """A box; its pose is the middle of its base."""

    size_m: Vector = (0.1, 0.1, 0.1)
    texture: Texture = Texture()


class Sphere(SceneObject):
    """A sphere; its pose is its centre."""

    radius_m: PositiveLength = 0.05
    colour: Colour = (0.5, 0.5, 0.5)


class Marker(SceneObject):
    """A printed marker on a sheet of paper: exact cells, one ink, one paper."""

    spec: Annotated[MarkerSpec, _read(MarkerSpec.parse)]
    # white border of the sheet, in cells
    margin_cells: NonNegative = 1.5
    # linear albedo
    ink: Share = 0.05
    paper: Share = 0.88
    inverted: bool = False
    # listed in job.toml; false: a distractor
    configured: bool = True

    @property
    def key(self) -> str:
        return self.spec.key


class Lamp(Settings):
    """Directional light. rgb: radiance of a white diffuse surface that faces it."""

    # from the room's x towards y
    azimuth_deg: float = 40.0
    elevation_deg: float = Field(default=55.0, ge=-90, le=90)
    rgb: Colour = (0.5, 0.5, 0.5)
    angular_size_deg: float = Field(default=2.0, ge=0, le=90)
    # amplitude of a sine in azimuth and in elevation
    swing_deg: Pair = (0.0, 0.0)
    # of the swing
    period_s: Positive = 2.0
    # (time_s, factor), linear between; the same time twice is a switch; beyond the ends
    # held
    brightness: tuple[Pair, ...] = ()


class Light(Settings):
    # radiance of a white surface without the lamps
    ambient_rgb: Colour = (0.3, 0.3, 0.3)
    lamps: tuple[Lamp, ...] = (Lamp(),)


class Exposure(Settings):
    """Sensor value = gain × radiance + bias, linear light, then clipped to 0..1."""

    gain: Positive = 1.0
    bias: float = Field(default=0.0, ge=-0.5, le=0.5)
    # amplitude of an automatic exposure's wandering
    drift_stops: float = 0.0
    drift_period_s: Positive = 2.0


class Noise(Settings):
    """Variance = read² + shot × signal, linear light."""

    read: NonNegative = 0.002
    shot: NonNegative = 0.00005


class Hidden(Settings):
    """What the job does not know: each entry breaks an assumption of the models that are tested."""

    # curve that the camera really applies
    transfer: TransferName = "srgb"
    noise_correlation_px: float = Field(default=0.0, ge=0, le=8)
    # time from the first row's to the last row's exposure
    rolling_shutter_s: NonNegative = 0.0
    # strength of a highlight on the prints
    gloss: Share = 0.0
    # ink albedo at the sheet's right edge; grows from the left
    worn_ink: Share | None = None


class DepthInput(Settings):
    """What the job is given of the scene's depth (`[input] depth`), as a depth camera
    measures it."""

    # FFV1 gray16; empty: none
    file: str = Field(default="", pattern=r"^([\w.-]+\.mkv)?$")
    # standard deviation, share of the distance
    noise: float = Field(default=0.0, ge=0, le=0.2)
    # share of pixels that are not measured, in blots
    holes: float = Field(default=0.0, ge=0, le=0.9)
    # beside edges of things nothing is measured within that many pixels
    edge_px: int = Field(default=0, ge=0, le=16)


class ModelPart(Settings):
    # block: of 12 faces;  robot: a toy with a flag, 8,580 faces
    shape: Literal["block", "robot"] = "robot"
    fit: str = "12cm"


class Job(Settings):
    # effects, as in a job file
    stages: tuple[str, ...] | Literal["auto"] = "auto"
    # further sections of the job file
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict)
    quality: Literal["draft", "standard", "high", "reference"] = "standard"
    codec: str = "h264"


class SceneFile(Settings):
    """A whole scene. See the classes of this module for every key."""

    description: str = ""
    seed: int = Field(default=0, ge=0)
    # n × n samples in a pixel in which something ends, moves or blurs
    samples: int = Field(default=2, ge=1, le=16)
    truth: tuple[Literal["depth", "mask", "flow"], ...] = ("depth", "mask", "flow")
    clip: Clip = Clip()
    lens: Lens = Lens()
    shot: tuple[Shot, ...] = (Shot(),)
    # the first configured one is the world of arfx
    marker: tuple[Marker, ...] = ()
    plane: tuple[Plane, ...] = ()
    box: tuple[Box, ...] = ()
    sphere: tuple[Sphere, ...] = ()
    light: Light = Light()
    exposure: Exposure = Exposure()
    noise: Noise = Noise()
    hidden: Hidden = Hidden()
    depth: DepthInput = DepthInput()
    model: ModelPart = ModelPart()
    job: Job = Job()

    @model_validator(mode="after")
    def _consistent(self) -> SceneFile:
        if self.lens.aperture_m > 0 and self.lens.focus_m is None:
            raise ValueError("lens.focus_m is needed with an aperture")
        for lamp in self.light.lamps:
            if list(lamp.brightness) != sorted(lamp.brightness, key=lambda k: k[0]):
                raise ValueError(
                    "light.lamps: brightness must be in the order of time"
                )
        names = {n for p in self.objects for n in (p.name, p.key) if n}
        for p in self.objects:
            if p.attached_to and p.attached_to not in names:
                raise ValueError(
                    f"attached_to = {p.attached_to!r} names nothing; there is"
                    f" {', '.join(sorted(names))}"
                )
        return self

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """Every object, in the order of its number in the masks (1, 2, …)."""
        return (*self.plane, *self.box, *self.sphere, *self.marker)

    @property
    def frames(self) -> int:
        return sum(s.frames for s in self.shot)

    @property
    def configured(self) -> tuple[Marker, ...]:
        return tuple(m for m in self.marker if m.configured)


def parse_scene(text: str, where: str = "scene.toml") -> SceneFile:
    """A scene from TOML text. Raises ConfigError listing every wrong key with its line."""
    try:
        tree = parse_toml(text)
    except ValueError as e:
        raise ConfigError(f"{where} is not TOML: {e}") from None
    try:
        return SceneFile.model_validate(tree)
    except ValidationError as e:
        lines = []
        for problem in e.errors():
            line = line_of(text, problem["loc"])
            key = ".".join(map(str, problem["loc"])) or "scene"
            message = on_one_line(problem["msg"].removeprefix("Value error, "))
            lines.append(f"{where}{f':{line}' if line else ''}: {key}: {message}")
        raise ConfigError(
            "\n".join(lines), "arfx/synth/description.py documents every key"
        ) from None


def load_scene(path: Path) -> SceneFile:
    """A scene file. Raises InputError, ConfigError."""
    return parse_scene(read_text(path, "scene"), str(path))
