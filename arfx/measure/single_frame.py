"""What plain OpenCV gives frame by frame: the yardstick that the analysis is measured against.

Whole-frame detection with sub-pixel corners, IPPE, the solution that reprojects better; no memory of other frames.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from arfx.analyse.markers.detect import dictionary
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose
from arfx.media.clip import probe
from arfx.media.frames import ClipReader


def single_frame_poses(clip: Path, camera: Camera, marker: MarkerSpec) -> list[Pose | None]:
    """camera_from_marker of every frame, None where the marker is not found."""
    detector = _detector(marker.family)
    with ClipReader(probe(clip)) as reader:
        return [_pose(detector, np.ascontiguousarray(frame.luma()), camera, marker) for frame in reader.frames()]


def _detector(family: str) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(dictionary(family), parameters)


def _pose(detector: cv2.aruco.ArucoDetector, luma: np.ndarray, camera: Camera, marker: MarkerSpec) -> Pose | None:
    corners, ids, _ = detector.detectMarkers(luma)
    for found, number in zip(corners, [] if ids is None else np.asarray(ids).ravel(), strict=False):
        if number != marker.id:
            continue
        points = np.asarray(found, float).reshape(4, 2)
        ok, rotations, translations, _ = cv2.solvePnPGeneric(
            marker.corners_m, camera.normalised(points), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        if ok:
            return Pose.from_rotvec(np.asarray(rotations[0]).ravel(), np.asarray(translations[0]).ravel())
    return None
