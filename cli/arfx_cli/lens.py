"""`arfx lens`: depth-of-field limits of a thin lens, both formulas."""

from __future__ import annotations

import math
from dataclasses import asdict

import click

from arfx_cli.console import message_options, print_rendered_table, wrote_json


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
def command(focal: str, fnumber: float, distance: str, coc: str) -> None:
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
    corrected = asdict(depth_of_field(lens, coc_mm))
    document = {
        "focal_mm": lens.focal_mm,
        "fnumber": fnumber,
        "distance_mm": lens.focus_mm,
        "coc_mm": coc_mm,
        PAPER: asdict(printed_limits(lens, coc_mm)),
        CORRECTED: corrected | {"back_is_infinite": corrected["back_mm"] == math.inf},
    }
    if not wrote_json(document):
        print_rendered_table(
            "measure/lens.jinja", d=document, focal=focal, distance=distance, coc=coc
        )
