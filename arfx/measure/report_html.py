"""report.html: one file without any outside link, its pictures inlined; every text escaped."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.errors import RenderError


def page(
    report: Mapping[str, Any],
    facts: Sequence[FrameFacts],
    before_after: Sequence[tuple[int, np.ndarray, np.ndarray]],
    plots: Mapping[str, bytes],
) -> str:
    """The whole page. plots : "pose" and "timing", PNG bytes."""
    clip = Path(str(report["input"]["path"])).name
    pose = plot_image(plots["pose"], "Trembling before and after smoothing, reprojection, status") + _legend()
    time = plot_image(plots["timing"], "Predicted and measured seconds") + _predicted(report)
    time += _facts_table(report["timing"])
    ends = f'<div class="two">{_facts_table(report["input"])}{_facts_table(report["output"])}</div>'
    sections = [
        _tiles(report),
        _warnings(report),
        _pictures(facts, before_after),
        section("Pose", pose + _pose_table(report["pose"])),
        section("Effects: what ran, and why not elsewhere", _stage_table(report["stages"])),
        section("Time", time),
        section("Health of the estimates", _health_table(report.get("health", []))),
        section("Light", _facts_table(report.get("light") or {})),
        section("Input and output", ends),
    ]
    return whole_page(f"{clip} – arfx report", sections)


def whole_page(title: str, sections: Sequence[str]) -> str:
    """page.html (style, and the slider before and after) with a title and these sections of HTML, empty ones left out."""
    frame = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
    return frame.replace("@TITLE@", _e(title)).replace("@BODY@", "\n".join(s for s in sections if s))


def _e(value: Any) -> str:
    return escape(str(value), quote=True)


def number(value: Any, digits: int = 3) -> str:
    """A value for reading: 3 significant digits, dashes for nothing, yes and no."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.{digits}g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(number(v, digits) for v in value) or "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {number(v, digits)}" for k, v in value.items()) or "–"
    return str(value)


def section(title: str, body: str) -> str:
    return f"<section><h2>{_e(title)}</h2>{body}</section>"


def plot_image(png: bytes, alt: str) -> str:
    return f'<img class="plot" alt="{_e(alt)}" src="{_uri(png, "image/png")}">'


def _uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def jpeg(rgb: np.ndarray, quality: int = 88) -> str:
    """An RGB uint8 picture as an address; quality : 0 to 100"""
    import cv2

    ok, data = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise RenderError(f"a picture of shape {rgb.shape} cannot be encoded")
    return _uri(data.tobytes(), "image/jpeg")


def _tiles(report: Mapping[str, Any]) -> str:
    pose, timing, out = report["pose"], report["timing"], report["output"]
    frames = out["frames"]
    present = pose["frames_measured"] + pose["frames_interpolated"]
    reprojection = (pose.get("reprojection_px") or {}).get("median")
    jitter = number(pose.get("jitter_px"))
    if pose.get("jitter_before_smoothing_px") is not None:
        jitter = f"{number(pose['jitter_before_smoothing_px'])} → {jitter}"
    tiles = [
        (f"{frames}", f"frames, {number(out['seconds'])} s"),
        (f"{present} of {frames}", f"frames with the object ({pose['frames_interpolated']} bridged)"),
        (f"{number(reprojection)} px", "reprojection, median"),
        (f"{jitter} px", "trembling before → after smoothing"),
        (f"{number(timing['wall_s'])} s", f"{number(timing['frames_per_s'])} frames/s, peak {number(timing['peak_rss_mb'])} MB"),
    ]
    boxes = "".join(f'<div class="tile"><b>{_e(big)}</b><span>{_e(small)}</span></div>' for big, small in tiles)
    path, result = _e(Path(str(report["input"]["path"])).name), _e(out["path"])
    return f'<header><h1>{path}</h1><p class="path">→ {result}</p><div class="tiles">{boxes}</div></header>'


def _warnings(report: Mapping[str, Any]) -> str:
    said = list(report.get("notices", []))
    said += [f"{h['check']}: {number(h['value'])} (limit {number(h['limit'])}); {h['action']}"
             for h in report.get("health", []) if h["verdict"] != "ok"]  # fmt: skip
    if not said:
        return ""
    items = "".join(f"<li>{_e(s)}</li>" for s in dict.fromkeys(said))
    return f'<section class="warn"><h2>Worth knowing</h2><ul>{items}</ul></section>'


