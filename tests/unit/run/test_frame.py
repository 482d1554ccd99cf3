from __future__ import annotations

import itertools
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from arfx.core.layers import Layer, Layers
from arfx.core.pixels import Pixels, Plate
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage, Stage
from arfx.errors import RenderError
from arfx.plan.planner import plan_frame
from arfx.run.frame import FrameLayers, ready_stages, run_frame
from arfx.run.schedule import chunks_of
from arfx.stages.composite import Composite
from tests.scenes import facts, layers_of, scene
from tests.unit.media.test_frame import frame, samples

SCENE = scene()
FACTS = facts(SCENE)
LEVEL = "standard"


def test_canvas_fills_with_nothing_virtual_and_keeps_what_is_outside() -> None:
    plate = np.random.default_rng(0).random((20, 30, 3), dtype=np.float32)
    layers = FrameLayers(Plate.of(plate, Rect(10, 10, 40, 30)))
    inner = Rect(15, 12, 20, 18)
    layers.put(Layer.COVERAGE, np.ones((6, 5), np.float32), inner, inner)
    view = layers.view(Rect(14, 11, 21, 19))
    assert view[Layer.COVERAGE].sum() == 30 and view[Layer.COVERAGE][0].sum() == 0
    assert (view[Layer.SHADOW] == 1).all()
    layers.put(Layer.IMAGE, np.zeros((6, 5, 3), np.float32), inner, inner)
    image, at = (
        layers.view(layers.rect)[Layer.IMAGE],
        inner.slices_in(layers.rect),
    )
    assert image[at].max() == 0
    untouched = image.copy()
    untouched[at] = plate[at]
    assert np.array_equal(untouched, plate), "and the plate itself was not written to"


def test_what_a_stage_wrote_of_image_lies_over_what_was_there() -> None:
    whole, inner, dark = Rect(0, 0, 40, 30), Rect(5, 5, 20, 20), Rect(10, 10, 30, 25)
    layers = FrameLayers(Plate.of(np.ones((30, 40, 3), np.float32), whole))
    layers.put(Layer.IMAGE, np.full((15, 15, 3), 3, np.float32), inner, inner)
    half = Pixels(dark, np.full((15, 20, 3), 0.5, np.float32))
    layers.put(Layer.IMAGE, half, whole, whole)
    expected = np.ones((30, 40, 3), np.float32)
    expected[inner.slices], expected[dark.slices] = 3, 0.5
    assert np.array_equal(layers.view(whole)[Layer.IMAGE], expected)


class Bad(Stage):
    name = "bad"

    def run(self, view: Any, prepared: Any) -> dict[Layer, np.ndarray]:
        out = view[Layer.IMAGE].copy()
        out[3, 4] = np.nan
        return {Layer.IMAGE: out}


def test_a_value_that_is_not_finite_stops_with_stage_frame_and_pixel() -> None:
    rect = Rect(5, 6, 25, 26)
    plan = FramePlan(
        7, rect, rect, (Step("bad", "standard", rect, rect, "", None),), ()
    )
    with pytest.raises(
        RenderError, match=r"'bad' made 1 pixels.*frame 7, first at x 9, y 9"
    ):
        run_frame(
            np.ones((20, 20, 3), np.float32),
            FACTS.with_(index=7),
            plan,
            ready_stages(plan, {"bad": Bad()}, SCENE),
        )


class Paint(Stage):
    """Covers a fixed rectangle with red."""

    name = "paint"

    def demand(self, f: Any, s: Any, frame: Rect) -> Any:
        from arfx.core.stage import Demand

        return Demand(Rect(40, 30, 60, 50), "red")

    def needs(self, out: Rect, *_: Any) -> Rect:
        return out

    def run(self, view: Any, prepared: Any) -> dict[Layer, np.ndarray]:
        r = view.rect
        return {
            Layer.COVERAGE: np.ones((r.height, r.width), np.float32),
            Layer.VIRTUAL: np.full((r.height, r.width, 3), (1, 0, 0), np.float32),
        }


class Spot(Paint):
    """As every raster does, it leaves the border of its rectangle free."""

    def run(self, view: Any, prepared: Any) -> dict[Layer, np.ndarray]:
        made = super().run(view, prepared)
        inner = np.pad(
            np.ones(tuple(n - 4 for n in made[Layer.COVERAGE].shape), np.float32), 2
        )
        return {
            Layer.COVERAGE: inner,
            Layer.VIRTUAL: made[Layer.VIRTUAL] * inner[..., None],
        }


class Shade(Paint):
    """A shadow around the red."""

    name = "shade"

    def demand(self, f: Any, s: Any, frame: Rect) -> Any:
        from arfx.core.stage import Demand

        return Demand(Rect(20, 20, 90, 80), "shade")

    def run(self, view: Any, prepared: Any) -> dict[Layer, np.ndarray]:
        r = view.rect
        left = np.linspace(0.4, 1, r.width, dtype=np.float32)[None, :, None]
        return {Layer.SHADOW: np.broadcast_to(left, (r.height, r.width, 3))}


