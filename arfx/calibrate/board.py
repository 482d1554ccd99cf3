"""What board was printed: chessboard or ChArUco, its size, its corners in metres."""

from __future__ import annotations

import re
from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.marker import FAMILIES, canonical_family
from arfx.core.marker_codes import dictionary
from arfx.core.units import length_m
from arfx.errors import ConfigError

CHESSBOARD = "chessboard"
CHARUCO = "charuco"
EXAMPLES = (
    "chessboard:9x6:25mm (inner corners) or charuco:12x8:18mm:14mm:5X5_100 (squares), with"
    " :legacy for the old pattern"
)


@dataclass(frozen=True, slots=True)
class BoardSpec:
    """A flat calibration board.

    kind : "chessboard" or "charuco"
    columns, rows : inner corners of a chessboard, squares of a ChArUco board (each as its
    users count them)
    square_m : side of a square
    marker_m, family, legacy : ChArUco only. `legacy` is the pattern of OpenCV before 4.6,
    whose first square is a marker
        also where the number of rows is even"""

    kind: str
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    family: str = ""
    legacy: bool = False

    @property
    def inner(self) -> tuple[int, int]:
        """Inner corners (across, down)."""
        less = int(self.kind == CHARUCO)
        return self.columns - less, self.rows - less

    @property
    def squares(self) -> tuple[int, int]:
        return self.inner[0] + 1, self.inner[1] + 1

    @property
    def corners_m(self) -> ndarray:
        """(n, 3) inner corners row by row, metres, in the board's plane z = 0; x along a
        row, y down the rows.
        """
        across, down = self.inner
        y, x, z = np.indices((down, across, 1)).reshape(3, -1)
        return np.stack([x, y, z], -1) * self.square_m

    @property
    def turn_is_ambiguous(self) -> bool:
        """Whether the board turned by half a turn looks the same (a chessboard with both
        counts odd, or both even).
        """
        return self.kind == CHESSBOARD and self.columns % 2 == self.rows % 2

    def __str__(self) -> str:
        size = f"{self.kind}:{self.columns}x{self.rows}:{self.square_m * 1e3:.12g}mm"
        if self.kind == CHESSBOARD:
            return size
        legacy = ":legacy" if self.legacy else ""
        return f"{size}:{self.marker_m * 1e3:.12g}mm:{self.family}{legacy}"

    @staticmethod
    def parse(text: str) -> BoardSpec:
        """The board of `chessboard:9x6:25mm` or `charuco:12x8:18mm:14mm:5X5_100[:legacy]`.

        Raises ConfigError.
        """
        m = re.fullmatch(
            r"(chessboard|charuco):(\d{1,9})x(\d{1,9}):([^:]+)(?::([^:]+):([^:]+?)(:legacy)?)?",
            text.strip(),
            re.IGNORECASE,
        )
        if not m or (m[1].lower() == CHARUCO) != bool(m[6]):
            raise ConfigError(f"board {text!r} is not understood", EXAMPLES)
        kind, columns, rows = m[1].lower(), int(m[2]), int(m[3])
        if not (3 <= columns <= 100 and 3 <= rows <= 100):
            raise ConfigError(
                f"board {text!r}: {columns}x{rows} is too small or too large",
                "3 to 100 each way",
            )
        square = length_m(m[4], what=f"square of board {text!r}")
        if square <= 0:
            raise ConfigError(f"board {text!r}: the square must be larger than 0")
        if kind == CHESSBOARD:
            return BoardSpec(kind, columns, rows, square)
        marker = length_m(m[5], what=f"marker of board {text!r}")
        family = canonical_family(m[6])
        if not 0 < marker < square:
            raise ConfigError(
                f"board {text!r}: the marker must be smaller than its square",
                EXAMPLES,
            )
        if (columns * rows) // 2 > FAMILIES[family]:
            raise ConfigError(
                f"board {text!r} needs {columns * rows // 2} markers, {family} has"
                f" {FAMILIES[family]}"
            )
        return BoardSpec(kind, columns, rows, square, marker, family, bool(m[7]))


def charuco_board(spec: BoardSpec) -> cv2.aruco.CharucoBoard:
    """OpenCV's board object of a ChArUco spec."""
    board = cv2.aruco.CharucoBoard(
        (spec.columns, spec.rows),
        float(spec.square_m),
        float(spec.marker_m),
        dictionary(spec.family),
    )
    board.setLegacyPattern(spec.legacy)
    return board
