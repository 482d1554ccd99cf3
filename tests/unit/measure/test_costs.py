"""The fit finds what made the numbers; calibration prices what it timed and nothing else."""

from __future__ import annotations

import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from arfx.core.cost import UNCALIBRATED, load_prices, shipped_prices
from arfx.errors import ConfigError
from arfx.measure import costs, costs_output
from arfx.measure.bench import bench
from arfx.measure.costs import calibrate, fit, save_prices
from arfx.measure.timing import Runs, Stopwatch
from arfx.media.codecs import CODECS
from tests.unit.measure.test_bench import sleeper  # noqa: F401


def runs(noise: float, count: int = 12, outliers: int = 0) -> Runs:
    r, out = np.random.default_rng(4), Runs()
    for k in range(count):
        terms = {
            "frames": 1.0,
            "mpx": float(r.uniform(0.02, 1)),
            "object_mpx": float(r.uniform(0, 0.2)),
            "mfaces": 0.006,
        }
        seconds = (0.003 + 0.04 * terms["mpx"] + 0.2 * terms["object_mpx"]) * float(
            np.exp(r.normal(0, noise))
        )
        out.add(terms, seconds * (3 if k < outliers else 1))
    return out


def test_coefficients_come_back_and_none_is_negative() -> None:
    exact = fit(runs(0.0), ("frames", "mpx", "object_mpx"))
    assert exact.coefficients["mpx"] == pytest.approx(0.04) and exact.coefficients[
        "object_mpx"
    ] == pytest.approx(0.2)
    noisy = fit(runs(0.3), ("frames", "mpx", "object_mpx", "mfaces"))
    assert (
        all(c >= 0 for c in noisy.coefficients.values())
        and noisy.spread > exact.spread
    )


def test_a_run_that_was_disturbed_does_not_take_the_price_with_it() -> None:
    found = fit(runs(0.05, 14, outliers=2), ("frames", "mpx", "object_mpx"))
    assert found.seconds(
        {"frames": 1, "mpx": 0.5, "object_mpx": 0.1}
    ) == pytest.approx(0.043, rel=0.35)
    assert found.spread > 0.2, "and the interval tells of it"


def test_few_runs_are_priced_by_pixels_with_a_wide_interval() -> None:
    few = Runs()
    few.add({"frames": 1.0, "mpx": 0.01, "object_mpx": 0.002, "new_lights": 1.0}, 0.5)
    few.add({"frames": 1.0, "mpx": 0.01, "object_mpx": 0.002}, 0.2)
    price = fit(few, ("frames", "mpx", "object_mpx", "new_lights"))
    assert (
        price.seconds({"frames": 1, "mpx": 0.02}) == pytest.approx(0.4)
        and price.spread >= 0.2
    )
    few.terms, few.seconds = (
        [{"mpx": 0.01, "depth_mpx": 0.0}, {"mpx": 0.02, "depth_mpx": 0.02}],
        [0.02, 0.16],
    )
    deep = fit(few, ("frames", "mpx", "object_mpx", "depth_mpx"))
    assert deep.coefficients == {
        "mpx": pytest.approx(2.0),
        "depth_mpx": pytest.approx(6.0),
    }
    with pytest.raises(ValueError, match="nothing"):
        fit(few, ("mfaces",))


@pytest.fixture
def no_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(costs, "time_output", lambda *_: None)


@pytest.mark.usefixtures("no_output", "sleeper")
def test_calibration_times_what_it_prices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prices = calibrate(limit_s=2.0)
    at = {
        k: prices.predict(
            f"sleeper/{k}", {"frames": 1.0, "mpx": 0.05, "object_mpx": 0.03}
        )
        for k in ("draft", "standard")
    }
    assert at["draft"].seconds < at["standard"].seconds < 0.2
    assert "encode h264" not in prices.prices and "raster/draft" not in prices.prices
    monkeypatch.setattr(
        costs, "prices_file", lambda: tmp_path / "cache" / "costs.json"
    )
    back = load_prices(save_prices(prices))
    assert back.calibrated and set(back.prices) == set(prices.prices)


@pytest.mark.usefixtures("no_output")
def test_what_there_is_no_time_for_keeps_the_shipped_price_and_its_wide_interval() -> (
    None
):
    prices = calibrate(limit_s=0.0)
    assert set(prices.prices) == {k for k in shipped_prices().prices if "/" in k}
    assert all(p.spread >= UNCALIBRATED for p in prices.prices.values())
    alone = calibrate(limit_s=0.0, stage="dof")
    assert {k.removeprefix("prepare ").split("/")[0] for k in alone.prices} == {"dof"}


def test_a_scene_that_is_too_small_for_a_stage_is_passed_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scenes = tmp_path / "scenes.toml"
    scenes.write_text(
        '[[scene]]\nsize = [64, 64]\ncovered = 0.1\ntriangles = [20, 19]\nshape = "ball"\n'
        "deep = false\nslow = false\n"
    )
    monkeypatch.setattr(costs, "SCENES", scenes)
    assert all(
        p.spread >= UNCALIBRATED for p in calibrate(stage="dof").prices.values()
    ), "as it was shipped"
    assert calibrate(stage="raster").prices["raster/draft"].runs > 0
    with pytest.raises(ConfigError, match="64x64 px there is nothing for dof"):
        bench([(64, 64)], "dof")


def test_every_codec_is_priced_and_one_that_this_machine_lacks_is_unknown(
    monkeypatch,
) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(costs_output, "SIZES", ((160, 96, 3), (96, 64, 3)))
    monkeypatch.setitem(
        CODECS, "prores", replace(CODECS["prores"], encoder="no_such_encoder")
    )
    timed: dict[str, Runs] = defaultdict(Runs)
    with ThreadPoolExecutor(2) as pool:
        costs_output.time_output(timed, Stopwatch(True, pool, 2), lambda *_: None)
    assert {f"encode {c}" for c in CODECS} - timed.keys() == {"encode prores"}
    assert all(s > 0 for runs in timed.values() for s in runs.seconds)
    assert len(timed["encode h264"].seconds) > len(timed["encode av1"].seconds), (
        "others at one size alone"
    )
    assert len(timed["edit"].seconds) == 4 and len(timed["join"].seconds) == 2


def test_the_processors_clock_counts_work_and_not_waiting() -> None:
    with ThreadPoolExecutor(2) as pool:
        asleep = Stopwatch(True, pool, 2).of_concurrent(lambda: time.sleep(0.05))
        assert (
            Stopwatch(False, pool, 2).of_concurrent(lambda: time.sleep(0.05))
            > 0.04
            > asleep
        )
