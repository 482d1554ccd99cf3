"""The options that `process` and `plan` share, and how they become a job."""

from __future__ import annotations

from collections.abc import Callable
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
    click.option("--set", "settings", multiple=True, metavar="STAGE.KEY=VALUE", help="Any setting, repeatable."),
    click.option("--start", metavar="T", help="First moment to process, from the clip's first frame: 1.5s, 0:10."),
    click.option("--end", metavar="T", help="Last moment to process."),
]  # fmt: skip


_RUN_OPTIONS = [
    click.option("-o", "--output", type=click.Path(path_type=Path), help="out.mp4 .mkv .mov .webm, or frames/%06d.png|exr."),
    click.option("--report", "report_dir", type=FOLDER, help="Folder for report.json and report.html."),
    click.option("--job", "job_dir", type=FOLDER, help="Job folder, kept afterwards; default OUT.job."),
    click.option("--resume", is_flag=True, help="Go on with an interrupted or killed job."),
    click.option("--workers", type=click.IntRange(1), help="Worker processes; default by the length of the job."),
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
    """The typed job from the parsed options. Raises ConfigError naming the option."""
    from arfx.config.load import load, parse_setting
    from arfx.config.presets import find
    from arfx.run.parameters import parameters, pipeline

    tree: dict[str, Any] = {}

    def put(section: str, key: str, value: Any) -> None:
        if value is not None:
            tree.setdefault(section, {})[key] = value

    for text in given["settings"]:
        parts, value = parse_setting(text)
        at = tree
        for part in parts[:-1]:
            at = at.setdefault(part, {})
        at[parts[-1]] = value
    for key in ("clip", "camera", "marker_map"):
        put("input", key, given[key] and str(given[key]))
    for key in ("start", "end"):
        put("input", key, given[key])
    put("model", "file", given["model"] and str(given["model"]))
    for key in ("scale", "fit", "up"):
        put("model", key, given[key])
    put("model", "offset", _three(given["offset"], "--offset"))
    rotate = _three(given["rotate"], "--rotate")
    put("model", "rotate", rotate and [_number(v, "--rotate") for v in rotate])
    if given["markers"]:
        tree["marker"] = [{"spec": m} for m in given["markers"]]
    if given["pipeline"]:
        names = [n.strip() for n in given["pipeline"].split(",") if n.strip()]
        put("pipeline", "stages", "auto" if names == ["auto"] else names)
    put("pipeline", "quality", given["quality"])
    if given["no_skip"]:
        put("pipeline", "skip", False)
    put("output", "path", output and str(output))
    file = given["config_file"]
    config = load(None if file is None else find(file), tree, parameters())
    pipeline(config)
    return config


def _three(text: str | None, option: str) -> list[str] | None:
    if text is None:
        return None
    parts = [p.strip() for p in text.split(",")]
    if len(parts) != 3:
        raise ConfigError(f"{option} {text!r} is not three values", "X,Y,Z with commas")
    return parts


def _number(text: str, option: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{option}: {text!r} is not a number of degrees") from None
