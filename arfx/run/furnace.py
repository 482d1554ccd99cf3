"""White furnace of a job's own voxels: the model made white on a white plane in an even light has to vanish.

Any energy that the cones lose or invent shows as a mean other than 1. Cost: one small picture, about half a second.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from arfx.analyse.pose.visibility import with_model
from arfx.core.camera import Camera
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.model import Material
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.scene import Scene
from arfx.core.stage import level_named
from arfx.plan.planner import plan_frame
from arfx.run.frame import run_frame
from arfx.stages import STAGES, TAKES_OVER

SIZE = (96, 72)
LIMIT = 0.05  # of the mean: thin parts and corners darken a little, as each sees the other darkened once more


def furnace_mean(scene: Scene, level: str) -> float | None:
    """Mean radiance of the white object in a light of 1, over pixels inside its outline; None where it shows too few.

    level : of `gi`; its reference traces no voxels
    """
    white = Material("white", base_colour=(1.0, 1.0, 1.0, 1.0), roughness=1.0, specular=0.0)
    model = replace(scene.model, parts=tuple(replace(p, material=white, colours=None) for p in scene.model.parts))
    width, height = SIZE
    focal = 0.9 * width
    camera = Camera(width, height, np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]]))
    even = Light(ambient_rgb=(1.0, 1.0, 1.0), lights=())
    small = replace(scene, camera=camera, model=model, light=even, surface_m=None)
    box = scene.world_from_anchor.inverse().apply(scene.model_corners_m)
    centre, reach = (box.min(0) + box.max(0)) / 2, float(np.linalg.norm(np.ptp(box, axis=0)))
    turn = rotation_from_euler_deg(180, 0, 0) @ rotation_from_euler_deg(-40, 0, 0)
    camera_from_anchor = Pose(turn, np.array([0, 0, 1.3 * reach]) - turn @ centre)
    pose = camera_from_anchor @ scene.world_from_anchor.inverse()
    seen = FrameFacts(0, 0.0, status=MEASURED, camera_from_world=pose, opacity=1.0, light=even)
    (facts,) = with_model([seen], small)
    names = ("raster", "lightmap", "gi", "composite")
    over = TAKES_OVER["gi"]
    stages = {n: STAGES[n](replace(STAGES[n].Params(), **over.get(n, {}))) for n in names}
    levels = {n: level_named(s.levels, level if n == "gi" else "standard") for n, s in stages.items()}
    plan = plan_frame(list(stages.values()), levels, facts, small, camera.rect)
    if not plan.steps:
        return None
    plate = np.ones((plan.rect.height, plan.rect.width, 3), np.float32)
    prepared = {s.stage: stages[s.stage].prepare(small, levels[s.stage]) for s in plan.steps}
    canvas = run_frame(plate, facts, plan, small, stages, levels, prepared).canvas
    view = canvas.view(frozenset({Layer.VIRTUAL, Layer.COVERAGE}), plan.rect)
    whole = view[Layer.COVERAGE] > 0.999
    inside = whole.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            inside &= np.roll(whole, step, axis)
    return float(view[Layer.VIRTUAL][inside].mean()) if inside.sum() >= 20 else None
