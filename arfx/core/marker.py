"""Printed square markers: which ones, how large, where their corners are."""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arfx.core.units import length_m
from arfx.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

MIN_MARKER_M, MAX_MARKER_M = 1e-4, 1e3  # of a marker: a tenth of a millimetre is the nearest that anything is projected


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """One marker of the scene. family : dictionary name as in FAMILIES ("36h11", "4X4_50", "ORIGINAL");
    size_m : length of the black square's side."""

    family: str
    id: int
    size_m: float

    @property
    def key(self) -> str:
        return f"{self.family}:{self.id}"

    @property
    def corners_m(self) -> np.ndarray:
        """(4, 3) top left, top right, bottom right, bottom left; x right, y up, z out of the print."""
        import numpy as np  # here: `process --help` needs the names of markers, and no numbers

        h = self.size_m / 2
        return np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0.0]])

    def __str__(self) -> str:
        return f"{self.family}:{self.id}:{self.size_m * 1e3:.12g}mm"

    @staticmethod
    def parse(text: str) -> MarkerSpec:
        """FAMILY:ID:SIZE such as 36h11:3:165mm. Raises ConfigError."""
        m = re.fullmatch(r"([^:]+):(\d{1,9}):(.+)", text.strip())
        if not m:
            raise ConfigError(f"marker {text!r} is not FAMILY:ID:SIZE", "for example 36h11:3:165mm or 4X4_50:0:50mm")
        family = canonical_family(m[1])
        size = length_m(m[3], what=f"size of marker {text!r}")
        if not MIN_MARKER_M <= size <= MAX_MARKER_M:
            between = f"between {MIN_MARKER_M:g} m and {MAX_MARKER_M:g} m, is {size:g} m"
            limits = between if size > 0 else "above 0"
            raise ConfigError(f"marker {text!r}: the size must be {limits}", "the length of the black square's side: 165mm")
        if int(m[2]) >= FAMILIES[family]:
            raise ConfigError(f"marker {text!r}: {family} has ids 0 to {FAMILIES[family] - 1}")
        return MarkerSpec(family, int(m[2]), size)


# name -> number of ids. Every predefined square dictionary of OpenCV's objdetect module.
FAMILIES: dict[str, int] = {
    **{f"{n}X{n}_{k}": k for n in (4, 5, 6, 7) for k in (50, 100, 250, 1000)},
    "ORIGINAL": 1024, "16h5": 30, "25h9": 35, "36h10": 2320, "36h11": 587, "MIP_36h12": 250,
}  # fmt: skip


def opencv_name(family: str) -> str:
    """What OpenCV calls the dictionary of a FAMILIES key: DICT_4X4_50, DICT_APRILTAG_36h11, DICT_ARUCO_ORIGINAL."""
    maker = "ARUCO_" if family.startswith(("ORIGINAL", "MIP")) else "APRILTAG_" if "h" in family else ""
    return f"DICT_{maker}{family}"


def canonical_family(name: str) -> str:
    """The FAMILIES key for any usual spelling (DICT_4X4_50, 4x4_50, tag36h11, AprilTag_36h11, ARUCO_ORIGINAL …).
    Raises ConfigError, naming the known ones."""
    s = name.strip().upper()
    for prefix in ("DICT_", "ARUCO_", "APRILTAG_", "APRILTAG", "TAG", "_"):
        s = s.removeprefix(prefix)
    for known in FAMILIES:
        if s == known.upper():
            return known
    raise ConfigError(f"unknown marker family {name!r}", "one of " + ", ".join(FAMILIES))


def anchor_marker(markers: Sequence[MarkerSpec], placed: Container[str]) -> MarkerSpec:
    """The marker that the model stands on: the first of `markers` whose key is in the map, else the first."""
    return next((m for m in markers if m.key in placed), markers[0])
