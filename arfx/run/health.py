"""Every estimate of a job with its value, limit, verdict, and what was done about it: `health` of report.json."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from arfx.analyse.pose.visibility import with_model
from arfx.core.facts import ABSENT, FrameFacts
from arfx.core.health import Check, JobView
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide
from arfx.core.opener import read_text
from arfx.core.plan import levels_of
from arfx.core.pose import find_rotvecs
from arfx.core.scene import Scene
from arfx.errors import InputError
from arfx.plan.planner import plan_frame
from arfx.run.frame import made_ready, run_frame
from arfx.run.planned import Job
from arfx.stages import STAGES

Rows = list[Check]


def health(job: Job) -> list[dict[str, Any]]:
    """Rows of {check, value, limit, verdict "ok" or "warn", action}. A job that got here made no value that is not finite:
    one that does stops with an error that names stage, frame and pixel."""
    facts, summary, truncated = job.facts, job.analysed.summary, job.analysed.truncated
    rows = [*_calibration(job), *_pose(facts, summary), *_light(summary.get("light"))]
    rows += _depth(job.analysed.depth)
    ran = levels_of(job.plan.frames)
    levels = {name: frozenset(level for stage, level in ran if stage == name) for name in job.stages}
    view = JobView(facts, job.scene, levels, picture)
    rows += [row for stage in job.stages.values() for row in stage.health(view)]
    absent = sum(f.status == ABSENT for f in facts)
    rows.append(Check("frames without a pose", absent, 0, absent == 0, "object left out there"))
    rows.append(Check("source file", truncated or "whole", "whole", truncated is None, "processed to its last good frame"))
    find_rotvecs(p for f in facts for p in f.poses)
    bad = non_finite(f.to_json() for f in facts)
    rows.append(Check("values that are not finite in the facts", bad, 0, bad == 0, "frames with them are not drawn"))
    rows.append(Check("values that are not finite in the pictures", 0, 0, True, "the job would have stopped there"))
    return [row.to_json() for row in rows]


def picture(scene: Scene, facts: FrameFacts, levels: Mapping[str, str]) -> Layers | None:
    """One frame by these stages with their usual settings: see `JobView`."""
    (facts,) = with_model([facts], scene)
    settings = {name: STAGES[name].Params() for name in levels}
    for name in levels:
        for other, changes in STAGES[name].overrides.items():
            settings[other] = replace(settings[other], **changes)
    stages = {name: STAGES[name](settings[name]) for name in levels}
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


def _pose(facts: Sequence[FrameFacts], summary: dict[str, Any]) -> Rows:
    rows: Rows = []
    reprojection = summary["reprojection_px"]["smoothed"]["median"]
    if reprojection is not None:
        action = "check marker size, calibration and lens mode"
        rows.append(Check("reprojection median (px)", reprojection, 1.0, reprojection <= 1.0, action))
    ambiguous, sightings = summary["ambiguous_sightings"], sum(summary["markers_seen"].values())
    action = "two planar poses fit almost equally: chosen by the motion of the whole clip"
    rows.append(Check("ambiguous sightings", ambiguous, sightings // 2, ambiguous <= sightings // 2, action))
    ratios = [m.ambiguity for f in facts for m in f.markers if np.isfinite(m.ambiguity)]
    if ratios:
        low = float(np.percentile(ratios, 5))
        rows.append(Check("pose hypotheses: second error / first, 5th percentile", low, 3.0, low >= 3.0, action))
    condition = summary["pose_condition"]["median"]
    if condition is not None:
        weak = "pose is weak: larger or more tilted marker"
        rows.append(Check("pose condition number", condition, 1e6, condition <= 1e6, weak))
    spread = [s for s in map(_pose_deviation, facts) if s is not None]
    if spread:
        turn, shift = (float(np.percentile([s[k] for s in spread], 95)) for k in (0, 1))
        rows.append(Check("pose standard deviation, 95th percentile (deg)", turn, 2.0, turn <= 2.0, "smoothed over more frames"))
        rows.append(Check("pose standard deviation, 95th percentile (% of distance)", shift, 2.0, shift <= 2.0,
                          "smoothed over more frames"))  # fmt: skip
    if not summary["map"]["given"] and summary["map"].get("condition") is not None:
        value = summary["map"]["condition"]
        rows.append(Check("marker map condition number", value, 1e6, value <= 1e6, "show the markers together in more frames"))
    return rows


def _pose_deviation(f: FrameFacts) -> tuple[float, float] | None:
    """(degrees, percent of the distance), the largest axis of each; None without a pose or covariance."""
    if f.pose_covariance is None or f.camera_from_world is None:
        return None
    c = np.asarray(f.pose_covariance, float)
    if c.shape != (6, 6) or not np.isfinite(c).all():
        return float("inf"), float("inf")
    turn, shift = (float(np.sqrt(max(np.linalg.eigvalsh(c[s, s])[-1], 0.0))) for s in (slice(0, 3), slice(3, 6)))
    away = float(np.linalg.norm(f.camera_from_world.translation_m))
    return float(np.degrees(turn)), float(divide(100 * shift, away))


def _light(light: dict[str, Any] | None) -> Rows:
    if light is None:
        return []
    photometry = light["photometry"]
    condition = max((c for c in photometry["condition"] if c is not None), default=None)
    ok = photometry["verdict"] == "measured"
    rows = [Check("photometry condition number", condition, 1e6, ok, f"bias taken for 0: {photometry['reason']}")]
    if "verdict" not in light:  # no frame with a pose that lasts
        return rows
    # what the markers' normals say of a direction beside ambient light; a given light does not need it
    known = light["verdict"] != "refused"
    rows.append(Check("light direction", light["verdict"], "measured or given", known, light["reason"]))
    if light["normals_seen"]:
        rows.append(Check("light fit condition number", light["condition"], 1e3, known, "no direction claimed"))
    rows.append(Check("clipped share of the markers", light["clipped_fraction"], 0.5, light["clipped_fraction"] <= 0.5,
                      "clipped samples left out: brightness rests on the others"))  # fmt: skip
    return rows


def _depth(depth: dict[str, Any] | None) -> Rows:
    """Of the depth input: how well its scale fits the markers' planes."""
    if depth is None:
        return []
    told = "as stated" if depth["residual"] is None else depth["residual"]
    rows = [Check("real depth: miss of the markers' planes", told if depth["known"] else depth["reason"], 0.1, depth["known"],
                  "not used: the real scene is the markers' planes")]  # fmt: skip
    if depth["known"]:
        without = depth["frames_without"]
        rows.append(Check("frames without real depth", without, 0, without == 0, "markers' planes there"))
    return rows


def non_finite(documents: Iterable[Any]) -> int:
    """How many numbers in these JSON-able documents are NaN or infinite; the infinite confidence of a light that was not
    measured is meant."""

    def count(value: Any, key: str = "") -> int:
        if isinstance(value, dict):
            return sum(count(v, k) for k, v in value.items())
        if isinstance(value, (list, tuple)):
            plain = len(value) > 2 and type(value[0]) is type(value[-1]) is float and all(type(v) is float for v in value)
            return 0 if plain and math.isfinite(sum(value)) else sum(count(v, key) for v in value)
        infinite = isinstance(value, float) and not np.isfinite(value)
        return int(infinite and not (key in ("confidence_deg", "px_per_dioptre_ci95", "focus_ci95") and value > 0))

    return sum(count(d) for d in documents)
