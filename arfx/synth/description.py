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
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from arfx.core.colour import Transfer
from arfx.core.marker import MarkerSpec
from arfx.core.opener import parse_toml, read_text
from arfx.core.units import length_m
from arfx.errors import ArfxError, ConfigError, on_one_line


def _read(parse: Callable[[str], Any]) -> BeforeValidator:
    """Texts through `parse`, whose ArfxError becomes one of pydantic's; other values as
    they are.
    """

    def read(value: Any) -> Any:
        try:
            return parse(value) if isinstance(value, str) else value
        except ArfxError as e:
            raise ValueError(on_one_line(str(e))) from None

    return BeforeValidator(read)


DEMO_SCENE = Path(__file__).with_name(
    "demo.toml"
)  # a desk with an AprilTag and a cube of markers, filmed hand-held on an orbit

Length = Annotated[float, _read(length_m)]
Vector = tuple[Length, Length, Length]
Angles = tuple[float, float, float]
Colour = tuple[float, float, float]
TransferName = Annotated[str, _read(lambda text: Transfer(text).name)]


class Part(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False
    )


class Clip(Part):
    file: str = Field(
        default="clip.mp4",
        pattern=r"^[\w.-]+\.(mp4|mkv)$",
        description=".mp4 = H.264, .mkv = lossless FFV1",
    )
    width: int = Field(default=640, ge=16, le=8192)
    height: int = Field(default=360, ge=16, le=8192)
    fps: float = Field(default=24.0, gt=0, le=1000)
    crf: float = Field(default=12.0, ge=0, le=51, description="H.264 quality")
    frame_times: Literal["constant", "variable"] = Field(
        default="constant", description="variable: ±35 % of a frame, from the seed"
    )
    start_s: float = Field(
        default=0.0, ge=0, description="presentation time of the first frame"
    )
    rotation_deg: Literal[0, 90, 180, 270] = Field(
        default=0, description="stored turned, with a display rotation that undoes it"
    )
    tone_hz: float | None = Field(
        default=None, gt=0, description="adds an audio stream with this tone"
    )


class Key(Part):
    """One key frame of a motion; between keys position and rotation follow a smooth
    (Catmull-Rom) curve.
    """

    time_s: float
    position_m: Vector = (0.0, 0.0, 0.0)
    rotate_deg: Angles = (0.0, 0.0, 0.0)
    target_m: Vector = (0.0, 0.0, 0.0)


def _rising(keys: tuple[Key, ...]) -> tuple[Key, ...]:
    for before, after in itertools.pairwise(keys):
        if not before.time_s < after.time_s:
            raise ValueError(
                f"the times of keys must increase: {after.time_s:g} s stands behind"
                f" {before.time_s:g} s"
            )
    return keys


Keys = Annotated[tuple[Key, ...], AfterValidator(_rising)]


class Motion(Part):
    """How an object moves; added to its pose.

    turn and sway act in the object's own axes, keys replace the pose.
    """

    kind: Literal["still", "turn", "sway", "keys"] = "still"
    axis: Angles = Field(default=(1.0, 0.0, 0.0), description="turn: axis")
    angle_deg: tuple[float, float] = Field(
        default=(0.0, 0.0), description="turn: from, to over the clip"
    )
    tilt_deg: float = Field(
        default=0.0,
        description="sway: largest tilt about x and y, in two incommensurate periods",
    )
    travel_m: Length = Field(default=0.0, description="sway: largest displacement")
    period_s: float = Field(default=2.0, gt=0)
    tremor_deg: float = Field(
        default=0.0, ge=0, description="rms of a hand's tremor, smooth noise"
    )
    tremor_m: Length = Field(default=0.0, ge=0)
    keys: Keys = ()


class CameraPath(Part):
    """How the camera moves in one shot.

    It looks at `target_m` with the room's z up, unless keys turn it.
    """

    kind: Literal["static", "orbit", "dolly", "keys"] = "static"
    target_m: Vector = (0.0, 0.0, 0.0)
    position_m: Vector = Field(
        default=(0.0, -0.4, 0.4), description="static, and where a dolly starts"
    )
    end_m: Vector = Field(default=(0.0, -0.4, 0.4), description="where a dolly ends")
    radius_m: Length = Field(default=0.5, gt=0)
    azimuth_deg: tuple[float, float] = (-120.0, -60.0)
    elevation_deg: tuple[float, float] = (45.0, 45.0)
    hand_deg: float = Field(
        default=0.0, ge=0, description="rms of hand-held shake, smooth noise about 4 Hz"
    )
    hand_m: Length = Field(default=0.0, ge=0)
    keys: Keys = Field(default=(), description="position_m and target_m are used")


