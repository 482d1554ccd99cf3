"""Zhao et al. 2012 as printed: the paper's numbers, the poles of its limits, bleed and blend."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.config.load import load
from arfx.core.layers import Layer
from arfx.core.lens import Lens, circle_of_confusion_mm
from arfx.core.rect import Rect
from arfx.errors import InputError
from arfx.papers.s2_dof import (
    INSIDE,
    GaussianDof,
    PrintedDof,
    PrintedDofParams,
    blur_factor,
    dioptres,
    eq7_circle,
    eq8_bleed,
    mean_filter,
    sharp_range,
    within_depth_of_field,
)
from arfx.papers.s2_lens import (
    eq1_circle,
    eq2_picture,
    eq3_circle,
    eq4_front,
    eq5_back,
    hyperfocal,
    printed_limits,
)
from arfx.run.parameters import parameters, stage_of
from arfx.stages.dof import Dof
from arfx.stages.dof.optics import CircleOfConfusion, circle_of_confusion
from arfx.stages.dof.planes import Plane, Real, direction_grid, plane_of
from tests.scenes import facts, scene
from tests.unit.stages.dof_scenes import Shot, blurred, shot, with_layers

EXAMPLE = Lens(200.0, 11.0, 2500.0)
COC = 0.035


def test_numbers_of_the_paper() -> None:
    d = printed_limits(EXAMPLE, COC)
    assert d.front_mm is not None and d.back_mm is not None
    assert d.front_mm == pytest.approx(
        58.7428, abs=1e-4
    ) and d.back_mm == pytest.approx(61.6394, abs=1e-4)
    assert d.front_mm + d.back_mm == pytest.approx(120.3822, abs=1e-4)
    assert d.total_mm == pytest.approx(120.3125, abs=1e-4)
    assert d.hyperfocal_mm == pytest.approx(103_896.10, abs=0.01)
    assert d.coc_at_infinity_mm == pytest.approx(1.58103, abs=1e-5)
    assert (2500 - d.front_mm) / 1e3 == pytest.approx(2.4413, abs=1e-4)
    assert (2500 + d.back_mm) / 1e3 == pytest.approx(2.5616, abs=1e-4)


@pytest.mark.parametrize("step", [-1e-9, 0.0, 1e-9])
def test_around_the_hyperfocal_distance(step: float) -> None:
    h = hyperfocal(11.0, COC, 200.0)
    printed = printed_limits(Lens(200.0, 11.0, h * (1 + step)), COC)
    assert printed.front_mm == pytest.approx(h / 2, rel=1e-8)
    assert (
        printed.back_mm is None
        if step > 0
        else printed.back_mm is None or printed.back_mm > 1e12
    )


def test_a_closed_aperture_has_no_limit_behind() -> None:
    for fnumber in (1e12, math.inf):
        d = printed_limits(Lens(50.0, fnumber, 1000.0), COC)
        assert (
            d.front_mm == pytest.approx(1000.0)
            and d.back_mm is None
            and d.total_mm is None
        )
    with pytest.raises(InputError, match="circle of confusion"):
        printed_limits(EXAMPLE, 0.0)


def test_settings_say_what_would_be_right() -> None:
    for setting, words in (
        ({"mean_px": 4}, "odd"),
        ({"near_m": -1.0}, "greater than or equal to 0"),
        ({"coc_mm": 0.0}, "greater than 0"),
    ):
        with pytest.raises(ValidationError, match=words):
            PrintedDofParams(**setting)  # type: ignore[arg-type]


def test_bleed_as_printed() -> None:
    """Centre 100 among 100, 120, 90, 180, 100, 60, 100, 140: weights 1/7, 4/7, 2/7 of the
    brighter ones.
    """
    grey = np.array([[100, 120, 90], [180, 100, 100], [60, 100, 140]], np.float32)
    colour = np.repeat(grey[..., None], 3, -1)
    even = np.ones((3, 3), np.float32)
    np.testing.assert_allclose(eq8_bleed(colour, even)[1, 1], 160.0, rtol=1e-5)
    dark = np.where(grey == 100, grey, 50).astype(np.float32)
    assert (eq8_bleed(np.repeat(dark[..., None], 3, -1), even)[1, 1] == 100).all()
    nearer = even.copy()
    nearer[1, 0] = 2.0  # 180 stands in front: it does not flow into what is behind
    np.testing.assert_allclose(
        eq8_bleed(colour, nearer)[1, 1], (20 * 120 + 40 * 140) / 60, rtol=1e-5
    )


def at_distances(
    *distance_m: float,
) -> tuple[np.ndarray, CircleOfConfusion, tuple[float, float]]:
    """Dioptres, the example's lens in pixels, and its sharp range."""
    s = scene()
    params = PrintedDofParams(focal_mm=200.0, fnumber=11.0, focus="2500mm")
    at = circle_of_confusion(params, facts(s), s)
    return 1 / np.array(distance_m), at, sharp_range(at, 200.0, COC)


