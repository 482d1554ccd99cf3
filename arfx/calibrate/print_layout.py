"""A printed sheet: markers or a board, their labels and a ruler, in millimetres on a page;
and its file, true to scale.

Page coordinates: x right, y down from the upper left corner."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.calibrate.board import (
    CHARUCO,
    CHESSBOARD,
    BoardSpec,
    charuco_board,
)
from arfx.core.guard import atomic_write
from arfx.core.marker import MarkerSpec
from arfx.core.marker_codes import marker_cells
from arfx.core.units import length_m
from arfx.errors import ConfigError

PAGES_MM = tomllib.loads(Path(__file__).with_name("pages.toml").read_text("utf-8"))
MARGIN_MM = 8.0  # what usual printers cannot print on, with room
FOOT_MM = 16.0  # ruler and its words at the bottom
LABEL_MM = 5.0  # line of text under each marker
TEXT_MM = 3.0  # height of letters
MM_PER_INCH = 25.4
LINE_MM = 0.2
CAP_FRACTION = 0.72  # height of capitals over a font's size
LARGEST_PX = 30000  # along one side of a PNG: 3.6 GB in memory
# what files of an ending say without a date, so that the same sheet gives the same bytes
UNDATED = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}, ".png": {}}
RULER_MM = (100.0, 50.0)  # the first that fits


class Sheet(NamedTuple):
    """A page. black : of each print (n, 4, 2) mm, rectangles;  lines : (n, 2, 2) mm, ends of
    thin black ones
    texts : x and y of the middle of the baseline, mm, and words in letters `TEXT_MM` high"""

    title: str
    width_mm: float
    height_mm: float
    black: list[ndarray]
    texts: list[tuple[float, float, str]]
    lines: ndarray


Target = MarkerSpec | BoardSpec


def parse_targets(texts: Sequence[str]) -> list[Target]:
    """Markers (36h11:3:165mm; a range 4X4_50:0-5:40mm) or one board. Raises ConfigError."""
    out: list[Target] = []
    for text in texts:
        if text.split(":")[0].lower() in (CHESSBOARD, CHARUCO):
            out.append(BoardSpec.parse(text))
        elif m := re.fullmatch(r"([^:]+):(\d+)-(\d+):(.+)", text.strip()):
            first, last = int(m[2]), int(m[3])
            if last < first:
                raise ConfigError(
                    f"markers {text!r}: the range runs backwards",
                    f"{m[1]}:{last}-{first}:{m[4]}",
                )
            numbers = range(first, last + 1)
            out += [MarkerSpec.parse(f"{m[1]}:{i}:{m[4]}") for i in numbers]
        else:
            out.append(MarkerSpec.parse(text))
    if any(isinstance(t, BoardSpec) for t in out) and len(out) > 1:
        raise ConfigError(
            "a board fills its own sheet", "one board, or any number of markers"
        )
    return out


def page_mm(name: str) -> Sequence[float]:
    """(width, height) of a page name or of WIDTHxHEIGHT with units, upright. Raises ConfigError."""
    if name.lower() in PAGES_MM:
        return PAGES_MM[name.lower()]
    if m := re.fullmatch(r"([\d.]+[a-z]+)x([\d.]+[a-z]+)", name.strip().lower()):
        size = [1000 * length_m(g, what=f"page {name!r}") for g in m.groups()]
        if min(size) > 0:
            return size
    raise ConfigError(
        f"unknown page {name!r}",
        f"{', '.join(PAGES_MM)}, or a size such as 300mmx400mm",
    )


def lay_out(targets: Sequence[Target], page: str = "a4") -> Sheet:
    """The sheet, upright if it fits so, else across.

    Raises ConfigError, with the sizes, if it fits neither way.
    """
    width, height = page_mm(page)
    prints = [_board(t) if isinstance(t, BoardSpec) else _marker(t) for t in targets]
    title = ", ".join(map(str, targets))
    for size in ((width, height), (height, width)):
        if (sheet := _sheet(title, prints, *size)) is not None:
            return sheet
    w, h, white = np.max([p.size_mm for p in prints], axis=0)
    raise ConfigError(
        f"{len(prints)} of {w:g} x {h:g} mm, {white:.3g} mm white around, with labels and ruler"
        f" do not fit on {width:g} x {height:g} mm, nor across",
        f"print smaller or fewer, or on a larger --page of {', '.join(PAGES_MM)}",
    )


class _Print(NamedTuple):
    """One marker or board. size_mm : width, height, and the white that detectors need around
    it;  black : (n, 4, 2) from its upper left corner;  words : under it"""

    size_mm: tuple[float, float, float]
    black: ndarray
    words: str


def outlines(black: ndarray, cell_mm: float, place_mm: Any = (0.0, 0.0)) -> ndarray:
    """(n, 4, 2) mm, a rectangle for every black cell of a pattern (rows, columns): filled as
    one path they show no hairlines between them. place_mm : of its upper left corner
    """
    corners = np.argwhere(black)[:, None, ::-1] + [(0, 0), (1, 0), (1, 1), (0, 1)]
    return corners * cell_mm + place_mm


def _marker(marker: MarkerSpec) -> _Print:
    size, black = marker.size_m * 1000, ~marker_cells(marker.family, marker.id)
    module = size / len(black)  # the least white; neighbours share nothing
    words = f"{marker}" if size >= 40 else f"{marker.key} {size:g}mm"
    return _Print((size, size, module), outlines(black, module), words)


def _board(spec: BoardSpec) -> _Print:
    square = spec.square_m * 1000
    columns, rows = spec.squares
    # OpenCV draws the first square black, and with the legacy pattern white where the
    # number of rows is even
    first_white = spec.legacy and spec.rows % 2 == 0
    i, j = np.mgrid[0:rows, 0:columns]
    black = [outlines((i + j) % 2 == int(first_white), square)]
    if spec.kind == CHARUCO:
        board = charuco_board(spec)
        for number, corners in zip(
            np.ravel(board.getIds()), board.getObjPoints(), strict=True
        ):
            cells = ~marker_cells(spec.family, int(number))
            place = 1000 * np.asarray(corners, float)[0, :2]
            black.append(outlines(cells, 1000 * spec.marker_m / len(cells), place))
    words = str(spec) + (" (inner corners)" if spec.kind == CHESSBOARD else "")
    return _Print(
        (columns * square, rows * square, 0.0), np.concatenate(black), words
    )


def _sheet(
    title: str, prints: Sequence[_Print], width: float, height: float
) -> Sheet | None:
    """Row by row, as many to a row as fit, with a ruler below; None where they do not fit."""
    w, h, white = np.max([p.size_mm for p in prints], axis=0)
    pitch_x, pitch_y = w + 2 * white, h + 2 * white + LABEL_MM
    # the white of the outermost ones may lie where the printer cannot print: it is white
    over = max(0.0, MARGIN_MM - white)
    room_x, room_y = width - 2 * over, height - over - FOOT_MM
    across, down = int((room_x + 1e-6) // pitch_x), int((room_y + 1e-6) // pitch_y)
    if across * down < len(prints):
        return None
    columns = min(across, len(prints))
    rows = -(-len(prints) // columns)
    left, top = (width - columns * pitch_x) / 2, over + (room_y - rows * pitch_y) / 2
    black, texts = [], []
    for i, p in enumerate(prints):
        row, column = divmod(i, columns)
        middle, upper = left + (column + 0.5) * pitch_x, top + row * pitch_y + white
        x, y = middle - p.size_mm[0] / 2, upper + (h - p.size_mm[1]) / 2
        black.append(p.black + np.array((x, y)))
        texts.append((middle, upper + h + white + LABEL_MM - 1, p.words))
    length = next((r for r in RULER_MM if r <= width - 2 * MARGIN_MM), RULER_MM[-1])
    x, y = (width - length) / 2, height - MARGIN_MM
    ticks = np.arange(0, length + 1, 10)
    up = np.where(ticks % length == 0, 3.0, 1.5)
    lines = [[(x, y), (x + length, y)]]
    lines += [[(x + t, y - u), (x + t, y)] for t, u in zip(ticks, up, strict=True)]
    words = f"{length:g} mm: measure this line; print at 100 %, not 'fit to page'"
    texts.append((width / 2, y - 3.5, words))
    return Sheet(title, width, height, black, texts, np.array(lines))


def write_sheet(sheet: Sheet, path: Path, dpi: float = 300.0) -> None:
    """Write by the ending of the name: .pdf, .svg or .png (dpi, to the nearest of which all
    edges are rounded).

    The file appears by atomic rename. Raises ConfigError for other endings and for a PNG
    that is too large."""
    ending = path.suffix.lower()
    if ending not in UNDATED:
        raise ConfigError(
            f"{path}: cannot write {ending or 'a file without ending'}",
            "a name that ends in .pdf, .svg or .png",
        )
    width, height, scale = sheet.width_mm, sheet.height_mm, dpi / MM_PER_INCH
    if ending == ".png":
        size = round(width * scale), round(height * scale)
        if not 36 <= dpi <= 4800 or max(size) > LARGEST_PX:
            raise ConfigError(
                f"{dpi:g} dpi gives a picture of {size[0]}x{size[1]} px",
                f"36 to 4800 dpi, up to {LARGEST_PX} px; or .pdf, .svg",
            )
        width, height = ((side + 1e-3) / scale for side in size)  # whole pixels
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    figure = Figure(figsize=(width / MM_PER_INCH, height / MM_PER_INCH))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    corners = np.concatenate(sheet.black)[:, [0, 1, 2, 3, 0]]
    outline = Outline.make_compound_path_from_polys(corners)
    axes.add_patch(PathPatch(outline, facecolor="black", linewidth=0, snap=True))
    axes.plot(
        *sheet.lines.T,
        color="black",
        linewidth=LINE_MM / MM_PER_INCH * 72,
        solid_capstyle="butt",
        clip_on=False,
    )
    size_pt = TEXT_MM / CAP_FRACTION / MM_PER_INCH * 72
    for text in sheet.texts:
        axes.text(*text, ha="center", va="baseline", fontsize=size_pt)
    # no random names
    with (
        atomic_write(path) as part,
        rc_context({"svg.hashsalt": "arfx", "svg.fonttype": "none"}),
    ):
        figure.savefig(
            part,
            format=ending[1:],
            dpi=dpi,
            metadata={"Title": sheet.title, **UNDATED[ending]},
        )