class Shot(Part):
    """A cut-free stretch. Its path's time runs from 0 at its first frame."""

    frames: int = Field(default=48, ge=1, le=100_000)
    path: CameraPath = CameraPath()


class Lens(Part):
    fov_deg: float = Field(
        default=60.0,
        gt=5,
        lt=160,
        description="horizontal field of view of the undistorted picture",
    )
    centre_offset_px: tuple[float, float] = (0.0, 0.0)
    model: Literal["brown", "fisheye"] = "brown"
    distortion: tuple[float, ...] = ()
    aperture_m: Length = Field(
        default=0.0, ge=0, description="diameter of the lens's opening; 0 = pinhole"
    )
    focus_m: Length | None = Field(
        default=None,
        gt=0,
        description="distance of sharp focus along the axis; needed with an aperture",
    )
    softness_px: float = Field(
        default=0.0,
        ge=0,
        le=5,
        description="sigma of the lens's own blur; good lenses have 0.4 to 0.6",
    )
    shutter_s: float = Field(
        default=0.0,
        ge=0,
        description="time the shutter is open, centred on the frame's time",
    )


class Texture(Part):
    kind: Literal["plain", "wood", "carpet", "noise", "checker", "poster", "image"] = (
        "plain"
    )
    colour: Colour = Field(
        default=(0.5, 0.5, 0.5), description="linear albedo 0..1, or the darker of two"
    )
    second: Colour = (0.7, 0.7, 0.7)
    feature_m: Length = Field(
        default=0.02, gt=0, description="size of the pattern's features"
    )
    file: Path | None = Field(
        default=None, description="image: an sRGB picture, beside the scene file"
    )


class SceneObject(Part):
    name: str = ""
    position_m: Vector = (0.0, 0.0, 0.0)
    rotate_deg: Angles = Field(
        default=(0.0, 0.0, 0.0), description="about x, then y, then z (fixed axes)"
    )
    motion: Motion = Motion()
    attached_to: str = Field(
        default="", description="marker spec key or name whose axes and motion it follows"
    )


class Plane(SceneObject):
    size_m: tuple[Length, Length] = (2.0, 2.0)
    texture: Texture = Texture()


class Box(SceneObject):
    """A box; its pose is the middle of its base."""

    size_m: Vector = (0.1, 0.1, 0.1)
    texture: Texture = Texture()


class Sphere(SceneObject):
    """A sphere; its pose is its centre."""

    radius_m: Length = Field(default=0.05, gt=0)
    colour: Colour = (0.5, 0.5, 0.5)


class Marker(SceneObject):
    """A printed marker on a sheet of paper: exact cells, one ink, one paper."""

    spec: Annotated[MarkerSpec, _read(MarkerSpec.parse)]
    margin_cells: float = Field(
        default=1.5, ge=0, description="white border of the sheet, in cells"
    )
    ink: float = Field(default=0.05, ge=0, le=1, description="linear albedo")
    paper: float = Field(default=0.88, ge=0, le=1)
    inverted: bool = False
    configured: bool = Field(
        default=True, description="listed in job.toml; false: a distractor"
    )


class Lamp(Part):
    """Directional light. rgb: radiance of a white diffuse surface that faces it."""

    azimuth_deg: float = Field(default=40.0, description="from the room's x towards y")
    elevation_deg: float = Field(default=55.0, ge=-90, le=90)
    rgb: Colour = (0.5, 0.5, 0.5)
    angular_size_deg: float = Field(default=2.0, ge=0, le=90)
    swing_deg: tuple[float, float] = Field(
        default=(0.0, 0.0), description="amplitude of a sine in azimuth and in elevation"
    )
    period_s: float = Field(default=2.0, gt=0, description="of the swing")
    brightness: tuple[tuple[float, float], ...] = Field(
        default=(),
        description=(
            "(time_s, factor), linear between; the same time twice is a switch; beyond the"
            " ends held"
        ),
    )


