"""Health of indirect light: seams of the environment map, and the white furnace of the
job's own model.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.cube import bordered
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.model import Material
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.stage import Check, JobView
from arfx.stages.light.surroundings import checked_faces

SIZE = (96, 72)
_VIEW_DEG = 58.10920819815431  # a focal length of .9 of the width
# of the mean: thin parts and corners darken a little, as each sees the other darkened once
# more
LIMIT = 0.05
_COARSE_PX = 16  # of a face: finer maps are looked at by their means
_LOOKS = 5  # environments that are looked at, evenly over the clip
T = TypeVar("T")


def seams(job: JobView) -> Iterator[Check]:
    """Steps of environment maps across the edges of their cubes beside those between texels
    within a face.
    """
    guesses = [f.environment for f in job.facts if f.environment is not None]
    maps = [checked_faces(guess) for guess in _evenly(guesses)]
    for rgba in _evenly([*job.scene.environment_maps.values()]):
        block, rgb = rgba.shape[1] // _COARSE_PX, rgba[..., :3].astype(float)
        blocks = rgb.reshape(6, _COARSE_PX, block, _COARSE_PX, block, 3)
        maps.append(blocks.mean((2, 4)))
    if maps:
        worst = max(map(seam_ratio, maps))
        name = "environment: steps across cube edges / within faces"
        yield Check(name, worst, 3.0, worst <= 3.0, "seam may show in reflections")


def _evenly(things: Sequence[T]) -> list[T]:
    """_LOOKS of them, or fewer."""
    last = max(len(things) - 1, 0)
    numbers = {int(k) for k in np.linspace(0, last, _LOOKS)}
    return [things[k] for k in sorted(numbers) if things]


def seam_ratio(faces: ndarray) -> float:
    """Median step across the edges of a cube (6, n, n, 3) over that within its faces next
    to them; 1 = no seam.

    Flat maps have neither: steps below a thousandth of the mean count as that."""
    rows = bordered(faces)
    columns = rows.swapaxes(1, 2)
    sides = np.concatenate([rows, rows[:, ::-1], columns, columns[:, ::-1]])
    steps = np.abs(np.diff(sides[:, :3, 1:-1], axis=1)).mean(-1)
    across, within = np.median(steps, (0, 2))
    least = max(1e-3 * float(np.abs(faces).mean()), 1e-9)
    return float(max(across, least) / max(within, least))


def furnace(job: JobView) -> Iterator[Check]:
    """Of every level but `reference`."""
    for level in sorted(job.levels["gi"] - {"reference"}):
        mean = furnace_mean(job, level)
        if mean is not None:
            ok, name = abs(mean - 1) <= LIMIT, f"white furnace at {level}: mean of 1"
            yield Check(name, mean, f"1 ± {LIMIT}", ok, "gi at a higher level")


def furnace_mean(job: JobView, level: str) -> float | None:
    """Mean radiance of the model, made white, on a white plane in a light of 1: it has to
    vanish. Energy that levels lose or invent is a mean other than 1. Over pixels inside its
    outline; None where it shows too few. Cost: one small picture."""
    from scipy.ndimage import binary_erosion

    scene = job.scene
    white = Material(
        "white", base_colour=(1.0, 1.0, 1.0, 1.0), roughness=1.0, specular=0.0
    )
    model = replace(
        scene.model,
        parts=tuple(
            replace(p, material=white, colours=None) for p in scene.model.parts
        ),
    )
    even = Light((1.0, 1.0, 1.0), ())
    camera = Camera.guess(*SIZE, _VIEW_DEG)
    small = replace(scene, camera=camera, model=model, light=even, surface_m=None)
    box = scene.world_from_anchor.inverse().apply(scene.model_corners_m)
    low, high = box.min(0), box.max(0)
    away_m = 1.3 * float(np.linalg.norm(high - low))
    turn = rotation_from_euler_deg(140, 0, 0)
    shift_m = np.array([0, 0, away_m]) - turn @ (low + high) / 2
    camera_from_anchor = Pose(turn, shift_m)
    pose = camera_from_anchor @ scene.world_from_anchor.inverse()
    facts = FrameFacts(
        0, 0.0, status=MEASURED, camera_from_world=pose, opacity=1.0, light=even
    )
    others = dict.fromkeys(("raster", "lightmap", "composite"), "standard")
    seen = job.picture(small, facts, {**others, "gi": level})
    if seen is None:
        return None
    inside = binary_erosion(seen[Layer.COVERAGE] > 0.999)
    return float(seen[Layer.VIRTUAL][inside].mean()) if inside.sum() >= 20 else None
