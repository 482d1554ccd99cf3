from __future__ import annotations

import itertools
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from arfx.core.layers import Layer, Layers
from arfx.core.pixels import Attenuated, Pixels
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage, Stage
from arfx.errors import RenderError
from arfx.plan.planner import plan_frame
from arfx.run.frame import FrameLayers, ready_stages, run_frame
from arfx.run.schedule import borders
from arfx.stages.composite import Composite
from tests.scenes import facts, layers_of, scene
from tests.unit.media.test_dimming import samples
from tests.unit.media.test_frame import frame

SCENE = scene()
FACTS = facts(SCENE)
LEVEL = "standard"


def test_canvas_fills_with_nothing_virtual_and_keeps_what_is_outside() -> None:
    plate = np.random.default_rng(0).random((20, 30, 3), dtype=np.float32)
    layers = FrameLayers(plate, Rect(10, 10, 40, 30))
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
    layers = FrameLayers(np.ones((30, 40, 3), np.float32), whole)
    layers.put(Layer.IMAGE, np.full((15, 15, 3), 3, np.float32), inner, inner)
    plate, left = layers.stored[Layer.PLATE], np.full((15, 20, 1), 0.5, np.float32)
    light = Attenuated(
        plate,
        dark,
        left,
        np.float32(1),
        np.zeros(3, np.float32),
        lambda p, k, _, __, out: np.multiply(p, k, out),
    )
    layers.put(Layer.IMAGE, Pixels(dark, rest=light), dark, dark)
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
    plan = FramePlan(7, rect, rect, (Step("bad", "standard", rect, rect, "", 0.0),), ())
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
def test_a_plane_in_shadow_is_dimmed_where_it_is_stored(bias: float) -> None:
    """Nothing but the object's own pixels is converted, and the picture is the one that
    whole conversion gives.
    """
    stages: dict[str, Any] = {"paint": Spot(), "shade": Shade(), "composite": Composite()}
    levels = {n: LEVEL for n in stages}
    f = FACTS.with_(
        opacity=0.9, bias_rgb=(bias, bias, bias), model_box=Rect(42, 32, 58, 48)
    )
    plan = plan_frame(list(stages.values()), levels, f, SCENE, SCENE.camera.rect)
    picture = frame("yuv420p", SCENE.camera.width, SCENE.camera.height, smooth=True)
    asked: list[Rect] = []

    def linear(rect: Rect) -> np.ndarray:
        asked.append(rect)
        return picture.linear(rect)

    found = run_frame(
        Pixels(plan.rect, rest=linear), f, plan, ready_stages(plan, stages, SCENE)
    )
    assert plan.changed == Rect(20, 20, 90, 80)
    dimmed = samples(found.onto(picture))
    assert asked and all(Rect(40, 30, 60, 50).contains(r) for r in asked)
    whole = picture.edited(plan.changed, picture.linear(plan.changed), found.image)
    for a, b in zip(dimmed, samples(whole), strict=True):
        assert np.abs(a - b).max() <= 1
    assert np.abs(dimmed[0] - samples(picture)[0]).max() > 10
    for a, b in zip(dimmed, samples(found.onto(picture)), strict=True):
        np.testing.assert_array_equal(
            a, b, err_msg="the same when IMAGE was asked for meanwhile"
        )


class Streak(Stage):
    """Brightens some columns of each row of IMAGE, and says which."""

    name = "streak"

    def demand(self, f: Any, s: Any, frame: Rect) -> Any:
        from arfx.core.stage import Demand

        return Demand(Rect(10, 10, 120, 100), "streak")

    def needs(self, out: Rect, *_: Any) -> Rect:
        return out

    def run(self, view: Any, prepared: Any) -> dict[Layer, Pixels]:
        now = view.layers
        made, rows = np.full((now.rect.height, now.rect.width, 3), np.nan, np.float32), []
        for y in range(20, 60):
            rows.append(
                Rect(11 + y // 2, y, 57 + y // 3, y + 1).shift(now.rect.x0, now.rect.y0)
            )
            made[rows[-1].slices_in(now.rect)] = 1.3 * now.crop(rows[-1])[
                Layer.IMAGE
            ] + np.float32(0.02)
        return {Layer.IMAGE: Pixels(now.rect, made, now.written[Layer.IMAGE], written=rows)}


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p10le", "gbrp"])
def test_a_stage_that_made_some_columns_gives_the_stored_samples_of_one_that_made_all(
    pixel_format: str,
) -> None:
    stages: dict[str, Any] = {
        "paint": Spot(),
        "shade": Shade(),
        "composite": Composite(),
        "streak": Streak(),
    }
    levels = {n: LEVEL for n in stages}
    f = FACTS.with_(model_box=Rect(42, 32, 58, 48))
    plan = plan_frame(list(stages.values()), levels, f, SCENE, SCENE.camera.rect)
    picture = frame(pixel_format, SCENE.camera.width, SCENE.camera.height, smooth=True)
    found = run_frame(
        Pixels(plan.rect, rest=picture.linear), f, plan, ready_stages(plan, stages, SCENE)
    )
    out = samples(found.onto(picture))
    assert np.isfinite(found.image).all()
    whole = picture.edited(plan.changed, picture.linear(plan.changed), found.image)
    for a, b in zip(out, samples(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.abs(out[0] - samples(picture)[0]).max() > 10


def test_a_plate_is_converted_once() -> None:
    asked: list[Rect] = []

    def read(rect: Rect) -> np.ndarray:
        asked.append(rect)
        return np.full((rect.height, rect.width, 3), len(asked), np.float32)

    plate = Pixels(Rect(0, 0, 50, 40), rest=read)
    assert plate(Rect(5, 5, 20, 20)).shape == (15, 15, 3) and plate(
        Rect(6, 6, 9, 9)
    ).shape == (3, 3, 3)
    assert asked == [Rect(5, 5, 20, 20)], "first what was asked for"
    assert plate(Rect(0, 0, 30, 8)).shape == (8, 30, 3) and plate(
        Rect(40, 30, 50, 40)
    ).shape == (10, 10, 3)
    assert sum(r.area for r in asked) == 50 * 40 and plate.seconds > 0, (
        "then bands, and nothing twice"
    )
    count = len(asked)
    assert (
        plate.over(plate.rect, [Rect(2, 2, 48, 38)]).shape == (40, 50, 3)
        and len(asked) == count
    )
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
            **{n: neutral(n, rect) for n in (Layer.VIRTUAL, Layer.COVERAGE, Layer.SHADOW)},
        },
    )
    out = ReadyStage.of(Composite(), SCENE, LEVEL).run(layers, FACTS)[Layer.IMAGE](rect)
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
    parts = borders(frames)
    assert parts[0][0] == 0 and parts[-1][1] == frames - 1
    assert all(a[1] + 1 == b[0] for a, b in itertools.pairwise(parts))
    assert max(b - a + 1 for a, b in parts) <= 120
