"""Clips as a telephone films them, each with its truth.

The radiance of every frame is exact (arfx.synth). What a telephone makes of it is added here:
exposure and white balance that change while the rows are read, 8-bit noise, a sharpening halo,
a black level, H.264 at crf 28 with a key frame every second. A hand's shadow takes the lamp's
light from a disc on the desk, and ink may have a colour: radiance is linear in both, so that
two renderings give every one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob
from arfx.core.colour import Transfer
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import smoothstep
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.synth.description import SceneFile
from arfx.synth.encode import ClipFile
from arfx.synth.picture import Picture
from arfx.synth.world import World
from tests.observed import Observed

WIDTH, HEIGHT = 384, 216
KEY_FRAME_S = 1.0
PRINTS = tuple(
    f"36h11:{i}" for i in range(6)
)  # the first is what the object stands on
CRF = 28.0
AMBIENT_RGB, LAMP_RGB = (0.22, 0.23, 0.25), (0.42, 0.40, 0.36)
TURNS_DEG = (
    0.0,
    20.0,
    70.0,
    160.0,
    -20.0,
    -70.0,
)  # of the prints: where tilted ones face
INK, MORE_INK = 0.05, 0.15  # albedos of the two renderings
HAND_RADIUS_M, HAND_EDGE_M = 0.045, 0.02
OBJECT_M = 0.03  # that stands on a print
HAND_S = (0.6, 1.4)  # while it is there
HAND_RISE_S = 0.15
LEFT_OF_AMBIENT = 0.8  # in a hand's shadow
SHARP_PX = 1.2  # sigma of the halo


def steady(time_s: np.ndarray) -> np.ndarray:
    return np.zeros(np.shape(time_s))


def dim(time_s: np.ndarray) -> np.ndarray:
    return np.full(np.shape(time_s), -3.0)


def ramps(time_s: np.ndarray) -> np.ndarray:
    """Half a stop up and down, at 1 stop a second, after a quarter of a second at rest."""
    phase = np.clip(np.asarray(time_s) - 0.25, 0, None)
    return np.abs((phase + 0.5) % 1.0 - 0.5)


def steps(time_s: np.ndarray) -> np.ndarray:
    """20 % down, up and up."""
    step = np.log2(1.2)
    return step * (
        -1.0 * (np.asarray(time_s) >= 0.5)
        + 1.0 * (np.asarray(time_s) >= 0.9)
        + 1.0 * (np.asarray(time_s) >= 1.4)
    )


@dataclass(frozen=True)
class Phone:
    """stops : exposure over time;  hunting : amplitude of the white balance's wandering,
    share of red and blue
    rolling_s : from the first row's exposure to the last row's;  black : (3,) linear light
    that is added;  noise_grey : 8-bit levels;  halo : strength of the sharpening
    """

    stops: Callable[[np.ndarray], np.ndarray] = steady
    hunting: float = 0.0
    rolling_s: float = 0.0
    black: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise_grey: float = 1.5
    halo: float = 0.0

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """(..., 3) factor of linear light."""
        time_s = np.asarray(time_s, float)
        wander = self.hunting * np.sin(2 * np.pi * time_s / 1.1)
        colour = np.stack([1 + wander, np.ones_like(wander), 1 - wander], -1)
        return colour * 2.0 ** self.stops(time_s)[..., None]


@dataclass(frozen=True)
class Look:
    """prints : how many;  side_m : of each;  distance_m : of the camera;  tilt_deg : of all
    prints but the first
    ink : (3,) albedo, None = grey;  gloss : of the prints
    hand : number of the print in a hand's shadow, None = none;  hand_at : from its middle
    hidden_s : while all prints are covered
    """

    name: str
    phone: Phone = field(default_factory=Phone)
    prints: int = 1
    side_m: float = 0.06
    distance_m: float = 0.42
    tilt_deg: float = 0.0
    ink: tuple[float, float, float] | None = None
    gloss: float = 0.0
    hand: int | None = None
    hand_at_m: tuple[float, float] = (0.0, 0.0)
    hidden_s: tuple[float, float] | None = None
    fps: float = 30.0
    frames: int = 60

    @property
    def desk(self) -> Desk:
        return Desk(
            self.prints,
            self.side_m,
            self.distance_m,
            self.tilt_deg,
            self.gloss,
            self.fps,
            self.frames,
        )

    @property
    def scene(self) -> SceneFile:
        return scene(self.desk)


class Desk(NamedTuple):
    """What is rendered; fields as of `Look`."""

    prints: int
    side_m: float
    distance_m: float
    tilt_deg: float
    gloss: float
    fps: float
    frames: int


def places_m(prints: int, side_m: float) -> list[tuple[float, float]]:
    """Of the prints' middles on the desk; the first one's is the origin."""
    apart = 1.9 * side_m
    rows = [(apart * (i % 3), apart * (i // 3)) for i in range(prints)]
    return [(x, y) for x, y in rows]


def scene(desk: Desk, ink: float = INK, lamp: float = 1.0) -> SceneFile:
    """A desk with prints under a lamp, filmed by hand. lamp : share of its light"""
    places = places_m(desk.prints, desk.side_m)
    tilts = [0.0] + [desk.tilt_deg] * (desk.prints - 1)
    middle = np.mean(places, 0)
    path = {
        "kind": "orbit",
        "target_m": [*middle, 0],
        "radius_m": desk.distance_m,
        "azimuth_deg": [-112, -84],
        "elevation_deg": [48, 54],
        "hand_deg": 0.3,
        "hand_m": 0.002,
    }
    tree: dict[str, Any] = {
        "seed": 5,
        "truth": [],
        "clip": {"width": WIDTH, "height": HEIGHT, "fps": desk.fps, "crf": CRF},
        "lens": {"fov_deg": 55, "softness_px": 0.5},
        "light": {
            "ambient_rgb": AMBIENT_RGB,
            "lamps": [
                {
                    "azimuth_deg": 40,
                    "elevation_deg": 55,
                    "rgb": [lamp * c for c in LAMP_RGB],
                    "angular_size_deg": 4,
                }
            ],
        },
        "hidden": {"gloss": desk.gloss},
        "plane": [
            {
                "size_m": [2, 2],
                "position_m": [0, 0, -2e-4],
                "texture": {
                    "kind": "wood",
                    "colour": [0.22, 0.12, 0.06],
                    "second": [0.60, 0.42, 0.26],
                },
            }
        ],
        "marker": [
            {
                "spec": f"{key}:{desk.side_m}m",
                "position_m": [x, y, 0.6 * desk.side_m * (tilt > 0)],
                "rotate_deg": [tilt, 0, turn],
                "ink": ink,
            }
            for key, (x, y), tilt, turn in zip(
                PRINTS, places, tilts, TURNS_DEG, strict=False
            )
        ],
        "shot": [{"frames": desk.frames, "path": path}],
    }
    return SceneFile.model_validate(tree)


@cache
def _radiance(desk: Desk, ink: float = INK, lamp: float = 1.0) -> np.ndarray:
    """(frames, h, w, 3) float32"""
    picture = Picture(World(scene(desk, ink, lamp)))
    return np.array([picture.radiance(n) for n in range(desk.frames)], np.float32)


def radiance(look: Look) -> np.ndarray:
    """(frames, h, w, 3) float32 linear, as the surfaces are."""
    out = _radiance(look.desk)
    if look.ink is not None:
        slope = (np.array(look.ink, np.float32) - INK) / (MORE_INK - INK)
        out = out + slope * (_radiance(look.desk, MORE_INK) - out)
    if look.hand is not None:
        soft = LEFT_OF_AMBIENT * _radiance(look.desk, INK, 0.0)
        out = out + shadow(look)[..., None] * (soft - out)
    if look.hidden_s is not None:
        times = np.arange(look.frames) / look.fps
        hidden = (times >= look.hidden_s[0]) & (times < look.hidden_s[1])
        covered = (
            np.stack([_grown(m) for m in _inked(look.desk)]) & hidden[:, None, None]
        )
        out = np.where(covered[..., None], np.float32(0.2), out)
    return out


def _inked(desk: Desk) -> np.ndarray:
    """(frames, h, w) where the prints' dark cells are."""
    more = np.abs(_radiance(desk, MORE_INK) - _radiance(desk)).max(-1)
    return np.asarray(more > 1e-3)


