"""Prints that tell a pose, coded markers and pictures: which ones, how large, where their
corners are.
"""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from arfx.core.units import length_m
from arfx.errors import ConfigError

if TYPE_CHECKING:
    from numpy import ndarray

MIN_MARKER_M, MAX_MARKER_M = (
    1e-4,
    1e3,
)  # of a print: a tenth of a millimetre is the nearest that anything is projected


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """One marker of the scene. family : dictionary name as in FAMILIES ("36h11", "4X4_50",
    "ORIGINAL");
    size_m : length of the black square's side."""

    family: str
    id: int
    size_m: float

    @property
    def key(self) -> str:
        return f"{self.family}:{self.id}"

    @property
    def corners_m(self) -> ndarray:
        """(4, 3) top left, top right, bottom right, bottom left; x right, y up, z out of
        the print.
        """
        return _corners(self.size_m, self.size_m)

    def __str__(self) -> str:
        return f"{self.family}:{self.id}:{self.size_m * 1e3:.12g}mm"

    @staticmethod
    def parse(text: str) -> MarkerSpec:
        """FAMILY:ID:SIZE such as 36h11:3:165mm. Raises ConfigError."""
        m = re.fullmatch(r"([^:]+):(\d{1,9}):(.+)", text.strip())
        if not m:
            raise ConfigError(
                f"marker {text!r} is not FAMILY:ID:SIZE",
                "for example 36h11:3:165mm or 4X4_50:0:50mm",
            )
        family = canonical_family(m[1])
        size = _size_m(
            m[3], f"marker {text!r}", "the length of the black square's side: 165mm"
        )
        if int(m[2]) >= FAMILIES[family]:
            raise ConfigError(
                f"marker {text!r}: {family} has ids 0 to {FAMILIES[family] - 1}"
            )
        return MarkerSpec(family, int(m[2]), size)


@dataclass(frozen=True, slots=True)
class PatternSpec:
    """A flat print whose picture is known. image : its file, by the name of which the print
    is called
    size_m : its width;  height_m : None until the picture is opened, if the print has the
    picture's shape
    """

    image: Path
    size_m: float
    height_m: float | None = None

    @property
    def key(self) -> str:
        return self.image.name

    @property
    def corners_m(self) -> ndarray:
        """As of a MarkerSpec. Raises ValueError where the picture was not opened."""
        if self.height_m is None:
            raise ValueError(
                f"the height of {self.key} is not known: open its picture first"
            )
        return _corners(self.size_m, self.height_m)

    def __str__(self) -> str:
        height = "" if self.height_m is None else f"x{self.height_m * 1e3:.12g}mm"
        return f"{self.image}:{self.size_m * 1e3:.12g}mm{height}"

    @staticmethod
    def parse(text: str) -> PatternSpec:
        """IMAGE:WIDTH such as poster.png:20cm, or IMAGE:WIDTHxHEIGHT. Raises ConfigError."""
        hint = "the picture and the width of its print: poster.png:20cm"
        image, _, size = text.strip().rpartition(":")
        if not image:
            raise ConfigError(f"pattern {text!r} is not IMAGE:SIZE", hint)
        width, times, height = size.partition("x")
        what = f"pattern {text!r}"
        return PatternSpec(
            Path(image),
            _size_m(width, what, hint),
            _size_m(height, what, hint) if times else None,
        )


Marker = MarkerSpec | PatternSpec


def _corners(width_m: float, height_m: float) -> ndarray:
    import numpy as np  # here: `process --help` needs the names of markers, and no numbers

    x, y = width_m / 2, height_m / 2
    return np.array([[-x, y, 0], [x, y, 0], [x, -y, 0], [-x, -y, 0.0]])


def _size_m(text: str, what: str, hint: str) -> float:
    size = length_m(text, what=f"size of {what}")
    if not MIN_MARKER_M <= size <= MAX_MARKER_M:
        between = f"between {MIN_MARKER_M:g} m and {MAX_MARKER_M:g} m, is {size:g} m"
        raise ConfigError(
            f"{what}: the size must be {between if size > 0 else 'above 0'}", hint
        )
    return size


# name -> number of ids. Every predefined square dictionary of OpenCV's objdetect module.
FAMILIES: dict[str, int] = {
    **{f"{n}X{n}_{k}": k for n in (4, 5, 6, 7) for k in (50, 100, 250, 1000)},
    "ORIGINAL": 1024,
    "16h5": 30,
    "25h9": 35,
    "36h10": 2320,
    "36h11": 587,
    "MIP_36h12": 250,
}


def smallest_family(family: str, highest_id: int) -> str:
    """The smallest of a family's nested dictionaries that holds ids up to `highest_id`:
    4X4_1000 -> 4X4_50.
    """
    root, _, size = family.partition("_")
    if family.startswith("MIP") or not size:
        return family
    sizes = sorted(
        n for name, n in FAMILIES.items() if name.partition("_")[0] == root
    )
    return f"{root}_{next(n for n in sizes if n > highest_id)}"


def canonical_family(name: str) -> str:
    """The FAMILIES key for any usual spelling (DICT_4X4_50, 4x4_50, tag36h11,
    AprilTag_36h11, ARUCO_ORIGINAL …). Raises ConfigError, naming the known ones."""
    s = name.strip().upper()
    for prefix in ("DICT_", "ARUCO_", "APRILTAG_", "APRILTAG", "TAG", "_"):
        s = s.removeprefix(prefix)
    for known in FAMILIES:
        if s == known.upper():
            return known
    raise ConfigError(
        f"unknown marker family {name!r}", "one of " + ", ".join(FAMILIES)
    )


def anchor_marker(markers: Sequence[Marker], placed: Container[str]) -> Marker:
    """The one that the model stands on: the first of `markers` whose key is in the map,
    else the first.
    """
    return next((m for m in markers if m.key in placed), markers[0])
