"""The standard scene is what it claims to be; rows tell medians of runs that took turns
with the yardstick.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.stage import Demand, Stage
from arfx.errors import ConfigError
from arfx.measure import bench as bench_module
from arfx.measure import costs
from arfx.measure.bench import bench
from arfx.measure.bench_scene import ball, bench_scene


class Sleeper(Stage):
    """A stage whose levels take known times."""

    name = "sleeper"
    levels = ("draft", "standard", "reference")

    def demand(self, facts: Any, scene: Any, frame: Any) -> Demand:
        return Demand(facts.model_box, "always")

    def needs(self, out: Any, facts: Any, scene: Any, level: str) -> Any:
        return out.pad(3 if level == "reference" else 0)

    def prepare(self, scene: Any, level: str) -> str:
        return level

    def run(self, view: Any, prepared: str) -> dict:
        assert prepared == view.level, (
            "each level is run with what was prepared for it"
        )
        time.sleep({"draft": 0.002, "standard": 0.02, "reference": 0.08}[prepared])
        return {Layer.IMAGE: view[Layer.IMAGE] * 0.5}


@pytest.fixture
def sleeper(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one stage that there is."""
    for module in (bench_module, costs):
        monkeypatch.setattr(module, "STAGES", {"sleeper": Sleeper})


def test_the_ball_has_6000_triangles_that_face_outwards() -> None:
    model = ball()
    (part,) = model.parts
    assert model.face_count == 6000
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    outwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3)
    assert (outwards > 0).all(), "no degenerate or inward triangle"
    assert np.allclose(np.linalg.norm(part.vertices, axis=1), 0.5)


@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (480, 640)])
def test_it_covers_a_tenth_of_the_picture(size: tuple[int, int]) -> None:
    import cv2

    at = bench_scene(*size)
    pose = at.facts.camera_from_world
    assert pose is not None
    outline = cv2.convexHull(
        at.scene.camera.project(pose.apply(at.scene.model_points_m)).astype(
            np.float32
        )
    )
    assert cv2.contourArea(outline) / (size[0] * size[1]) == pytest.approx(
        0.1, rel=0.02
    )
    assert at.scene.model_points_m[:, 2].min() == pytest.approx(0, abs=1e-9), (
        "it stands on the plane"
    )
    assert at.plate.shape == (size[1], size[0], 3) and at.plate.dtype == np.float32


@pytest.mark.usefixtures("sleeper")
def test_rows_order_levels_by_their_cost() -> None:
    rows = bench([(128, 96)])
    assert [(r["stage"], r["level"], r["size"]) for r in rows] == [
        ("sleeper", le, "128x96") for le in Sleeper.levels
    ]
    assert rows[0]["ms"] < rows[1]["ms"] < rows[2]["ms"]
    for r in rows:
        assert (
            r["ratio"] == pytest.approx(r["ms"] / r["yardstick_ms"])
            and r["yardstick_ms"] > 0
            and r["runs"] >= 3
        )


@pytest.mark.usefixtures("sleeper")
def test_a_stage_or_level_can_be_singled_out() -> None:
    rows = bench([(128, 96), (96, 128)], level="draft")
    assert [(r["level"], r["size"]) for r in rows] == [
        ("draft", "128x96"),
        ("draft", "96x128"),
    ]


@pytest.mark.usefixtures("sleeper")
@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"stage": "sleper"}, "did you mean 'sleeper'"),
        ({"level": "best"}, "reference"),
        ({"sizes": [(10, 10)]}, "1280x720"),
    ],
)
def test_what_is_unknown_is_said_with_what_is_known(
    what: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError) as e:
        bench(**{"sizes": [(128, 96)], **what})
    assert said in e.value.hint
