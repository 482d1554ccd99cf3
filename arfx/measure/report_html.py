"""report.html: one file without any outside link, its pictures inlined; every text escaped."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from arfx.analyse.pose.visibility import jitter_px
from arfx.core.camera import Camera
from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED, FrameFacts
from arfx.core.opener import printable
from arfx.errors import RenderError

POSE_FIGURES = (
    "frames_measured",
    "frames_interpolated",
    "frames_absent",
    "reprojection_px",
    "jitter_px",
    "jitter_before_smoothing_px",
    "jitter_with_camera_px",
    "flips_resolved",
    "ambiguous_sightings",
    "whole_frame_searches",
    "static",
    "cuts",
    "markers_seen",
)


def page(
    report: Mapping[str, Any],
    facts: Sequence[FrameFacts],
    before_after: Sequence[tuple[int, np.ndarray, np.ndarray]],
    plots: Mapping[str, bytes],
) -> str:
    """The whole page. plots : "pose" and "timing", PNG bytes."""
    clip = Path(str(report["input"]["path"])).name
    legend = " ".join(
        f'<i style="background:{c}"></i>{escaped(s)}' for s, c in STATUS_COLOUR.items()
    )
    pose = plot_image(
        plots["pose"], "Trembling before and after smoothing, reprojection, status"
    )
    pose += f'<p class="legend">{legend}</p>'
    time = plot_image(plots["timing"], "Predicted and measured seconds") + _predicted(
        report
    )
    time += _facts_table(report["timing"])
    workers = report.get("workers") or []
    if len(workers) > 1:
        keys = ("name", "host", "chunks", "frames", "seconds")
        time += html_table(keys, [[w[k] for k in keys] for w in workers])
    ends = (
        "<div"
        f' class="two">{_facts_table(report["input"])}{_facts_table(report["output"])}</div>'
    )
    sections = [
        _tiles(report),
        _warnings(report),
        _pictures(facts, before_after),
        section(
            "Pose",
            pose
            + _facts_table(
                {k: report["pose"][k] for k in POSE_FIGURES if k in report["pose"]}
            ),
        ),
        section("Effects: what ran, and why not elsewhere", _stage_table(report["stages"])),
        section("Time", time),
        section("Health of the estimates", _health_table(report.get("health", []))),
        section("Light", light_told(report.get("light") or {})),
        section("Input and output", ends),
    ]
    return full_page(f"{clip} – arfx report", sections)


def full_page(title: str, sections: Sequence[str]) -> str:
    """page.html (style, and the slider before and after) with a title and these sections of
    HTML, empty ones left out.
    """
    frame = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
    before, _, after = frame.partition("@BODY@")
    return (
        before.replace("@TITLE@", escaped(title))
        + "\n".join(s for s in sections if s)
        + after
    )


def escaped(value: Any) -> str:
    """Text for HTML."""
    return escape(printable(str(value)), quote=True)


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


class Html(str):
    """Text that is HTML already."""


def cell(value: Any) -> str:
    """HTML of a value in a table."""
    return value if isinstance(value, Html) else escaped(number(value))


def figure(rgb: np.ndarray, caption: str, quality: int) -> str:
    """A picture, (h, w, 3) uint8 RGB, over its caption. quality : of JPEG, 0 to 100"""
    text = escaped(caption)
    return (
        f'<figure><img alt="{text}"'
        f' src="{jpeg(rgb, quality)}"><figcaption>{text}</figcaption></figure>'
    )


def tiles(values: Sequence[tuple[Any, str]]) -> str:
    """Large figures, each over what it is."""
    boxes = "".join(
        f'<div class="tile"><b>{escaped(big)}</b><span>{escaped(small)}</span></div>'
        for big, small in values
    )
    return f'<div class="tiles">{boxes}</div>'


def section(title: str, body: str) -> str:
    return f"<section><h2>{escaped(title)}</h2>{body}</section>"


def plot_image(png: bytes, alt: str) -> str:
    return f'<img class="plot" alt="{escaped(alt)}" src="{_uri(png, "image/png")}">'


def _uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def jpeg(rgb: np.ndarray, quality: int = 88) -> str:
    """An RGB uint8 picture as an address; quality : 0 to 100"""
    import cv2

    ok, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
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
    shown = [
        (frames, f"frames, {number(out['seconds'])} s"),
        (
            f"{present} of {frames}",
            f"frames with the object ({pose['frames_interpolated']} bridged)",
        ),
        (f"{number(reprojection)} px", "reprojection, median"),
        (f"{jitter} px", "jitter before → after smoothing"),
        (
            f"{number(timing['wall_s'])} s",
            (
                f"{number(timing['frames_per_s'])} frames/s, peak"
                f" {number(timing['peak_rss_mb'])} MB"
            ),
        ),
    ]
    path, result = escaped(Path(str(report["input"]["path"])).name), escaped(out["path"])
    return f'<header><h1>{path}</h1><p class="path">→ {result}</p>{tiles(shown)}</header>'


def _warnings(report: Mapping[str, Any]) -> str:
    bad = (h for h in report.get("health", []) if h["verdict"] != "ok")
    checks = (
        f"{h['check']}: {number(h['value'])} (limit {number(h['limit'])}); {h['action']}"
        for h in bad
    )
    items = "".join(
        f"<li>{escaped(s)}</li>"
        for s in dict.fromkeys([*report.get("notices", []), *checks])
    )
    return (
        items and f'<section class="warn"><h2>Worth knowing</h2><ul>{items}</ul></section>'
    )


def _pictures(
    facts: Sequence[FrameFacts], pairs: Sequence[tuple[int, np.ndarray, np.ndarray]]
) -> str:
    if not pairs:
        return section("Before and after", "<p>The job kept no pictures.</p>")
    times = {f.index: f.time_s for f in facts}
    sheet = []
    for index, before, after in pairs:
        caption = escaped(
            f"frame {index}" + (f", {times[index]:.2f} s" if index in times else "")
        )
        sheet.append(
            f'<figure tabindex="0" data-said="{caption}"><img class="out" alt="{caption},'
            f' output" src="{jpeg(after)}"><img class="in" hidden alt="{caption}, input"'
            f' src="{jpeg(before)}"><figcaption>{caption}</figcaption></figure>'
        )
    slider = (
        '<div class="slider" hidden><div class="stack"><img class="below" alt="input"><img'
        ' class="above" alt="output"><i class="bar"></i><span class="tag'
        ' l">input</span><span class="tag r">output</span><input type="range" min="0"'
        ' max="100" step="0.1" value="50" aria-label="input on the left, output on the'
        ' right"></div><p class="said"></p></div>'
    )
    return section(
        "Before and after", slider + f'<div class="sheet">{"".join(sheet)}</div>'
    )


def html_table(
    head: Sequence[str], rows: Sequence[Sequence[Any]], right: frozenset[int] = frozenset()
) -> str:
    """Cells are values for `number`, or Html; a column in `right` is right-aligned."""

    def cells(row: Sequence[Any], tag: str) -> str:
        inner = "".join(
            f"<{tag}{' class=num' if i in right else ''}>{cell(c)}</{tag}>"
            for i, c in enumerate(row)
        )
        return f"<tr>{inner}</tr>"

    body = "".join(cells(r, "td") for r in rows)
    top = f"<thead>{cells(head, 'th')}</thead>" if any(head) else ""
    return f'<div class="scroll"><table>{top}<tbody>{body}</tbody></table></div>'


def _facts_table(values: Mapping[str, Any]) -> str:
    rows = [(k.replace("_", " "), v) for k, v in values.items() if k != "stream"]
    return html_table(("", ""), rows)


VERDICTS = {
    "measured": "Measured: nothing else explains what the markers showed.",
    "likely": (
        "Likely: the simplest light that explains what the markers showed. Its shadow is as"
        " soft as it is uncertain."
    ),
    "refused": "Not known: soft light is used.",
    "assumed": "Given, as bright as the markers show.",
}


def light_told(light: Mapping[str, Any]) -> str:
    """The verdict in words, what it was in each span where it changes, and all figures."""
    said = (
        f"<p><b>{escaped(VERDICTS.get(light.get('verdict', ''), ''))}</b>"
        f" {escaped(light.get('reason', ''))}</p>"
    )
    spans = light.get("spans") or []
    rows = [
        (
            f"{s['start_s']:.2f} – {s['end_s']:.2f}",
            s["verdict"],
            [li["rgb"] for li in s["lights"]],
            s["ambient_rgb"],
            s["reason"],
        )
        for s in spans
    ]
    table = (
        html_table(("seconds", "verdict", "lights, RGB", "ambient RGB", "reason"), rows)
        if len(spans) > 1
        else ""
    )
    return (
        said
        + table
        + _facts_table({k: v for k, v in light.items() if k not in ("spans", "reason")})
    )


def _stage_table(stages: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for s in stages:
        why = "<br>".join(
            f"{n} × {escaped(text)}" for text, n in s.get("reasons", {}).items()
        )
        levels = ", ".join(f"{k} {v}" for k, v in s.get("levels", {}).items())
        rows.append(
            (
                s["name"],
                levels,
                s["frames_run"],
                s["frames_skipped"],
                f"{100 * s['area_fraction']:.1f} %",
                s.get("predicted_s"),
                s.get("measured_s"),
                Html(why),
            )
        )
    head = (
        "stage",
        "level: frames",
        "ran",
        "left out",
        "area",
        "predicted, s",
        "measured, s",
        "why left out",
    )
    return html_table(head, rows, frozenset({2, 3, 4, 5, 6}))


def _predicted(report: Mapping[str, Any]) -> str:
    """One sentence: what the plan predicted for the whole job, and what it took.

    Empty in reports of earlier versions.
    """
    predicted, timing = report.get("predicted") or {}, report["timing"]
    if not predicted:
        return ""
    wall = predicted.get("wall")
    if wall is None:
        return "<p>A part of this job had no price, so no time was predicted.</p>"
    ends = f"{number(wall['low_s'])} to {number(wall['high_s'])} s nine times in ten"
    prices = (
        ""
        if predicted.get("calibrated")
        else "; with shipped prices: <code>arfx bench --calibrate</code> narrows them"
    )
    return (
        f"<p>The plan predicted {number(wall['s'])} s ({ends}{prices}); the job took"
        f" {number(timing['wall_s'])} s.</p>"
    )


def _health_table(health: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for h in health:
        mark = f'<b class="{"ok" if h["verdict"] == "ok" else "bad"}">{escaped(h["verdict"])}</b>'
        rows.append((h["check"], h["value"], h["limit"], Html(mark), h["action"]))
    return html_table(("check", "value", "limit", "verdict", "action"), rows)


INK = "#7d8590"  # readable on white and on nearly black
RAW, SMOOTH, PREDICTED = "#d9822b", "#2f81f7", "#8b949e"
STATUS_COLOUR = {MEASURED: "#2da44e", INTERPOLATED: "#d4a72c", ABSENT: "#cf5b56"}


def pose_plot(
    facts: Sequence[FrameFacts], camera: Camera | None, points_m: np.ndarray | None
) -> bytes:
    """Trembling before and after smoothing, reprojection error, and each frame's status as
    a coloured strip.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    times = np.array([f.time_s for f in facts], float)
    fig = Figure(figsize=(9.0, 4.6), layout="constrained")
    jitter, error, strip = fig.subplots(3, 1, sharex=True, height_ratios=(5, 3, 0.7))
    if camera is not None and points_m is not None and len(facts) > 2:
        for raw, colour, label in (
            (True, RAW, "before smoothing"),
            (False, SMOOTH, "after smoothing"),
        ):
            _, d = jitter_px(facts, points_m, camera, raw)
            label += (
                f", median {np.nanmedian(d):.3g} px"
                if np.isfinite(d).any()
                else ", no three frames in a row"
            )
            jitter.plot(times, d, color=colour, lw=0.9 if raw else 1.4, label=label)
        jitter.legend(loc="upper right", frameon=False, labelcolor=INK, fontsize=8)
    jitter.set_ylabel("second difference, px", fontsize=8)
    jitter.set_title(
        "Jitter of a cube on the marker against the footage",
        fontsize=9,
        loc="left",
        color=INK,
    )
    px = np.array(
        [np.nan if f.reprojection_px is None else f.reprojection_px for f in facts], float
    )
    error.plot(times, px, ".", ms=2.5, color=SMOOTH)
    error.set_ylabel("reprojection, px", fontsize=8)
    for axis in (jitter, error):
        axis.set_ylim(bottom=0)
    order = (MEASURED, INTERPOLATED, ABSENT)
    codes = np.array([[order.index(f.status) if f.status in order else 2 for f in facts]])
    if len(facts):
        end = times[-1] + (float(np.median(np.diff(times))) if len(facts) > 1 else 1.0)
        colours = ListedColormap([STATUS_COLOUR[s] for s in order])
        strip.pcolormesh(
            np.append(times, end), [0, 1], codes, cmap=colours, vmin=-0.5, vmax=2.5
        )
    strip.set_yticks([])
    strip.set_xlabel("time, s", fontsize=8)
    return png(fig)


