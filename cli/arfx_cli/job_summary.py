"""What `process`, `demo`, `verify` and `report` say of a job: one line, and with --verbose the rest of its report."""

from __future__ import annotations

from typing import Any

from arfx_cli.console import detail, say


def say_job(report: dict[str, Any]) -> None:
    """The job in a line; with --verbose also its stages, phases and the health of every estimate."""
    pose, timing = report["pose"], report["timing"]
    reprojection = (pose.get("reprojection_px") or {}).get("median")
    say(
        f"{report['output']['frames']} frames to {report['output']['path']}: object in "
        f"{pose['frames_measured']} measured and {pose['frames_interpolated']} bridged frames, absent in {pose['frames_absent']}"
        + (f"; reprojection {reprojection:.2f} px" if reprojection is not None else "")
        + f"; {timing['wall_s']:.1f} s ({timing['frames_per_s']:.1f} frames/s)"
        + (f", resumed: the time of {timing['processes']} processes" if timing["resumed"] else "")
    )
    detail_job(report)


def detail_job(report: dict[str, Any]) -> None:
    given, made, timing = report["input"], report["output"], report["timing"]
    detail(f"camera: {given['camera']}{' (a guess)' if given['camera_guessed'] else ''}; {given['width']}x{given['height']}")
    detail(f"output: {made['codec']}, {made['pixel_format']}, {made['bytes'] / 1e6:.2f} MB")
    for s in report["stages"]:
        why = "".join(f"; left out in {n}: {text}" for text, n in s["reasons"].items())
        levels = ", ".join(s["levels"]) or "no level"
        area = f"{s['area_fraction']:.1%} of the picture"
        detail(f"stage {s['name']}: {s['frames_run']} frames, {levels}, {area}, {s['measured_s']:.2f} s{why}")
    light = report["light"]
    detail(f"light: {light['verdict']}, from {light['source']}: {light['reason']}")
    phases = ("decode", "analyse", "plan", "prepare", "render", "encode")
    detail("seconds: " + ", ".join(f"{p} {timing[f'{p}_s']:.2f}" for p in phases) + f"; peak {timing['peak_rss_mb']:.0f} MB")
    for h in report["health"]:
        value = f"{h['value']:.3g}" if isinstance(h["value"], float) else h["value"]
        against = "" if h["verdict"] == "ok" else f" (limit {h['limit']}): {h['action']}"
        detail(f"{h['verdict']}: {h['check']} {value}{against}")
