"""A clip through pixels: filmed by arfx.synth, coded as H.264, decoded and analysed as a
job does it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.params import LightParams
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.synth.clip import make_clip
from arfx.synth.description import SceneFile
from arfx.synth.world import true_camera
from tests.calibrated.scenes import ANCHOR_M, CUBE_M, FPS, KEY, OTHER_M, Clip, sphere
from tests.observed import Observed

FRAMES, WIDTH, HEIGHT = 48, 384, 288
SKY_LAMPS = 40
# Room axes, z up: those of the prints at rest, or from a camera's at rest, which looks
# along the room's y.
ROOM_FROM_CAMERA = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
WOOD = {
    "kind": "wood",
    "colour": [0.22, 0.12, 0.06],
    "second": [0.60, 0.42, 0.26],
    "feature_m": 0.02,
}

TILES = {
    "kind": "checker",
    "colour": [0.2, 0.25, 0.3],
    "second": [0.5, 0.45, 0.4],
    "feature_m": 0.06,
}


def scene(clip: Clip) -> SceneFile:
    tree: dict[str, Any] = {
        "seed": clip.seed,
        "truth": [],
        "clip": {"width": WIDTH, "height": HEIGHT, "fps": FPS, "crf": 14},
        "lens": {"fov_deg": 45, "softness_px": 0.4},
        "light": {"ambient_rgb": [0, 0, 0], "lamps": _lamps(clip)},
        "exposure": {
            "gain": float(np.exp(np.log(clip.gain).mean())),
            "bias": clip.bias,
            "drift_stops": clip.drift[0],
            "drift_period_s": clip.drift[1],
        },
        "noise": {"read": 0.001 * clip.noise_grey, "shot": 5e-5 * clip.noise_grey**2},
        "hidden": {"gloss": clip.gloss},
    }
    if clip.case.gamma[1] > 1.1:
        tree["hidden"]["transfer"] = f"gamma:{2.2 / clip.gamma:.3f}"
    if clip.bright_side is None:
        tree["light"]["ambient_rgb"] = clip.ambient.tolist()
    prints = [
        {
            "spec": f"{key}:{ANCHOR_M if key == KEY else OTHER_M}m",
            "position_m": at.tolist(),
            "rotate_deg": euler_deg(rotation),
        }
        for key, (rotation, at) in clip.prints.items()
    ]
    if clip.camera_rests:
        wall = {
            "name": "wall",
            "size_m": [2.4, 1.8],
            "position_m": [0, 0.9, 0],
            "rotate_deg": [90, 0, 0],
        }
        tree["plane"] = [wall | {"texture": TILES}]
        prints[0]["motion"] = {"kind": "keys", "keys": _keys(clip)}
        for other in prints[1:]:
            other["attached_to"] = KEY
        path = {"kind": "static", "position_m": [0, 0, 0], "target_m": [0, 1, 0]}
    else:
        tree["plane"] = [
            {
                "name": "desk",
                "size_m": [1.6, 1.1],
                "position_m": [0, 0.1, -2e-4],
                "texture": WOOD,
            }
        ]
        if clip.case.prints == "cube":
            rotation, top = clip.prints[next(reversed(clip.prints))]
            middle = top - rotation[:, 2] * (CUBE_M / 2 + 2e-4)
            tree["box"] = [{"name": "cube", "size_m": [CUBE_M] * 3, "position_m": (middle - [0, 0, CUBE_M / 2]).tolist(),
                            "rotate_deg": euler_deg(rotation), "texture": {"colour": [0.8, 0.8, 0.8]}}]  # fmt: skip
        centres = -np.einsum("kij,ki->kj", clip.turns, clip.places_m)
        keys = [
            {"time_s": float(t), "position_m": c.tolist()}
            for t, c in zip(clip.times_s, centres, strict=True)
        ]
        path = {"kind": "keys", "keys": keys, "hand_deg": 0.2, "hand_m": 0.001}
    return SceneFile.model_validate(
        tree
        | {"marker": prints, "shot": [{"frames": len(clip.times_s), "path": path}]}
    )


def _keys(clip: Clip) -> list[dict[str, Any]]:
    return [
        {
            "time_s": float(t),
            "position_m": (ROOM_FROM_CAMERA @ p).tolist(),
            "rotate_deg": euler_deg(ROOM_FROM_CAMERA @ turn),
        }
        for t, turn, p in zip(clip.times_s, clip.turns, clip.places_m, strict=True)
    ]


def euler_deg(turn: np.ndarray) -> list[float]:
    """About x, then y, then z (fixed axes)."""
    y = np.arcsin(np.clip(-turn[2, 0], -1, 1))
    angles = np.arctan2(turn[2, 1], turn[2, 2]), y, np.arctan2(turn[1, 0], turn[0, 0])
    return [float(np.degrees(a)) for a in angles]


def _lamps(clip: Clip) -> list[dict[str, Any]]:
    room = ROOM_FROM_CAMERA if clip.camera_rests else np.eye(3)
    out = []
    for lamp in clip.lamps:
        keys = zip(clip.times_s.tolist(), lamp.on.tolist(), strict=True)
        out.append(
            _lamp(room @ lamp.direction, lamp.rgb)
            | {
                "angular_size_deg": 2 * lamp.half_deg,
                "brightness": list(keys),
            }
        )
    if clip.bright_side is not None:
        directions, radiance = clip.sky
        cells = sphere(SKY_LAMPS)
        nearest = (directions @ cells.T).argmax(1)
        for i in np.unique(nearest):
            of = nearest == i
            out.append(
                _lamp(
                    room @ (radiance[of].mean(1) @ directions[of]),
                    radiance[of].sum(0),
                )
            )
    return out


def _lamp(towards: np.ndarray, rgb: np.ndarray) -> dict[str, Any]:
    x, y, z = towards / np.linalg.norm(towards)
    return {"azimuth_deg": float(np.degrees(np.arctan2(y, x))), "elevation_deg": float(np.degrees(np.arcsin(z))),
            "rgb": rgb.tolist(), "angular_size_deg": 0.0}  # fmt: skip


class Filmed:
    """A clip that is filmed into a new folder, its frames analysed up to the light, which
    `lit` gives.
    """

    def __init__(self, clip: Clip, folder: Path) -> None:
        asked = scene(clip)
        make_clip(asked, folder, truth_pictures=False)
        self._analyser = Observed(
            AnalysisJob(tuple(m.spec for m in asked.marker), true_camera(asked)),
            {"light"},
        )
        with ClipReader(probe(folder / asked.clip.file)) as reader:
            for k, frame in enumerate(reader.frames()):
                self._analyser.step(
                    AnalysisFrame(
                        k, frame.time_s, np.ascontiguousarray(frame.luma()), frame
                    )
                )

    def lit(self, params: LightParams) -> Analysis:
        self._analyser.job = replace(self._analyser.job, light=params)
        return self._analyser.finish()