def test_blend_factor_as_printed() -> None:
    dioptre, at, sharp = at_distances(2.5, 2.52, 5.0, 100.0)
    a = blur_factor(dioptre, (1 / 100.0, 1 / 2.0), at)
    circle = circle_of_confusion_mm(1e3 / dioptre, EXAMPLE)
    assert circle[1] < COC < circle[2]
    np.testing.assert_allclose(a, circle / circle[3], rtol=1e-9)
    np.testing.assert_allclose(
        within_depth_of_field(dioptre, sharp, 0.0), [2 / 3, 2 / 3, 1, 1]
    )


def test_equations_of_the_circle_agree() -> None:
    picture = eq2_picture(200.0, 2500.0)
    for other in (600.0, 2499.0, 2500.0, 1e4):
        circle = eq3_circle(200.0, 11.0, 2500.0, other)
        assert eq1_circle(picture, 2500.0, other, 200.0 / 11.0) == pytest.approx(
            circle, rel=1e-12
        )
        dioptre, at, _ = at_distances(other / 1e3)
        assert eq7_circle(dioptre, at)[0] == pytest.approx(circle, abs=1e-9)


def test_inside_lies_between_the_printed_limits() -> None:
    """Where the circle of (7) is larger than the permitted one already: (4) and (5) leave
    out that L counts less F.
    """
    *_, sharp = at_distances()
    front, back = (
        eq4_front(11.0, COC, 2500.0, 200.0),
        eq5_back(11.0, COC, 2500.0, 200.0),
    )
    assert back is not None
    assert [1e3 / d for d in sharp] == pytest.approx(
        [2500 + back, 2500 - front], rel=1e-12
    )
    within = 2500 - front + 0.5, 2500 + back - 0.5
    dioptre, at, _ = at_distances(*(d / 1e3 for d in within))
    assert (within_depth_of_field(dioptre, sharp, 0.0) == 2 / 3).all() and (
        eq7_circle(dioptre, at) > COC
    ).all()


@pytest.mark.parametrize(
    ("step", "all_behind"), [(-1e-6, False), (1e-6, True), (1.0, True)]
)
def test_beyond_the_hyperfocal_distance_all_behind_is_inside(
    step: float, all_behind: bool
) -> None:
    s, h = scene(), hyperfocal(11.0, COC, 200.0)
    params = PrintedDofParams(
        focal_mm=200.0, fnumber=11.0, focus=f"{h * (1 + step):.6f}mm"
    )
    at = circle_of_confusion(params, facts(s), s)
    sharp = sharp_range(at, 200.0, COC)
    assert (sharp[0] < 0) == all_behind and np.isfinite(sharp).all()
    factor = within_depth_of_field(np.array([0.0, at.focus, 1 / 30.0]), sharp, 0.0)
    np.testing.assert_allclose(factor, [INSIDE if all_behind else 1, INSIDE, 1])


def test_the_border_of_the_depth_of_field_is_smooth() -> None:
    """No step where the depth of field ends; the border is its own middle, and a hard one
    takes a third at once.
    """
    *_, sharp = at_distances()
    dioptre = np.linspace(sharp[0] - 0.02, sharp[1] + 0.02, 2001)
    for border, step in ((0.0, 1 / 3), (0.5, 0.002), (1.0, 0.001)):
        factor = within_depth_of_field(dioptre, sharp, border)
        assert factor.min() == pytest.approx(INSIDE) and factor[
            [0, -1]
        ] == pytest.approx(1.0)
        assert (
            (np.abs(np.diff(factor)).max() > 0.3)
            if border == 0
            else (np.abs(np.diff(factor)).max() < step)
        )
        if border:
            np.testing.assert_allclose(
                within_depth_of_field(np.array(sharp), sharp, border), 5 / 6
            )
    with pytest.raises(ValidationError, match=r"border\n.*less than or equal to 1"):
        PrintedDofParams(border=1.5)


def test_the_mean_keeps_what_stands_in_front_out_of_what_is_behind() -> None:
    colour, dioptre = (
        np.zeros((9, 20, 3), np.float32),
        np.full((9, 20), 0.5, np.float32),
    )
    colour[:, 10:], dioptre[:, 10:] = 1.0, 2.0  # white, in front
    for n, edge in ((5, 2), (1, 0)):
        out = mean_filter(colour, dioptre, np.ones(n, np.float32))
        assert (out[:, :10] == 0).all(), "none of it in what is behind"
        assert np.allclose(out[:, 10 + edge :], 1) and (
            n == 1 or ((out[:, 10:12] > 0.3).all() and (out[:, 10] < 0.7).all())
        )
    even = mean_filter(colour, np.ones_like(dioptre), np.ones(5, np.float32))
    np.testing.assert_allclose(
        even[4, 6:14, 0], [0, 0, 0.2, 0.4, 0.6, 0.8, 1, 1], atol=1e-6
    )


