"""One back end held against the other: same models, poses and lenses, two ways of drawing
that share no kernel.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.model import BLEND, Material, Model, Part, Texture
from arfx.core.numerics import angle_between
from arfx.core.rect import Rect
from arfx.core.scene import Placement, Scene
from arfx.media.models import load_model
from arfx.stages.raster import Raster
from tests.scenes import box_model
from tests.unit.stages.raster_scenes import PLAIN, camera, in_front, render, square

MODELS = (
    Path(__file__).parents[2].parent / "shared" / "data" / "models" / "mikedh-trimesh"
)
POSES = {
    "above": in_front(1.0, 35, 25),
    "near": in_front(0.6, -20, 140),
    "far": in_front(3.0, 60, -70),
}


def ball_with_colours() -> Part:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    colours = np.pad(ball.vertices * 0.5 + 0.5, ((0, 0), (0, 1)), constant_values=1.0)
    return Part(
        ball.vertices,
        ball.faces.astype(np.int32),
        ball.vertices,
        PLAIN,
        None,
        colours,
    )


def picture() -> np.ndarray:
    smooth = np.random.default_rng(3).random((8, 8, 3), dtype=np.float32)
    return (
        cv2.resize(smooth, (128, 128), interpolation=cv2.INTER_CUBIC).clip(0, 1) * 255
    ).astype(np.uint8)


def own_models() -> dict[str, Model]:
    texture = Material(
        base_texture=Texture(picture()),
        base_colour=(1, 1, 1, 1),
        double_sided=True,
        emissive=(0.5, 0.25, 2.0),
    )
    glass = Material(
        base_colour=(0.9, 0.1, 0.1, 0.4), alpha_mode=BLEND, double_sided=True
    )
    return {
        "box": box_model(
            1.0, Material(base_colour=(0.3, 0.6, 0.9, 1), roughness=0.3)
        ),
        "coloured ball": Model((ball_with_colours(),), "z"),
        "textured, glowing": Model(
            (square(0.5, 0, texture), *box_model(0.4, PLAIN).parts), "z"
        ),
        "behind glass": Model(
            (square(0.7, 0.6, glass), *box_model(0.8, PLAIN).parts), "z"
        ),
    }


def hold_against(model: Model, pose_name: str, lens: str) -> None:
    scene = Scene(
        camera(lens),
        model,
        Placement(fit_m=0.35, offset_m=(0.02, 0.01, -0.1)).world_from_model(model),
    )
    gl, rays = (render(scene, POSES[pose_name], b) for b in ("pyrender", "rays"))
    a, b = gl[Layer.COVERAGE], rays[Layer.COVERAGE]
    assert (b > 0).sum() > 300, "the case shows nothing"
    rim = (((a > 0) & (a < 1)) | ((b > 0) & (b < 1)) | ((a > 0) != (b > 0))).sum()
    # 9 samples against 64: half a sample, .06 to .1 of an edge pixel, more where the lens
    # bends the grid
    assert np.abs(a - b).sum() < (0.12 if lens == "ideal" else 0.16) * rim + 1
    # .04 px all along the rim: nine samples a pixel, and the next texel instead of the
    # exact one under a lens
    assert abs((a - b).sum()) < 0.04 * rim + 1, (
        "one silhouette is larger than the other"
    )
    assert np.abs(a - b).max() < 0.6
    same = (gl[Layer.OBJECT_ID] == rays[Layer.OBJECT_ID]) & (
        rays[Layer.OBJECT_ID] > 0
    )
    # more samples meet more of the rim's slivers
    assert (rays[Layer.OBJECT_ID] > 0).sum() - same.sum() < 0.18 * rim + 1
    inner = (
        cv2.erode((same & (a > 0) & (b > 0)).astype(np.uint8), np.ones((3, 3))) > 0
    )
    z, w = gl[Layer.DEPTH][inner], rays[Layer.DEPTH][inner]
    assert (
        np.median(np.abs(z - w) / w) < 2e-5
        and np.percentile(np.abs(z - w) / w, 98) < 3e-3
    )
    turn = np.degrees(
        angle_between(gl[Layer.NORMAL][inner], rays[Layer.NORMAL][inner])
    )
    assert np.median(turn) < 0.3 and np.percentile(turn, 90) < 6
    for name, size in (
        (Layer.ALBEDO, 1.0),
        (Layer.MATERIAL, 1.0),
        (Layer.EMISSIVE, 2.0),
    ):
        difference = np.abs(gl[name] - rays[name])[inner]
        assert (
            difference.mean() < 0.012 * size
            and np.percentile(difference, 98) < 0.12 * size
        ), name
    assert (
        np.median(
            np.linalg.norm(gl[Layer.POSITION] - rays[Layer.POSITION], axis=-1)[inner]
        )
        < 1e-4
    )


@pytest.mark.opengl
@pytest.mark.parametrize("lens", ["ideal", "barrel"])
@pytest.mark.parametrize("pose", list(POSES))
@pytest.mark.parametrize("name", list(own_models()))
def test_back_ends_agree(name: str, pose: str, lens: str) -> None:
    hold_against(own_models()[name], pose, lens)


@pytest.mark.opengl
@pytest.mark.real
@pytest.mark.skipif(
    not MODELS.is_dir(), reason=f"sample models are absent ({MODELS})"
)
@pytest.mark.parametrize(
    "name", ["Duck.glb", "CesiumMilkTruck.glb", "suzanne.ply", "featuretype.STL"]
)
def test_back_ends_agree_on_real_models(name: str) -> None:
    hold_against(load_model(MODELS / name), "above", "barrel")


@pytest.mark.opengl
def test_a_picture_shifted_by_half_a_pixel_would_be_noticed() -> None:
    model = own_models()["box"]
    good = POSES["above"]
    shifted = type(good)(
        good.rotation,
        good.translation_m + np.array([0.5 * good.translation_m[2] / 300, 0, 0]),
    )
    scene = Scene(
        camera(),
        model,
        Placement(fit_m=0.35, offset_m=(0.02, 0.01, -0.1)).world_from_model(model),
    )
    a, b = (
        render(scene, shifted, "pyrender")[Layer.COVERAGE],
        render(scene, good, "rays")[Layer.COVERAGE],
    )
    rim = (((a > 0) & (a < 1)) | ((b > 0) & (b < 1)) | ((a > 0) != (b > 0))).sum()
    assert np.abs(a - b).sum() > 0.2 * rim


@pytest.mark.opengl
@pytest.mark.parametrize("lens", ["ideal", "barrel"])
def test_opengl_over_a_rectangle_is_the_crop_of_the_whole(lens: str) -> None:
    """The same bits: the stage draws the model's whole box, whatever part of it is asked for."""
    model = box_model(0.3, PLAIN)
    scene = Scene(camera(lens), model, np.eye(4))
    whole = render(scene, POSES["above"], "pyrender")
    for rect in (Rect(100, 80, 190, 150), Rect(0, 0, 131, 240)):
        part = render(scene, POSES["above"], "pyrender", rect=rect)
        for name in part:
            assert np.array_equal(part[name], whole[name][rect.slices]), name


@pytest.mark.opengl
def test_memory_stays_flat_over_many_renders() -> None:
    scene = Scene(camera(), box_model(0.3, PLAIN), np.eye(4))
    stage = Raster()
    from arfx.stages.raster.gl import GlFaces
    from arfx.stages.raster.renderer import Renderer

    renderer = Renderer(scene.mesh, scene.camera, GlFaces, 4)
    assert stage.levels

    def resident_mb() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

    for k in range(550):
        if k == 50:
            before = resident_mb()
        renderer.render(Rect(120, 100, 150 + k % 7, 130 + k % 5), POSES["above"])
    # OSMesa's leak was 6.4 MB a render
    assert resident_mb() - before < 25
