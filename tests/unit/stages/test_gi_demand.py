"""What `gi` leaves out, why, and that nobody can see it."""

from __future__ import annotations

import numpy as np

from arfx.core.model import Material
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.stages.gi import Gi
from tests.scenes import facts
from tests.unit.stages.gi_scenes import CAMERA, LAMP, box, from_above, on_plane

GREY = Material(base_colour=(0.5, 0.5, 0.5, 1.0), specular=0.0, roughness=1.0)


def test_nothing_where_the_object_is_out_of_view() -> None:
    s = on_plane(box(GREY), LAMP, CAMERA)
    f = facts(s, from_above())
    aside = f.with_(
        camera_from_world=Pose(from_above().rotation, np.array([40.0, 0, 0.6])),
        model_box=Rect(0, 0, 0, 0),
    )
    told = Gi().demand(aside, s, CAMERA.rect)
    assert told.rect.empty and "out of view" in told.reason
