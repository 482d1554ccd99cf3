"""A plan touches a third of the pixels that forcing touches, for the same picture, where
little is called for (proportions of scene 0050); and a budget is kept by the plan, which a
resumed job reads back."""

from __future__ import annotations

import json
import time
from pathlib import Path

import av
import numpy as np
import pytest

from arfx.config.load import load
from arfx.core.light import DirectionalLight, Light
from arfx.core.stage import level_named
from arfx.errors import ConfigError
from arfx.measure.bench_scene import ball, bench_scene
from arfx.plan.planner import plan_frame
from arfx.run.folder import JobFolder, Lines
from arfx.run.frame import ready_stages, run_frame
from arfx.run.inputs import open_inputs
from arfx.run.job import Options, plan_job, process
from arfx.run.parameters import parameters
from arfx.stages import STAGES
from tests.clips import MARKER, write_camera, write_clip, write_model

FRAMES = 24
SEEN = 8


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Path:
    d = tmp_path_factory.mktemp("savings")
    write_clip(d / "clip.mp4", FRAMES, absent=range(SEEN, FRAMES))
    write_camera(d / "camera.yaml")
    write_model(d / "model.glb")
    return d


def job(material: Path, out: Path, **pipeline: object):  # type: ignore[no-untyped-def]
    return load(None, {
        "input": {"clip": str(material / "clip.mp4"), "camera": str(material / "camera.yaml")}, "marker": [{"spec": str(MARKER)}],
        "model": {"file": str(material / "model.glb"), "fit": "4cm"}, "output": {"path": str(out), "codec": "ffv1"},
        "pipeline": {"stages": ["lightmap", "dof"], **pipeline},
        # in focus for the first half of the time that the marker is seen
        "dof": {"scope": "virtual", "fnumber": 5.6, "focus": "object@0.13s, 5m@0.14s"},
    }, parameters())  # fmt: skip


def options(folder: Path, **more: object) -> Options:
    return Options(folder, notice=lambda _: None, **more)  # type: ignore[arg-type]


def test_planned_is_forced_for_a_part_of_the_work(
    material: Path, tmp_path: Path
) -> None:
    reports = {}
    for name, skip in (("planned", True), ("forced", False)):
        reports[name] = process(
            job(material, tmp_path / f"{name}.mkv", skip=skip),
            options(tmp_path / name),
        )
    pixels = {
        name: sum(s["area_fraction"] * s["frames_run"] for s in r["stages"])
        for name, r in reports.items()
    }
    assert pixels["forced"] >= 3 * pixels["planned"], (
        pixels
    )  # stage-pixels: seconds are not told apart on a busy machine
    dof = next(s for s in reports["planned"]["stages"] if s["name"] == "dof")
    assert 0 < dof["frames_run"] < SEEN and any(
        "blur circle" in r for r in dof["reasons"]
    )
    assert sum(dof["reasons"].values()) == FRAMES - dof["frames_run"]
    pictures = []
    for name in reports:
        with av.open(str(tmp_path / f"{name}.mkv")) as clip:
            pictures.append(
                [
                    f.to_ndarray(format="rgb24").astype(int)
                    for f in clip.decode(video=0)
                ]
            )
    assert max(np.abs(a - b).max() for a, b in zip(*pictures, strict=True)) <= 1


def test_a_small_object_in_a_large_picture_takes_a_third_of_the_time() -> None:
    """1920x1080, where what a stage costs by itself no longer hides what it costs by the
    pixel; in focus and out of it. The object covers 9,000 px, as it would at a hundredth of
    1280x720."""
    at = bench_scene(1920, 1080, 0.0044, ball(40, 31))
    lamp = DirectionalLight((0.5, 0.3, 1.0), (0.6, 0.6, 0.5), 5.0)
    facts = at.facts.with_(light=Light(ambient_rgb=(0.4, 0.4, 0.4), lights=(lamp,)))
    spent = {True: 0.0, False: 0.0}
    for focus, runs in (("object", 3), ("1m", 4)):
        dof = STAGES["dof"](
            STAGES["dof"].Params(scope="virtual", fnumber=4.0, focus=focus)
        )
        stages = {n: STAGES[n]() for n in ("raster", "lightmap", "composite")} | {
            "dof": dof
        }
        levels = {n: level_named(s.levels, "standard") for n, s in stages.items()}
        whole = plan_frame(
            list(stages.values()),
            levels,
            facts,
            at.scene,
            at.scene.camera.rect,
            skip=False,
        )
        ready = ready_stages(whole, stages, at.scene)
        pictures, times = {}, {True: [], False: []}
        for skip in [True, False] * 3:
            plan = plan_frame(
                list(stages.values()),
                levels,
                facts,
                at.scene,
                at.scene.camera.rect,
                skip,
            )
            assert len(plan.steps) == (runs if skip else 4)
            plate = at.plate[plan.rect.slices]
            start = time.process_time()
            made = run_frame(plate, facts, plan, ready)
            times[skip].append(time.process_time() - start)
            pictures[skip] = at.plate.copy()
            pictures[skip][plan.changed.slices] = made.image
        for skip in times:
            spent[skip] += min(times[skip])
        assert np.abs(pictures[True] - pictures[False]).max() < 0.004
    assert spent[False] >= 3 * spent[True], spent


def test_a_budget_is_planned_on_its_upper_end_and_a_resumed_job_keeps_its_plan(
    material: Path, tmp_path: Path
) -> None:
    folder = JobFolder(tmp_path / "job")
    folder.open(False)
    config = job(material, tmp_path / "out.mkv", budget="500s")
    first = plan_job(open_inputs(config), folder, options(folder.path))
    assert (
        first.plan.levels["by"] == "budget"
        and first.plan.predicted["wall"]["high_s"] <= 500
        and first.plan.levels["met"]
    )
    levels = {(row["stage"], row["level"]) for row in first.plan.levels["chosen"]}
    assert ("raster", "reference") in levels, "there is time for the best"
    written = folder.plan.read_bytes()
    (line,) = Lines(folder.plan, json.loads)[:1]
    assert len(line["steps"][0]["cost"]) == 3
    json.loads(folder.plan_summary.read_text())
    again = plan_job(open_inputs(config), folder, options(folder.path, resume=True))
    assert (
        folder.plan.read_bytes() == written and again.plan.frames == first.plan.frames
    )
    hurried = tmp_path / "hurried"
    JobFolder(hurried).open(False)
    told: list[str] = []
    poor = plan_job(
        open_inputs(job(material, tmp_path / "o.mkv", budget="0.01s")),
        JobFolder(hurried),
        Options(hurried, notice=told.append),
    )
    assert not poor.plan.levels["met"] and any("even the cheapest" in t for t in told)
    seconds = [
        sum(s.cost.seconds for p in plan.plan.frames for s in p.steps)
        for plan in (poor, first)
    ]
    assert seconds[0] < seconds[1]


def test_two_ways_to_choose_levels_are_one_too_many(
    material: Path, tmp_path: Path
) -> None:
    folder = JobFolder(tmp_path / "job")
    folder.open(False)
    with pytest.raises(ConfigError, match="both choose levels"):
        plan_job(
            open_inputs(job(material, tmp_path / "o.mkv", budget="9s", max_error=1)),
            folder,
            options(folder.path),
        )
