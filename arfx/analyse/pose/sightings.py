"""Every print that was seen with its geometry: corners, how sure they are, planar solutions."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from arfx.analyse.markers.corners import shared_px
from arfx.analyse.markers.detect import Detection, Record, sides
from arfx.analyse.markers.inner_edges import AGREE_CELLS
from arfx.analyse.pose.marker_map import Prints
from arfx.analyse.pose.planar import Observed, lens_scale, planar_poses, residuals
from arfx.analyse.tables import by_columns
from arfx.core.camera import Camera
from arfx.core.facts import MarkerSighting
from arfx.core.marker import Marker, MarkerSpec
from arfx.core.marker_codes import cells_per_side
from arfx.core.numerics import divide

# of a corner, at least, that no smoothing averages away: the print's edges, the optics
_COMMON_PX = 0.005
# What covers a print comes and goes. Beside a frame where it is told, what is not told may
# be left; half of it so far away.
_COVERS_S = 1 / 30
_LEAST_SIGMA_PX = 0.015  # no corner of a real print in a real picture is known better


class Sightings:
    """All sightings with their geometry.

    prints : those that have a planar pose;  facts : of each frame
    common_px : (frames,) error of a frame's corners that its neighbours' have too
    sigma_factor : on the predicted sigma"""

    def __init__(
        self, records: Sequence[Record], markers: Sequence[Marker], camera: Camera
    ) -> None:
        from scipy.spatial import cKDTree

        spec = {m.key: m for m in markers}
        number = {key: k for k, key in enumerate(spec)}
        seen = [s for r in records for s in r.detections]
        frame = np.repeat(
            np.arange(len(records)), [len(r.detections) for r in records]
        )
        columns = by_columns(seen, Detection)
        corners = columns["corners_px"].reshape(-1, 4, 2)
        blur, misplaced = columns["blur_px"], columns["misplaced_px"]
        sigma = np.hypot(columns["sigma_px"], misplaced)
        kinds = [spec[s.key] for s in seen]
        cells = np.array(
            [
                cells_per_side(m.family) if isinstance(m, MarkerSpec) else 1
                for m in kinds
            ]
        )
        points = np.array([m.corners_m for m in kinds]).reshape(-1, 4, 3)
        ideal = camera.normalised(corners)
        scale = lens_scale(camera, np.where(np.isfinite(ideal), ideal, 0.0))
        shared = shared_px(corners, blur, cells)
        rough = np.hypot(np.maximum(sigma, _LEAST_SIGMA_PX), shared)
        poses = planar_poses(points, ideal, scale, rough)
        known = poses.known[:, 0]
        sure = known & (sigma < 1.0)
        every = Observed(points, ideal, scale, np.ones((len(seen), 4)))
        marker = np.array([number[s.key] for s in seen], int)
        best = poses.rotation[sure, 0], poses.translation[sure, 0]
        self.sigma_factor = _sigma_factor(
            residuals(*best, every.take(sure)), sigma[sure], frame[sure], marker[sure]
        )
        px = np.hypot(np.maximum(sigma * self.sigma_factor, _LEAST_SIGMA_PX), shared)
        every = every._replace(weight=np.repeat(px[:, None] ** -2.0, 4, 1))
        self.common_px = np.full(len(records), _COMMON_PX)
        np.maximum.at(self.common_px, frame, shared)
        untold = AGREE_CELLS * sides(corners).mean(1) / cells
        # of the corners' weights; with the square of misplaced_px, of what is not told
        whole, off, hidden = (
            np.bincount(frame, w / px**2, len(records))
            for w in (np.ones(len(seen)), misplaced**2, untold**2)
        )
        times_s = np.array([[r.time_s] for r in records])
        # to the nearest frame where it is told, infinite where there is none
        gap_s, _ = cKDTree(times_s[off > 0]).query(times_s)
        off = np.where(off > 0, off, hidden * 0.5 ** (2 * gap_s / _COVERS_S))
        self.common_px = np.hypot(self.common_px, np.sqrt(divide(off, whole)))
        self.prints = Prints(
            frame[known], marker[known], every.take(known), poses.take(known)
        )
        first, second = poses.error_px.T
        ratio = divide(second, first, where_zero=np.inf)
        self.facts: list[list[MarkerSighting]] = [[] for _ in records]
        for k, s, sigma_px, ambiguity in zip(
            frame, seen, px.tolist(), ratio.tolist(), strict=True
        ):
            self.facts[k].append(
                MarkerSighting(s.key, s.corners_px, sigma_px, ambiguity, s.inverted)
            )


def _sigma_factor(
    misfit: ndarray, sigma: ndarray, frame: ndarray, marker: ndarray
) -> float:
    """Factor on the predicted sigma (n,), from how residuals (n, 4, 2) change from one
    sighting of a marker to its next.

    What stays (a bent print, an imperfect lens model) is no noise: taken for noise it
    would let the smoother drag the object away from a picture that shakes. 8
    coordinates minus 6 unknowns leave 2 degrees of freedom."""
    order = np.lexsort((frame, marker))
    a, b = order[:-1], order[1:]
    follows = (marker[a] == marker[b]) & (frame[a] + 1 == frame[b])
    change = ((misfit[b] - misfit[a]) ** 2).sum((1, 2))
    chi2 = (change / (sigma[a] ** 2 + sigma[b] ** 2))[follows]
    if len(chi2) < 5:
        return 1.0
    # by the median of chi squared with two degrees
    return float(np.clip(np.sqrt(np.median(chi2) / 1.386), 0.5, 20.0))