def _grown(mask: np.ndarray) -> np.ndarray:
    """By half of a small print's side."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0


def hand(look: Look) -> np.ndarray:
    """(frames,) 0..1 how much of the hand's shadow is there."""
    times = np.arange(look.frames) / look.fps
    if look.hand is None:
        return np.zeros(look.frames)
    begin, end = HAND_S
    return np.asarray(
        smoothstep((times - begin) / HAND_RISE_S)
        * smoothstep((end - times) / HAND_RISE_S)
    )


def taken(look: Look) -> float:
    """Share of the lamp's light that a hand takes from an object in the middle of its print."""
    across = np.linspace(-OBJECT_M / 2, OBJECT_M / 2, 9)
    x, y = np.subtract(np.stack(np.meshgrid(across, across), -1), look.hand_at_m).T
    return float(np.mean(_share(np.hypot(x, y))))


def _share(away_m: np.ndarray) -> np.ndarray:
    """Of the lamp's light that a hand takes, so far from its shadow's middle."""
    return np.asarray(1 - smoothstep((away_m - HAND_RADIUS_M) / HAND_EDGE_M + 0.5))


def shadow(look: Look) -> np.ndarray:
    """(frames, h, w) float32 0..1 of the lamp's light that the hand takes."""
    world = World(look.scene)
    rays = Picture(world).rays(0.0, 0.0)
    towards = np.concatenate([rays, np.ones_like(rays[..., :1])], -1)
    x, y = np.add(places_m(look.prints, look.side_m)[look.hand or 0], look.hand_at_m)
    out = np.zeros((look.frames, HEIGHT, WIDTH), np.float32)
    for n, there in enumerate(hand(look)):
        if there <= 0:
            continue
        pose = world.camera_at(n, float(world.frame_times_s[n])).inverse()
        d = towards @ pose.rotation.T
        at = pose.translation_m[:2] - d[..., :2] * (
            pose.translation_m[2] / d[..., 2:]
        )
        away = np.linalg.norm(at - [x, y], axis=-1)
        out[n] = there * _share(away)
    return out


