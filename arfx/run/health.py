"""Every estimate of a job with its value, limit, verdict, and what was done about it: `health` of report.json."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.cube import face_directions
from arfx.core.facts import ABSENT, FrameFacts
from arfx.core.numerics import angle_between, divide
from arfx.core.opener import read_text
from arfx.core.pose import find_rotvecs
from arfx.errors import InputError
from arfx.run.planned import Job

Rows = list[dict[str, Any]]
_LOOKS = 5  # environments that are looked at, evenly over the clip


def health(job: Job) -> Rows:
    """Rows of {check, value, limit, verdict "ok" or "warn", action}. A job that got here made no value that is not finite:
    one that does stops with an error that names stage, frame and pixel."""
    facts, summary, truncated = job.facts, job.analysed.summary, job.analysed.truncated
    rows = [*_calibration(job), *_pose(facts, summary), *_light(summary.get("light"))]
    rows += _lens(job) + _depth(job.analysed.depth) + _environment(facts) + _furnace(job)
    absent = sum(f.status == ABSENT for f in facts)
    rows.append(check("frames without a pose", absent, 0, absent == 0, "object left out there"))
    rows.append(check("source file", truncated or "whole", "whole", truncated is None, "processed to its last good frame"))
    find_rotvecs(p for f in facts for p in f.poses)
    bad = non_finite(f.to_json() for f in facts)
    rows.append(check("values that are not finite in the facts", bad, 0, bad == 0, "frames with them are not drawn"))
    rows.append(check("values that are not finite in the pictures", 0, 0, True, "the job would have stopped there"))
    return rows


def check(name: str, value: Any, limit: Any, ok: bool, action: str) -> dict[str, Any]:
    return {"check": name, "value": value, "limit": limit, "verdict": "ok" if ok else "warn", "action": "none" if ok else action}


def _calibration(job: Job) -> Rows:
    camera, config = job.inputs.camera, job.inputs.config
    known = "guessed" if camera.guessed else "given"
    rows = [check("camera calibration", known, "given", not camera.guessed, "field of view assumed")]
    told = {} if config.input.camera is None else stated(config.input.camera)
    if "verdict" in told:
        word = told["verdict"]
        rows.append(check("calibration's own verdict", word, "usable", word in ("good", "usable"), "calibrate again"))
    if "condition" in told:
        rows.append(check("calibration condition number", told["condition"], 1e8, told["condition"] <= 1e8, "calibrate again"))
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
        rows.append(check("reprojection median (px)", reprojection, 1.0, reprojection <= 1.0, action))
    ambiguous, sightings = summary["ambiguous_sightings"], sum(summary["markers_seen"].values())
    action = "two planar poses fit almost equally: chosen by the motion of the whole clip"
    rows.append(check("ambiguous sightings", ambiguous, sightings // 2, ambiguous <= sightings // 2, action))
    ratios = [m.ambiguity for f in facts for m in f.markers if np.isfinite(m.ambiguity)]
    if ratios:
        low = float(np.percentile(ratios, 5))
        rows.append(check("pose hypotheses: second error / first, 5th percentile", low, 3.0, low >= 3.0, action))
    condition = summary["pose_condition"]["median"]
    if condition is not None:
        weak = "pose is weak: larger or more tilted marker"
        rows.append(check("pose condition number", condition, 1e6, condition <= 1e6, weak))
    spread = [s for s in map(_pose_deviation, facts) if s is not None]
    if spread:
        turn, shift = (float(np.percentile([s[k] for s in spread], 95)) for k in (0, 1))
        rows.append(check("pose standard deviation, 95th percentile (deg)", turn, 2.0, turn <= 2.0, "smoothed over more frames"))
        rows.append(check("pose standard deviation, 95th percentile (% of distance)", shift, 2.0, shift <= 2.0,
                          "smoothed over more frames"))  # fmt: skip
    if not summary["map"]["given"] and summary["map"].get("condition") is not None:
        value = summary["map"]["condition"]
        rows.append(check("marker map condition number", value, 1e6, value <= 1e6, "show the markers together in more frames"))
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
    rows = [check("photometry condition number", condition, 1e6, ok, f"bias taken for 0: {photometry['reason']}")]
    if "verdict" not in light:  # no frame with a pose that lasts
        return rows
    # what the markers' normals say of a direction beside ambient light; a given light does not need it
    known = light["verdict"] != "refused"
    rows.append(check("light direction", light["verdict"], "measured or given", known, light["reason"]))
    if light["normals_seen"]:
        rows.append(check("light fit condition number", light["condition"], 1e3, known, "no direction claimed"))
    rows.append(check("clipped share of the markers", light["clipped_fraction"], 0.5, light["clipped_fraction"] <= 0.5,
                      "clipped samples left out: brightness rests on the others"))  # fmt: skip
    return rows


def _lens(job: Job) -> Rows:
    """The lens of the blur: given, or measured from the footage's edges."""
    params = job.inputs.config.params.get("dof")
    if "dof" not in job.stages or params is None:
        return []
    if params.lens != "footage":
        return [check("lens of the blur", "given", "given or measured", True, "")]
    fits = [f.extra["footage_lens"] for f in job.facts if f.extra.get("footage_lens")]
    known = [f for f in fits if f["known"]]
    reason = fits[0]["reason"] if fits else "not measured"
    rows = [
        check("lens of the blur", "measured" if known else "refused", "measured", bool(known), f"object stays sharp: {reason}")
    ]
    if known:
        share = max(float(divide(f["px_per_dioptre_ci95"], f["px_per_dioptre"])) for f in known)
        rows.append(check("lens of the blur, half width of its interval", share, 0.5, share <= 0.5, "blur is a rough guess"))
    return rows


