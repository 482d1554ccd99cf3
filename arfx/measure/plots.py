"""Plots of the pages, and their style."""

import io
import tomllib
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

INK = "#7d8590"  # as in plots.toml
PREDICTED = "#8b949e"

STYLE: Any = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
styled = rc_context(STYLE)  # in which a figure of the pages is drawn


@styled
def png(fig: Figure) -> bytes:
    """Of a figure that was drawn in the same style."""
    out = io.BytesIO()
    fig.savefig(out, format="png")
    return out.getvalue()
