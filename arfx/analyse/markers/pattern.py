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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from arfx.core.camera import Camera
from arfx.core.colour import SRGB
from arfx.core.numerics import divide
from arfx.core.rect import Rect
from arfx.errors import ConfigError, InputError

BASE_PX, LEVEL = 512, 0.5**0.5  # longest side of the finest level; ratio of one to the next
LEAST_LEVEL_PX = 32  # longest side of the coarsest level
LEAST_PICTURE_PX = 64  # shorter side of a picture that can be used
LEAST_SIDE_PX = 20.0  # of the print in the frame: smaller ones tell no pose
FEATURES, LEAST_FEATURES, FRAME_FEATURES = 250, 40, 1200
RATIO = 0.8  # nearest over second nearest descriptor
LEAST_MATCHES, LEAST_POINTS = 8, 12
MOST_SIGMA_PX = 2.0  # of the print's corners
SHARE = 0.3  # of the corners in view that must agree
# SIFT's threshold of contrast: half of the usual one, for prints that are small or blurred
_FAINT = 0.02
_POINTS, _WINDOW_PX, _EVEN_PX = 160, 15, 25
_REACH = 3  # further halvings of the images for a homography that is only about right
_BLURRED, _SHARED = (
    2,
    2.0,
)  # levels coarser; factor on the deviation there: neighbouring corners err alike under blur
_RETURN_PX, _AGREE_PX = 0.7, 2.0  # there and back; and to a homography at first
_CORNERS = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])  # order of MarkerSpec.corners_m
# Scale, direction and factor of foreshortening of the views whose features are matched.
_VIEWS = (
    (1.0, 0.0, 1.0),
    (0.5, 0.0, 1.0),
    (0.25, 0.0, 1.0),
    *((0.7, a, 0.5) for a in (0.0, 45.0, 90.0, 135.0)),
)
_TURNS = (
    180,
    120,
    90,
    72,
)  # degrees: prints are square, or logos of up to six-fold symmetry; 270 is 90 seen from the other
_AGREEING, _SAME = (
    0.5,
    0.7,
)  # share of corners; correlation of the even pictures: 0.66 where half of a print tells its turn
_STEP = 1e-4  # of a homography's numbers, for its derivative
_NODE_PX = 8  # between points for which lens distortion is computed


