"""Stage hide: real things that stand nearer than the object."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.core.layers import Layer
from arfx.core.real_depth import RealDepth, tile_ranges
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage
from arfx.stages.guided import refined
from arfx.stages.hide import Hide, HideParams
from tests.contract import stage_laws as laws
from tests.unit.stages.dof_scenes import Shot, shot, with_layers

SIZE = (320, 240)
BAR = slice(150, 170)  # columns of a bright bar in the picture, before the object


def scene_with_bar(bar_m: float, off_px: int = 0) -> Shot:
    """The object on its plane, a bar before it.

    off_px : by which the depth map has the bar beside where it is seen
    """
    at = shot(width=SIZE[0], height=SIZE[1])
    plate = np.full((SIZE[1], SIZE[0], 3), 0.1, np.float32)
    plate[:, BAR] = 0.7
    real = np.full((SIZE[1], SIZE[0]), 1.0, np.float32)
    real[:, BAR.start + off_px : BAR.stop + off_px] = bar_m
    known = RealDepth.of(0, 1.0, "", tile_ranges(real, SIZE))
    return Shot(
        at.scene,
        at.facts.with_(real_depth=known),
        with_layers(at, plate=plate, real_depth=real).layers,
    )


def hidden(
    at: Shot, rect: Rect | None = None, **params: float
) -> tuple[np.ndarray, np.ndarray]:
    """COVERAGE and VIRTUAL of the frame, or of a part."""
    stage = Hide(HideParams(**params))
    layers = at.layers if rect is None else at.layers.crop(rect)
    made = laws.run(ReadyStage.of(stage, at.scene, "standard"), layers, at.facts)
    return made[Layer.COVERAGE], made[Layer.VIRTUAL]


def test_a_nearer_thing_hides_the_object_and_a_farther_one_does_not() -> None:
    at = scene_with_bar(0.2)
    coverage, virtual = hidden(at)
    before = at.layers[Layer.COVERAGE]
    assert before[:, BAR].max() == 1, "the bar crosses the object"
    assert coverage[:, BAR].max() < 0.03 and virtual[:, BAR].max() < 0.03
    away = np.ones(SIZE[0], bool)
    away[BAR.start - 13 : BAR.stop + 13] = False
    np.testing.assert_array_equal(coverage[:, away], before[:, away])
    assert (
        Hide()
        .demand(at.facts, at.scene, at.scene.camera.rect)
        .rect.contains(Rect(BAR.start, 0, BAR.stop, SIZE[1]).clip(at.facts.model_box))
    )
    for far_m in (0.9, 1.0):
        behind = scene_with_bar(far_m)
        np.testing.assert_array_equal(hidden(behind)[0], before)
        demand = Hide().demand(behind.facts, behind.scene, behind.scene.camera.rect)
        assert demand.rect.empty and "nothing real is nearer than" in demand.reason


def test_within_the_margin_nothing_is_hidden() -> None:
    at = scene_with_bar(0.2)
    depth = at.layers[Layer.DEPTH]
    on = (at.layers[Layer.COVERAGE] > 0) & np.isfinite(depth)
    for nearer, hides in ((0.02, 0.0), (0.045, 0.5), (0.07, 1.0)):
        real = np.where(on, depth / (1 + nearer), 1.0).astype(np.float32)
        coverage, _ = hidden(with_layers(at, real_depth=real), margin=0.03)
        inside = on & (at.layers[Layer.COVERAGE] == 1)
        assert coverage[inside].mean() == pytest.approx(1 - hides, abs=0.01)


def test_the_edge_is_the_pictures_not_the_depth_maps() -> None:
    """Two pixels off, the map's edge goes back to the bar's; in between the mask is soft."""
    at = scene_with_bar(0.2, off_px=2)
    coverage, _ = hidden(at)
    rows = (at.layers[Layer.COVERAGE][:, BAR.start - 8 : BAR.stop + 8] == 1).all(1)
    assert rows.sum() > 20
    profile = coverage[rows].mean(0)
    assert profile[BAR.start - 2] > 0.6 > 0.4 > profile[BAR.start + 1], profile[
        BAR.start - 5 : BAR.start + 5
    ]
    assert profile[BAR.stop - 2] < 0.4 < 0.6 < profile[BAR.stop + 1], profile[
        BAR.stop - 5 : BAR.stop + 5
    ]
    assert ((coverage > 0.05) & (coverage < 0.95))[rows][
        :, BAR.start - 8 : BAR.stop + 8
    ].any()


def test_draft_keeps_the_edge_of_the_depth_map() -> None:
    at = scene_with_bar(0.2, off_px=2)
    made = laws.run(ReadyStage.of(Hide(), at.scene, "draft"), at.layers, at.facts)[
        Layer.COVERAGE
    ]
    rows = (at.layers[Layer.COVERAGE][:, BAR.start - 8 : BAR.stop + 8] == 1).all(1)
    hidden_columns = np.flatnonzero(made[rows][0, BAR.start - 8 : BAR.stop + 8] == 0)
    assert hidden_columns.tolist() == list(range(10, 10 + BAR.stop - BAR.start))
    assert Hide().needs(Rect(140, 90, 181, 131), at.facts, at.scene, "draft") == Rect(
        140, 90, 181, 131
    )


def test_the_objects_outline_stays_as_it_is() -> None:
    """Where all of the object is nearer than a bar that begins at its edge, its edge pixels
    keep their bits.
    """
    g = np.random.default_rng(0)
    mask, there = np.ones((40, 40), np.float32), np.zeros((40, 40), np.float32)
    there[10:30, 10:30] = 1
    np.testing.assert_array_equal(
        refined(mask, there, g.random((40, 40, 3)).astype(np.float32), 3), mask
    )
    mask[:, 20:] = 0
    made = refined(mask, there, np.repeat(mask[..., None], 3, -1), 3)
    assert made[10:30, 10:19].min() > 0.9 and made[10:30, 21:30].max() < 0.1


def test_a_part_gives_what_the_whole_gives() -> None:
    at = scene_with_bar(0.2, off_px=1)
    out = Rect(140, 90, 181, 131)
    need = Hide().needs(out, at.facts, at.scene, "standard")
    assert need.area < at.scene.camera.rect.area
    for part, whole in zip(hidden(at, need), hidden(at), strict=True):
        np.testing.assert_allclose(
            part[out.slices_in(need)], whole[out.slices], rtol=0, atol=1e-5
        )


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_depths_that_are_none_hide_nothing(value: float) -> None:
    at = scene_with_bar(0.2)
    coverage, virtual = hidden(
        with_layers(at, real_depth=np.full((SIZE[1], SIZE[0]), value, np.float32))
    )
    np.testing.assert_array_equal(coverage, at.layers[Layer.COVERAGE])
    np.testing.assert_array_equal(virtual, at.layers[Layer.VIRTUAL])


def test_without_depth_it_is_not_called_for() -> None:
    at = shot(width=SIZE[0], height=SIZE[1])
    demand = Hide().demand(at.facts, at.scene, at.scene.camera.rect)
    assert demand.rect.empty and "not known" in demand.reason
    with pytest.raises(ValidationError, match="margin"):
        HideParams(margin=0.0)
