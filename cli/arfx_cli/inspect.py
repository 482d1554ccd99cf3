"""`arfx inspect`: what is in a clip, and the `process` command for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from arfx.core.opener import printable
from arfx.errors import counted
from arfx_cli.console import FILE, detail, emit_json, message_options, print_table, tell

LEFT_OUT_SHOWN = 8


@click.command()
@click.argument("clip", type=FILE)
@click.option(
    "--camera", type=FILE, help="Calibration file; with it the markers' tilt is shown too."
)
@click.option(
    "--samples",
    type=click.IntRange(1, 1000),
    default=24,
    show_default=True,
    help="Frames that are searched.",
)
@message_options
def command(clip: Path, camera: Path | None, samples: int, as_json: bool) -> None:
    """Stream properties of CLIP, the markers in it, blur and light, and the `process`
    command that fits.

    \b
    Example:
      arfx inspect clip.mp4 --camera camera.yaml"""
    from arfx.measure.inspection import inspect, suggestion
    from arfx.media.cameras import load_camera
    from arfx.media.clip import probe

    info = probe(clip)
    lens = (
        None
        if camera is None
        else load_camera(camera).scaled_to(info.width, info.height, info.pixel_aspect)
    )
    document = inspect(info, lens, samples)
    document["suggestion"] = suggestion(document, clip, camera)
    _detail(document)
    if as_json:
        emit_json(document)
        return
    _print(document)


def _detail(document: dict[str, Any]) -> None:
    c = document["clip"]
    for s in c["streams"]:
        detail(
            f"stream {', '.join(f'{k} {v}' for k, v in s.items() if v not in (None, ''))}"
        )
    detail(
        f"time base {c['time_base']} s, transfer {c['transfer']}, sample aspect"
        f" {c['sample_aspect'] or 'not stated'}"
    )
    detail("frames searched: " + ", ".join(map(str, document["samples"])))
    for m in document["markers"]:
        detail(
            f"{m['marker']}: in {m['frames']} of {m['looked']} frames searched, twice in"
            f" {m['twice_in_a_frame']}"
        )


def _print(document: dict[str, Any]) -> None:
    from arfx.analyse.markers.detect import SCANNED_FAMILIES
    from arfx.measure.inspection import size_names

    c, light = document["clip"], document["light"]
    pixels = (
        f"{c['pixel_format']}, {'full' if c['full_range'] else 'limited'} range,"
        f" {c['matrix']}"
    )
    rate = "unknown rate" if c["fps"] is None else f"{c['fps']:.3f} frames/s"
    times = (
        f"{counted(c['frames'], 'frames')}, {c['seconds']:.2f} s from {c['start_s']:.3f} s,"
        f" {rate}"
    )
    times += ", variable" if c["vfr"] else ", even"
    if c["gaps"]:
        times += f"; {c['gaps']} gaps, the longest {c['longest_gap_s']:.3f} s"
    cuts = (
        "not looked for (long clip)"
        if document["cuts"] is None
        else ", ".join(f"frame {i}" for i in document["cuts"]) or "none"
    )
    others = (
        ", ".join(
            str(s["kind"]) + " " + str(s["codec"]) for s in c["streams"] if not s["used"]
        )
        or "none"
    )
    level = light["mean_level"]
    brightness = (
        "no frame"
        if level is None
        else (
            f"mean level {level['median']:.0%} (from {level['min']:.0%} to"
            f" {level['max']:.0%}), clipped up to {light['clipped_fraction']:.1%}, black up"
            f" to {light['black_fraction']:.1%}"
        )
    )
    for name, value in (
        ("clip", c["path"]),
        (
            "picture",
            f"{c['width']}x{c['height']}, {c['codec']}, {pixels}, rotation"
            f" {c['rotation_deg']}°",
        ),
        ("time", times),
        ("other streams", others),
        ("light", brightness),
        ("cuts", cuts),
        *(("damage", text) for text in [c["truncated"]] if text),
        *(("note", text) for text in c["notices"]),
    ):
        click.echo(f"{name:15}{printable(str(value))}")
    looked = len(document["samples"])
    if not document["markers"]:
        click.echo(
            f"\nNo marker was found in {counted(looked, 'sampled frames')} (dictionaries"
            f" tried: {', '.join(SCANNED_FAMILIES)})."
        )
        _print_left_out(document)
        help_text = (
            "a marker needs a white margin, sides of 12 px or more and even light;"
            " --samples looks at more frames"
        )
        tell(f"help: {help_text}")
        return
    rows = [
        (
            m["marker"] + (" (twice in a frame)" if m["twice_in_a_frame"] else ""),
            f"{m['frames']}",
            *(_range(m[k]) for k in ("side_px", "blur_px", "tilt_deg")),
        )
        for m in document["markers"]
    ]
    print_table(
        f"\nmarkers in {counted(looked, 'sampled frames')}",
        ("marker", "seen", "side, px", "edge blur, px", "tilt, °"),
        rows,
    )
    _print_left_out(document)
    click.echo(f"A marker is in {document['marker_coverage']:.0%} of the sampled frames.")
    if document["camera"] is None:
        click.echo(
            "Calibrate the camera with `arfx calibrate`; without --camera the field of view"
            " is guessed."
        )
    first, names = document["markers"][0]["marker"], size_names(document["markers"])
    for name, m in zip(names, document["markers"], strict=True):
        if name != "SIZE":
            click.echo(
                f"{m['marker']} is about {m['size_of_first']:.2g} times as large as {first}:"
                f" {name}"
            )
    click.echo("\nNext, with SIZE = the measured side of the black square (such as 165mm):")
    click.echo("  " + document["suggestion"])


def _print_left_out(document: dict[str, Any]) -> None:
    rows = document["left_out"]
    for m in rows[:LEFT_OUT_SHOWN]:
        click.echo(
            f"left out: {m['marker']}, in {m['frames']} of {m['looked']}: {m['why']}"
        )
    if len(rows) > LEFT_OUT_SHOWN:
        click.echo(f"left out: {len(rows) - LEFT_OUT_SHOWN} more (--json lists them)")


def _range(spread: dict[str, float] | None) -> str:
    if spread is None:
        return "–"
    return f"{spread['median']:.3g} ({spread['min']:.3g} … {spread['max']:.3g})"
