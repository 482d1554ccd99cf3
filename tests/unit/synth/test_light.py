"""Light and shadow against closed forms: spheres, a straight edge before a lamp of some size."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.unit.synth.little_scenes import from_above, little_scene, picture_of

GREY = {"kind": "plain", "colour": [0.5, 0.5, 0.5]}
FLOOR = {"size_m": [20, 20], "texture": GREY}


def ground_points(world) -> np.ndarray:  # type: ignore[no-untyped-def]
    """(h, w, 3) points of the floor z = 0 at the pixels' centres, camera straight above the
    origin at z = 1.
    """
    camera = world.camera
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    f, (cx, cy) = camera.matrix[0, 0], camera.matrix[:2, 2]
    return np.stack([(x - cx) / f, -(y - cy) / f, np.zeros(x.shape)], -1)


def test_radiance_is_albedo_times_ambient_plus_facing_lamp() -> None:
    lamp = {
        "azimuth_deg": 30,
        "elevation_deg": 50,
        "rgb": [0.4, 0.5, 0.6],
        "angular_size_deg": 0,
    }
    scene = little_scene(
        path=from_above(),
        plane=[FLOOR],
        light={"ambient_rgb": [0.1, 0.2, 0.3], "lamps": [lamp]},
    )
    made = picture_of(scene)[1].radiance(0)
    exact = 0.5 * (
        np.array([0.1, 0.2, 0.3]) + np.array([0.4, 0.5, 0.6]) * np.sin(np.radians(50))
    )
    assert np.abs(made - exact).max() < 1e-9


def test_a_sphere_s_shadow_is_the_cylinder_behind_it() -> None:
    lamp = {
        "azimuth_deg": 20,
        "elevation_deg": 40,
        "rgb": [0.6, 0.6, 0.6],
        "angular_size_deg": 0,
    }
    ball = {
        "radius_m": 0.06,
        "position_m": [0.15, 0.05, 0.1],
        "colour": [0.9, 0.1, 0.1],
    }
    scene = little_scene(
        160,
        120,
        path=from_above(),
        plane=[FLOOR],
        sphere=[ball],
        light={"ambient_rgb": [0.2, 0.2, 0.2], "lamps": [lamp]},
    )
    world, picture = picture_of(scene, samples=1)
    made, (_, owner) = picture.radiance(0)[..., 0], picture.surfaces(0)
    a, e = np.radians(20), np.radians(40)
    to_lamp = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    points = ground_points(world)
    offset = np.array(ball["position_m"]) - points
    distance = np.linalg.norm(np.cross(offset, to_lamp), axis=-1)
    floor = owner == 1
    dark, lit = floor & (distance < 0.059), floor & (distance > 0.061)
    assert dark.sum() > 300, "most of the shadow lies beside the ball"
    assert np.allclose(made[dark], 0.5 * 0.2) and np.allclose(
        made[lit], 0.5 * (0.2 + 0.6 * np.sin(e))
    )
    shadow = points[dark].mean(0) - np.array([0.15, 0.05, 0])
    assert shadow @ to_lamp < -0.08, "it falls away from the lamp"


@pytest.mark.parametrize(
    ("azimuth_deg", "elevation_deg", "size_deg"),
    [(20, 40, 0), (200, 30, 0.02), (-75, 65, 0.02), (-75, 65, 0), (0, 90, 0.02)],
)
@pytest.mark.parametrize("what", ["boxes", "board"])
def test_a_shadow_is_the_outline_of_the_corners(
    what: str, azimuth_deg: float, elevation_deg: float, size_deg: float
) -> None:
    """One box on the floor, one in the air, through which nothing shines; a tilted board,
    with floor on both its sides.
    """
    lamp = {
        "azimuth_deg": azimuth_deg,
        "elevation_deg": elevation_deg,
        "rgb": [0.6] * 3,
        "angular_size_deg": size_deg,
    }
    boxes = [
        {
            "size_m": [0.12, 0.08, 0.1],
            "position_m": [0.1, 0.05, 0],
            "rotate_deg": [0, 0, 25],
            "texture": GREY,
        },
        {
            "size_m": [0.1, 0.06, 0.05],
            "position_m": [-0.15, -0.1, 0.15],
            "rotate_deg": [20, -15, 40],
            "texture": GREY,
        },
    ]
    board = {
        "size_m": [0.12, 0.08],
        "position_m": [0.05, 0.1, 0.12],
        "rotate_deg": [35, 20, 10],
        "texture": GREY,
    }
    objects = (
        {"plane": [FLOOR], "box": boxes}
        if what == "boxes"
        else {"plane": [FLOOR, board]}
    )
    scene = little_scene(
        160,
        120,
        path=from_above(),
        **objects,
        light={"ambient_rgb": [0.2] * 3, "lamps": [lamp]},
    )
    world, picture = picture_of(scene, samples=1)
    made, (_, owner) = picture.radiance(0)[..., 0], picture.surfaces(0)
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    points = ground_points(world)[..., :2].astype(np.float32)
    inside = np.full(owner.shape, -np.inf)
    for thing, pose in zip(
        boxes if what == "boxes" else [board], world.poses(0.0)[1:], strict=True
    ):
        w, d, h = (*thing["size_m"], 0)[:3]
        corners = pose.apply(
            np.array(
                [
                    (x, y, z)
                    for x in (-w / 2, w / 2)
                    for y in (-d / 2, d / 2)
                    for z in (0, h)
                ]
            )
        )
        hull = cv2.convexHull(
            (corners - corners[:, 2:] / towards[2] * towards)[:, :2].astype(
                np.float32
            )
        )
        distance = [
            cv2.pointPolygonTest(hull, (float(x), float(y)), True)
            for x, y in points.reshape(-1, 2)
        ]
        inside = np.maximum(inside, np.reshape(distance, owner.shape))
    floor = owner == 1
    dark, lit = floor & (inside > 1e-3), floor & (inside < -1e-3)
    assert lit.sum() > 3000 and dark.sum() > (60 if elevation_deg < 90 else 0)
    assert np.allclose(made[dark], 0.5 * 0.2) and np.allclose(
        made[lit], 0.5 * (0.2 + 0.6 * np.sin(e))
    )


def test_penumbra_is_as_wide_as_the_lamp_and_the_height_make_it() -> None:
    """A straight edge at height H before a disc of angular size s, overhead: the penumbra
    reaches H·tan(s/2) either way.
    """
    size_deg, height = 12.0, 0.3
    lamp = {
        "azimuth_deg": 0,
        "elevation_deg": 90,
        "rgb": [1, 1, 1],
        "angular_size_deg": size_deg,
    }
    roof = {
        "size_m": [4, 4],
        "position_m": [2, 0, height],
        "texture": GREY,
    }  # its edge is above x = 0
    scene = little_scene(
        160, 120, path={"kind": "static", "position_m": [-0.5, 0, 0.25], "target_m": [-0.05, 0, 0]}, plane=[FLOOR, roof],
        light={"ambient_rgb": [0, 0, 0], "lamps": [lamp]},
    )  # fmt: skip
    world, picture = picture_of(scene, samples=4)
    made, (depth, owner) = picture.radiance(0)[..., 0] / 0.5, picture.surfaces(0)
    camera_points = (
        np.concatenate([picture.rays(0, 0), np.ones((120, 160, 1))], -1)
        * depth[..., None]
    )
    x = world.camera_at(0, 0.0).inverse().apply(camera_points)[..., 0]
    reach = height * np.tan(np.radians(size_deg / 2))
    u = np.clip(-x / reach, -1, 1)
    exact = (
        0.5 + (u * np.sqrt(1 - u * u) + np.arcsin(u)) / np.pi
    )  # area of a unit disc on one side of a chord
    floor = owner == 1
    floor &= cv2.erode(floor.astype(np.uint8), np.ones((3, 3))).astype(bool)
    assert ((exact > 0.1) & (exact < 0.9) & floor).sum() > 500
    error = (made - exact)[floor]
    assert np.sqrt((error**2).mean()) < 0.03 and abs(error.mean()) < 0.01


def test_lamps_switch_fade_and_swing() -> None:
    lamp = {
        "azimuth_deg": 10, "elevation_deg": 40, "rgb": [0.6, 0.4, 0.2], "swing_deg": [30, 5], "period_s": 4.0,
        "brightness": [[0.5, 1.0], [0.5, 0.0], [1.5, 1.0]],
    }  # fmt: skip
    world = picture_of(
        little_scene(path=from_above(), plane=[FLOOR], light={"lamps": [lamp]})
    )[0]
    rgb = lambda t: world.lights_at(t)[0, 3:6]  # noqa: E731
    assert rgb(0.49) == pytest.approx([0.6, 0.4, 0.2]) and rgb(0.5) == pytest.approx(
        [0, 0, 0]
    )
    assert rgb(1.0) == pytest.approx([0.3, 0.2, 0.1]) and rgb(9.0) == pytest.approx(
        [0.6, 0.4, 0.2]
    )

    def azimuth(t: float) -> float:
        x, y = world.lights_at(t)[0, :2]
        return np.degrees(np.arctan2(y, x))

    assert (
        azimuth(0) == pytest.approx(10)
        and azimuth(1.0) == pytest.approx(40)
        and azimuth(3.0) == pytest.approx(-20)
    )
    assert np.degrees(np.arcsin(world.lights_at(1.0)[0, 2])) == pytest.approx(45)


def test_one_sample_stands_for_all_only_where_nothing_ends() -> None:
    """The same as with every sample in every pixel, which a shutter, however short, asks for."""
    lamp = {
        "azimuth_deg": 20,
        "elevation_deg": 40,
        "rgb": [0.6] * 3,
        "angular_size_deg": 8,
    }
    parts = {
        "plane": [
            FLOOR,
            {
                "size_m": [0.12, 0.08],
                "position_m": [0.05, 0.1, 0.12],
                "rotate_deg": [35, 20, 10],
                "texture": GREY,
            },
        ],
        "marker": [
            {
                "spec": "36h11:3:200mm",
                "position_m": [-0.2, -0.1, 0.001],
                "rotate_deg": [0, 0, 30],
            }
        ],
        "light": {"ambient_rgb": [0.2] * 3, "lamps": [lamp]},
    }
    few, every = (
        picture_of(
            little_scene(160, 120, path=from_above(), lens={"shutter_s": s}, **parts),
            3,
        )[1].radiance(0)
        for s in (0, 1e-9)
    )
    assert np.abs(few - every).max() < 1e-6