class Light(Part):
    ambient_rgb: Colour = Field(
        default=(0.3, 0.3, 0.3), description="radiance of a white surface without the lamps"
    )
    lamps: tuple[Lamp, ...] = (Lamp(),)
    environment: Literal["", "studio", "sunset"] | Path = Field(
        default="",
        description=(
            "HDR picture (equirectangular, z up) or a built-in one; lights with true"
            " shadows, replaces ambient"
        ),
    )
    environment_scale: float = Field(default=1.0, gt=0)
    environment_lights: int = Field(
        default=48, ge=1, le=1024, description="directional lights it is divided into"
    )


class Exposure(Part):
    """Sensor value = gain × radiance + bias, linear light, then clipped to 0..1."""

    gain: float = Field(default=1.0, gt=0)
    bias: float = Field(default=0.0, ge=-0.5, le=0.5)
    drift_stops: float = Field(
        default=0.0, description="amplitude of an automatic exposure's wandering"
    )
    drift_period_s: float = Field(default=2.0, gt=0)


class Noise(Part):
    """Variance = read² + shot × signal, linear light."""

    read: float = Field(default=0.002, ge=0)
    shot: float = Field(default=0.00005, ge=0)


class Hidden(Part):
    """What the job does not know: each entry breaks an assumption of the models that are tested."""

    transfer: TransferName = Field(
        default="srgb", description="curve that the camera really applies"
    )
    noise_correlation_px: float = Field(default=0.0, ge=0, le=8)
    drift_stops: float = 0.0
    rolling_shutter_s: float = Field(
        default=0.0,
        ge=0,
        description="time from the first row's to the last row's exposure",
    )
    focal_error_percent: float = Field(
        default=0.0, description="camera.yaml states a focal length that much too large"
    )
    gloss: float = Field(
        default=0.0, ge=0, le=1, description="strength of a highlight on the prints"
    )
    worn_ink: float | None = Field(
        default=None,
        ge=0,
        le=1,
        description="ink albedo at the sheet's right edge; grows from the left",
    )


class DepthInput(Part):
    """What the job is given of the scene's depth (`[input] depth`), as a depth camera
    measures it.
    """

    file: str = Field(
        default="", pattern=r"^([\w.-]+\.mkv)?$", description="FFV1 gray16; empty: none"
    )
    noise: float = Field(
        default=0.0, ge=0, le=0.2, description="standard deviation, share of the distance"
    )
    holes: float = Field(
        default=0.0,
        ge=0,
        le=0.9,
        description="share of pixels that are not measured, in blots",
    )
    edge_px: int = Field(
        default=0,
        ge=0,
        le=16,
        description="beside edges of things nothing is measured within that many pixels",
    )


class ModelPart(Part):
    shape: str = "robot"
    fit: str = "12cm"


class Job(Part):
    stages: tuple[str, ...] | Literal["auto"] = Field(
        default="auto", description="effects, as in a job file"
    )
    settings: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="further sections of the job file"
    )
    quality: Literal["draft", "standard", "high", "reference"] = "standard"
    codec: str = "h264"


class SceneFile(Part):
    """A whole scene. See the classes of this module for every key."""

    description: str = ""
    seed: int = Field(default=0, ge=0)
    samples: int = Field(
        default=2,
        ge=1,
        le=16,
        description="n × n samples in a pixel in which something ends, moves or blurs",
    )
    truth: tuple[Literal["depth", "mask", "flow"], ...] = ("depth", "mask", "flow")
    clip: Clip = Clip()
    lens: Lens = Lens()
    shot: tuple[Shot, ...] = (Shot(),)
    marker: tuple[Marker, ...] = Field(
        default=(), description="the first configured one is the world of arfx"
    )
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
                raise ValueError("light.lamps: brightness must be in the order of time")
        names = {p.name for p in self.objects if p.name} | {m.spec.key for m in self.marker}
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
            key = ".".join(
                str(k)
                for k in problem["loc"]
                if k != "function-after[_consistent(), SceneFile]"
            )
            last = next(
                (str(k) for k in reversed(problem["loc"]) if isinstance(k, str)), ""
            )
            at = next(
                (
                    f":{n}"
                    for n, raw in enumerate(text.splitlines(), 1)
                    if last and raw.strip().startswith(last)
                ),
                "",
            )
            lines.append(
                f"{where}{at}: {key or 'scene'}:"
                f" {problem['msg'].removeprefix('Value error, ')}"
            )
        raise ConfigError(
            "\n".join(lines), "arfx/synth/description.py documents every key"
        ) from None


def load_scene(path: Path) -> SceneFile:
    """A scene file; picture files in it are found beside it. Raises InputError, ConfigError."""
    return parse_scene(read_text(path, "scene"), str(path))
