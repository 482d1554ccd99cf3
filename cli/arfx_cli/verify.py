"""`arfx verify`: a synthetic scene through the whole job, against its truth."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import click

from arfx_cli.console import (
    FOLDER,
    Progress,
    detail,
    detail_job,
    emit_json,
    message_options,
    note,
)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--keep",
    type=FOLDER,
    help="Folder for the clip, the output and the job; default temporary.",
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Worker processes.",
)
@message_options
def command(folder: Path, keep: Path | None, workers: int, as_json: bool) -> None:
    """Run the synthetic scene in FOLDER and report errors against its truth.

    FOLDER is made by `arfx synth`, or a scene folder, which is rendered first. Exit code 5
    if a figure breaks a bound of the folder's tolerance.toml.

    \b
    Example:
      arfx verify sample_scenes/0901-frontal-40px"""
    from arfx.errors import ArfxError, ConfigError
    from arfx.measure.verification import read_tolerance, verify

    if keep is not None and any(
        os.path.lexists(keep / name) for name in ("job", "out.mkv", "out.mkv.job")
    ):
        raise ConfigError(f"{keep} holds an earlier run", "name another folder with --keep")
    with (
        tempfile.TemporaryDirectory(prefix="arfx-verify-") as temporary,
        Progress() as progress,
    ):
        work = keep or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        done = verify(folder, work, progress, note, workers)
    detail_job(done.report)
    for kind, bounds in read_tolerance(folder).get("truth", {}).items():
        for name, bound in bounds.items() if kind in ("max", "min") else ():
            detail(f"bound: {name} {'at most' if kind == 'max' else 'at least'} {bound:g}")
    if as_json:
        emit_json({"folder": str(folder), "figures": done.figures, "broken": done.broken})
    else:
        _table(done.figures)
    if done.broken:
        raise ArfxError(
            f"{folder}: " + "; ".join(done.broken),
            "tolerance.toml in that folder gives the bounds and their reasons",
        )


def _table(figures: dict[str, Any]) -> None:
    columns = f"{'rotation deg':>24}{'position mm':>24}{'corner':>9}{'tremble':>9}"
    click.echo(f"{'pose of ' + figures['world']:28}{columns}{'lag':>8}{'flips':>7}")
    spread = f"{'median     p95     max':>24}"
    click.echo(f"{'':28}{spread}{spread}{'px':>9}{'px':>9}{'frames':>8}")
    names = {
        "single_frame": "single frame, OpenCV",
        "raw": "arfx before smoothing",
        "arfx": "arfx",
    }
    for key, name in names.items():
        e = figures.get(key)
        if not e or not e["frames"]:
            click.echo(f"{name:28}no frame")
            continue
        spreads = "".join(
            f"{''.join(f'{e[k][s]:8.3f}' for s in ('median', 'p95', 'max')):>24}"
            for k in ("rotation_deg", "position_mm")
        )
        lag = "-" if e["lag_frames"] is None else f"{e['lag_frames']:.3f}"
        tremble = "-" if e["tremble_px"] is None else f"{e['tremble_px']:.3f}"
        first = f"{name} ({e['frames']})"
        corner = f"{e['corner_px']:9.3f}"
        click.echo(f"{first:28}{spreads}{corner}{tremble:>9}{lag:>8}{e['flips']:7d}")
    p, c = figures["presence"], figures["cuts"]
    click.echo(
        f"frames: {p['seen']} with a free marker, {p['missed']} of them missed;"
        f" {p['hidden']} without, {p['invented']} of them invented; {p['bridged']} bridged;"
        f" {p['unclear']} unclear"
    )
    click.echo(
        f"cuts: {c['found']} found, {c['missed']} missed, {c['invented']} invented; static:"
        f" {figures['static']}"
    )
    if "map" in figures:
        click.echo(
            f"map: at most {figures['map']['position_mm_max']:.2f} mm,"
            f" {figures['map']['rotation_deg_max']:.2f} deg off"
        )
    if "light" in figures:
        click.echo(_light(figures["light"]))


def _light(light: dict[str, Any]) -> str:
    text = (
        f"light: a direction claimed in {light['measured']} of {light['frames']} frames,"
        f" {light['false']} of them falsely"
    )
    if "direction_deg" in light:
        text += f", {light['direction_deg']['median']:.2f} deg off (median)"
    if "irradiance" in light:
        text += f"; irradiance {light['irradiance']['median']:.1%} off (median)"
    return f"{text}; bias {light['bias_grey']:.1f} grey levels off"
