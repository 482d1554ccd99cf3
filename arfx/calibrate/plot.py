"""The picture of a calibration. Imports matplotlib; load it only when the picture is wanted."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from arfx.calibrate.calibration import Calibration
from arfx.core.guard import atomic_write


def write_plot(result: Calibration, path: Path) -> None:
    """Where the corners of all views lie and how each misses, enlarged, as PNG into an
    existing folder.
    """
    fitted, camera = result.fitted, result.fitted.camera
    points = np.concatenate([v.pixels for v in fitted.views])
    misses = np.concatenate(fitted.residuals)
    usual = np.quantile(np.linalg.norm(misses, axis=1), 0.95)
    scale = 0.03 * camera.width / max(usual, 1e-6)
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(*points.T, ".", color="0.6", markersize=2.5)
    axes.quiver(
        *points.T, *(scale * misses).T, angles="xy", scale_units="xy", scale=1
    )
    axes.plot(camera.cx, camera.cy, "k+", markersize=12)
    axes.set(
        xlim=(-0.5, camera.width - 0.5),
        ylim=(camera.height - 0.5, -0.5),
        aspect="equal",
        xlabel="px",
        title=f"{len(fitted.views)} views, {result.seen.cells:.0%} of the cells covered;"
        f" corners found minus predicted, {scale:.0f} x enlarged:"
        f" rms {fitted.rms_px:.3f} px",
    )
    with atomic_write(path) as part:
        figure.savefig(part, format="png")
