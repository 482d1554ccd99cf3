"""Yao, Tao, Wu 2018 as printed: what the stage does to the picture and to the object."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.core.layers import Layer
from arfx.core.light import DirectionalLight, Light
from arfx.papers.s4_cones import cone_steps, cone_trace, six_cones
from arfx.papers.s4_environment import step3_mipmap
from arfx.papers.s4_gi import PrintedGiParams, Surfels, wide_cones
from arfx.papers.s4_volumes import octree_of
from arfx.papers.s4_voxels import Volume
from arfx.run.parameters import quality_notices, stage_of
from arfx.stages.gi import GiParams
from tests.unit.stages import gi_scenes
from tests.unit.stages.gi_scenes import (
    BLACK,
    CAMERA,
    EVEN,
    LAMP,
    MATT_RED,
    MATT_WHITE,
    ball,
    box,
    from_above,
    ground_points,
    inner,
    on_plane,
    plain_plate,
    run_gi,
)

FROM_VIEWER = Light(
    (0.4, 0.4, 0.4), (DirectionalLight((0.1, -0.6, 0.6), (0.6, 0.6, 0.6), 2.0),)
)
POSE = from_above(55)


def small(**changes: Any) -> PrintedGiParams:
    return PrintedGiParams(voxels=32, **changes)


@pytest.mark.parametrize(("changes", "message"), [
    ({"plane_albedo": -1.0}, "plane_albedo\n.*greater than or equal to 0"), ({"voxels": 100}, "voxels\n.*32, 64, 128 or 256"),
])  # fmt: skip
def test_settings_that_mean_nothing(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        PrintedGiParams(**changes)


def near(
    s: Any, pose: Any, made: dict[Layer, np.ndarray], radius_m: float = 0.1
) -> np.ndarray:
    out: np.ndarray = (made[Layer.COVERAGE] == 0) & (
        np.hypot(*np.moveaxis(ground_points(s, pose)[..., :2], -1, 0)) < radius_m
    )
    return out


def test_the_sign_of_the_difference() -> None:
    """V_rho - V_mu, added as its name suggests, takes red light from the plane before a red
    box; it is subtracted.
    """
    s = on_plane(box(MATT_RED), FROM_VIEWER, CAMERA)
    made = run_gi(s, pose=POSE, params=small(plane_gloss=0.0))
    change = (made[Layer.SHADOW] - 1)[near(s, POSE, made)]
    assert change[:, 0].max() > 0.02 and change[:, 0].max() > 5 * change[:, 1].max()
    assert (made[Layer.VIRTUAL][made[Layer.COVERAGE] == 0] == 0).all(), (
        "the picture is changed by the ratio"
    )


def test_a_black_object_hardly_darkens_the_plane() -> None:
    """A lone plane gets no light from itself, so the shadow's negative light does not reach
    it; voxels that hold the plane and the object's foot leak a little."""
    s = on_plane(box(BLACK), LAMP, CAMERA)
    printed, corrected = run_gi(s, params=small()), run_gi(s, "draft")
    around = near(s, from_above(), printed)
    assert (
        printed[Layer.SHADOW][around].mean() > 0.975
        and printed[Layer.SHADOW].max() <= 1
    )
    assert corrected[Layer.SHADOW][around].mean() < 0.93


def test_without_a_light_that_has_a_direction_no_pixel_of_the_plane_changes() -> None:
    made = run_gi(on_plane(box(MATT_RED), EVEN, CAMERA), params=small())
    assert (made[Layer.SHADOW] == 1).all() and (
        made[Layer.VIRTUAL][made[Layer.COVERAGE] == 0] == 0
    ).all()


def test_the_object_is_mirrored_in_the_plane_unless_that_is_switched_off() -> None:
    """Where the traced reference mirrors it, with the light of the lamp alone."""
    s = on_plane(box(MATT_RED), FROM_VIEWER, CAMERA)
    ways: tuple[dict[str, Any], ...] = ({"plane_gloss": 0.0}, {})
    matt, printed = (
        run_gi(s, pose=POSE, params=PrintedGiParams(voxels=64, **p))[Layer.SHADOW]
        for p in ways
    )
    gloss = PrintedGiParams().plane_gloss
    assert gloss > 0
    mirrored = (printed - matt)[..., 0] - (printed - matt)[..., 1]  # red
    reference = [
        run_gi(s, "reference", POSE, params=GiParams(plane_gloss=g, samples=8))[
            Layer.SHADOW
        ]
        for g in (0.0, gloss)
    ]
    truth = (reference[1] - reference[0])[..., 0] - (reference[1] - reference[0])[
        ..., 1
    ]
    y, x = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    middles = []
    for image in (mirrored, truth):
        w = np.where(image > 0.5 * np.percentile(image[image > 0.01], 90), image, 0)
        middles.append(np.array([(w * x).sum(), (w * y).sum()]) / w.sum())
    assert np.linalg.norm(middles[0] - middles[1]) < 1.5, "px"
    assert (
        0.3 < mirrored.sum() / truth.sum() < 0.8
        and np.corrcoef(mirrored.ravel(), truth.ravel())[0, 1] > 0.85
    )


