"""Dof's draft looks at no pixel of the plate that was not asked for."""

from typing import Any

import numpy as np
import pytest

from arfx.core import pixels
from arfx.core.layers import Layer
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.stage import level_named
from arfx.plan.planner import plan_frame
from arfx.run.frame import ready_stages, run_frame
from arfx.stages import STAGES
from arfx.stages.dof.params import DofParams
from tests.scenes import box_model, camera, facts, look_at, scene
from tests.unit.stages.dof_scenes import texture

CHAIN = ("raster", "lightmap", "composite", "dof")


class Unset:
    """numpy, whose empty arrays hold NaN."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def empty(self, shape: Any, dtype: Any) -> np.ndarray:
        return np.full(shape, np.nan, dtype)


@pytest.mark.parametrize("level", ["draft", "standard"])
@pytest.mark.parametrize("aperture_px, focus", [(1.6, "80cm"), (3.0, "40cm")])
@pytest.mark.parametrize("roll_deg", [35.0, 60.0, 155.0])
def test_a_plate_that_is_made_in_parts_gives_a_finite_picture(
    level: str, roll_deg: float, aperture_px: float, focus: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not where its memory holds NaN, as that of other arrays may: a rolled camera, a part of the plane in focus."""
    s = scene(camera(640, 480), box_model(), 0.03)
    seen, turn = look_at(0.6, 50.0), np.radians(roll_deg)
    roll = Pose(np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]), np.zeros(3))
    f = facts(s, roll @ seen)
    stages = {n: STAGES[n](DofParams(aperture_px=aperture_px, focus=focus)) if n == "dof" else STAGES[n]() for n in CHAIN}
    levels = {n: level_named(stages[n].levels, level) for n in CHAIN}
    plate = texture(480, 640)
    plan = plan_frame(list(stages.values()), levels, f, s, s.camera.rect)
    ready = ready_stages(plan, stages, s)
    monkeypatch.setattr(pixels, "np", Unset())
    asked: list[Rect] = []

    def part(rect: Rect) -> np.ndarray:
        asked.append(rect)
        return plate[rect.slices]

    out = run_frame(Pixels(s.camera.rect, rest=part), f, plan, ready)
    image = out.layers.stored[Layer.IMAGE]
    assert sum(r.area for r in asked) < 0.95 * s.camera.rect.area, "some of the plate is not made"
    for r in image.written.rects:
        assert np.isfinite(image.array[r.slices_in(image.part)]).all()
