"""The published methods as they are printed, for reproduction and comparison: README.md lists papers, equations, deviations.

One table: what a section's `formula` chooses. Nothing but `run` and what is above it looks in here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any


class Classes(Mapping[str, Any]):
    """section -> class, imported when looked up."""

    def __init__(self, places: dict[str, str]) -> None:
        self._places = places

    def __getitem__(self, section: str) -> Any:
        module, _, name = self._places[section].rpartition(".")
        return getattr(import_module(module), name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


CORRECTED, PAPER = "corrected", "paper"

# formula -> section -> class; a section that is not named has the corrected one alone
FORMULAS: Mapping[str, Mapping[str, Any]] = {
    PAPER: Classes(
        {
            "light": "arfx.papers.s1_light.PrintedLight",
            "lightmap": "arfx.papers.s1_lightmap.PrintedLightmap",
            "dof": "arfx.papers.s2_dof.PrintedDof",
            "environment": "arfx.papers.s4_gi.PrintedEnvironment",
            "gi": "arfx.papers.s4_gi.PrintedGi",
            "watercolor": "arfx.papers.s3_watercolor.PrintedWatercolor",
        }
    )
}
