"""Stage dof: settings, key frames, the real scene's surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.lens import Lens, LensFit, circle_of_confusion_mm
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.errors import ConfigError, InputError
from arfx.papers.s2_dof import PrintedDof
from arfx.stages.dof import Dof
from arfx.stages.dof.aperture import disc
from arfx.stages.dof.optics import circle_of_confusion, focal_mm, focus_dioptre
from arfx.stages.dof.params import (
    DofParams,
    fnumber_keys,
    focal_keys,
    focus_keys,
    interpolate,
)
from arfx.stages.dof.planes import direction_grid, plane_of, real_scene
from arfx.stages.viewing import between_nodes
from tests.scenes import facts, look_at, scene
from tests.unit.stages.dof_scenes import Shot, blurred, shot


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"scope": "real"}, "'all' or 'virtual'"),
        ({"lens": "footage"}, "blur the footage twice"),
        ({"fnumber": 0.0}, "between 0.001 and inf, is 0"),
        ({"fnumber": "wide"}, "is not a number"),
        ({"focal_mm": -5.0}, "between 0 and 1e.06, is -5"),
        ({"focal_mm": "50@0s, 2e6@1s"}, "is 2e.06"),
        ({"focal_mm": "nan"}, "between 0 and 1e.06"),
        ({"focal_mm": "long"}, "'long' is not a number"),
        ({"focal_mm": "50, 85@1s"}, "has no time"),
        ({"focal_mm": "50@1s, 85@1s"}, "must rise"),
        ({"sensor_width_mm": 0.0}, "greater than 0"),
        ({"aperture_px": -1.0}, "greater than or equal to 0"),
        ({"blades": 2}, "3 to 32"),
        ({"focus": "60"}, None),
        ({"focus": "-5cm"}, "above 0"),
        ({"focus": "the cat"}, "neither object, marker"),
        ({"focus": "object, 1m"}, "has no time"),
        ({"focus": "object@2s, 1m@1s"}, "must rise"),
    ],
)
def test_settings_say_what_would_be_right(setting: dict, words: str | None) -> None:
    if words is None:
        DofParams(**setting)
        return
    with pytest.raises(ValidationError, match=words):
        DofParams(**setting)


def test_key_frames() -> None:
    assert focus_keys("object@0s, 36h11:3@1.5s, 2m@3s, inf@4s") == [
        (0, "object"),
        (1.5, "id:36h11:3"),
        (3, 2.0),
        (4, np.inf),
    ]
    assert focus_keys(3) == [(0.0, "id:3")]
    assert fnumber_keys("f/2.8@1s, 11@3s") == [(1.0, 2.8), (3.0, 11.0)]
    assert focal_keys("35mm@1s, 0@3s") == [(1.0, 35.0), (3.0, 0.0)]
    assert [
        interpolate([(1.0, 2.0), (3.0, 6.0)], t) for t in (0.0, 1.0, 2.0, 3.0, 9.0)
    ] == [2.0, 2.0, 4.0, 6.0, 6.0]


def test_focus_follows_what_it_is_set_to() -> None:
    s = scene()
    f = facts(s)
    pose = f.camera_from_world
    assert pose is not None
    corners = pose.apply(s.model_corners_m)[:, 2]

    def distance(focus: str, at: FrameFacts = f) -> float:
        return 1 / focus_dioptre(DofParams(focus=focus), at, s)

    assert (
        distance("marker")
        == distance("3")
        == distance("36h11:3")
        == pytest.approx(0.5)
    )
    assert distance("object") == pytest.approx((corners.min() + corners.max()) / 2)
    assert distance("80cm") == pytest.approx(0.8)
    rack = "marker@0s, 1m@2s"  # steady in dioptres: 2, 1.5, 1
    assert [
        distance(rack, f.with_(time_s=t)) for t in (0.0, 1.0, 2.0)
    ] == pytest.approx([0.5, 1 / 1.5, 1.0])
    with pytest.raises(ConfigError, match="there is no marker '7'"):
        distance("7")


def test_circles_are_those_of_the_lens() -> None:
    s = scene()
    f = facts(s)
    params = DofParams(
        focal_mm=50.0, fnumber="2@0s, 8@2s", sensor_width_mm=24.0, focus="80cm"
    )
    distance = np.array([0.3, 0.79, 0.8, 2.0, 1e3, np.inf])
    for time, fnumber in ((0.0, 2.0), (1.0, 4.0), (2.0, 8.0)):
        at = circle_of_confusion(params, f.with_(time_s=time), s)
        mm = circle_of_confusion_mm(1e3 * distance, Lens(50.0, fnumber, 800.0))
        px = (
            np.minimum(mm / 24.0, 0.2) * s.camera.width
        )  # the radius is bounded by a tenth of the width
        np.testing.assert_allclose(
            2 * at.radius_px(1 / distance), px, rtol=1e-9, atol=1e-9
        )
    own = circle_of_confusion(DofParams(focus="80cm"), f, s)
    focal = s.camera.fx * 36 / s.camera.width
    assert own.px_per_dioptre == pytest.approx(
        circle_of_confusion(
            DofParams(focal_mm=focal, focus="80cm"), f, s
        ).px_per_dioptre
    )
    zoom = DofParams(focal_mm="0@0s, 100@2s", focus="80cm")
    at_s = [focal_mm(zoom, f.with_(time_s=t), s) for t in (0.0, 1.0, 2.0, 3.0)]
    assert at_s == pytest.approx([focal, np.sqrt(focal * 100), 100, 100])
    px = circle_of_confusion(DofParams(aperture_px=30.0, focus="80cm"), f, s)
    assert 2 * px.radius_px(0.0) == pytest.approx(30.0)


@pytest.mark.parametrize("made", [Dof, PrintedDof])
def test_lens_and_focus_move_by_key_frames(made: type[Dof]) -> None:
    """A frame between two key frames looks as under the lens that they give there, set once
    for all.
    """
    at, fixed = (
        shot(),
        {"focal_mm": 40.0, "fnumber": 4.0, "focus": "50cm", "background_m": 2.0},
    )
    half = Shot(at.scene, at.facts.with_(time_s=1.0), at.layers)

    def of(where: Shot, **more: object) -> np.ndarray:
        return blurred(where, "standard", made=made, **{**fixed, **more})

    for name, keys, between in (
        ("focal_mm", "20@0s, 80@2s", 40.0), ("fnumber", "1@0s, 16@2s", 4.0), ("focus", "40cm@0s, 66.66666667cm@2s", "50cm"),
    ):  # fmt: skip
        np.testing.assert_allclose(
            of(half, **{name: keys}),
            of(half, **{name: between}),
            atol=1e-6,
            err_msg=name,
        )
        assert (
            np.abs(of(at, **{name: keys}) - of(half, **{name: keys})).max() > 5e-3
        ), name
    with pytest.raises(
        InputError, match="lens of 500 mm cannot be focused at 500 mm"
    ):
        of(half, focal_mm="20@0s, 500@0.5s")


def test_the_real_plane_has_the_depth_of_its_points() -> None:
    s = scene()
    pose = look_at()
    grid = direction_grid(s.camera)
    real = real_scene(s, pose, 0.0)
    assert real.base is not None and not real.finite_planes
    points = np.array([[0.05, 0.02, 0], [-0.1, 0.08, 0], [0.11, -0.09, 0.0]])
    z = pose.apply(points)[:, 2]
    dioptres = real.dioptres(grid, s.camera.rect)
    at = np.rint(s.camera.project(pose.apply(points))).astype(int)
    np.testing.assert_allclose(
        dioptres[at[:, 1], at[:, 0]], 1 / z, rtol=4e-3
    )  # half a pixel beside the point
    part = Rect(33, 17, 90, 61)
    np.testing.assert_array_equal(real.dioptres(grid, part), dioptres[part.slices])
    with_wall = real_scene(s, pose, 0.55)
    low, high = with_wall.dioptre_range(grid)
    assert low == pytest.approx(1 / 0.55) and high > 2


def test_a_plane_of_limited_size_ends_where_it_is_said_to() -> None:
    s, pose = scene(), look_at()
    plane = plane_of(pose @ s.world_from_anchor, 0.1)
    inside = plane.within(
        between_nodes(plane.positions(direction_grid(s.camera)), s.camera.rect)
    )
    for x, seen in ((0.095, True), (-0.095, True), (0.107, False), (-0.107, False)):
        for point in ([x, 0, 0], [0, x, 0]):
            u, v = np.rint(
                s.camera.project(pose.apply(np.array(point, float)))
            ).astype(int)
            if 0 <= u < s.camera.width and 0 <= v < s.camera.height:
                assert inside[v, u] == seen, point


def test_a_marker_that_stands_up_is_a_surface_of_its_own() -> None:
    s = scene()
    wall = MarkerSpec("36h11", 9, 0.08)
    stands = Pose(rotation_from_euler_deg(90, 0, 0), np.array([0.0, 0.15, 0.05]))
    flat = Pose(np.eye(3), np.array([0.2, 0, 0.0]))
    beside = MarkerSpec("36h11", 10, 0.08)
    where = {**s.world_from_marker, wall.key: stands, beside.key: flat}
    more = Scene(
        s.camera, s.model, s.world_from_model, (*s.markers, wall, beside), where
    )
    real = real_scene(more, look_at(), 0.0)
    assert len(real.finite_planes) == 1 and real.finite_planes[
        0
    ].half_m == pytest.approx(0.05)


def test_a_plane_seen_edge_on_is_nowhere() -> None:
    plane = plane_of(Pose(rotation_from_euler_deg(90, 0, 0), np.zeros(3)), 0.0)
    assert not plane.positions(direction_grid(scene().camera)).any()


@pytest.mark.parametrize("blades", [0, 3, 6])
def test_shapes_are_even_and_as_large_as_the_disc(blades: int) -> None:
    for radius in (0.5, 0.9, 2.0, 5.3, 16.0):
        light = disc(radius, blades, 20.0)
        y, x = np.indices(light.shape) - len(light) // 2
        assert light.min() >= 0 and light.sum() == pytest.approx(1.0, abs=1e-5)
        if radius > 2:
            assert light.max() == pytest.approx(1 / (np.pi * radius**2), rel=0.01), (
                "full pixels get alike"
            )
            assert (
                abs(float((light * x).sum())) < 0.02
                and abs(float((light * y).sum())) < 0.02
            )


def test_the_footages_lens_is_used_where_it_is_known() -> None:
    at = shot()
    stage, frame = (
        Dof(DofParams(lens="footage", scope="virtual")),
        at.scene.camera.rect,
    )
    assert (
        stage.demand(at.facts, at.scene, frame).reason
        == "the lens of the footage was not measured"
    )
    np.testing.assert_array_equal(
        blurred(at, "standard", lens="footage", scope="virtual"),
        at.layers[Layer.IMAGE],
    )
    refused = at.facts.with_(lens=LensFit(False, "too few edges"))
    assert stage.demand(refused, at.scene, frame).reason.endswith(
        "from the footage: too few edges"
    )
    fit = LensFit(True, "", 9.0, 0.5)
    known = Shot(at.scene, at.facts.with_(lens=fit), at.layers)
    assert not stage.demand(known.facts, at.scene, frame).rect.empty
    same = blurred(
        at, "standard", scope="virtual", aperture_px=9.0, focus="2m"
    )  # 9 px a dioptre, radius
    np.testing.assert_allclose(
        blurred(known, "standard", lens="footage", scope="virtual"), same, atol=1e-6
    )