def _pictures(facts: Sequence[FrameFacts], pairs: Sequence[tuple[int, np.ndarray, np.ndarray]]) -> str:
    if not pairs:
        return section("Before and after", "<p>The job kept no pictures.</p>")
    times = {f.index: f.time_s for f in facts}
    sheet = []
    for index, before, after in pairs:
        said = f"frame {index}" + (f", {times[index]:.2f} s" if index in times else "")
        sheet.append(
            f'<figure tabindex="0" data-said="{_e(said)}"><img class="out" alt="{_e(said)}, output" src="{jpeg(after)}">'
            f'<img class="in" hidden alt="{_e(said)}, input" src="{jpeg(before)}"><figcaption>{_e(said)}</figcaption></figure>'
        )
    slider = (
        '<div class="slider" hidden><div class="stack"><img class="below" alt="input"><img class="above" alt="output">'
        '<i class="bar"></i><span class="tag l">input</span><span class="tag r">output</span>'
        '<input type="range" min="0" max="100" step="0.1" value="50" aria-label="input on the left, output on the right"></div>'
        '<p class="said"></p></div>'
    )
    return section("Before and after", slider + f'<div class="sheet">{"".join(sheet)}</div>')


def _legend() -> str:
    from arfx.measure.report_plots import STATUS_COLOUR

    return '<p class="legend">' + " ".join(f'<i style="background:{c}"></i>{_e(s)}' for s, c in STATUS_COLOUR.items()) + "</p>"


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]], right: frozenset[int] = frozenset()) -> str:
    """rows hold HTML; a column in `right` is right-aligned."""

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(f"<{tag}{' class=num' if i in right else ''}>{c}</{tag}>" for i, c in enumerate(row))

    body = "".join(f"<tr>{cells(r, 'td')}</tr>" for r in rows)
    top = f"<thead><tr>{cells([_e(h) for h in head], 'th')}</tr></thead>" if any(head) else ""
    return f'<div class="scroll"><table>{top}<tbody>{body}</tbody></table></div>'


def _facts_table(values: Mapping[str, Any]) -> str:
    rows = [(_e(k.replace("_", " ")), _e(number(v))) for k, v in values.items() if k != "stream"]
    return html_table(("", ""), rows)


def _pose_table(pose: Mapping[str, Any]) -> str:
    keys = ("frames_measured", "frames_interpolated", "frames_absent", "reprojection_px", "jitter_px",
            "jitter_before_smoothing_px", "jitter_with_camera_px",
            "flips_resolved", "ambiguous_sightings", "whole_frame_searches", "static", "cuts", "markers_seen")  # fmt: skip
    return _facts_table({k: pose[k] for k in keys if k in pose})


def _stage_table(stages: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for s in stages:
        why = "<br>".join(f"{n} × {_e(text)}" for text, n in s.get("reasons", {}).items())
        levels = ", ".join(f"{_e(k)} {_e(v)}" for k, v in s.get("levels", {}).items())
        predicted, measured = s.get("predicted_s"), s.get("measured_s")
        rows.append((_e(s["name"]), levels, _e(s["frames_run"]), _e(s["frames_skipped"]), f"{100 * s['area_fraction']:.1f} %",
                     _e(number(predicted)), _e(number(measured)), why))  # fmt: skip
    head = ("stage", "level: frames", "ran", "left out", "area", "predicted, s", "measured, s", "why left out")
    return html_table(head, rows, frozenset({2, 3, 4, 5, 6}))


def _predicted(report: Mapping[str, Any]) -> str:
    """One sentence: what the plan said of the whole job, and what it took. Empty in reports of earlier versions."""
    predicted, timing = report.get("predicted") or {}, report["timing"]
    if not predicted:
        return ""
    wall = predicted.get("wall")
    if wall is None:
        return "<p>A part of this job had no price, so no time was predicted.</p>"
    ends = f"{number(wall['low_s'])} to {number(wall['high_s'])} s nine times in ten"
    prices = "" if predicted.get("calibrated") else "; with shipped prices: <code>arfx bench --calibrate</code> narrows them"
    return f"<p>The plan said {number(wall['s'])} s ({ends}{prices}); the job took {number(timing['wall_s'])} s.</p>"


def _health_table(health: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for h in health:
        mark = f'<b class="{"ok" if h["verdict"] == "ok" else "bad"}">{_e(h["verdict"])}</b>'
        rows.append((_e(h["check"]), _e(number(h["value"])), _e(number(h["limit"])), mark, _e(h["action"])))
    return html_table(("check", "value", "limit", "verdict", "action"), rows)
