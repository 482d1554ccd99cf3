"""`arfx lens`: depth-of-field limits of a thin lens, both formulas."""

from __future__ import annotations

from dataclasses import asdict

import click

from arfx_cli.console import emit_json, message_options, print_table

_ROWS = (
    ("front_mm", "sharp before the focus"),
    ("back_mm", "sharp behind the focus"),
    ("total_mm", "depth of field"),
    ("hyperfocal_mm", "hyperfocal distance"),
    ("coc_at_infinity_mm", "blur circle at infinity"),
)


@click.command()
@click.option(
    "--focal", required=True, metavar="LENGTH", help="Focal length, such as 50mm."
)
@click.option(
    "--fnumber", required=True, type=float, metavar="N", help="F-number, such as 2.8."
)
@click.option(
    "--distance",
    required=True,
    metavar="LENGTH",
    help="Focus distance from the lens, such as 2.5m.",
)
@click.option(
    "--coc",
    default="0.03mm",
    show_default=True,
    metavar="LENGTH",
    help="Diameter of the largest blur circle that passes as sharp.",
)
@message_options
def command(focal: str, fnumber: float, distance: str, coc: str, as_json: bool) -> None:
    """What a lens shows sharp: near and far limits around the focus distance, and the
    hyperfocal distance.

    Two formulas: `paper` as Zhao et al. (2012) print it, `corrected` as a thin lens has it.

    \b
    Example:
      arfx lens --focal 200mm --fnumber 11 --distance 2500mm --coc 0.035mm"""
    from arfx.core.lens import Lens, depth_of_field
    from arfx.core.units import length_m
    from arfx.papers import CORRECTED, PAPER
    from arfx.papers.s2_lens import printed_limits

    lens = Lens(
        1e3 * length_m(focal, "--focal"), fnumber, 1e3 * length_m(distance, "--distance")
    )
    coc_mm = 1e3 * length_m(coc, "--coc")
    limits = {
        PAPER: asdict(printed_limits(lens, coc_mm)),
        CORRECTED: asdict(depth_of_field(lens, coc_mm)),
    }
    if as_json:
        given = {
            "focal_mm": lens.focal_mm,
            "fnumber": fnumber,
            "distance_mm": lens.focus_mm,
            "coc_mm": coc_mm,
        }
        beyond = {"back_is_infinite": limits[CORRECTED]["back_mm"] == float("inf")}
        emit_json(
            {**given, PAPER: limits[PAPER], CORRECTED: {**limits[CORRECTED], **beyond}}
        )
        return
    rows = [
        (words, *(_shown(limits[name][key]) for name in (PAPER, CORRECTED)))
        for key, words in _ROWS
    ]
    print_table(
        f"{focal} f/{fnumber:g} focused at {distance}, circle {coc}",
        ("mm", PAPER, CORRECTED),
        rows,
    )


def _shown(value: float | None) -> str:
    return (
        "not defined"
        if value is None
        else "infinite"
        if value == float("inf")
        else f"{value:,.4f}"
    )
