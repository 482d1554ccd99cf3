"""`arfx target`: a printable marker, marker sheet or board, true to scale."""

from pathlib import Path

from arfx.core.guard import Guard
from arfx_cli.console import arfx_command, detail_template, say, wrote_json


@arfx_command("target")
def command(
    specs: tuple[str, ...],
    output: Path,
    page: str,
    dpi: float,
    overwrite: bool,
) -> None:
    """A printable marker, sheet of markers or calibration board, true to scale, with its
    size and a ruler printed on it.

    SPEC is a marker 36h11:3:165mm, a range of them 4X4_50:0-5:40mm, or one board:
    chessboard:9x6:25mm (inner corners), charuco:12x8:18mm:14mm:5X5_100 (squares).

    \b
    Example:
      arfx target 36h11:3:165mm -o marker.pdf"""
    from arfx.calibrate.print_layout import lay_out, parse_targets, write_sheet

    targets = parse_targets(specs)
    sheet = lay_out(targets, page)
    Guard((), overwrite).file(output)
    write_sheet(sheet, output, dpi)
    say(
        f"wrote {output}: {sheet.width_mm:g} x {sheet.height_mm:g} mm; print at 100 % and"
        " measure the ruler"
    )
    blacks = zip(targets, sheet.black, strict=True)
    detail_template("calibrate/sheet.jinja", targets=blacks)
    wrote_json(
        {
            "output": str(output),
            "page_mm": [sheet.width_mm, sheet.height_mm],
            "targets": [str(t) for t in targets],
        }
    )
