"""A flat print whose picture is known: found in a frame by its features, then aligned with
it by its texture.

`PatternPicture` is what is known before the clip is seen. `find` matches SIFT features by
the ratio test and fits a homography. `align` takes any homography that is right to some
pixels: the print is cut out of the frame as the picture is seen, the picture's corners are
followed into that cut-out and back (Lucas, Kanade), and what agrees moves the homography.
Both images are brought to even local contrast before, so that light, shadow and exposure do
not matter. Homographies are ideal_from_unit: from the print (x right, y down, 0..1) to
normalised coordinates without lens distortion.
Source: docs/methods/pose.md#patterns. Cost (two threads): `align` 5 to 12 ms, `find` about
60 ms for a frame of 640x360.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.markers.detect import Detection, sides
from arfx.analyse.markers.texture import even_contrast, follow
from arfx.core.camera import FISHEYE, Camera
from arfx.core.colour import SRGB
from arfx.core.marker_codes import UNIT_SQUARE
from arfx.core.numerics import divide
from arfx.errors import ConfigError, InputError

BASE_PX, LEVEL = (
    512,
    0.5**0.5,
)  # longest side of the finest level; ratio of one to the next
LEAST_LEVEL_PX = 32  # longest side of the coarsest level
LEAST_PICTURE_PX = 64  # shorter side of a picture that can be used
LEAST_SIDE_PX = 20.0  # of the print in the frame: smaller ones tell no pose
FEATURES, FRAME_FEATURES = (
    250,
    1200,
)  # at most, of one view of the picture, and of a frame
LEAST_FEATURES = 100  # of the picture in all views
RATIO = 0.8  # nearest over second nearest descriptor
LEAST_MATCHES, LEAST_POINTS = 8, 12
MOST_SIGMA_PX = 2.0  # of the print's corners
SHARE = 0.3  # of the corners in view that must agree
# SIFT's threshold of contrast: half of the usual one, for prints that are small or blurred
_FAINT = 0.02
_POINTS, _MARGIN_PX = 160, 7
_REACH = 3  # further halvings of the images for a homography that is only about right
# levels coarser; factor on the deviation there: neighbouring corners err alike under blur
_BLURRED, _SHARED = 2, 2.0
_RETURN_PX, _AGREE_PX = 0.7, 2.0  # there and back; and to a homography at first
_SCALES = (0.7, 0.35, 0.18)  # of the picture whose features are matched
# degrees: prints are square, or logos of up to six-fold symmetry; 270 is 90 seen from the other
_TURNS = (180, 120, 90, 72)
_SAME = 0.7  # share of corners: .5 where half of a print tells its turn
_STEP = 1e-4  # of a homography's numbers, for its derivative
_WORN = 4.0  # deviations at which a point counts half
_ALIKE = (
    1.5  # corners whose windows overlap err alike: factor on the deviation of a fit
)
_LEAST_PX = 1e-4  # of residuals: no corner is followed better


class Level(NamedTuple):
    """The picture at one size.

    even : (h, w) uint8 of even local contrast;  points : (k, 2) float32 px, its corners
    """

    even: ndarray
    points: ndarray

    @property
    def unit_from_level(self) -> ndarray:
        h, w = self.even.shape
        return np.array([[1 / w, 0, 0.5 / w], [0, 1 / h, 0.5 / h], [0, 0, 1]])


class PatternPicture:
    """The picture of one print. luma : (h, w) uint8

    Raises InputError, naming the print, where it is too small or too plain to be found."""

    def __init__(self, name: str, luma: ndarray) -> None:
        h, w = luma.shape
        if min(h, w) < LEAST_PICTURE_PX:
            raise InputError(
                f"pattern {name} is {w}x{h}",
                f"a picture of at least {LEAST_PICTURE_PX} pixels each way",
            )
        self.name, self.levels = name, list[Level]()
        side = float(min(BASE_PX, max(h, w)))
        self._units, self._descriptors = _described(_resized(luma, side))
        while side >= LEAST_LEVEL_PX:
            self.levels.append(_level(_resized(luma, side)))
            side *= LEVEL
        if len(self._units) < LEAST_FEATURES:
            raise InputError(
                f"pattern {name} is too plain: {len(self._units)} features, at least"
                f" {LEAST_FEATURES} are needed",
                "a picture with detail all over it",
            )

    def find(self, features: Features, camera: Camera) -> list[ndarray]:
        """ideal_from_unit by matching features, right to some pixels, if enough agree."""
        if len(features.descriptors) < LEAST_MATCHES:
            return []
        pairs = cv2.BFMatcher().knnMatch(self._descriptors, features.descriptors, 2)
        good = [m for m, second in pairs if m.distance < RATIO * second.distance]
        ideal = camera.normalised(features.pixels[[m.trainIdx for m in good]])
        known = np.isfinite(ideal).all(1)
        if known.sum() < LEAST_MATCHES:
            return []
        # in pixels: USAC fails on numbers of the size of its thresholds' rounding
        unit = self._units[[m.queryIdx for m in good]][known] * BASE_PX
        px = ideal[known] * camera.fx
        h, inside = cv2.findHomography(
            unit, px, cv2.USAC_MAGSAC, 3 * features.px, maxIters=5000
        )
        if h is None or int(inside.sum()) < LEAST_MATCHES:
            return []
        pixel, base = 1 / camera.fx, float(BASE_PX)
        return [h * np.outer([pixel, pixel, 1], [base, base, 1])]

    def align(
        self, luma: ndarray, camera: Camera, abouts: Iterable[ndarray]
    ) -> list[Detection]:
        """The print, if it is there. abouts : ideal_from_unit of where it is about, the first
        that leads to it counts

        By the coarsest level that is hardly coarser than the print in the frame; where the
        print is blurred, by one of half its size."""
        for about in abouts:
            side = 0.9 * sides(_pixels(camera, about, UNIT_SQUARE)).max()
            finest = sum(max(level.even.shape) >= side for level in self.levels)
            levels = self.levels[max(finest - 1, 0) :: _BLURRED]
            for level, factor in zip(levels, (1.0, _SHARED), strict=False):
                found = _followed(level, luma, camera, about)
                there = found and _aligned(self.name, camera, found, factor)
                if there:
                    return [there]
        return []


def check_turned(name: str, luma: ndarray) -> None:
    """Raises ConfigError for a print that looks the same turned about its middle: it would
    be found in several poses.
    luma : (h, w) uint8

    A print that is its own mirror image passes: its front is never seen mirrored. Two
    mirror lines are a turn by 180 degrees."""
    picture = PatternPicture(name, luma)
    finest = picture.levels[0]
    h, w = finest.even.shape
    luma, camera = _resized(luma, max(w, h)), Camera.guess(w, h)
    ideal_from_unit = homography_of(camera.normalised(UNIT_SQUARE * [w, h] - 0.5))
    for degrees in _TURNS:
        m = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), degrees, 1)
        turned = cv2.warpAffine(luma, m, (w, h), borderMode=cv2.BORDER_REPLICATE)
        found = _followed(finest, turned, camera, ideal_from_unit)
        if found and found.share >= _SAME:
            raise ConfigError(
                f"pattern {name} looks the same when it is turned by {degrees} degrees: its"
                " pose would be a guess",
                "a print without such a symmetry: add a word or a picture at one side, or"
                " use a marker",
            )


class Features(NamedTuple):
    """Of a frame. pixels : (n, 2) of the frame;  descriptors : (n, 128);  px : the searched
    image's pixel, in the frame's
    """

    pixels: ndarray
    descriptors: ndarray
    px: float


def frame_features(luma: ndarray, most_px: float) -> Features:
    """SIFT features of a frame, reduced to about `most_px` pixels where it has more."""
    h, w = luma.shape
    px = max(float(np.sqrt(h * w / most_px)), 1.0)
    finder = cv2.SIFT.create(FRAME_FEATURES, contrastThreshold=_FAINT)
    units, descriptors = _found(finder, _resized(luma, max(w, h) / px))
    return Features(units * [w, h] - 0.5, descriptors, px)


def _found(finder: cv2.Feature2D, image: ndarray) -> tuple[ndarray, ndarray]:
    """Of an image's features their places (n, 2), in its size, and descriptors (n, 128)."""
    keypoints, descriptors = finder.detectAndCompute(image, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    return (np.array([k.pt for k in keypoints]) + 0.5) / image.shape[
        ::-1
    ], descriptors


def _described(image: ndarray) -> tuple[ndarray, ndarray]:
    """Features of the picture as it is seen from near and far, straight and foreshortened to
    one half (Morel and Yu 2009), as of `_found`."""
    plain = cv2.SIFT.create(FEATURES, contrastThreshold=_FAINT)
    finder, found = cv2.AffineFeature.create(plain, 1, 0, 2.0, 90.0), []
    for scale in _SCALES:
        small = cv2.resize(
            image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
        )
        found.append(_found(finder, small))
    units, descriptors = map(np.concatenate, zip(*found, strict=True))
    inside = ((units > 0) & (units < 1)).all(1)
    return units[inside], descriptors[inside]


def plausible(quad: ndarray) -> bool:
    """Whether a quad (4, 2) px can be the front of a print: finite, convex, the right way
    round, not too small.
    """
    if not np.isfinite(quad).all() or np.abs(quad).max() > 1e5:
        return False
    side, longest = np.roll(quad, -1, 0) - quad, float(sides(quad).max())
    turns = np.linalg.det(np.stack([side, np.roll(side, -1, 0)], 1))
    return bool(
        longest >= LEAST_SIDE_PX and turns.min() >= LEAST_SIDE_PX / 4 * longest
    )


def homography_of(quad: ndarray) -> ndarray:
    """(3, 3) from the unit square to a quad (4, 2)."""
    return cv2.getPerspectiveTransform(UNIT_SQUARE, quad.astype(np.float32))


def coded_luma(linear: ndarray, ink: float, paper: float) -> ndarray:
    """(h, w) uint8 luma of a print, as a clip holds it: of its picture (h, w, 3), linear,
    in ink and paper of these albedos.
    """
    light = SRGB.encode(ink + (paper - ink) * linear) / SRGB.encode(np.array(paper))
    return (light @ np.array([0.2126, 0.7152, 0.0722]) * 255 + 0.5).astype(np.uint8)


def _resized(luma: ndarray, longest_px: float) -> ndarray:
    """The picture with a longer side of so many pixels."""
    scale = longest_px / max(luma.shape)
    size = [max(round(length * scale), 8) for length in luma.shape[::-1]]
    return cv2.resize(luma, size, interpolation=cv2.INTER_AREA)


def _level(image: ndarray) -> Level:
    even = even_contrast(image)
    inside = np.zeros_like(even)
    margin = min(_MARGIN_PX, min(even.shape) // 8)
    inside[margin:-margin, margin:-margin] = 255
    apart = max(max(even.shape) / 28, 2.0)
    points = cv2.goodFeaturesToTrack(
        even, _POINTS, 0.02, apart, mask=inside, blockSize=5
    )
    return Level(even, np.reshape(() if points is None else points, (-1, 2)))


def _mapped(h: ndarray, xy: ndarray) -> ndarray:
    """Points (n, 2) under a homography; NaN on and beyond a horizon."""
    p = np.concatenate([xy, np.ones((len(xy), 1))], 1) @ h.T
    return np.where(p[:, 2:] > 1e-9, divide(p[:, :2], p[:, 2:]), np.nan)


def _pixels(camera: Camera, ideal_from_unit: ndarray, unit: ndarray) -> ndarray:
    ideal = _mapped(ideal_from_unit, unit)
    return camera.project(np.concatenate([ideal, np.ones((len(unit), 1))], 1))


class _Followed(NamedTuple):
    """Corners of the picture in a frame.

    cut : ideal_from_level, where the frame was cut out;  ideal_from_unit : where they have
    the print;  units, moved : (n, 2) of it, and px of the cut-out
    agree : (n,) on that;  share : of the corners in view that agree"""

    cut: ndarray
    ideal_from_unit: ndarray
    units: ndarray
    moved: ndarray
    agree: ndarray
    share: float


def _followed(
    level: Level, luma: ndarray, camera: Camera, ideal_from_unit: ndarray
) -> _Followed | None:
    """None where too few corners agree on a homography."""
    h, w = level.even.shape
    fisheye = camera.model == FISHEYE
    maps = (
        cv2.fisheye.initUndistortRectifyMap
        if fisheye
        else cv2.initUndistortRectifyMap
    )
    for reach in (_REACH, 0):
        cut = ideal_from_unit @ level.unit_from_level
        quad, at = (
            _pixels(camera, ideal_from_unit, UNIT_SQUARE),
            _pixels(camera, cut, level.points),
        )
        there = (at > 2).all(1) & (at < np.subtract(luma.shape[::-1], 3)).all(1)
        points = level.points[there]
        needed = max(LEAST_POINTS, SHARE * len(points))
        if not plausible(quad) or len(points) < needed:
            return None
        # the frame as the picture is seen; it may be finer than the finest level
        fine = 2 * int(sides(quad).max() / max(w, h) / 2) + 1
        lens, view = (camera.matrix, camera.distortion), np.linalg.inv(cut)
        places = maps(*lens, view, np.eye(3), (w, h), cv2.CV_32FC1)
        seen = cv2.remap(
            cv2.blur(luma, (fine, fine)),
            *places,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        moved, away = follow(level.even, even_contrast(seen), points, reach)
        good = away < _RETURN_PX
        if good.sum() < needed:
            return None
        a, b = points[good].astype(float), moved[good].astype(float)
        by, agree = cv2.findHomography(
            a, b, cv2.USAC_MAGSAC, _AGREE_PX, maxIters=2000
        )
        if by is None or agree.sum() < needed:
            return None
        ideal_from_unit = cut @ by @ np.linalg.inv(level.unit_from_level)
    units, share = _mapped(level.unit_from_level, a), float(agree.sum() / len(points))
    return _Followed(cut, ideal_from_unit, units, b, agree.ravel() > 0, share)


def _aligned(
    name: str, camera: Camera, found: _Followed, factor: float
) -> Detection | None:
    """By robust least squares; None for a quad that no print can show, or one that is not
    known well. factor : on its deviation"""
    from scipy.optimize import approx_fprime, least_squares

    level_from_ideal = np.linalg.inv(found.cut)

    def changed(change: ndarray) -> ndarray:
        """The print moved a little in its own plane, by eight numbers."""
        moved = np.eye(3) + np.append(change, 0.0).reshape(3, 3)
        return found.ideal_from_unit @ moved

    def missed_by(change: ndarray) -> ndarray:
        there = _mapped(level_from_ideal @ changed(change), found.units)
        return (there - found.moved)[found.agree].ravel()

    def corners_by(change: ndarray) -> ndarray:
        return _pixels(camera, changed(change), UNIT_SQUARE).ravel()

    first = missed_by(np.zeros(8))
    if not np.isfinite(first).all():
        return None
    worn = _WORN * _deviation(first)
    fit = least_squares(
        missed_by, np.zeros(8), loss="arctan", f_scale=worn, ftol=1e-5
    )
    corners = corners_by(fit.x).reshape(4, 2)
    slope = approx_fprime(fit.x, corners_by, _STEP) @ np.linalg.pinv(fit.jac)
    sigma = _ALIKE * _deviation(fit.fun) * float(np.sqrt((slope**2).sum() / 8))
    if not plausible(corners) or not factor * sigma <= MOST_SIGMA_PX:
        return None
    off = _pixels(camera, changed(fit.x), found.units)
    off -= _pixels(camera, found.cut, found.moved)
    misfit = float(np.sqrt((off**2).sum(1).mean()))
    return Detection(name, corners, factor * sigma, np.nan, False, misfit_px=misfit)


def _deviation(residuals: ndarray) -> float:
    return max(1.4826 * float(np.median(np.abs(residuals))), _LEAST_PX)