class PhoneFile(ClipFile):
    """A key frame every second, as telephones write them."""

    def __init__(self, path: Path, scene: SceneFile) -> None:
        super().__init__(path, scene)
        context = self._stream.codec_context
        context.options = {
            **context.options,
            "g": str(round(KEY_FRAME_S * scene.clip.fps)),
        }


def film(look: Look, path: Path) -> np.ndarray:
    """Write the clip. Returns (3,) linear light below which a hundredth of what was filmed is."""
    phone, out = look.phone, PhoneFile(path, look.scene)
    rng = np.random.default_rng(len(look.name))
    encode = Transfer("srgb").encode
    row_s = phone.rolling_s * ((np.arange(HEIGHT) + 0.5) / HEIGHT - 0.5)
    filmed = radiance(look)
    for n, exact in enumerate(filmed):
        time_s = n / look.fps
        light = exact * phone.gain(time_s + row_s)[:, None] + np.array(phone.black)
        coded = encode(np.clip(light, 0, 1)).astype(np.float32)
        if phone.halo:
            coded = coded + phone.halo * (
                coded - cv2.GaussianBlur(coded, (0, 0), SHARP_PX)
            )
        coded = coded + rng.normal(0, phone.noise_grey / 255, coded.shape).astype(
            np.float32
        )
        out.write(np.clip(coded, 0, 1).astype(np.float32), time_s)
    out.close()
    gains = phone.gain(np.arange(look.frames) / look.fps)[:, None, None]
    return np.asarray(
        np.percentile((filmed * gains)[::7, ::5, ::5].reshape(-1, 3), 1, axis=0)
        + phone.black
    )


def analysed(look: Look, path: Path) -> Analysis:
    """The clip's analysis up to the light, as a job does it."""
    asked = look.scene
    markers = tuple(m.spec for m in asked.marker)
    job = AnalysisJob(markers, World(asked).camera)
    analyser = Observed(job, {"light"}, look.frames)
    with ClipReader(probe(path)) as reader:
        frames = [(f, np.ascontiguousarray(f.luma())) for f in reader.frames()]
    for k, (frame, luma) in enumerate(frames):
        following = frames[k + 1][1] if k + 1 < len(frames) else None
        after = None if following is None else lambda luma=following: luma
        analyser.step(AnalysisFrame(k, frame.time_s, luma, frame, after))
    return analyser.finish()


def true_lights(look: Look, of_object: bool) -> list[Light]:
    """Every frame's light, room axes. of_object : what a hand takes from its own print is
    taken from the object
    """
    lamp = World(look.scene).lights_at(0.0)[0]
    gains = look.phone.gain(np.arange(look.frames) / look.fps)
    share = taken(look) if of_object and look.hand == 0 else 0.0
    out = []
    for gain, there in zip(gains, share * hand(look), strict=True):
        soft = gain * AMBIENT_RGB * (1 - there * (1 - LEFT_OF_AMBIENT))
        rgb = gain * lamp[3:6] * (1 - there)
        out.append(
            Light(triple(soft), (DirectionalLight(triple(lamp[:3]), triple(rgb)),))
        )
    return out
