"""`arfx tradeoff`: error and time of every level of every effect, on the user's own clip."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any

import click

from arfx.errors import counted
from arfx_cli.console import (
    Progress,
    emit_json,
    message_options,
    overwrite_option,
    print_table,
    say,
)
from arfx_cli.job_options import job_config, job_options, run_options

if TYPE_CHECKING:
    from arfx.run.inputs import Inputs


@click.command(params=job_options())
@click.option(
    "--frames",
    type=click.IntRange(1, 24),
    default=2,
    show_default=True,
    help="How many frames stand for the clip.",
)
@overwrite_option
@message_options
def command(frames: int, as_json: bool, **given: Any) -> None:
    """Measure what accuracy costs on CLIP: every level of every effect against its
    reference, and whole pipelines.

    The arguments are those of `arfx process`; nothing is encoded. --report DIR gets
    tradeoff.json, which `--tradeoff` of `process` and `plan` reads for --max-error and
    --budget, and tradeoff.html with plots, pictures and error maps.

    \b
    Example:
      arfx tradeoff clip.mp4 --camera camera.yaml --marker 36h11:3:165mm --model duck.glb \\
        --fit 15cm --pipeline lightmap,dof --report costs"""
    import json

    from arfx.core.guard import Guard
    from arfx.core.numerics import finite
    from arfx.measure.tradeoff import measure
    from arfx.measure.tradeoff_html import document, write_tradeoff
    from arfx.run.aside import planned_aside
    from arfx.run.folder import write
    from arfx.run.place import PAGE_START, files_locked, files_read

    def check(inputs: Inputs) -> None:
        if folder is not None:
            made = {
                "tradeoff.json": b'{\n "clip": ',
                "tradeoff.html": PAGE_START.encode(),
            }
            guard = Guard(files_read(inputs), options.overwrite)
            report.enter_context(files_locked(guard, folder, made, "--report"))

    began = time.perf_counter()
    with contextlib.ExitStack() as report:
        with Progress() as progress:
            options = run_options(given, progress)
            folder = options.report
            with planned_aside(job_config(given), options, check) as job:
                found = measure(job, frames, progress)
        measured = finite(document(found, job, time.perf_counter() - began))
        if folder is not None:
            write(
                folder / "tradeoff.json",
                json.dumps(measured, indent=1, allow_nan=False) + "\n",
            )
            say(f"report: {write_tradeoff(folder, found, measured)}")
    if as_json:
        emit_json(measured)
        return
    _show(measured)


def _show(measured: dict[str, Any]) -> None:
    from arfx.measure.tradeoff_html import levels_in_words

    effects: list[tuple[str, ...]] = []
    last = ""
    for r in measured["effects"]:
        if last and r["name"] != last:
            effects.append(())
        flicker = (
            ""
            if r["unrest"] is None
            else f"{r['unrest']['level']:.1f}/{r['unrest']['reference']:.1f}"
        )
        effects.append(
            (
                "" if r["name"] == last else r["name"],
                *_columns(r),
                f"{r['delta_e']:.2f}",
                f"{r['ssim']:.3f}",
                flicker,
            )
        )
        last = r["name"]
    heads = ("level", "time a frame", "mean", "99 %", "FLIP")
    print_table(
        "error against reference, grey levels;"
        f" {counted(len(measured['frames']), 'frames')}",
        ("effect", *heads, "ΔE", "SSIM", "flicker"),
        effects,
        words=2,
    )
    names = {r["name"] for r in measured["effects"]}
    pipelines = [
        (name, levels_in_words(r, names), *rest)
        for r in measured["pipelines"]
        for name, *rest in [_columns(r)]
    ]
    print_table(
        "whole pipelines against all at reference",
        ("pipeline", "levels", *heads[1:]),
        pipelines,
        words=2,
    )
    click.echo(measured["recommendation"])


def _columns(r: dict[str, Any]) -> tuple[str, ...]:
    level = r["level"] + (
        " (paper)" if r["formula"] == "paper" else ", beaten" if r["beaten"] else ""
    )
    return (
        level,
        _duration(r["seconds_per_frame"], *r["between_s"]),
        f"{r['mean']:.2f}",
        f"{r['p99']:.1f}",
        f"{r['flip']:.3f}",
    )


def _duration(seconds: float, low_s: float, high_s: float) -> str:
    """In ms, s or min, with half the interval's width where that is more than a sixth."""
    unit, factor = next(
        (u for u in (("ms", 1e3), ("s", 1.0)) if seconds * u[1] < 600), ("min", 1 / 60)
    )
    wide = (high_s - low_s) / 2 / max(seconds, 1e-9)
    return f"{seconds * factor:.3g} {unit}" + (
        f" ± {100 * wide:.0f} %" if wide > 1 / 6 else ""
    )
