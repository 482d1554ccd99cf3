"""Both planar poses of one print, as poses."""

from __future__ import annotations

import numpy as np

from arfx.analyse.pose.planar import Observed, planar_poses
from arfx.core.pose import Pose


def planar(
    corners_m: np.ndarray,
    ideal: np.ndarray,
    px_per_ideal: np.ndarray,
    sigma_px: float,
) -> list[tuple[Pose, float]]:
    """(camera_from_marker, rms over the corners in px), best first; none, one or two.

    corners_m : (4, 3);  ideal : (4, 2);  px_per_ideal : (4, 2, 2)"""
    weight = np.full(4, sigma_px**-2.0)
    rows = (np.asarray(a)[None] for a in (corners_m, ideal, px_per_ideal, weight))
    found = planar_poses(Observed(*rows))
    both = zip(*(part[0][found.known[0]] for part in found), strict=True)
    return [(Pose(turn, shift), float(error)) for turn, shift, error in both]
