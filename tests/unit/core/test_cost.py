"""Predictions: intervals, sums, the price list as a file, and what is not known."""

import json
import math
from pathlib import Path

import pytest

from arfx.core.cost import (
    UNCALIBRATED,
    Price,
    Prices,
    load_prices,
    measured,
    sum_independent,
    with_spread,
)
from arfx.measure.bench_scene import ball, bench_scene
from arfx.measure.costs import textured_ball
from arfx.plan.planner import terms_of

PRICES = Prices(
    {"dof/draft": Price({"frames": 0.002, "mpx": 0.03}, 0.2, 9)},
    2,
    "a test",
    calibrated=True,
)


def test_a_prediction_is_the_price_of_its_terms_and_carries_its_interval() -> None:
    p = PRICES.predict("dof/draft", {"frames": 1, "mpx": 2.0, "object_mpx": 5.0})
    assert p is not None and p.seconds == pytest.approx(0.062)
    assert p.low_s < p.seconds < p.high_s and p.high_s / p.seconds == pytest.approx(
        math.exp(1.645 * 0.2)
    )
    assert PRICES.predict("gi/draft", {"frames": 1}) is None, (
        "unknown is allowed, a made-up number is not"
    )


def test_prices_of_another_machine_are_wide() -> None:
    shipped = Prices(PRICES.prices, calibrated=False).predict(
        "dof/draft", {"frames": 1}
    )
    assert shipped is not None and shipped.high_s / shipped.seconds == pytest.approx(
        math.exp(1.645 * UNCALIBRATED)
    )


def test_independent_errors_add_in_quadrature_and_what_was_measured_adds_none() -> (
    None
):
    a, b = with_spread(3.0, 0.1), with_spread(4.0, 0.1)
    s = sum_independent([a, b, measured(2.0)])
    assert s.seconds == pytest.approx(9.0)
    assert s.high_s - 9 == pytest.approx(math.hypot(a.high_s - 3, b.high_s - 4))
    assert s.high_s < 2 + a.high_s + b.high_s and sum_independent([]).seconds == 0


def test_the_file_holds_the_list_and_a_damaged_one_is_not_believed(tmp_path) -> None:
    file = tmp_path / "costs.json"
    file.write_text(json.dumps(PRICES.to_json()))
    back = load_prices(file)
    assert back.calibrated and back.prices == PRICES.prices and back.threads == 2
    for text in ("", "{}", "[]", json.dumps({**PRICES.to_json(), "format": 99}),
                 json.dumps(PRICES.to_json()).replace("0.03", "-0.03"),
                 json.dumps(PRICES.to_json()).replace("0.03", "NaN")):  # fmt: skip
        file.write_text(text)
        assert not load_prices(file).calibrated
    assert not load_prices(tmp_path / "absent.json").calibrated


def test_the_shipped_list_prices_every_stage_at_every_level() -> None:
    from arfx.stages import STAGES

    shipped = load_prices(Path("/nonexistent/costs.json"))
    assert shipped.predict("encode h264", {"frames": 30, "mpx": 27.0}) is not None
    for name, stage in STAGES.items():
        for level in stage.levels:
            found = shipped.predict(
                f"{name}/{level}",
                {"frames": 1, "mpx": 0.5, "object_mpx": 0.1, "mfaces": 0.006},
            )
            assert (
                found is not None
                and 0 <= found.low_s <= found.seconds <= found.high_s
            )
            prepared = [
                key for key in shipped.prices if key.startswith(f"prepare {name}/")
            ]
            assert prepared, f"what {name} prepares has a price"


def test_five_textures_cost_more_than_one() -> None:
    shipped = load_prices(Path("/nonexistent/costs.json"))
    seconds = []
    for model in (ball(), textured_ball(60, 51)):
        scene = bench_scene(640, 360, 0.2, model)
        need = scene.scene.camera.rect
        found = shipped.predict(
            "raster/standard", terms_of(need, scene.facts, scene.scene)
        )
        assert found is not None
        seconds.append(found.seconds)
    assert seconds[1] > 2 * seconds[0]
