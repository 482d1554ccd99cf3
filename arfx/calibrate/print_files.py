"""A sheet as a file, true to scale: PDF and SVG in points, PNG with its resolution."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from arfx.calibrate.print_layout import TEXT_MM, Sheet, outlines
from arfx.core.guard import atomic_write
from arfx.errors import ConfigError

MM_PER_INCH = 25.4
LINE_MM = 0.2
CAP_SHARE = 0.72  # height of capitals over a font's size
LARGEST_PX = 30000  # along one side of a PNG: 900 MB in memory


def write_sheet(sheet: Sheet, path: Path, dpi: float = 300.0) -> None:
    """Write by the ending of the name: .pdf, .svg or .png (dpi, to the nearest of which all edges are rounded).

    The file appears by atomic rename. Raises ConfigError for other endings and for a PNG that is too large.
    """
    ending = path.suffix.lower()
    if ending not in (".pdf", ".svg", ".png"):
        raise ConfigError(f"{path}: cannot write {ending or 'a file without ending'}", "a name that ends in .pdf, .svg or .png")
    with atomic_write(path) as part:
        if ending == ".png":
            _png(sheet, part, dpi)
        else:
            _drawn(sheet, part, ending[1:])


def _drawn(sheet: Sheet, path: Path, kind: str) -> None:
    """PDF or SVG: both in points."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    figure = Figure(figsize=(sheet.width_mm / MM_PER_INCH, sheet.height_mm / MM_PER_INCH))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, sheet.width_mm), ylim=(sheet.height_mm, 0))
    axes.set_axis_off()
    for cells in sheet.cells:
        path_of_all = Outline.make_compound_path_from_polys(outlines(cells)[:, [0, 1, 2, 3, 0]])
        axes.add_patch(PathPatch(path_of_all, facecolor="black", edgecolor="none", linewidth=0))
    for x0, y0, x1, y1 in sheet.lines:
        axes.plot([x0, x1], [y0, y1], color="black", linewidth=LINE_MM / MM_PER_INCH * 72, solid_capstyle="butt", clip_on=False)
    for t in sheet.texts:
        axes.text(t.x_mm, t.y_mm, t.words, ha="center", va="baseline", fontsize=TEXT_MM / CAP_SHARE / MM_PER_INCH * 72)
    # no date and no random names, so that the same sheet gives the same bytes
    undated = {"CreationDate" if kind == "pdf" else "Date": None}
    with rc_context({"svg.hashsalt": "arfx", "svg.fonttype": "none"}):
        figure.savefig(path, format=kind, metadata={"Title": sheet.title, **undated})


def _png(sheet: Sheet, path: Path, dpi: float) -> None:
    from PIL import Image, ImageDraw, ImageFont

    scale = dpi / MM_PER_INCH
    size = round(sheet.width_mm * scale), round(sheet.height_mm * scale)
    if not 36 <= dpi <= 4800 or max(size) > LARGEST_PX:
        raise ConfigError(
            f"{dpi:g} dpi gives a picture of {size[0]}x{size[1]} px", f"36 to 4800 dpi, up to {LARGEST_PX} px; or .pdf, .svg"
        )
    picture = np.full((size[1], size[0]), 255, np.uint8)
    for cells in sheet.cells:
        rows, columns = cells.black.shape
        xs = np.round((cells.x_mm + cells.cell_mm * np.arange(columns + 1)) * scale).astype(int)
        ys = np.round((cells.y_mm + cells.cell_mm * np.arange(rows + 1)) * scale).astype(int)
        for r, c in np.argwhere(cells.black):
            picture[ys[r] : ys[r + 1], xs[c] : xs[c + 1]] = 0
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for line in sheet.lines:
        draw.line([v * scale for v in line], fill=0, width=max(1, round(LINE_MM * scale)))
    font = ImageFont.load_default(TEXT_MM / CAP_SHARE * scale)
    for t in sheet.texts:
        draw.text((t.x_mm * scale, t.y_mm * scale), t.words, fill=0, font=font, anchor="ms")
    image.save(path, format="PNG", dpi=(dpi, dpi))
