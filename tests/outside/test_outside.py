"""The product's pictures beside those of an outside renderer, which read the same files
(scenes.py, tools/outside_render.py).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from arfx.analyse.light.given import light_from_panorama
from arfx.analyse.light.seen import given_everywhere
from arfx.core.camera import Camera
from arfx.core.colour import SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import normalise
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.core.stage import level_named
from arfx.media.images import load_image
from arfx.media.models import load_model
from arfx.plan.planner import plan_frame
from arfx.run.frame import ready_stages, run_frame
from arfx.stages import STAGES
from tests import scenes as small
from tests.outside import scenes
from tests.outside.scenes import OutsideScene

Z_UP = np.array(
    [[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
)  # from a glTF file's axes


def placed(scene: OutsideScene, folder: Path) -> tuple[Scene, FrameFacts]:
    """As a job of `--environment` has them."""
    model_file, environment_file = scenes.write(scene, folder)
    view, model, panorama = (
        scene.camera,
        load_model(model_file),
        load_image(environment_file),
    )
    matrix = np.diag([view.focal_px, view.focal_px, 1.0])
    matrix[:2, 2] = (view.width - 1) / 2, (view.height - 1) / 2
    camera = Camera(view.width, view.height, matrix, np.zeros(0))
    light = light_from_panorama(panorama)
    forward = normalise(np.subtract(view.target_m, view.eye_m))
    right = normalise(np.cross(forward, [0, 0, 1.0]))
    turn = np.stack([right, np.cross(forward, right), forward])
    pose = Pose(turn, -turn @ np.array(view.eye_m))
    bare = Scene(camera, model, Z_UP, light=light)
    lit = small.facts(bare, pose).with_(light=light)
    (facts,), maps = given_everywhere([lit], panorama, np.eye(3))
    return Scene(camera, model, Z_UP, light=light, environment_maps=maps), facts


def rendered(scene: OutsideScene, folder: Path) -> tuple[Scene, FrameFacts, Layers]:
    """Layers of the whole frame over an even grey plate, at standard levels, planned as in
    a job.
    """
    s, facts = placed(scene, folder)
    stages = {name: STAGES[name]() for name in ("raster", "lightmap", "composite")}
    chosen = {
        name: level_named(stage.levels, "standard") for name, stage in stages.items()
    }
    plan = plan_frame(list(stages.values()), chosen, facts, s, s.camera.rect)
    plate = np.full(
        (plan.rect.height, plan.rect.width, 3), scenes.PLANE_ALBEDO, np.float32
    )
    result = run_frame(plate, facts, plan, ready_stages(plan, stages, s))
    return s, facts, result.layers.view(plan.rect)


def outside(name: str) -> np.ndarray:
    """(h, w, 3) grey levels."""
    picture = cv2.imread(str(Path(__file__).parent / f"{name}.png"))
    assert picture is not None
    return picture[..., ::-1].astype(float)


def grey_levels(linear: np.ndarray) -> np.ndarray:
    return np.asarray(255 * SRGB.encode(np.clip(np.asarray(linear, float), 0, 1)))


def places_on_plane(scene: Scene, facts: FrameFacts) -> np.ndarray:
    """(h, w, 2) metres, where each pixel's ray meets the plane."""
    camera, world_from_camera = scene.camera, facts.pose.inverse()
    y, x = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.matrix).T
    rays = pixels @ world_from_camera.rotation.T
    eye = world_from_camera.translation_m
    return np.asarray((eye - rays * (eye[2] / rays[..., 2:]))[..., :2])


MATERIAL_LEVELS, CONTACT_LEVELS = 4.0, 3.0
BY_NAME = {scene.name: scene for scene in scenes.SCENES}
MISSING = {
    "thin_wall_lamp": "the soft light that the plane gets is linear in direction: 3.4 levels",
}


def cases(names: Iterable[str]) -> list[Any]:
    """Parameters; strictly expected to fail where MISSING says why."""
    marks = {
        name: [pytest.mark.xfail(reason=why, strict=True)]
        for name, why in MISSING.items()
    }
    return [pytest.param(name, marks=marks.get(name, [])) for name in names]


@pytest.mark.parametrize("name", cases(scenes.MATERIALS))
def test_materials_look_as_another_renderer_makes_them(
    name: str, tmp_path: Path
) -> None:
    scene, _, layers = rendered(BY_NAME[name], tmp_path)
    at = layers.rect.slices_in(scene.camera.rect)
    difference = np.abs(grey_levels(layers[Layer.VIRTUAL]) - outside(name)[at])
    error = difference[layers[Layer.COVERAGE] > 0].mean()
    assert error <= MATERIAL_LEVELS, f"{error:.2f} grey levels"


@pytest.mark.parametrize(
    "name", cases(s.name for s in scenes.SCENES if s.shows == "plane")
)
def test_the_plane_around_a_contact_is_as_dark_as_another_renderer_makes_it(
    name: str, tmp_path: Path
) -> None:
    """Also where the object hides it.

    Means of 3 x 3 pixels, as the other picture has noise of some 2 levels.
    """
    scene, facts, layers = rendered(BY_NAME[name], tmp_path)
    distance = scenes.contact_distance_m(
        BY_NAME[name].model, places_on_plane(scene, facts).reshape(-1, 2)
    ).reshape(scene.camera.height, scene.camera.width)
    near = (distance > 0) & (distance <= scenes.NEAR * scenes.SIZE_M)
    ratio = np.ones((scene.camera.height, scene.camera.width, 3))
    ratio[layers.rect.slices_in(scene.camera.rect)] = layers[Layer.SHADOW]
    ours, theirs = grey_levels(scenes.PLANE_ALBEDO * ratio), outside(name)
    ours[distance == 0] = theirs[distance == 0]  # the object stands there
    ours, theirs = cv2.blur(ours, (3, 3)), cv2.blur(theirs, (3, 3))
    error = np.abs(ours - theirs)[near].mean()
    assert error <= CONTACT_LEVELS, f"{error:.2f} grey levels"
