"""Plots of the pages, and their style."""

from __future__ import annotations

import io
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from arfx.analyse.pose.visibility import jitter_px
from arfx.core.camera import Camera
from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED, FrameFacts

INK = "#7d8590"  # as in plots.toml
RAW, SMOOTH, PREDICTED = "#d9822b", "#2f81f7", "#8b949e"
STATUS_COLOUR = {MEASURED: "#2da44e", INTERPOLATED: "#d4a72c", ABSENT: "#cf5b56"}


STYLE: Any = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
styled = rc_context(STYLE)  # in which a figure of the pages is drawn


@styled
def pose_plot(
    facts: Sequence[FrameFacts], camera: Camera | None, points_m: np.ndarray | None
) -> bytes:
    """Trembling before and after smoothing, reprojection error, and each frame's status as
    a coloured strip.
    """
    times = np.array([f.time_s for f in facts], float)
    fig = Figure((9.0, 4.6))
    jitter, error, strip = fig.subplots(3, 1, sharex=True, height_ratios=(5, 3, 0.7))
    if camera is not None and points_m is not None and len(facts) > 2:
        for raw, colour, label in (
            (True, RAW, "before smoothing"),
            (False, SMOOTH, "after smoothing"),
        ):
            _, d = jitter_px(facts, points_m, camera, raw)
            label += (
                f", median {np.nanmedian(d):.3g} px"
                if np.isfinite(d).any()
                else ", no three frames in a row"
            )
            jitter.plot(times, d, color=colour, lw=0.9 if raw else 1.4, label=label)
        jitter.legend(loc="upper right")
    jitter.set_ylabel("second difference, px")
    jitter.set_title("Jitter of a cube on the marker against the footage")
    px = np.array(
        [np.nan if f.reprojection_px is None else f.reprojection_px for f in facts],
        float,
    )
    error.plot(times, px, ".", ms=2.5, color=SMOOTH)
    error.set_ylabel("reprojection, px")
    for axis in (jitter, error):
        axis.set_ylim(bottom=0)
    order = (MEASURED, INTERPOLATED, ABSENT)
    codes = np.array(
        [[order.index(f.status) if f.status in order else 2 for f in facts]]
    )
    if len(facts):
        end = times[-1] + (
            float(np.median(np.diff(times))) if len(facts) > 1 else 1.0
        )
        colours = ListedColormap([STATUS_COLOUR[s] for s in order])
        strip.pcolormesh(
            np.append(times, end), [0, 1], codes, cmap=colours, vmin=-0.5, vmax=2.5
        )
    strip.set_yticks([])
    strip.set_xlabel("time, s")
    return png(fig)


@styled
def png(fig: Figure) -> bytes:
    """Of a figure that was drawn in the same style."""
    out = io.BytesIO()
    fig.savefig(out, format="png")
    return out.getvalue()
