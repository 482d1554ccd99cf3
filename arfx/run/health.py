"""Every estimate of a job with its value, limit, verdict, and what was done about it: `health` of report.json."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from arfx.analyse.folds import FOLDS
from arfx.analyse.pose.visibility import with_model
from arfx.core.facts import ABSENT, FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.opener import read_text
from arfx.core.plan import levels_of
from arfx.core.scene import Scene
from arfx.core.stage import Check, JobView
from arfx.errors import InputError
from arfx.plan.planner import plan_frame
from arfx.run.frame import made_ready, run_frame
from arfx.run.parameters import stages_of
from arfx.run.planned import Job
from arfx.stages import STAGES

Rows = list[Check]


def health(job: Job) -> list[dict[str, Any]]:
    """Rows of {check, value, limit, verdict "ok" or "warn", action}. A job that got here made no value that is not finite:
    one that does stops with an error that names stage, frame and pixel."""
    facts, summary, truncated = job.facts, job.analysed.summary, job.analysed.truncated
    rows = [*_calibration(job), *(row for fold in FOLDS.values() for row in fold.health(facts, summary))]
    ran = levels_of(job.plan.frames)
    levels = {name: frozenset(level for stage, level in ran if stage == name) for name in job.stages}
    view = JobView(facts, job.scene, levels, picture)
    rows += [row for stage in job.stages.values() for row in stage.health(view)]
    absent = sum(f.status == ABSENT for f in facts)
    rows.append(Check("frames without a pose", absent, 0, absent == 0, "object left out there"))
    rows.append(Check("source file", truncated or "whole", "whole", truncated is None, "processed to its last good frame"))
    for where in ("facts", "pictures"):
        rows.append(Check(f"values that are not finite in the {where}", 0, 0, True, "the job would have stopped there"))
    return [row.to_json() for row in rows]


def picture(scene: Scene, facts: FrameFacts, levels: Mapping[str, str]) -> Layers | None:
    """One frame by these stages with their usual settings: see `JobView`."""
    (facts,) = with_model([facts], scene)
    stages = stages_of({name: STAGES[name].Params() for name in levels}, levels)
    plan = plan_frame(list(stages.values()), levels, facts, scene, scene.camera.rect)
    if not plan.steps:
        return None
    plate = np.ones((plan.rect.height, plan.rect.width, 3), np.float32)
    canvas = run_frame(plate, facts, plan, made_ready(plan, stages, scene)).canvas
    return canvas.view(frozenset(Layer), plan.rect)


def _calibration(job: Job) -> Rows:
    camera, config = job.inputs.camera, job.inputs.config
    known = "guessed" if camera.guessed else "given"
    rows = [Check("camera calibration", known, "given", not camera.guessed, "field of view assumed")]
    told = {} if config.input.camera is None else stated(config.input.camera)
    if "verdict" in told:
        word = told["verdict"]
        rows.append(Check("calibration's own verdict", word, "usable", word in ("good", "usable"), "calibrate again"))
    if "condition" in told:
        rows.append(Check("calibration condition number", told["condition"], 1e8, told["condition"] <= 1e8, "calibrate again"))
    return rows


def stated(path: Path) -> dict[str, Any]:
    """What `arfx calibrate` wrote of itself into a camera file; {} for files of others."""
    try:
        text = read_text(path, "camera file")
    except InputError:  # one camera of a file that holds several
        return {}
    out: dict[str, Any] = {}
    if found := re.search(r"^\W*verdict\W+(\w+)", text, re.MULTILINE):
        out["verdict"] = found[1]
    if found := re.search(r"^\W*condition\W+(\d+(?:\.\d*)?(?:[eE][+-]?\d{1,3})?)(?:\s|,|$)", text, re.MULTILINE):
        out["condition"] = float(found[1])
    return out
