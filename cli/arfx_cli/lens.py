"""`arfx lens`: depth-of-field limits of a thin lens, both formulas."""

import math

from arfx_cli.console import arfx_command, print_table, wrote_json


@arfx_command("lens")
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
        1e3 * length_m(focal, "--focal"),
        fnumber,
        1e3 * length_m(distance, "--distance"),
    )
    coc_mm = 1e3 * length_m(coc, "--coc")
    corrected = depth_of_field(lens, coc_mm)._asdict()
    document = {
        "focal_mm": lens.focal_mm,
        "fnumber": fnumber,
        "distance_mm": lens.focus_mm,
        "coc_mm": coc_mm,
        PAPER: printed_limits(lens, coc_mm)._asdict(),
        CORRECTED: corrected | {"back_is_infinite": corrected["back_mm"] == math.inf},
    }
    if not wrote_json(document):
        print_table(
            "measure/lens.jinja", d=document, focal=focal, distance=distance, coc=coc
        )