def timing_plot(report: Mapping[str, Any]) -> bytes:
    """Predicted and measured seconds of each stage, and the phases of the job."""
    from matplotlib.figure import Figure

    stages = [s for s in report["stages"] if s["frames_run"]]
    phases = [
        (k.removesuffix("_s"), v)
        for k, v in report["timing"].items()
        if k.endswith("_s") and k != "wall_s"
    ]
    phases = [
        (k, v) for k, v in phases if k != "frames_per" and isinstance(v, (int, float))
    ]
    rows = max(len(stages), len(phases), 1)
    fig = Figure(figsize=(9.0, 0.9 + 0.36 * rows), layout="constrained")
    left, right = fig.subplots(1, 2)
    y = np.arange(len(stages))
    left.barh(
        y - 0.19,
        [s["predicted_s"] or 0.0 for s in stages],
        0.36,
        color=PREDICTED,
        label="predicted",
    )
    left.barh(
        y + 0.19,
        [s["measured_s"] or 0.0 for s in stages],
        0.36,
        color=SMOOTH,
        label="measured",
    )
    left.set_yticks(y, [s["name"] for s in stages])
    left.set_title("Stages, s (summed over workers)", fontsize=9, loc="left", color=INK)
    if stages:
        left.legend(frameon=False, labelcolor=INK, fontsize=8)
    y = np.arange(len(phases))
    right.barh(y, [v for _, v in phases], 0.6, color=SMOOTH)
    right.set_yticks(y, [k for k, _ in phases])
    right.set_title("Phases, s", fontsize=9, loc="left", color=INK)
    for axis in (left, right):
        axis.invert_yaxis()
    return png(fig)


def png(fig: Any) -> bytes:
    for axis in fig.axes:
        axis.set_facecolor("none")
        axis.tick_params(colors=INK, labelsize=8)
        axis.xaxis.label.set_color(INK)
        axis.yaxis.label.set_color(INK)
        for side, spine in axis.spines.items():
            spine.set_color(INK)
            spine.set_visible(side in ("left", "bottom"))
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=130, transparent=True)
    return out.getvalue()