def _depth(depth: dict[str, Any] | None) -> Rows:
    """Of the depth input: how well its scale fits the markers' planes."""
    if depth is None:
        return []
    told = "as stated" if depth["residual"] is None else depth["residual"]
    rows = [check("real depth: miss of the markers' planes", told if depth["known"] else depth["reason"], 0.1, depth["known"],
                  "not used: the real scene is the markers' planes")]  # fmt: skip
    if depth["known"]:
        without = depth["frames_without"]
        rows.append(check("frames without real depth", without, 0, without == 0, "markers' planes there"))
    return rows


def _environment(facts: Sequence[FrameFacts]) -> Rows:
    """Steps of the environment map across the edges of its cube beside those between texels within a face."""
    told = [f.extra["environment"] for f in facts if f.extra.get("environment")]
    if not told:
        return []
    from arfx.stages.gi.frame_light import decoded

    worst = max(seam_ratio(np.asarray(decoded(told[i]), float)) for i in np.linspace(0, len(told) - 1, _LOOKS).astype(int))
    return [
        check("environment: steps across cube edges / within faces", worst, 3.0, worst <= 3.0, "seam may show in reflections")
    ]


def seam_ratio(faces: np.ndarray) -> float:
    """Median step across the edges of a cube (6, n, n, 3) over that within its faces next to them; 1 = no seam.

    Flat maps have neither: steps below a thousandth of the mean count as that.
    """
    n = faces.shape[1]
    directions = face_directions(n)
    flat, values = directions.reshape(-1, 3), faces.reshape(-1, faces.shape[-1])
    border = np.zeros((n, n), bool)
    border[[0, -1], :] = border[:, [0, -1]] = True
    across: list[np.ndarray] = []
    within: list[np.ndarray] = []
    for face in range(6):
        own = np.arange(face * n * n, (face + 1) * n * n)[border.ravel()]
        others = np.delete(np.arange(6 * n * n), np.s_[face * n * n : (face + 1) * n * n])
        inner = np.setdiff1d(np.arange(face * n * n, (face + 1) * n * n), own)
        for candidates, steps in ((others, across), (inner if len(inner) else own, within)):
            near = candidates[np.argmax(flat[own] @ flat[candidates].T, axis=1)]
            apart_rad = np.maximum(angle_between(flat[own], flat[near]), 1e-6)
            steps.append(divide(np.abs(values[own] - values[near]).mean(1), apart_rad))
    least = max(1e-3 * float(np.abs(values).mean()) * n, 1e-9)
    return float(max(np.median(np.concatenate(across)), least) / max(np.median(np.concatenate(within)), least))


def _furnace(job: Job) -> Rows:
    """Only where voxels were used: not at level reference."""
    used = {s.level for p in job.plan.frames for s in p.steps if s.stage == "gi"} - {"reference"}
    if not used:
        return []
    from arfx.run.furnace import LIMIT, furnace_mean

    rows = []
    for level in sorted(used):
        mean = furnace_mean(job.scene, level)
        if mean is not None:
            ok = abs(mean - 1) <= LIMIT
            rows.append(check(f"voxel furnace at {level}: mean of 1", mean, f"1 ± {LIMIT}", ok, "gi at a higher level"))
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
