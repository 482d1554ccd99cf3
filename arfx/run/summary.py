"""report.json of a job, from its facts, plans and timings (the fields are a contract: docs of `arfx report`)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from arfx.analyse.pose.visibility import jitter_px
from arfx.plan.explain import summarise
from arfx.run.chunks import Chunk
from arfx.run.health import health
from arfx.run.planned import Job
from arfx.run.times import Spent


def build_report(job: Job, chunks: Sequence[Chunk], join_s: float) -> dict[str, Any]:
    """The report of a job whose output is written. join_s : seconds that it took to put the chunks together"""
    info, done, facts = job.inputs.info, job.analysed, job.facts
    pts = np.array(done.pts, dtype=object) * info.time_base
    steps = np.diff(pts).astype(float)
    uneven = bool(len(steps) and steps.max() - steps.min() > 0.1 * np.median(steps))
    last_s = float(np.median(steps)) if len(pts) > 1 else 1.0 / (info.fps or 25.0)
    seconds = float(pts[-1] - pts[0]) + last_s
    spent = job.log.spent(job.analysis_key, [c.key for c in chunks])
    rows = summarise(job.plan.frames, job.stages, job.inputs.camera.rect.area)
    for row in rows:
        row["measured_s"] = spent.stages.get(row["name"], 0.0)
    plan, output = job.inputs.output, job.inputs.output.path
    written = [output.with_name(output.name % f.index) for f in facts] if plan.is_sequence else [output]
    size = sum(p.stat().st_size for p in written)
    stream = info.to_json()
    return {
        "input": {
            "path": str(info.path), "frames": len(facts), "seconds": seconds, "width": info.width, "height": info.height,
            "fps": info.fps, "vfr": uneven, "rotation": info.rotation_deg,
            "audio": [str(s) for s in info.audio], "truncated": done.truncated,
            "camera": job.inputs.camera.source, "camera_guessed": job.inputs.camera.guessed, "stream": stream,
        },
        "output": {
            "path": str(output), "frames": len(facts), "seconds": seconds, "bytes": size,
            "codec": plan.codec, "pixel_format": plan.pixel_format,
        },
        "pose": _pose(job),
        "light": dict(job.analysed.summary["light"]),
        "depth": done.summary.get("depth"),
        "lens": done.summary.get("footage_lens"),
        "stages": rows,
        "levels": job.plan.levels,
        "predicted": job.plan.predicted,
        "health": health(job),
        "timing": _timing(spent, job.plan.seconds, join_s, chunks),
        "notices": done.notices,
    }  # fmt: skip


def _timing(spent: Spent, plan_s: float, join_s: float, chunks: Sequence[Chunk]) -> dict[str, Any]:
    """Of a resumed job the time of all processes whose work is in the output, not of the last one alone."""
    s = defaultdict(float, spent.seconds)
    frames = sum(c.frames for c in chunks)
    return {
        "decode_s": s["decode"], "analyse_s": s["analyse"], "plan_s": plan_s,
        "render_s": sum(spent.stages.values()) + s["edit"], "encode_s": s["encode"] + join_s, "prepare_s": s["prepare"],
        "wall_s": spent.wall_s, "frames_per_s": frames / spent.wall_s if spent.wall_s > 0 else None,
        "peak_rss_mb": spent.peak_rss_mb,
        "resumed": spent.processes > 1, "processes": spent.processes,
        "frames_untimed": sum(c.frames for c in chunks if c.key in spent.untimed),
    }  # fmt: skip


def _pose(job: Job) -> dict[str, Any]:
    facts, summary = job.facts, job.analysed.summary
    corners, camera = job.scene.model_corners_m, job.inputs.camera
    before, after = (
        [float(np.nanmedian(px)) if np.isfinite(px).any() else 0.0 for px in jitter_px(facts, corners, camera, raw)]
        for raw in (True, False)
    )
    return {
        **{k: v for k, v in summary.items() if k != "depth"},
        "reprojection_px": {**summary["reprojection_px"]["smoothed"], "before_smoothing": summary["reprojection_px"]["raw"]},
        # trembling of the object against its marker; the camera's own shake moves both and is meant to stay
        "jitter_px": after[1],
        "jitter_before_smoothing_px": before[1],
        "jitter_with_camera_px": after[0],
        "jitter_with_camera_before_smoothing_px": before[0],
        "static": job.analysed.static,
        "world_from_marker": {k: p.to_json() for k, p in job.analysed.world_from_marker.items()},
    }
