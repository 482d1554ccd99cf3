"""Every stage x level x seed keeps the laws; broken stages are caught."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.rect import Rect
from arfx.core.stage import LEVELS, Demand, ReadyStage, Stage
from arfx.papers import FORMULAS
from arfx.plan.planner import ABSENT, plan_frame
from arfx.stages import STAGES
from tests.contract import stage_laws as laws
from tests.scenes import camera, facts, scene

SCENE = scene(camera(160, 120, (0.05, -0.02, 0.001, 0.0005)))
FACTS = facts(SCENE)
PRINTED = {
    f"{formula} {name}": table[name]
    for formula, table in FORMULAS.items()
    for name in STAGES
    if name in table
}
CLASSES = {**STAGES, **PRINTED}
CASES = [
    (name, level)
    for name, stage in CLASSES.items()
    for level in range(len(stage.levels))
]
IDS = [f"{name}-{CLASSES[name].levels[level]}" for name, level in CASES]


# the laws hold for any number of rays and voxels
QUICK: dict[str, dict[str, Any]] = {
    "gi": {"samples": 2},
    "printed gi": {"voxels": 32},
}


@cache
def made(name: str, level: int) -> ReadyStage:
    stage = CLASSES[name](CLASSES[name].Params(**QUICK.get(name, {})))
    return ReadyStage.of(stage, SCENE, stage.levels[level])


@pytest.mark.parametrize(("name", "level"), CASES, ids=IDS)
def test_declares_what_the_contract_asks(name: str, level: int) -> None:
    stage = made(name, level).stage
    assert isinstance(stage, Stage) and stage.name == name.rpartition(" ")[2]
    assert list(stage.levels) == [level for level in LEVELS if level in stage.levels]
    demand = stage.demand(FACTS, SCENE, SCENE.camera.rect)
    assert demand.reason
    assert demand.rect is None or SCENE.camera.rect.contains(demand.rect)


@pytest.mark.parametrize("name", CLASSES)
def test_runs_only_where_it_says_so_if_the_object_is_absent(name: str) -> None:
    stage = CLASSES[name]()
    absent = FACTS.with_(
        camera_from_world=None, opacity=0.0, model_box=Rect(0, 0, 0, 0)
    )
    plan = plan_frame(
        [stage], {stage.name: stage.levels[0]}, absent, SCENE, SCENE.camera.rect
    )
    assert stage.without_object or [s.reason for s in plan.skipped] == [ABSENT]


def test_a_class_without_name_or_run_is_no_stage() -> None:
    with pytest.raises(TypeError, match="lacks name, run"):
        type("Nothing", (Stage,), {})
    with pytest.raises(TypeError, match="lacks run"):
        type("Idle", (Stage,), {"name": "idle"})


@pytest.mark.parametrize(
    "levels", ["standard", (), ("fast",), ("standard", "draft"), ["draft"], None]
)
def test_wrong_levels_are_refused_where_the_class_is_made(levels: Any) -> None:
    with pytest.raises(TypeError, match=r"levels of stage Odd are .* in this order"):
        type("Odd", (Stage,), {"name": "odd", "run": print, "levels": levels})


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "level"), CASES, ids=IDS)
def test_roi_law(name: str, level: int, seed: int) -> None:
    laws.check_roi_law(made(name, level), FACTS, seed, atol=1e-5)


@pytest.mark.parametrize(("name", "level"), CASES, ids=IDS)
def test_pure_and_deterministic(name: str, level: int) -> None:
    laws.check_pure(made(name, level), FACTS)


@pytest.mark.parametrize(("name", "level"), CASES, ids=IDS)
def test_finite_on_hard_layers(name: str, level: int) -> None:
    laws.check_finite(made(name, level), FACTS)


class Blur(Stage):
    """A stage made only to be broken in one way at a time."""

    name = "blur"

    def __init__(self, fault: str = "") -> None:
        super().__init__()
        self.fault = fault
        self.padding_px = 0 if fault == "no padding" else 4

    def demand(self, f: Any, s: Any, frame: Rect) -> Demand:
        return Demand(frame, "always")

    def run(self, view: Any, prepared: Any) -> dict[Layer, np.ndarray]:
        image = view[Layer.IMAGE]
        out = cv2.blur(image, (9, 9), borderType=cv2.BORDER_REPLICATE)
        if self.fault == "not deterministic":
            out = (
                out
                + np.random.default_rng().random(out.shape, dtype=np.float32) * 1e-3
            )
        if self.fault == "writes its input":
            image.setflags(write=True)
            image[0, 0] = 0
        if self.fault == "not finite":
            with np.errstate(divide="ignore"):
                out = out + 0 / np.where(image > 0, 1, image)
        return (
            {Layer.DEPTH: out[..., 0], Layer.IMAGE: out}
            if self.fault == "undeclared"
            else {Layer.IMAGE: out}
        )


def blur(fault: str = "") -> ReadyStage:
    return ReadyStage.of(Blur(fault), SCENE, "standard")


def test_a_sound_blur_passes() -> None:
    laws.check_roi_law(blur(), FACTS, 0)
    laws.check_pure(blur(), FACTS)


def test_a_missing_padding_is_caught() -> None:
    with pytest.raises(AssertionError):
        laws.check_roi_law(blur("no padding"), FACTS, 0)


@pytest.mark.parametrize(
    "fault", ["not deterministic", "writes its input", "undeclared"]
)
def test_impure_stages_are_caught(fault: str) -> None:
    with pytest.raises((AssertionError, ValueError)):
        laws.check_pure(blur(fault), FACTS)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_values_that_are_not_finite_are_caught() -> None:
    with pytest.raises(AssertionError, match="NaN"):
        laws.check_finite(blur("not finite"), FACTS)
