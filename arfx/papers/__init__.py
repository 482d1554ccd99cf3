"""The published methods as they are printed, for reproduction and comparison: README.md
lists papers, equations, deviations.

One table: the class that a section's `formula` selects. Only `run` and layers above it
import this package."""

from collections.abc import Mapping

from arfx.stages import Classes

CORRECTED = "corrected"
PAPER = "paper"

# formula -> section -> class; a section that is not named has the corrected one alone
FORMULAS: Mapping[str, Classes] = {
    PAPER: Classes(
        {
            "light": "arfx.papers.s1_light.PrintedLight",
            "lightmap": "arfx.papers.s1_lightmap.PrintedLightmap",
            "dof": "arfx.papers.s2_dof.PrintedDof",
            "gi": "arfx.papers.s4_gi.PrintedGi",
            "watercolor": "arfx.papers.s3_watercolor.PrintedWatercolor",
        }
    ),
    "gaussian": Classes(
        {"dof": "arfx.papers.s2_dof.GaussianDof"}
    ),  # what Zhao et al. compare themselves with
}