def test_what_stands_before_the_plane_is_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    s = on_plane(box(MATT_RED), FROM_VIEWER, CAMERA)
    whole = run_gi(s, pose=POSE, params=small())
    depth = POSE.apply(ground_points(s, POSE))[..., 2].astype(np.float32)
    depth[:, :80] -= 0.1
    bare = gi_scenes.surface
    monkeypatch.setattr(
        gi_scenes,
        "surface",
        lambda scene, f: bare(scene, f) | {Layer.REAL_DEPTH: depth},
    )
    made = run_gi(s, pose=POSE, params=small())[Layer.SHADOW]
    assert (made[:, :80] == 1).all() and not (whole[Layer.SHADOW][:, :80] == 1).all()
    assert np.array_equal(made[:, 80:], whole[Layer.SHADOW][:, 80:])


def test_no_light_is_taken_that_is_not_there() -> None:
    """The picture never loses more than it shows."""
    s = on_plane(box(BLACK), FROM_VIEWER, CAMERA)
    plate = np.full((CAMERA.height, CAMERA.width, 3), 0.004, np.float32)
    made = run_gi(
        s, pose=POSE, plate=plate, params=small(plane_gloss=1.0, plane_albedo=1.0)
    )
    assert made[Layer.SHADOW].min() >= 0 and np.isfinite(made[Layer.SHADOW]).all()


@pytest.mark.parametrize("voxels", [32, 64])
def test_white_furnace(voxels: int) -> None:
    """A white ball in an even picture: what the leaking voxels of the plane take is little."""
    made = run_gi(
        on_plane(ball(MATT_WHITE), EVEN, CAMERA),
        plate=plain_plate(rgb=(1, 1, 1)),
        params=PrintedGiParams(voxels=voxels),
    )
    assert made[Layer.VIRTUAL][inner(made[Layer.COVERAGE])].mean() == pytest.approx(
        1, abs=0.04
    )


def test_the_object_shows_the_picture() -> None:
    """The environment is folded from this very frame: another picture gives another object."""
    s = on_plane(ball(MATT_WHITE), EVEN, CAMERA)
    red, blue = (
        run_gi(s, plate=plain_plate(rgb=c), params=small())[Layer.VIRTUAL]
        for c in ((0.5, 0, 0), (0, 0, 0.5))
    )
    assert red[..., 0].max() > 0.4 and red[..., 2].max() == 0
    np.testing.assert_allclose(red[..., 0], blue[..., 2], atol=1e-6)


def test_the_plane_lights_the_object_through_the_rebuilt_volume() -> None:
    s = on_plane(ball(MATT_WHITE), LAMP, CAMERA)
    dark, bright = (
        run_gi(s, plate=plain_plate(rgb=(0, 0, 0)), params=small(plane_albedo=a))[
            Layer.VIRTUAL
        ]
        for a in (0.0, 1.0)
    )
    assert bright.max() > 0.05 and (bright >= dark - 1e-6).all()


def test_the_environment_counts_by_what_a_cone_lets_through() -> None:
    """Six cones under a half opaque ceiling, .25 upwards and .15 each of the five others."""
    n = 16
    ceiling = np.array([(x, y, 12) for y in range(n) for x in range(n)])
    made = octree_of(
        Volume(n, (0.0, 0.0, 0.0), 1.0),
        ceiling,
        np.zeros((n * n, 3)),
        np.full(n * n, 0.5),
    )
    V = np.zeros((len(made.tree.eta), 3), np.float32)
    at = Surfels(
        np.array([[8.0, 8.0, 8.0]]),
        np.array([[0.0, 0.0, 1.0]]),
        np.array([[0.0, 0.0, -1.0]]),
    )
    got = wide_cones(
        made, V, at, (step3_mipmap(np.full((6, 8, 8, 3), 0.5)), np.eye(3))
    )[0]
    six, weights, tan_half = six_cones()
    left = cone_trace(made, V, cone_steps(tan_half, n), at.position, six[None])[
        0, :, 3
    ]
    assert weights[0] == pytest.approx(0.25) and weights[1:] == pytest.approx(
        [0.15] * 5
    )
    assert (
        left.max() < 1
        and got[:3] == pytest.approx(0.5 * (weights @ left), rel=1e-3)
        and got[3] == pytest.approx(weights @ left)
    )


def test_a_quality_that_the_paper_does_not_have_is_said() -> None:
    stages = {
        name: stage_of(name, params)
        for name, params in (("gi", PrintedGiParams()), ("lightmap", None))
    }
    assert not quality_notices("standard", stages)
    assert quality_notices("reference", stages) == [
        "--quality reference: gi as printed, which has one level, standard"
    ]
    assert not quality_notices("reference", {"gi": stage_of("gi", GiParams())})
