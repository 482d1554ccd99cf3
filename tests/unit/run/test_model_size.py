"""An object whose file was read in the wrong unit is told by its size beside the distance;
a camera inside it is an error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from arfx.core.camera import Camera
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.marker import Marker, MarkerSpec
from arfx.core.model import Material, Model, Part
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.scene import Scene
from arfx.errors import ConfigError
from arfx.run.model_size import check_size, model_size, size_in_words

CAMERA = Camera(320, 240, np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]))
DOWN = Pose(
    rotation_from_euler_deg(180, 0, 0), np.array([0.0, 0.0, 0.5])
)  # half a metre above the print
FACTS = [
    FrameFacts(i, i / 25, status=MEASURED, camera_from_world=DOWN) for i in range(4)
]


def scene(side: float, inward: bool = False) -> Scene:
    """A cube that stands on a print of 10 cm."""
    box = trimesh.creation.box((side, side, side))
    box.apply_translation((0, 0, side / 2))
    faces = box.faces[:, ::-1] if inward else box.faces
    part = Part(
        np.array(box.vertices),
        np.array(faces, np.int32),
        np.array(box.vertex_normals),
        material=Material(),
    )
    marker: Marker = MarkerSpec("36h11", 3, 0.1)
    return Scene(
        CAMERA, Model((part,)), np.eye(4), (marker,), {marker.key: Pose.identity()}
    )


def test_sizes_that_fit_say_nothing() -> None:
    assert check_size(scene(0.2), FACTS) == []
    assert model_size(scene(0.2), FACTS) == pytest.approx(
        {"size_m": 0.2, "marker": "36h11:3", "marker_m": 0.1, "distance_m": 0.5}
    )
    assert (
        size_in_words(model_size(scene(0.2), FACTS))
        == "object 200 mm on marker 36h11:3 (100 mm), 500 mm away"
    )


def test_scale_counts() -> None:
    s = scene(200.0)
    assert (
        check_size(
            replace(s, world_from_model=np.diag([1e-3, 1e-3, 1e-3, 1.0])), FACTS
        )
        == []
    )


@pytest.mark.parametrize(("side", "word"), [(0.004, "small"), (20.0, "large")])
def test_what_does_not_fit_is_a_notice_with_the_way_out(
    side: float, word: str
) -> None:
    """The large one is a room seen from within, else the camera would be inside it."""
    (notice,) = check_size(scene(side, inward=True), FACTS)
    assert (
        f"the object is {word}" in notice
        and "--scale" in notice
        and "--fit" in notice
    )


def test_a_camera_inside_the_object_is_an_error() -> None:
    with pytest.raises(
        ConfigError,
        match=(
            r"the camera is inside the object \(object 20 m on marker 36h11:3 "
            r"\(100 mm\), 500 mm away\)"
        ),
    ) as e:
        check_size(scene(20.0), FACTS)
    assert "--scale 0.001" in e.value.hint
    beside = replace(
        scene(20.0),
        world_from_model=np.array(Pose(np.eye(3), np.array([30.0, 0, 0])).matrix),
    )
    assert len(check_size(beside, FACTS)) == 1, (
        "in its box only once it is moved aside"
    )


def test_no_pose_no_word() -> None:
    assert check_size(scene(20.0), [FrameFacts(0, 0.0)]) == []
