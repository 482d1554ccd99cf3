"""The room in a mirror ball: rays from its surface meet what the camera's rays meet."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.reproduce.s4_pictures import mirror_rays
from arfx.synth.description import parse_scene
from arfx.synth.picture import Picture
from arfx.synth.rays import radiance
from arfx.synth.world import World

SCENE = """
samples = 1
[clip]
width = 64
height = 48
[[shot]]
frames = 1
[[plane]]
size_m = [1.4, 1.2]
position_m = [0, 0, "-1mm"]
texture = { kind = "plain", colour = [0.6, 0.3, 0.1] }
[[sphere]]
radius_m = "5cm"
position_m = [0.05, 0.05, 0.05]
colour = [0.1, 0.2, 0.7]
[[marker]]
spec = "36h11:3:40mm"
position_m = [-0.2, 0, 0]
"""


def test_a_ray_meets_what_the_camera_sees() -> None:
    world = World(parse_scene(SCENE))
    room, pose = world.at(0.0), world.camera_at(0, 0.0).inverse()
    seen = Picture(world).radiance(0)
    pixels = np.array(
        [[33, 22], [20, 40], [50, 30]]
    )  # sphere, the plane before it, beside it
    towards = world.camera.directions(pixels.astype(float)) @ pose.rotation.T
    starts = np.tile(pose.translation_m, (3, 1))
    light, _ = radiance(mirror_rays(starts, towards), room)
    assert light == pytest.approx(seen[pixels[:, 1], pixels[:, 0]], rel=0.02)
    up = mirror_rays(np.array([[0.0, 0, 1]]), np.array([[0.1, 0.2, 3.0]]))
    assert radiance(up, room)[1] == 1, "nothing is met"
