"""The options that `process` and `plan` share, and how they become a job."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from arfx.errors import ConfigError

FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)

_OPTIONS = [
    click.option("--config", "config_file", type=FILE, help="Job file (TOML) or preset name; the command line wins."),
    click.option("--camera", type=FILE, help="Calibration: OpenCV, ROS, COLMAP, Kalibr, WPILib. Missing: a guess."),
    click.option("--marker", "markers", multiple=True, metavar="FAMILY:ID:SIZE", help="Repeatable: 36h11:3:165mm."),
    click.option("--marker-map", type=FILE, help="Known layout of several markers; without it they are mapped from the clip."),
    click.option("--model", type=FILE, help="glTF/GLB, OBJ, PLY, STL …; the middle of its base stands on the marker's centre."),
    click.option("--scale", type=float, help="Metres per file unit."),
    click.option("--fit", metavar="SIZE", help="Scale the model's largest extent to this length: 15cm."),
    click.option("--offset", metavar="X,Y,Z", help="Lengths along the marker's axes (x right, y up, z out): 0cm,2cm,0cm."),
    click.option("--rotate", metavar="X,Y,Z", help="Degrees about the marker's axes, in this order."),
    click.option("--up", type=click.Choice(["x", "y", "z"]), help="Which axis of the file points up; default by file type."),
    click.option("--pipeline", metavar="A,B,C", help="Effects allowed, in order; default auto = all that exist."),
    click.option("--no-skip", is_flag=True, help="Force every stage on every frame that has a pose."),
    click.option("--quality", type=click.Choice(["draft", "standard", "high", "reference"]), help="Level of every effect."),
    click.option("--budget", metavar="TIME", help="Levels: the best that keep the whole job within it: 90s, 1:30."),
    click.option("--fps", type=click.FloatRange(min=0, min_open=True), help="The same as frames per second of work."),
    click.option("--max-error", type=click.FloatRange(0), metavar="E", help="Levels: the cheapest within E mean grey levels."),
    click.option("--tradeoff", type=FILE, metavar="FILE", help="Errors of this clip's levels: a tradeoff.json; default shipped."),
    click.option("--light", metavar="AZ,EL[,R,G,B]", help="A known light: azimuth from the marker's x, elevation; degrees."),
    click.option("--environment", type=FILE, help="A known light: HDR panorama, its top the marker's z, its middle x."),
    click.option("--formula", type=click.Choice(["paper", "corrected"]), help="As printed, or with its defects removed."),
    click.option("--depth", type=click.Path(path_type=Path), help="Real depth: maps (16-bit PNG, PGM, EXR, TIFF), video (FFV1)."),
    click.option("--depth-scale", type=float, metavar="N", help="Stored depth values to a metre; default 1000 (mm), EXR 1."),
    click.option("--anchor", type=click.Choice(["marker", "plane"]), help="Stand on the marker, or on the depth's main plane."),
    click.option("--poses", type=FILE, help="Camera poses for --anchor plane: tx ty tz qx qy qz qw a frame."),
    click.option("--set", "settings", multiple=True, metavar="STAGE.KEY=VALUE", help="Any setting, repeatable."),
    click.option("--start", metavar="T", help="First moment to process, from the clip's first frame: 1.5s, 0:10."),
    click.option("--end", metavar="T", help="Last moment to process."),
]  # fmt: skip


_RUN_OPTIONS = [
    click.option("-o", "--output", type=click.Path(path_type=Path), help="out.mp4 .mkv .mov .webm, or frames/%06d.png|exr."),
    click.option("--codec", metavar="NAME", help="h264, h265, av1, prores, ffv1, png, exr; default by the output's name."),
    click.option("--crf", type=float, help="Constant rate factor of the codec: lower is better and larger."),
    click.option("--pixel-format", metavar="NAME", help="FFmpeg pixel format, such as yuv444p10le."),
    click.option("--report", "report_dir", type=FOLDER, help="Folder for report.json and report.html."),
    click.option("--job", "job_dir", type=FOLDER, help="Job folder, kept afterwards; default OUT.job."),
    click.option("--resume", is_flag=True, help="Go on with an interrupted or killed job."),
    click.option("--workers", type=click.IntRange(1), help="Worker processes; default: threads on up to 4 cores."),
]  # fmt: skip


def run_options(f: Callable[..., Any]) -> Callable[..., Any]:
    """Where a job goes and how it is run."""
    for option in reversed(_RUN_OPTIONS):
        f = option(f)
    return f


def job_options(f: Callable[..., Any]) -> Callable[..., Any]:
    for option in reversed(_OPTIONS):
        f = option(f)
    return click.argument("clip", type=FILE, required=False)(f)


def job_config(given: dict[str, Any], output: Path | None = None) -> Any:
    """The typed job from the parsed options.

    Raises ConfigError naming the option, and for an option and a --set that give one key different values.
    """
    from arfx.config.load import load, parse_setting, put_setting
    from arfx.config.presets import find
    from arfx.run.parameters import parameters, pipeline

    kinds = parameters()
    formulas = [name for name, kind in kinds.items() if any(f.name == "formula" for f in dataclasses.fields(kind))]
    tree: dict[str, Any] = {}
    settings = [(text, *parse_setting(text)) for text in given["settings"]]
    for text, parts, value in settings:
        put_setting(tree, parts, value, f"--set {text}")
    for path, value, words in _by_option(given, output, formulas):
        _agree(path, value, words, settings)
        put_setting(tree, list(path), value, words)
    file = given["config_file"]
    config = load(None if file is None else find(file), tree, kinds)
    pipeline(config)
    return config


def _by_option(given: dict[str, Any], output: Path | None, formulas: Sequence[str]) -> Iterator[tuple[tuple[str, ...], Any, str]]:
    """(key in a job file, value, the words that gave it) of every ordinary option on the command line."""
    files = {
        "clip": "input.clip", "camera": "input.camera", "marker_map": "input.marker_map", "model": "model.file",
        "depth": "input.depth", "poses": "input.poses", "tradeoff": "pipeline.tradeoff",
    }  # fmt: skip
    plain = {
        "start": "input.start", "end": "input.end", "depth_scale": "input.depth_scale", "anchor": "model.anchor",
        "scale": "model.scale", "fit": "model.fit", "up": "model.up",
        "quality": "pipeline.quality", "budget": "pipeline.budget", "fps": "pipeline.fps",
        "max_error": "pipeline.max_error", "codec": "output.codec", "crf": "output.crf",
        "pixel_format": "output.pixel_format",
    }  # fmt: skip
    for name, dotted in {**files, **plain}.items():
        value = given[name]
        if value is not None:
            words = f"CLIP {value}" if name == "clip" else f"--{name.replace('_', '-')} {value}"
            yield tuple(dotted.split(".")), str(value) if name in files else value, words
    for name in ("offset", "rotate"):
        if given[name] is not None:
            three = _three(given[name], f"--{name}")
            value = [_number(v, f"--{name}") for v in three] if name == "rotate" else three
            yield ("model", name), value, f"--{name} {given[name]}"
    if given["markers"]:
        yield ("marker",), [{"spec": m} for m in given["markers"]], " ".join(f"--marker {m}" for m in given["markers"])
    if given["pipeline"]:
        names = [n.strip() for n in given["pipeline"].split(",") if n.strip()]
        yield ("pipeline", "stages"), "auto" if names == ["auto"] else names, f"--pipeline {given['pipeline']}"
    if given["no_skip"]:
        yield ("pipeline", "skip"), False, "--no-skip"
    if given["light"]:
        from arfx.analyse.params import parse_light

        yield ("light", "given"), parse_light(given["light"]), f"--light {given['light']}"
    if given["environment"]:
        yield ("light", "environment"), str(given["environment"]), f"--environment {given['environment']}"
    if given["formula"]:
        for name in formulas:
            yield (name, "formula"), given["formula"], f"--formula {given['formula']}"
    if output is not None:
        yield ("output", "path"), str(output), f"-o {output}"


def _agree(path: tuple[str, ...], value: Any, words: str, settings: list[tuple[str, list[str], Any]]) -> None:
    """Refuse a --set that gives another value to the key that an option gives: one of them would be lost unsaid."""
    from arfx.config.load import same_value

    for text, parts, other in reversed(settings):  # of several --set the last one counts
        common = min(len(path), len(parts))
        if tuple(parts[:common]) != path[:common]:
            continue
        if len(parts) != len(path) or not same_value(path, value, other):
            raise ConfigError(f"{words} and --set {text} give different values to {'.'.join(path)}", "give one of them")
        return


def _three(text: str, option: str) -> list[str]:
    parts = [p.strip() for p in text.split(",")]
    if len(parts) != 3:
        raise ConfigError(f"{option} {text!r} is not three values", "X,Y,Z with commas")
    return parts


def _number(text: str, option: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{option}: {text!r} is not a number of degrees") from None