@dataclass(frozen=True, eq=False)
class Level:
    """The picture at one size.

    even : (h, w) uint8 of even local contrast;  points : (k, 2) float32 px, its corners
    """

    even: np.ndarray
    points: np.ndarray

    @property
    def unit_from_level(self) -> np.ndarray:
        h, w = self.even.shape
        return np.array([[1 / w, 0, 0.5 / w], [0, 1 / h, 0.5 / h], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class Alignment:
    """ideal_from_unit : (3, 3);  corners_px : (4, 2) of the print in the picture, order of
    MarkerSpec.corners_m
    sigma_px : standard deviation of their coordinates;  share : of the print's corners that agree
    """

    ideal_from_unit: np.ndarray
    corners_px: np.ndarray
    sigma_px: float
    share: float


class PatternPicture:
    """The picture of one print. luma : (h, w) uint8

    Raises InputError, naming the print, where it is too small or too plain to be found."""

    def __init__(self, name: str, luma: np.ndarray) -> None:
        h, w = luma.shape
        if min(h, w) < LEAST_PICTURE_PX:
            raise InputError(
                f"pattern {name} is {w}x{h}",
                f"a picture of at least {LEAST_PICTURE_PX} pixels each way",
            )
        self.name = name
        self.levels: list[Level] = []
        side = float(min(BASE_PX, max(h, w)))
        base = luma
        while side >= LEAST_LEVEL_PX:
            size = max(round(w * side / max(h, w)), 8), max(round(h * side / max(h, w)), 8)
            small = cv2.resize(luma, size, interpolation=cv2.INTER_AREA)
            base = small if not self.levels else base
            self.levels.append(_level(small))
            side *= LEVEL
        views = [_described(base, view) for view in _VIEWS]
        self._units, self._descriptors = (
            np.concatenate(part) for part in zip(*views, strict=True)
        )
        if len(views[0][0]) < LEAST_FEATURES:
            raise InputError(
                f"pattern {name} is too plain: {len(views[0][0])} features, at least"
                f" {LEAST_FEATURES} are needed",
                "a picture with detail all over it",
            )

    def find(self, features: Features, camera: Camera) -> np.ndarray | None:
        """ideal_from_unit by matching features, right to some pixels; None where too few agree."""
        if len(features.descriptors) < LEAST_MATCHES:
            return None
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(
            self._descriptors, features.descriptors, 2
        )
        good = [
            m
            for m, second in (p for p in pairs if len(p) == 2)
            if m.distance < RATIO * second.distance
        ]
        if len(good) < LEAST_MATCHES:
            return None
        unit = self._units[[m.queryIdx for m in good]]
        ideal = camera.normalised(features.pixels[[m.trainIdx for m in good]])
        known = np.isfinite(ideal).all(1)
        if known.sum() < LEAST_MATCHES:
            return None
        # in pixels: USAC fails on numbers of the size of its thresholds' rounding
        unit, px = unit[known] * BASE_PX, ideal[known] * camera.fx
        h, inside = cv2.findHomography(
            unit, px, cv2.USAC_MAGSAC, 3 * features.px, maxIters=5000
        )
        if h is None or int(inside.sum()) < LEAST_MATCHES:
            return None
        return (
            np.diag([1 / camera.fx, 1 / camera.fx, 1.0])
            @ h
            @ np.diag([BASE_PX, BASE_PX, 1.0])
        )

    def align(
        self, luma: np.ndarray, camera: Camera, ideal_from_unit: np.ndarray
    ) -> Alignment | None:
        """The print where it is, from where it is about; None where it is not there."""
        for level, factor in zip(
            self._levels_for(camera, ideal_from_unit), (1.0, _SHARED), strict=False
        ):
            near = _aligned(level, luma, camera, ideal_from_unit, _REACH)
            there = near and _aligned(level, luma, camera, near.ideal_from_unit, 0)
            if there and factor * there.sigma_px <= MOST_SIGMA_PX:
                return replace(there, sigma_px=factor * there.sigma_px)
        return None

    def _levels_for(self, camera: Camera, ideal_from_unit: np.ndarray) -> Sequence[Level]:
        """The coarsest level that is hardly coarser than the print in the frame, and one of
        half its size, where the print is blurred; none for a quad that no print can
        show."""
        quad = _pixels(camera, ideal_from_unit, _CORNERS)
        if not plausible(quad):
            return ()
        side = float(np.linalg.norm(quad - np.roll(quad, -1, 0), axis=1).max())
        finest = max(
            (i for i, k in enumerate(self.levels) if max(k.even.shape) >= 0.9 * side),
            default=0,
        )
        return self.levels[finest::_BLURRED][:2]


def check_turned(name: str, luma: np.ndarray) -> None:
    """Raises ConfigError for a print that looks the same turned about its middle: it would
    be found in several poses.
    luma : (h, w) uint8

    A print that is its own mirror image passes: its front is never seen mirrored. Two
    mirror lines are a turn by 180 degrees."""
    picture = PatternPicture(name, luma)
    h, w = picture.levels[0].even.shape
    luma, camera = (
        cv2.resize(luma, (w, h), interpolation=cv2.INTER_AREA),
        Camera.guess(w, h),
    )
    ideal_from_unit = homography_of(camera.normalised(_CORNERS * [w, h] - 0.5))
    for degrees in _TURNS:
        m = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), degrees, 1)
        turned = cv2.warpAffine(luma, m, (w, h), borderMode=cv2.BORDER_REPLICATE)
        there = picture.align(turned, camera, ideal_from_unit)
        if there is None or there.share < _AGREEING:
            continue
        seen = _cut_out(
            turned,
            camera,
            there.ideal_from_unit @ picture.levels[0].unit_from_level,
            (w, h),
        )
        if np.corrcoef(picture.levels[0].even.ravel(), _even(seen).ravel())[0, 1] >= _SAME:
            raise ConfigError(
                f"pattern {name} looks the same when it is turned by {degrees} degrees: its"
                " pose would be a guess",
                "a print without such a symmetry: add a word or a picture at one side, or"
                " use a marker",
            )