def test_the_gaussian_does_not_ask_for_luminance() -> None:
    """A bright and a dark point spread alike, with the standard deviation of the mean; as
    printed the bright one spreads more.
    """
    flat = np.ones((21, 21), np.float32)
    grey, y = np.full((2, 21, 21, 3), 0.5, np.float32), np.arange(21) - 10
    grey[0, 10, 10], grey[1, 10, 10] = 1.0, 0.0
    of = {
        made: [
            made(made.Params(mean_px=5)).blurred(c, flat)[..., 0] - 0.5 for c in grey
        ]
        for made in (PrintedDof, GaussianDof)
    }
    bright, dark = of[GaussianDof]
    np.testing.assert_allclose(bright, -dark, atol=1e-6)
    assert (bright.sum(0) * y**2).sum() / bright.sum() == pytest.approx(2.0, rel=0.02)
    bright, dark = of[PrintedDof]
    assert (bright > 1e-4).sum() > 1.5 * (dark < -1e-4).sum()


def test_the_settings_choose_the_gaussian() -> None:
    config = load(None, {"dof": {"formula": "gaussian", "mean_px": 7}}, parameters())
    stage = stage_of("dof", config.params["dof"])
    assert isinstance(stage, GaussianDof) and stage.params.mean_px == 7
    assert "gaussian" not in parameters()["light"]


def test_finite_planes_are_where_they_stand() -> None:
    """A plane of limited size hides what is behind: the background begins at its edge."""
    at = shot()
    s = at.scene
    plane = plane_of(at.facts.pose @ s.world_from_anchor, 0.15)
    real = Real(Plane(np.zeros((3, 3)), 0.0), (plane,), 0.2)
    found = dioptres(
        at.layers,
        at.facts.with_(model_box=Rect(0, 0, 0, 0)),
        real,
        direction_grid(s.camera),
    )
    bare = at.layers[Layer.COVERAGE] == 0
    corners = at.facts.pose.apply(
        np.array([[x, y, 0.0] for x in (-0.12, 0.12) for y in (-0.12, 0.12)])
    )
    u, v = np.rint(s.camera.project(corners)).astype(int).T
    seen = bare[v, u]
    assert seen.any()
    np.testing.assert_allclose(found[v, u][seen], 1 / corners[seen, 2], rtol=0.01)
    assert (found[bare] == np.float32(0.2)).any() and (
        (found[bare] == np.float32(0.2)) | (found[bare] > 1)
    ).all()


def test_all_virtual_scene_takes_every_distance_from_the_model() -> None:
    """A model that fills the picture: no pixel of the real scene counts."""
    at = shot()
    h, w = at.layers[Layer.COVERAGE].shape
    depth = np.broadcast_to(np.linspace(0.3, 3.0, w, dtype=np.float32), (h, w)).copy()
    image = at.layers[Layer.IMAGE]
    full = with_layers(
        at, coverage=np.ones((h, w), np.float32), depth=depth, virtual=image
    )
    virtual = Shot(
        at.scene,
        at.facts.with_(depth_range_m=(0.3, 3.0), model_box=at.layers.rect),
        full.layers,
    )
    for made in (PrintedDof, GaussianDof, Dof):
        out = blurred(virtual, "standard", made=made, aperture_px=30.0, focus="60cm")
        change = np.abs(out - image).max(-1)
        sharp = np.abs(1 / depth[0] - 1 / 0.6) < 0.02
        assert (
            change[:, sharp].mean() < 0.3 * change[:, -40:].mean()
            and np.isfinite(out).all()
        ), made


def test_the_blur_fades_with_the_object() -> None:
    at = shot()
    image = at.layers[Layer.IMAGE]
    whole, part = (
        blurred(Shot(at.scene, at.facts.with_(opacity=o), at.layers), "standard", made=PrintedDof, aperture_px=200.0)
        for o in (1.0, 0.1)
    )  # fmt: skip
    assert 0 < np.abs(part - image).mean() < 0.2 * np.abs(whole - image).mean()


def test_the_printed_formula_blurs_the_whole_picture_or_nothing() -> None:
    at = shot()
    frame, image = at.scene.camera.rect, at.layers[Layer.IMAGE]
    out = blurred(at, "standard", made=PrintedDof, aperture_px=20.0, focus="object")
    assert np.isfinite(out).all() and 0.002 < np.abs(out - image).mean() < 0.1
    np.testing.assert_array_equal(
        blurred(at, "standard", made=PrintedDof, fnumber=1e9), image
    )
    stage = PrintedDof(PrintedDofParams(aperture_px=20.0, focus="object"))
    assert stage.demand(at.facts, at.scene, frame).rect == frame
