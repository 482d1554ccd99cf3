"""report.json of a job, from its facts, plans and timings (the fields are a contract: docs
of `arfx report`).

`health` holds every estimate with its value, limit, verdict, and what was done about it."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from arfx.analyse.clip import checks
from arfx.analyse.pose.visibility import jitter_px, with_model
from arfx.core.facts import ABSENT, FrameFacts
from arfx.core.layers import Layers
from arfx.core.plan import levels_of
from arfx.core.scene import Scene
from arfx.core.stage import Check, JobView, Stage
from arfx.media.cameras import calibration_claims
from arfx.plan.explain import summarise
from arfx.plan.planner import plan_frame
from arfx.run.frame import ready_stages, run_frame
from arfx.run.model_size import model_size
from arfx.run.parameters import stages_of
from arfx.run.planned import Job, places_in_words
from arfx.run.schedule import Chunk
from arfx.run.times import TimeSpent
from arfx.stages import STAGES

_SHADING = frozenset({"lightmap", "gi"})  # stages that lay the light on the object


def build_report(job: Job, chunks: Sequence[Chunk], join_s: float) -> dict[str, Any]:
    """The report of a job whose output is written.

    join_s : seconds that it took to put the chunks together
    """
    info, analysed, facts = job.inputs.info, job.analysed, job.facts
    pts = np.array(analysed.pts, dtype=object) * info.time_base
    steps = np.diff(pts).astype(float)
    uneven = bool(len(steps) and steps.max() - steps.min() > 0.1 * np.median(steps))
    last_s = float(np.median(steps)) if len(pts) > 1 else 1.0 / (info.fps or 25.0)
    seconds = float(pts[-1] - pts[0]) + last_s
    spent = job.log.spent(job.analysis_key, [c.name for c in chunks])
    rows = summarise(job.plan.frames, job.stages, job.inputs.camera.rect.area)
    for row in rows:
        row["measured_s"] = spent.stages.get(row["name"], 0.0)
    plan, output = job.inputs.output, job.inputs.output.path
    written = [output]
    if plan.is_sequence:
        written = [output.with_name(output.name % f.index) for f in facts]
    lit = {
        f.index for f in job.plan.frames if any(s.stage in _SHADING for s in f.steps)
    }
    shaded = sum(f.light is not None and f.index in lit for f in facts)
    return {
        "input": {
            "path": str(info.path),
            "frames": len(facts),
            "seconds": seconds,
            "width": info.width,
            "height": info.height,
            "fps": info.fps,
            "vfr": uneven,
            "rotation": info.rotation_deg,
            "audio": [str(s) for s in info.audio],
            "truncated": analysed.truncated,
            "missing": analysed.missing,
            "camera": job.inputs.camera.source,
            "camera_guessed": job.inputs.camera.guessed,
            "stream": info.to_json(),
        },
        "output": {
            "path": str(output),
            "frames": len(facts),
            "seconds": seconds,
            "bytes": sum(p.stat().st_size for p in written),
            "codec": plan.codec,
            "pixel_format": plan.pixel_format,
        },
        "model": model_size(job.scene, facts),
        "pose": _pose(job),
        "light": analysed.summary["light"] | {"frames_shaded": shaded},
        "depth": analysed.summary.get("depth"),
        "lens": analysed.summary.get("footage_lens"),
        "stages": rows,
        "levels": job.plan.levels,
        "predicted": job.plan.predicted,
        "health": [check.to_json() for check in health(job)],
        "timing": _timing(spent, job.plan.seconds, join_s, chunks),
        "workers": list(spent.workers),
        "notices": analysed.notices,
    }


def _timing(
    spent: TimeSpent, plan_s: float, join_s: float, chunks: Sequence[Chunk]
) -> dict[str, Any]:
    """Of a resumed job the time of all processes whose work is in the output, not of the
    last one alone.
    """
    s = defaultdict(float, spent.seconds)
    frames = sum(c.frames for c in chunks)
    return {
        "decode_s": s["decode"],
        "analyse_s": s["analyse"],
        "plan_s": plan_s,
        "render_s": sum(spent.stages.values()) + s["edit"],
        "encode_s": s["encode"] + join_s,
        "prepare_s": s["prepare"],
        "wall_s": spent.wall_s,
        "frames_per_s": frames / spent.wall_s if spent.wall_s > 0 else None,
        "peak_rss_mb": spent.peak_rss_mb,
        "resumed": spent.processes > 1,
        "processes": spent.processes,
        "frames_untimed": sum(c.frames for c in chunks if c.name in spent.untimed),
    }


def _pose(job: Job) -> dict[str, Any]:
    facts, summary = job.facts, job.analysed.summary
    corners, camera = job.scene.model_corners_m, job.inputs.camera
    before, after = (
        [
            float(np.nanmedian(px)) if np.isfinite(px).any() else 0.0
            for px in jitter_px(facts, corners, camera, raw)
        ]
        for raw in (True, False)
    )
    error = summary["reprojection_px"]
    return {
        **{k: v for k, v in summary.items() if k != "depth"},
        "reprojection_px": error["smoothed"] | {"before_smoothing": error["raw"]},
        # jitter of the object against its marker; the camera's own shake moves both and is
        # meant to stay
        "jitter_px": after[1],
        "jitter_before_smoothing_px": before[1],
        "jitter_with_camera_px": after[0],
        "jitter_with_camera_before_smoothing_px": before[0],
        "static": job.analysed.static,
        "world_from_marker": {
            k: p.to_json() for k, p in job.analysed.world_from_marker.items()
        },
    }


def health(job: Job) -> Iterator[Check]:
    """Every check of a job whose output is written.

    None of its values is not finite: it would have stopped there.
    """
    facts, summary, truncated = (
        job.facts,
        job.analysed.summary,
        job.analysed.truncated,
    )
    camera, file = job.inputs.camera, job.inputs.config.input.camera
    known = "guessed" if camera.guessed else "given"
    yield Check(
        "camera calibration",
        known,
        "given",
        not camera.guessed,
        "field of view assumed",
    )
    claims = {} if file is None else calibration_claims(file)
    again = "calibrate again"
    if word := claims.get("verdict"):
        ok = word in ("good", "usable")
        yield Check("calibration's own verdict", word, "usable", ok, again)
    if (number := claims.get("condition")) is not None:
        yield Check("calibration condition number", number, 1e8, number <= 1e8, again)
    yield from checks(facts, summary)
    ran = levels_of(job.plan.frames)
    levels = {
        name: frozenset(level for stage, level in ran if stage == name)
        for name in job.stages
    }
    for stage in job.stages.values():
        yield from stage.health(JobView(facts, job.scene, levels, picture))
    absent = sum(f.status == ABSENT for f in facts)
    yield Check(
        "frames without a pose", absent, 0, absent == 0, "object left out there"
    )
    missing = sum(count for _, count in job.analysed.missing)
    state = (
        "damaged" if job.analysed.damaged else "incomplete" if missing else "whole"
    )
    state, action = truncated or state, "processed to its last good frame"
    yield Check("source file", state, "whole", state == "whole", action)
    action = f"left out: {places_in_words(job.analysed.missing)}"
    yield Check("frames missing in the source", missing, 0, missing == 0, action)
    for where in ("facts", "pictures"):
        name = f"values that are not finite in the {where}"
        yield Check(name, 0, 0, True, "the job would have stopped there")


def picture(
    scene: Scene,
    facts: FrameFacts,
    levels: Mapping[str, str],
    own: Mapping[str, Stage] = MappingProxyType({}),
) -> Layers | None:
    """One frame by these stages with their usual settings, except `own`: see `JobView`."""
    (facts,) = with_model([facts], scene)
    stages = {
        **stages_of({name: STAGES[name].Params() for name in levels}, levels),
        **own,
    }
    plan = plan_frame(list(stages.values()), levels, facts, scene, scene.camera.rect)
    if not plan.steps:
        return None
    plate = np.ones((plan.rect.height, plan.rect.width, 3), np.float32)
    layers = run_frame(plate, facts, plan, ready_stages(plan, stages, scene)).layers
    return layers.view(plan.rect)
