"""Scenes small enough to compute by hand."""

from __future__ import annotations

from typing import Any

from arfx.synth.description import SceneFile
from arfx.synth.picture import Picture
from arfx.synth.world import World

FLAT_LIGHT = {"ambient_rgb": [1, 1, 1], "lamps": []}
NO_NOISE = {"read": 0, "shot": 0}


def little_scene(
    width: int = 64,
    height: int = 48,
    frames: int = 1,
    path: dict[str, Any] | None = None,
    **parts: Any,
) -> SceneFile:
    """A noise-free scene; `path` is the camera's in its only shot."""
    tree: dict[str, Any] = {
        "clip": {"width": width, "height": height, "fps": 10},
        "shot": [{"frames": frames, "path": path or {}}],
        "noise": NO_NOISE,
        "light": FLAT_LIGHT,
        "truth": [],
    }
    tree["clip"] |= parts.pop("clip", {})
    return SceneFile.model_validate(tree | parts)


def picture_of(scene: SceneFile, samples: int | None = None) -> tuple[World, Picture]:
    world = World(scene)
    return world, Picture(world, samples)


def from_above(height_m: float = 1.0) -> dict[str, Any]:
    """A camera that looks straight down: picture right = room x, picture up = room y."""
    return {"kind": "static", "position_m": [0, 0, height_m], "target_m": [0, 0, 0]}
