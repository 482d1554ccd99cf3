"""Two pictures of a calibration: residuals, and coverage. Imports matplotlib; load it only
when pictures are wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from arfx.calibrate.advice import GRID, TILTED_DEG
from arfx.calibrate.calibration import Calibration
from arfx.calibrate.solve import grid_pixels
from arfx.core.guard import atomic_write

DPI = 110


def write_plots(result: Calibration, paths: Sequence[Path]) -> None:
    """Write the two pictures, as PNG, into existing folders."""
    for path, figure in zip(paths, (_residuals(result), _coverage(result)), strict=True):
        with atomic_write(path) as part:
            FigureCanvasAgg(figure).print_figure(part, format="png", dpi=DPI)


def _residuals(result: Calibration) -> Figure:
    """Left: where the misses point, enlarged; right: all misses, and each view's size."""
    fitted = result.fitted
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    field, cloud, bars = figure.subplots(1, 3, width_ratios=(1.7, 1, 1))
    points = np.concatenate([v.pixels for v in fitted.views])
    misses = np.concatenate(fitted.residuals)
    lengths = np.linalg.norm(misses, axis=1)
    scale = 0.03 * fitted.camera.width / max(float(np.quantile(lengths, 0.95)), 1e-6)
    field.quiver(
        *points.T,
        *(misses.T * scale),
        lengths,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.0015,
        cmap="viridis",
    )
    _picture_axes(field, result, f"residuals, {scale:.0f} x enlarged")
    cloud.scatter(*misses.T, s=3, alpha=0.4, linewidths=0)
    limit = float(np.abs(misses).max()) * 1.1 + 1e-6
    cloud.set(
        xlim=(-limit, limit),
        ylim=(limit, -limit),
        xlabel="x, px",
        ylabel="y, px",
        aspect="equal",
    )
    cloud.set_title(f"found minus predicted: rms {fitted.rms_px:.3f} px", fontsize=10)
    rows = np.arange(len(fitted.views))
    bars.barh(rows, result.chosen.held_out_px, color="0.75", label="held out")
    bars.barh(rows, fitted.view_rms_px, height=0.45, label="fitted")
    bars.set_yticks(
        rows, [v.name for v in fitted.views], fontsize=max(4, min(8, 160 // len(rows)))
    )
    bars.invert_yaxis()
    bars.set_xlabel("rms per view, px")
    bars.legend(fontsize=8, loc="lower right")
    return figure


def _coverage(result: Calibration) -> Figure:
    """Left: corners over the picture and how uncertain the projection is; right: the tilts."""
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    picture = figure.add_subplot(1, 2, 1)
    tilts = figure.add_subplot(1, 2, 2, projection="polar")
    camera = result.fitted.camera
    if result.projection_sd_px.size == GRID[0] * GRID[1]:
        x, y = grid_pixels(camera, *GRID).reshape(GRID[1], GRID[0], 2).transpose(2, 0, 1)
        values = result.projection_sd_px.reshape(GRID[1], GRID[0])
        filled = picture.contourf(x, y, values, levels=12, cmap="YlOrRd", alpha=0.7)
        figure.colorbar(
            filled,
            ax=picture,
            label="projection uncertainty (1 standard deviation), px",
            shrink=0.8,
        )
    for view in result.fitted.views:
        picture.plot(*view.pixels.T, ".", markersize=2.5, alpha=0.7)
    _picture_axes(
        picture,
        result,
        f"corners of {len(result.fitted.views)} views: {result.seen.cells:.0%} of the cells"
        " covered",
    )
    # drawn as in the picture: right is right, down is down
    tilts.set_theta_direction(-1)  # type: ignore[attr-defined]
    tilts.scatter(np.radians(result.seen.azimuth_deg), result.seen.tilt_deg, s=30)
    circle = np.linspace(0, 2 * np.pi, 181)
    tilts.plot(circle, np.full(circle.shape, TILTED_DEG), "--", color="0.5", linewidth=1)
    tilts.set_ylim(0, max(45.0, float(result.seen.tilt_deg.max()) * 1.1))
    tilts.set_title(
        "tilt of each view, degrees, towards its near edge (dashed: too little to count)",
        fontsize=10,
    )
    figure.suptitle(
        f"verdict: {result.verdict.word}"
        + (f" - {result.verdict.reasons[0]}" if result.verdict.reasons else ""),
        fontsize=11,
    )
    return figure


def _picture_axes(axes: Axes, result: Calibration, title: str) -> None:
    camera = result.fitted.camera
    axes.set(
        xlim=(-0.5, camera.width - 0.5),
        ylim=(camera.height - 0.5, -0.5),
        aspect="equal",
        xlabel="px",
        ylabel="px",
    )
    axes.plot([camera.cx], [camera.cy], "k+", markersize=12)
    axes.set_title(title, fontsize=10)
