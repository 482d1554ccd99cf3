"""Two pictures of a calibration: residuals, and coverage. Imports matplotlib; load it only
when pictures are wanted.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from arfx.calibrate.advice import GRID, TILTED_DEG
from arfx.calibrate.calibration import Calibration
from arfx.calibrate.solve import grid_pixels
from arfx.core.guard import atomic_write

DPI = 110


def write_plots(result: Calibration, paths: Sequence[Path]) -> None:
    """Write the two pictures, as PNG, into existing folders."""
    for path, figure in zip(
        paths, (_residuals(result), _coverage(result)), strict=True
    ):
        with atomic_write(path) as part:
            figure.savefig(part, format="png", dpi=DPI)


def _residuals(result: Calibration) -> Figure:
    """Left: where the misses point, enlarged; right: each view's size of them."""
    fitted = result.fitted
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    field, bars = figure.subplots(1, 2, width_ratios=(1.7, 1))
    points = np.concatenate([v.pixels for v in fitted.views])
    misses = np.concatenate(fitted.residuals)
    lengths = np.linalg.norm(misses, axis=1)
    scale = 0.03 * fitted.camera.width / max(float(np.quantile(lengths, 0.95)), 1e-6)
    field.quiver(
        *points.T,
        *misses.T,
        lengths,
        angles="xy",
        scale_units="xy",
        scale=1 / scale,
        width=0.0015,
    )
    words = (
        f"found minus predicted, {scale:.0f} x enlarged: rms {fitted.rms_px:.3f} px"
    )
    _picture_axes(field, result, words)
    rows = np.arange(len(fitted.views))
    bars.barh(rows, result.chosen.held_out_px, color="0.75", label="held out")
    bars.barh(rows, fitted.view_rms_px, height=0.45, label="fitted")
    bars.set_yticks(
        rows, [v.name for v in fitted.views], fontsize=min(8, 160 / len(rows))
    )
    bars.invert_yaxis()
    bars.set_xlabel("rms per view, px")
    bars.legend()
    return figure


def _coverage(result: Calibration) -> Figure:
    """Left: corners over the picture and how uncertain the projection is; right: the tilts."""
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    picture = figure.add_subplot(1, 2, 1)
    tilts = figure.add_subplot(1, 2, 2, projection="polar")
    camera, seen = result.fitted.camera, result.seen
    x, y = grid_pixels(camera, *GRID).T.reshape(2, *GRID[::-1])
    values = result.projection_sd_px.reshape(x.shape)
    filled = picture.contourf(x, y, values, levels=12, cmap="YlOrRd", alpha=0.7)
    words = "projection uncertainty (1 standard deviation), px"
    figure.colorbar(filled, ax=picture, label=words, shrink=0.8)
    for view in result.fitted.views:
        picture.plot(*view.pixels.T, ".", markersize=2.5)
    views = len(result.fitted.views)
    words = f"corners of {views} views: {seen.cells:.0%} of the cells covered"
    _picture_axes(picture, result, words)
    # drawn as in the picture: right is right, down is down
    tilts.set_theta_direction(-1)  # type: ignore[attr-defined]
    tilts.scatter(np.radians(seen.azimuth_deg), seen.tilt_deg)
    circle = np.linspace(0, 2 * np.pi, 181)
    tilts.plot(circle, np.full(circle.shape, TILTED_DEG), "--", color="0.5")
    tilts.set_ylim(0, max(45.0, float(seen.tilt_deg.max()) * 1.1))
    words = "tilt of each view, degrees, towards its near edge (dashed: too little to count)"
    tilts.set_title(words, fontsize=10)
    word, reasons, _ = result.verdict
    figure.suptitle(" - ".join([f"verdict: {word}", *reasons[:1]]))
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
    axes.plot(camera.cx, camera.cy, "k+", markersize=12)
    axes.set_title(title, fontsize=10)
