"""A clip fed to the light's analysis as readings: what a camera makes of a print's dark and
bright cells, by code of its own.
"""

from __future__ import annotations

import numpy as np

from arfx.analyse.job import Analysis
from arfx.analyse.light.frames import Reading, with_light
from arfx.analyse.light.patches import Patches
from arfx.analyse.params import LightParams
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose
from tests.calibrated.scenes import ANCHOR_M, KEY, Clip, about

SAMPLES = 40
BRIGHT = np.arange(8) >= 4  # of the eight patches: dark in each quarter, then bright


def encode(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def decode(e: np.ndarray) -> np.ndarray:
    return np.where(e <= 0.04045, e / 12.92, ((e + 0.055) / 1.055) ** 2.4)


def analysis(clip: Clip) -> tuple[Analysis, list[Reading]]:
    """What the poses' analysis would hand over, with an error of the poses, and the
    readings of every print that is seen.
    """
    rng = np.random.default_rng([clip.seed, 1, *clip.case.name.encode()])
    ink, paper = rng.uniform(0.03, 0.07), rng.uniform(0.82, 0.92)
    rho = np.where(BRIGHT, paper, ink)
    codec = rng.normal(0, 0.25 / 255, 3)  # a codec's rounding, the same in all frames
    slow, wrong = np.zeros(3), np.radians(rng.uniform(*clip.case.pose_off_deg))
    facts, readings = [], []
    for k, time_s in enumerate(clip.times_s):
        slow = 0.8 * slow + 0.6 * wrong * rng.normal(size=3)
        off = slow + 0.3 * wrong * rng.normal(size=3)
        turn = (
            about(off / np.linalg.norm(off), float(np.linalg.norm(off)))
            @ clip.turns[k]
        )
        pose = Pose(turn, clip.places_m[k])
        facts.append(
            FrameFacts(
                k,
                float(time_s),
                0,
                MEASURED,
                pose,
                pose,
                np.eye(6) * wrong**2,
                opacity=1.0,
            )
        )
        for key, (rotation, at) in clip.prints.items():
            n, place = (
                clip.turns[k] @ rotation[:, 2],
                clip.turns[k] @ at + clip.places_m[k],
            )
            if n @ place > -0.2 * np.linalg.norm(place):
                continue
            static = n if clip.camera_rests else rotation[:, 2]
            light = clip.irradiance(
                static, k, place - [0, 0, 0.5] if clip.camera_rests else at
            )
            seen = rho[:, None] * light + _gloss(clip, n, place, k)
            light = clip.gain[k] * seen + clip.bias
            readings.append(Reading(k, key, _photographed(light, clip, codec, rng)))
    placed = {key: Pose(rotation, at) for key, (rotation, at) in clip.prints.items()}
    static = "camera" if clip.camera_rests else "marker"
    return (
        Analysis(
            tuple(facts),
            placed,
            static,
            anchor=MarkerSpec("36h11", int(KEY.split(":")[1]), ANCHOR_M),
        ),
        readings,
    )


def _gloss(
    clip: Clip, normal: np.ndarray, place: np.ndarray, frame: int
) -> np.ndarray:
    """(3,) mirrored light of the lamps, camera axes."""
    out = np.zeros(3)
    for lamp in clip.lamps if clip.gloss else ():
        towards = (
            lamp.direction
            if clip.camera_rests
            else clip.turns[frame] @ lamp.direction
        )
        half = towards - place / np.linalg.norm(place)
        out += (
            clip.gloss
            * lamp.on[frame]
            * lamp.rgb
            * max(float(normal @ half / np.linalg.norm(half)), 0.0) ** 40
        )
    return out


def _photographed(
    light: np.ndarray, clip: Clip, codec: np.ndarray, rng: np.random.Generator
) -> Patches:
    """light : (8, 3) linear, on the sensor"""
    exact = encode(np.repeat(light[:, None], SAMPLES, 1) ** clip.gamma)
    grey = np.round(
        (exact + codec + rng.normal(0, clip.noise_grey / 255, exact.shape)) * 255
    )
    fine = ((grey > 0) & (grey < 255)).all(-1)
    value, count = decode(grey / 255), fine.sum(-1)
    w, many = fine[..., None], np.maximum(count, 1)[:, None]
    mean = (value * w).sum(1) / many
    spread2 = ((value - mean[:, None]) ** 2 * w).sum(1) / np.maximum(many - 1, 1)
    lost = 1 - count / SAMPLES
    slope = 2.4 / 1.055 * np.maximum(mean, 0.003) ** (1 - 1 / 2.4)
    variance = (
        spread2 / many + (0.3 / 255 * slope) ** 2 + (2 * lost[:, None]) ** 2 * spread2
    )
    few = count < 4
    return Patches(
        np.where(few[:, None], 0, mean), variance, np.where(few, 0, count), lost
    )


def lit(clip: Clip, params: LightParams | None = None) -> Analysis:
    """The clip with every frame's light."""
    found, readings = analysis(clip)
    return with_light(found, readings, (), params or LightParams())
