"""What stands for a clip, how far pictures are apart, what is rendered in a window, and the
sentence that comes of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from arfx.core.colour import SRGB
from arfx.core.cost import Price, Prices, measured
from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.core.stage import Stage, View, level_named
from arfx.measure.difference import Difference, difference, mean_flicker, touched
from arfx.measure.steps import Chain, FrameRenderer, PreparedStages, window_of
from arfx.measure.tradeoff import (
    LEFT_OUT,
    Measurements,
    Row,
    _choose_windows,
    _compare,
    _Work,
    front,
)
from arfx.measure.tradeoff_frames import NAMES, Sample, pick_frames
from arfx.measure.tradeoff_html import (
    error_map,
    page,
    recommendation,
)
from arfx.measure.tradeoff_time import Times
from arfx.plan.planner import plan_frame
from arfx.run.parameters import stages_of
from arfx.stages import STAGES
from tests.scenes import camera, facts, look_at, scene

NOISE = np.random.default_rng(0)
NONE: Mapping[str, Price] = {}


def row(
    name: str,
    level: str,
    seconds: float,
    mean: float,
    p99: float,
    formula: str = "",
) -> Row:
    frame, other = 3, {"dof": Stage()} if formula else {}
    r = Row(
        name, level, formula, measured(seconds), levels={"dof": level}, other=other
    )
    r.by_frame[frame] = Difference(
        mean, p99, mean / 100, mean / 3, 1 - mean / 100, 900
    )
    r.pictures[frame] = NOISE.integers(0, 255, (40, 50, 3)).astype(np.uint8)
    return r


def found() -> Measurements:
    effects = [row("dof", LEFT_OUT, 0.0, 9.0, 90), row("dof", "standard", 0.03, 4.0, 40, "paper"),
               row("dof", "draft", 0.01, 2.0, 30),
               row("dof", "standard", 0.02, 0.4, 5), row("dof", "reference", 2.0, 0, 0)]  # fmt: skip
    whole = [row("pipeline", "usual", 0.001, 5.0, 50, "paper"),
             row("pipeline", "draft", 0.02, 1.8, 28), row("pipeline", "standard", 0.05, 0.8, 6),
             row("pipeline", "high", 0.06, 0.9, 6), row("pipeline", "reference", 2.0, 0, 0)]  # fmt: skip
    samples = [Sample(3, dict.fromkeys(NAMES, 1.0), "typical")]
    return Measurements(
        samples,
        effects,
        whole,
        {3: Rect(0, 0, 50, 40)},
    )


def told(f: Measurements) -> dict[str, Any]:
    def line(r: Row) -> dict[str, Any]:
        return {"name": r.name, "level": r.level, "formula": r.formula, "levels": {"dof": r.level}, "beaten": False,
                "seconds_per_frame": r.seconds, "between_s": [r.seconds, 2 * r.seconds], "predicted": r.level == "reference",
                "mean": r.average("mean"), "mean_worst": r.worst("mean"), "p99": r.worst("p99"), "flip": r.average("flip"),
                "delta_e": r.average("delta_e"), "ssim": r.average("ssim"),
                "worst_frame": 3, "unrest": {"level": 1.0, "reference": 0.9}}  # fmt: skip

    return {"clip": "a<b>.mp4", "recommendation": recommendation(f), "effects": [line(r) for r in f.effects],
            "pipelines": [line(r) for r in f.pipelines],
            "frames": [{"frame": 3, "time_s": 0.1, "stands_for": "typical"}]}  # fmt: skip


def test_frames_are_unlike_each_other_and_say_what_they_stand_for() -> None:
    s = scene(camera(320, 240))
    clip = [facts(s, look_at(0.5 + 0.002 * i), i) for i in range(20)] + [
        facts(s, look_at(1.6), 20),
        facts(s, look_at(0.35), 21),
    ]
    clip += [facts(s, look_at(), 22).with_(camera_from_world=None, opacity=0.0)]
    picked = pick_frames(clip, s.camera.rect, 3)
    assert [p.index for p in picked if p.words != "typical"] == [20, 21] and len(
        picked
    ) == 3
    assert "far" in next(p.words for p in picked if p.index == 20)
    assert pick_frames(clip[-1:], s.camera.rect, 3) == []
    assert len(pick_frames(clip[:1] * 5, s.camera.rect, 4)) == 1, (
        "equal frames are one"
    )


def test_errors_are_of_the_touched_pixels_alone() -> None:
    a = NOISE.integers(60, 200, (60, 80, 3)).astype(np.uint8)
    b = a.copy()
    b[20:30, 30:50] += 6
    where = touched((a, b))
    d = difference(a, b, where)
    assert where.sum() == 200 and d.mean == 6 and d.p99 == 6 and d.pixels == 200
    assert 0.01 < d.flip < 0.2 and 1 < d.delta_e < 6 and 0.5 < d.ssim < 1
    assert difference(a, a, np.zeros_like(where)) == Difference()


def test_a_picture_that_moves_with_its_footage_is_at_rest_and_one_that_flickers_is_not() -> (
    None
):
    import cv2

    plate = cv2.GaussianBlur(
        NOISE.integers(0, 255, (80, 100, 3)).astype(np.uint8), (0, 0), 3
    )
    moved = np.roll(plate, 2, axis=1)
    where = np.zeros((80, 100), bool)
    where[20:60, 20:80] = True
    steady = mean_flicker(plate, moved, plate, moved, where)
    flicker = mean_flicker(
        plate,
        np.clip(moved.astype(int) + 12, 0, 255).astype(np.uint8),
        plate,
        moved,
        where,
    )
    assert steady < 2.5 and flicker > steady + 8


def test_a_window_shows_what_the_whole_picture_shows() -> None:
    s = scene(camera(160, 120))
    f = facts(s)
    stages = {n: STAGES[n]() for n in ("raster", "lightmap", "composite", "dof")}
    levels = {n: level_named(st.levels, "standard") for n, st in stages.items()}
    plan = plan_frame(list(stages.values()), levels, f, s, s.camera.rect)
    plate = NOISE.uniform(0.1, 0.6, (120, 160, 3)).astype(np.float32)
    window = window_of(plan, f, s.camera.rect, 900)
    assert window.area <= 1100 and plan.changed.contains(window)
    picture = FrameRenderer(f, plate, plan, stages, window, PreparedStages(s))
    whole = FrameRenderer(f, plate, plan, stages, s.camera.rect, PreparedStages(s))
    chain = picture.chain(levels)
    assert np.array_equal(picture.image(()), picture.original())
    assert np.array_equal(picture.image(chain), whole.image(chain)[window.slices])
    assert (picture.image(chain) != picture.original()).any()


def tiny_frame(stages: Mapping[str, Stage]) -> FrameRenderer:
    s = scene(camera(160, 120))
    plan = plan_frame(
        list(stages.values()),
        dict.fromkeys(stages, "standard"),
        facts(s),
        s,
        s.camera.rect,
    )
    plate = np.zeros((120, 160, 3), np.float32)
    return FrameRenderer(
        facts(s), plate, plan, stages, s.camera.rect, PreparedStages(s)
    )


class Deep(Stage):
    """Shows the real depth, 255 grey levels a metre."""

    name, facts = "deep", frozenset({"pose", "depth"})

    def run(self, view: View, prepared: None) -> dict[Layer, np.ndarray]:
        depth = view[Layer.REAL_DEPTH]
        return {
            Layer.IMAGE: (
                np.repeat(depth[..., None], 3, -1)
                if depth.size
                else 0 * view[Layer.IMAGE]
            )
        }


def test_stages_read_the_measured_depth_as_in_a_job() -> None:
    s = scene(camera(160, 120))
    f, whole = facts(s), s.camera.rect
    plan = FramePlan(
        0, whole, whole, (Step("deep", "standard", whole, whole, "", None),), ()
    )
    depth = NOISE.uniform(0.2, 0.9, (120, 160)).astype(np.float32)
    window = Rect(30, 20, 90, 70)
    stages: Any = {"deep": Deep()}
    plate = np.zeros((120, 160, 3), np.float32)
    pictures = []
    for measured_m in (depth, None):
        frame = FrameRenderer(
            f, plate, plan, stages, window, PreparedStages(s), measured_m
        )
        pictures.append(frame.image(frame.chain({"deep": "standard"})))
    assert np.array_equal(
        pictures[0][..., 0], np.rint(255 * SRGB.encode(depth[window.slices]))
    )
    assert (pictures[1] == 255).all(), "unmeasured is far away"


def test_the_sentence_names_the_cheapest_that_does_not_show_and_what_would() -> None:
    text = recommendation(found())
    assert "\n" not in text and text.startswith(
        "standard is within 0.8 grey levels of reference"
    )
    assert "at 1/40 of its time" in text and "dof draft would show (frame 3)" in text
    cheap = found()
    cheap.pipelines = [
        row("pipeline", "draft", 0.02, 0.5, 5),
        row("pipeline", "reference", 2.0, 0, 0),
    ]
    assert "show" not in recommendation(cheap), (
        "what is better than the advice is no warning"
    )
    bad = found()
    bad.pipelines = [
        row("pipeline", "draft", 0.1, 5, 60),
        row("pipeline", "reference", 1, 0, 0),
    ]
    told = recommendation(bad)
    assert (
        told.startswith("no quality below reference is without")
        and "would show in frame 3" in told
    )
    bad.pipelines[0].levels = {"dof": "draft"}
    assert "most of it is dof's" in recommendation(bad)


def test_a_small_window_is_said() -> None:
    small = found()
    assert "px of a frame alone" not in recommendation(small)
    small.windows = {3: Rect(0, 0, 33, 18), 9: Rect(0, 0, 500, 400)}
    assert "compared on 33 × 18 px of a frame alone" in recommendation(small)


def test_the_front_holds_only_what_nothing_beats() -> None:
    own = [r for r in found().pipelines if not r.other]
    assert [r.level for r in front(own)] == [
        "draft",
        "standard",
        "reference",
    ]


def work_of(
    frame: FrameRenderer,
    levels: Mapping[str, str],
    prices: Mapping[str, Price] = NONE,
) -> _Work:
    """A tradeoff of one frame."""
    params = {n: kind.Params() for n, kind in STAGES.items()}
    config = SimpleNamespace(params=params)
    inputs = SimpleNamespace(config=config, camera=frame.prepared.scene.camera)
    job: Any = SimpleNamespace(stages=frame.stages, inputs=inputs)
    return _Work(
        job,
        {3: frame},
        None,
        levels,
        Times([frame], {0: frozenset()}, Prices(prices)),
    )


def stages_named(*names: str) -> Mapping[str, Stage]:
    return stages_of({n: kind.Params() for n, kind in STAGES.items()}, names)


def test_what_is_left_of_a_job_has_the_settings_of_a_job_of_its_own() -> None:
    stages = stages_named("raster", "lightmap", "gi", "composite")
    usual = dict.fromkeys(stages, "standard")
    work = work_of(tiny_frame(stages), usual)
    left = {n: level for n, level in usual.items() if n != "gi"}
    assert (
        work.stages(usual) == stages
        and work.stages(left)["raster"] is stages["raster"]
    )
    soft = [work.stages(levels)["lightmap"].soft for levels in (usual, left)]
    assert soft == [False, True], "indirect light takes over, and gives back"


def test_pictures_are_as_large_as_the_references_leave_time_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("arfx.measure.tradeoff.LEAST_PX", 1)
    best = {"raster": "reference", "gi": "reference"}
    frame = tiny_frame(stages_named("raster", "gi"))
    whole = frame.plan.changed.area
    areas = [step.out.area for step in frame.plan.steps]
    for asked, dear_s, expected in (
        (whole // 4, 20.0, whole // 4),
        (4 * whole, 20.0, whole),
        (None, 60.0, 1 / sum(1 / area for area in areas)),
        (None, 3.0, whole),
    ):
        prices = {f"{n}/reference": Price({"frames": dear_s}, 0.1) for n in best}
        work = work_of(frame, best, prices)
        _choose_windows(work, [best], asked)
        assert work.frames[3].window.area == pytest.approx(expected, rel=0.1)


def test_a_step_is_timed_upon_the_steps_before_it_that_are_not_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    upon: list[Chain] = []
    monkeypatch.setattr(
        Times, "of", lambda self, chain: upon.append(chain) or measured(0.0)
    )
    frame = tiny_frame(stages_named("raster", "lightmap", "composite"))
    work = work_of(frame, dict.fromkeys(frame.stages, "reference"))
    levels = {"raster": "reference", "composite": "standard"}
    work.time(Row("composite", "standard", "", levels=levels))
    assert [(s.name, level) for s, level in upon[0]] == [
        ("raster", frame.stages["raster"].levels[-2]),
        ("composite", "standard"),
    ]


def test_the_page_holds_everything() -> None:
    f = found()
    html = page(f, told(f))
    assert "a&lt;b&gt;.mp4" in html and "error × 8" in html
    assert html.count("standard (paper)") >= 2 and "usual (paper)" in html
    assert html.count("≈ 2") == 2, "what was not measured is marked"
    assert "http://" not in html.replace("http://www.w3.org", "")
    reference = np.full((4, 5, 3), 100, np.uint8)
    assert (error_map(reference, reference + 3) == 152).all() and (
        error_map(reference, reference) == 128
    ).all()


def test_the_other_formulas_pixels_do_not_dilute_a_levels_error() -> None:
    plain = np.full((20, 30, 3), 100, np.uint8)
    small, wide = plain.copy(), plain.copy()
    small[:5, :6] += 10
    wide[:, :15] += 50
    shown = {"standard": small, "reference": plain, "usual": wide}
    rows = [
        Row("dof", "usual", "paper", other={"dof": Stage()}),
        Row("dof", "standard", ""),
        Row("dof", "reference", ""),
    ]
    frame = SimpleNamespace(
        plan=SimpleNamespace(steps=[SimpleNamespace(stage="dof")])
    )
    work: Any = SimpleNamespace(
        frames={3: frame}, image=lambda frame, r: shown[r.level]
    )
    _compare(work, rows)
    other, own, _ = (r.by_frame[3] for r in rows)
    assert own.pixels == 30 and own.mean == pytest.approx(10, abs=0.5)
    assert other.pixels == 300 and other.mean == pytest.approx(50, abs=2)