@pytest.mark.parametrize("bias", [0.0, -0.02])
@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p10le", "gbrp"])
def test_object_and_shadow_are_written_in_linear_light(
    pixel_format: str, bias: float
) -> None:
    """The stored picture's light is the plate's times the shadow, to a step; what neither
    reaches keeps its bits.
    """
    stages: dict[str, Any] = {
        "paint": Spot(),
        "shade": Shade(),
        "composite": Composite(),
    }
    levels = {n: LEVEL for n in stages}
    f = FACTS.with_(
        opacity=0.9, bias_rgb=(bias, bias, bias), model_box=Rect(42, 32, 58, 48)
    )
    plan = plan_frame(list(stages.values()), levels, f, SCENE, SCENE.camera.rect)
    picture = frame(
        pixel_format, SCENE.camera.width, SCENE.camera.height, smooth=True
    )
    plate = Plate(plan.rect, picture.linear)
    found = run_frame(plate, f, plan, ready_stages(plan, stages, SCENE))
    assert plan.changed == Rect(20, 20, 90, 80)
    out = found.onto(picture)
    beside = Rect(20, 52, 90, 80)  # no object there
    before, after = picture.linear(beside), out.linear(beside)
    left = np.linspace(0.4, 1, 70, dtype=np.float32)[None, :, None]
    expected = bias + (1 + 0.9 * (left - 1)) * (before - bias)
    step = 1 / (picture.clip.layout.peak * 219 / 255)
    coded = [picture.clip.transfer.encode(x) for x in (after, expected)]
    assert np.abs(coded[0] - coded[1])[2:-2, 2:-2].max() < 2.5 * step
    for a, b in zip(samples(out), samples(picture), strict=True):
        assert np.array_equal(a[82:], b[82:]) and np.abs(a - b).max() > 10 * (
            len(a) > 200
        )


def test_a_plate_is_converted_once_in_bands() -> None:
    asked: list[Rect] = []

    def read(rect: Rect, out: np.ndarray) -> None:
        asked.append(rect)
        out[...] = len(asked)

    plate = Plate(Rect(2, 40, 50, 200), read)
    assert plate.part(Rect(5, 70, 20, 90)).shape == (20, 15, 3)
    assert asked == [Rect(2, 64, 50, 128)], "its band, over all columns"
    assert plate.part(Rect(5, 50, 20, 130)).shape == (80, 15, 3)
    assert asked[1:] == [Rect(2, 40, 50, 64), Rect(2, 128, 50, 192)]
    whole = plate.part(plate.rect)
    assert len(asked) == 4 and (whole[24:88] == 1).all() and (whole[-8:] == 4).all()
    gone = weakref.ref(plate)
    del plate
    assert gone() is None, (
        "freed at once, not when Python next looks for cycles: it is as large as a picture"
    )


@pytest.mark.parametrize("opacity", [1.0, 0.25])
def test_composite_over_the_plate_with_opacity(opacity: float) -> None:
    stages: dict[str, Any] = {"paint": Paint(), "composite": Composite()}
    levels = {n: LEVEL for n in stages}
    f = FACTS.with_(opacity=opacity, model_box=Rect(42, 32, 58, 48))
    plan = plan_frame(list(stages.values()), levels, f, SCENE, SCENE.camera.rect)
    plate = np.random.default_rng(1).random(
        (plan.rect.height, plan.rect.width, 3), dtype=np.float32
    )
    result = run_frame(plate, f, plan, ready_stages(plan, stages, SCENE))
    np.testing.assert_allclose(
        result.image, plate + opacity * (np.float32([1, 0, 0]) - plate), atol=1e-6
    )
    assert set(result.seconds) == {"paint", "composite"}


def test_composite_leaves_bare_pixels_bit_identical() -> None:
    from arfx.core.layers import neutral

    rect = Rect(0, 0, 50, 40)
    plate = np.random.default_rng(2).random((40, 50, 3), dtype=np.float32)
    layers = layers_of(
        rect,
        {
            Layer.PLATE: plate,
            Layer.IMAGE: plate,
            **{
                n: neutral(n, rect)
                for n in (Layer.VIRTUAL, Layer.COVERAGE, Layer.SHADOW)
            },
        },
    )
    out = ReadyStage.of(Composite(), SCENE, LEVEL).run(layers, FACTS)[Layer.IMAGE]
    assert isinstance(out, Pixels)
    out = Layers(rect, {**layers.written, Layer.IMAGE: out})[Layer.IMAGE]
    assert np.array_equal(out, plate)


def test_random_numbers_depend_on_seed_frame_and_stage_only() -> None:
    other = type("Other", (Bad,), {"name": "other"})
    layers, draws = Layers(Rect(3, 4, 9, 8)), []
    for seed, index, stage in (
        (0, 1, Bad),
        (0, 1, other),
        (0, 2, Bad),
        (1, 1, Bad),
        (0, 1, Bad),
    ):
        ready = ReadyStage(stage(), replace(SCENE, seed=seed), LEVEL, None)
        draws.append(ready.view(layers, FACTS.with_(index=index)).noise().tobytes())
    assert draws[0] == draws[4] and len(set(draws)) == 4


def test_what_a_stage_asks_of_a_frame_without_a_pose_is_an_error_that_names_the_frame() -> (
    None
):
    absent = FACTS.with_(camera_from_world=None, opacity=0.0, index=12, light=None)
    view = ReadyStage.of(Bad(), SCENE, LEVEL).view(Layers(Rect(0, 0, 8, 8)), absent)
    assert view.light is SCENE.light and view.rect == view.out
    with pytest.raises(ValueError, match="frame 12 has no pose"):
        _ = view.pose


@pytest.mark.parametrize("frames", [1, 29, 30, 31, 159, 240, 960, 961, 5000])
def test_chunk_borders_cover_every_frame_once(frames: int) -> None:
    parts = [(c.first, c.last) for c in chunks_of(frames)]
    assert parts[0][0] == 0 and parts[-1][1] == frames - 1
    assert all(a[1] + 1 == b[0] for a, b in itertools.pairwise(parts))
    assert max(b - a + 1 for a, b in parts) <= 120