@dataclass(frozen=True, eq=False)
class Features:
    """Of a frame. pixels : (n, 2) of the frame;  descriptors : (n, 128);  px : the searched
    image's pixel, in the frame's
    """

    pixels: np.ndarray
    descriptors: np.ndarray
    px: float


def frame_features(luma: np.ndarray, most_px: float) -> Features:
    """SIFT features of a frame, reduced to about `most_px` pixels where it has more."""
    h, w = luma.shape
    scale = max(float(np.sqrt(h * w / most_px)), 1.0)
    size = max(round(w / scale), 1), max(round(h / scale), 1)
    small = luma if scale == 1 else cv2.resize(luma, size, interpolation=cv2.INTER_AREA)
    at, descriptors = _sift(small, FRAME_FEATURES)
    return Features((at + 0.5) * [w / size[0], h / size[1]] - 0.5, descriptors, scale)


def _sift(image: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(places (n, 2) px, descriptors (n, 128)) of an image's features."""
    keypoints, descriptors = cv2.SIFT.create(
        most, contrastThreshold=_FAINT
    ).detectAndCompute(image, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    return np.array([k.pt for k in keypoints]), descriptors


def _described(
    image: np.ndarray, view: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Features of the picture as it is seen from elsewhere: (units (n, 2), descriptors (n, 128)).

    view : scale; and direction (degrees) along which it is foreshortened by the factor that
    comes last
    """
    h, w = image.shape
    scale, direction, squeeze = view
    c, s = np.cos(np.radians(direction)), np.sin(np.radians(direction))
    turn = np.array([[c, s], [-s, c]])
    m = scale * (turn.T @ np.diag([squeeze, 1.0]) @ turn)
    corners = (np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5) @ m.T
    low, high = corners.min(0), corners.max(0)
    size = np.maximum(np.ceil(high - low), 8).astype(int)
    affine = np.concatenate([m, -low[:, None] - 0.5], 1)
    shrink = 1 / (
        scale * scale * squeeze
    )  # in area; what is finer than a pixel is blurred away before
    soft = (
        image
        if shrink <= 1
        else cv2.GaussianBlur(image, (0, 0), 0.5 * float(np.sqrt(shrink - 1)))
    )
    seen = cv2.warpAffine(
        soft, affine, tuple(size.tolist()), borderMode=cv2.BORDER_REPLICATE
    )
    at, descriptors = _sift(seen, FEATURES)
    at = (at - affine[:, 2]) @ np.linalg.inv(m).T
    units = (at + 0.5) / [w, h]
    inside = ((units > 0) & (units < 1)).all(1)
    return units[inside], descriptors[inside]


def plausible(quad: np.ndarray) -> bool:
    """Whether a quad (4, 2) px can be the front of a print: finite, convex, the right way
    round, not too small.
    """
    if not np.isfinite(quad).all() or np.abs(quad).max() > 1e5:
        return False
    side = np.roll(quad, -1, 0) - quad
    after = np.roll(side, -1, 0)
    cross = side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0]
    longest = float(np.linalg.norm(side, axis=1).max())
    return bool(longest >= LEAST_SIDE_PX and cross.min() >= LEAST_SIDE_PX / 4 * longest)


def homography_of(quad: np.ndarray) -> np.ndarray:
    """(3, 3) from the unit square to a quad (4, 2)."""
    return cv2.getPerspectiveTransform(_CORNERS.astype(np.float32), quad.astype(np.float32))


def unit_corners(ideal_from_unit: np.ndarray) -> np.ndarray:
    """(4, 2) where the corners of the unit square are."""
    return _mapped(ideal_from_unit, _CORNERS)


def coded_luma(linear: np.ndarray, ink: float, paper: float) -> np.ndarray:
    """(h, w) uint8 luma of a print, as a clip holds it: of its picture (h, w, 3), linear,
    in ink and paper of these albedos.
    """
    light = SRGB.encode(ink + (paper - ink) * linear) / SRGB.encode(np.array(paper))
    return (light @ np.array([0.2126, 0.7152, 0.0722]) * 255 + 0.5).astype(np.uint8)


def _level(image: np.ndarray) -> Level:
    even = _even(image)
    inside = np.zeros_like(even)
    margin = min(_WINDOW_PX // 2, min(even.shape) // 8)
    inside[margin:-margin, margin:-margin] = 255
    apart = max(max(even.shape) / 28, 2.0)
    points = cv2.goodFeaturesToTrack(even, _POINTS, 0.02, apart, mask=inside, blockSize=5)
    return Level(
        even, np.zeros((0, 2), np.float32) if points is None else points.reshape(-1, 2)
    )


def _even(image: np.ndarray) -> np.ndarray:
    """(h, w) uint8 of even local contrast about 128."""
    f, n = image.astype(np.float32), (_EVEN_PX, _EVEN_PX)
    mean = cv2.blur(f, n)
    spread = np.sqrt(np.maximum(cv2.blur(f * f, n) - mean * mean, 0) + 9.0)
    return np.clip(128 + 45 * (f - mean) / spread + 0.5, 0, 255).astype(np.uint8)


def _mapped(h: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Points (n, 2) under homographies (..., 3, 3); NaN on and beyond a horizon."""
    p = np.concatenate([xy, np.ones((len(xy), 1))], 1) @ np.swapaxes(h, -1, -2)
    return np.where(p[..., 2:] > 1e-9, divide(p[..., :2], p[..., 2:]), np.nan)


def _pixels(camera: Camera, ideal_from_unit: np.ndarray, unit: np.ndarray) -> np.ndarray:
    ideal = _mapped(ideal_from_unit, unit)
    return camera.project(np.concatenate([ideal, np.ones_like(ideal[..., :1])], -1))


def _cut_out(
    luma: np.ndarray, camera: Camera, ideal_from_level: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """The frame as the picture is seen: (h, w) uint8 of size (w, h)."""
    w, h = size
    corners = _pixels(camera, ideal_from_level, _CORNERS * [w, h] - 0.5)
    side = float(np.linalg.norm(corners - np.roll(corners, -1, 0), axis=1).max())
    x0, y0, k = 0, 0, int(side / max(size))
    if k > 1:  # the frame is finer than the finest level
        part = Rect.around(corners, 2.0 * k).clip(Rect.of(luma.shape[1], luma.shape[0]))
        if part.width < 4 * k or part.height < 4 * k:
            return np.zeros((h, w), np.uint8)
        x0, y0 = part.x0, part.y0
        luma = luma[y0 : y0 + part.height // k * k, x0 : x0 + part.width // k * k]
        luma = cv2.resize(
            luma, (luma.shape[1] // k, luma.shape[0] // k), interpolation=cv2.INTER_AREA
        )
    k = max(k, 1)
    here = np.array(
        [[1 / k, 0, (0.5 - x0) / k - 0.5], [0, 1 / k, (0.5 - y0) / k - 0.5], [0, 0, 1]]
    )
    if not camera.distorted:
        m = here @ camera.matrix @ ideal_from_level
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpPerspective(
            luma, m, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
    nodes = [(np.arange(-1, n // _NODE_PX + 2) + 0.5) * _NODE_PX - 0.5 for n in size]
    grid = np.stack(np.meshgrid(*nodes), -1)
    at = _pixels(camera, ideal_from_level, grid.reshape(-1, 2)).reshape(grid.shape)
    at = np.where(np.isfinite(at), (at - [x0, y0] + 0.5) / k - 0.5, -1e4).astype(np.float32)
    full = cv2.resize(
        at,
        (grid.shape[1] * _NODE_PX, grid.shape[0] * _NODE_PX),
        interpolation=cv2.INTER_LINEAR,
    )
    full = full[_NODE_PX : _NODE_PX + h, _NODE_PX : _NODE_PX + w]
    return cv2.remap(
        luma,
        full[..., 0].copy(),
        full[..., 1].copy(),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )


def _aligned(
    level: Level, luma: np.ndarray, camera: Camera, ideal_from_unit: np.ndarray, reach: int
) -> Alignment | None:
    ideal_from_level = ideal_from_unit @ level.unit_from_level
    h, w = level.even.shape
    picture, points = level.even, level.points
    seen = _even(_cut_out(luma, camera, ideal_from_level, (w, h)))
    at = _pixels(camera, ideal_from_level, points.astype(float))
    there = (at > 2).all(1) & (at < [luma.shape[1] - 3, luma.shape[0] - 3]).all(1)
    points = points[there]
    if len(points) < LEAST_POINTS:
        return None
    moved = _followed(picture, seen, points, reach)
    good = (
        np.linalg.norm(_followed(seen, picture, moved, reach) - points, axis=1) < _RETURN_PX
    )
    needed = max(LEAST_POINTS, SHARE * len(points))
    if good.sum() < needed:
        return None
    a, b = points[good].astype(float), moved[good].astype(float)
    start, inside = cv2.findHomography(a, b, cv2.USAC_MAGSAC, _AGREE_PX, maxIters=2000)
    if start is None or inside.sum() < needed:
        return None
    inside = inside.ravel() > 0
    # in units of the longer side: all numbers of the homography are of the size of 1
    to_px = np.diag([float(max(w, h)), float(max(w, h)), 1.0])
    start = np.linalg.inv(to_px) @ start @ to_px
    numbers, covariance = _fitted(a[inside] / max(w, h), b[inside] / max(w, h), start)
    if not np.isfinite(numbers).all():
        return None
    start_from_unit = np.linalg.inv(level.unit_from_level @ to_px)

    def moved_by(numbers: np.ndarray) -> np.ndarray:
        fit = np.insert(numbers, 8, 1.0, axis=-1).reshape(*numbers.shape[:-1], 3, 3)
        return np.asarray(ideal_from_level @ to_px @ fit @ start_from_unit)

    new = moved_by(numbers)
    new = new / new[2, 2] if new[2, 2] else new
    corners = _pixels(camera, new, _CORNERS)
    if not plausible(corners):
        return None
    ahead, behind = (
        _pixels(camera, moved_by(numbers + step * np.eye(8)), _CORNERS)
        for step in (_STEP, -_STEP)
    )
    slope = (ahead - behind) / (2 * _STEP)
    sigma = float(np.sqrt(np.einsum("inc,ij,jnc->", slope, covariance, slope) / 8))
    return Alignment(new, corners, sigma, float(inside.sum() / len(points)))


def _followed(
    first: np.ndarray, second: np.ndarray, points: np.ndarray, reach: int
) -> np.ndarray:
    """(n, 2) where points of one image are in another; far away where they are lost."""
    window = (_WINDOW_PX, _WINDOW_PX)
    start, out = np.array(points, np.float32), np.zeros(points.shape, np.float32)
    moved, ok, _ = cv2.calcOpticalFlowPyrLK(
        first, second, start, out, winSize=window, maxLevel=reach, criteria=(3, 20, 0.005)
    )
    return np.where(np.asarray(ok) > 0, moved, -1e4).astype(np.float32)


def _fitted(
    a: np.ndarray, b: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Robust least squares for the homography from a (n, 2) to b (n, 2): (its first eight
    numbers, the last is 1; their covariance (8, 8)).
    """
    h = divide(start, start[2, 2])
    normal, size = np.eye(8), 0.0
    from_a = np.column_stack([a, np.ones(len(a))])
    none = np.zeros_like(from_a)
    for _ in range(6):
        p = from_a @ h.T
        y = divide(p[:, :2], p[:, 2:])
        rows = [
            np.column_stack([from_a, none, -y[:, :1] * a]),
            np.column_stack([none, from_a, -y[:, 1:] * a]),
        ]
        j = divide(np.stack(rows, 1), p[:, 2, None, None])
        r = b - y
        length = np.linalg.norm(r, axis=1)
        # of one coordinate: a Rayleigh median is 1.177 of it
        size = max(1.4826 * float(np.median(length)) / 1.177, 1e-7)
        weight = 1 / (1 + (length / (3 * size)) ** 2) ** 2
        normal = np.einsum("n,nki,nkj->ij", weight, j, j)
        right = np.einsum("n,nki,nk->i", weight, j, r)
        h = h + np.append(np.linalg.lstsq(normal, right, rcond=None)[0], 0.0).reshape(3, 3)
    return h.ravel()[:8], np.linalg.pinv(normal, hermitian=True) * size**2
