"""A calibrated camera: projection with lens distortion, and its inverse.

Pixel centres lie at integer coordinates; x right, y down, z forward (OpenCV)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy import ndarray
from scipy.spatial.transform import Rotation

from arfx.core.codec import Array, Document
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.rect import Rect
from arfx.errors import InputError

# OpenCV k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]: Brown-Conrady, rational, thin
# prism, tilt
BROWN = "brown"
FISHEYE = "fisheye"  # OpenCV fisheye k1..k4 (Kannala-Brandt, also "equidistant")


@dataclass(frozen=True, eq=False)
class Camera(Document):
    """Intrinsics of one picture size.
    width, height : px;  matrix : (3, 3) float64, zero skew;  source : where it came from,
    for messages
    distortion : (n,) float64, n in 0, 4, 5, 8, 12, 14 for `brown`, 4 for `fisheye`
    Raises InputError for non-finite values, a focal length <= 0 or a wrong number of coefficients.
    """

    width: int
    height: int
    matrix: Array
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    model: str = BROWN
    source: str = ""
    guessed: bool = False

    def __post_init__(self) -> None:
        m, d = np.array(self.matrix, float), np.array(self.distortion, float).ravel()
        if self.model == FISHEYE and not d.size:
            d = np.zeros(4)  # OpenCV's functions for it take no fewer
        object.__setattr__(self, "matrix", m)
        object.__setattr__(self, "distortion", d)
        where = f" in {self.source}" if self.source else ""
        allowed = (0, 4) if self.model == FISHEYE else (0, 4, 5, 8, 12, 14)
        what = hint = ""
        if m.shape != (3, 3) or not np.isfinite([*m.flat, *d]).all():
            what, hint = (
                " holds values that are not finite numbers",
                "calibrate again",
            )
        elif min(m[0, 0], m[1, 1]) <= 0:
            what = f": focal length must be above 0, is {m[0, 0]:g}, {m[1, 1]:g} px"
        elif min(self.width, self.height) <= 0:
            what = f": picture size {self.width}x{self.height}"
        elif self.model not in (BROWN, FISHEYE) or d.size not in allowed:
            what = f": {d.size} distortion coefficients for model {self.model!r}"
            hint = f"one of {', '.join(map(str, allowed))}"
        if what:
            raise InputError(f"camera calibration{where}{what}", hint)

    fx = property(lambda self: float(self.matrix[0, 0]))
    fy = property(lambda self: float(self.matrix[1, 1]))
    cx = property(lambda self: float(self.matrix[0, 2]))
    cy = property(lambda self: float(self.matrix[1, 2]))

    @property
    def rect(self) -> Rect:
        return Rect.of(self.width, self.height)

    @property
    def distorted(self) -> bool:
        return self.model == FISHEYE or bool(np.any(self.distortion))

    def _coefficients(self) -> ndarray:
        d = np.zeros(14)
        d[: self.distortion.size] = self.distortion
        return d

    @cached_property
    def max_radius(self) -> float:
        """Largest normalised radius r = |(x, y)/z| up to which the distortion is
        one-to-one; inf if everywhere. Beyond it the polynomial folds back, and points that
        are out of the picture would reappear inside it."""
        if self.model == FISHEYE:
            radial, r = self, np.tan(np.linspace(1e-4, np.pi / 2 - 1e-3, 2000))
            largest = float(r[-1])
        else:
            d = self._coefficients()
            d[[2, 3, *range(8, 14)]] = 0.0
            radial, r = replace(self, distortion=d), np.linspace(0, 10, 20001)[1:]
            largest = float("inf")
        distorted = radial.distort(np.stack([r, 0 * r], -1))[:, 0]
        fold = np.flatnonzero(np.diff(distorted) <= 0)
        return float(r[fold[0]]) if fold.size else largest

    def distort(self, xy: ndarray) -> ndarray:
        """Ideal normalised coordinates (..., 2) to distorted ones.

        Source: OpenCV calib3d documentation.
        """
        xy = np.asarray(xy, float)
        if not self.distorted:
            return xy.copy("K")
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        d = self._coefficients()
        if self.model == FISHEYE:
            r = np.sqrt(r2)
            th = np.arctan(r)
            t2 = th * th
            td = th * (1 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3]))))
            return xy * divide(td, r, where_zero=1.0)[..., None]
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tx, ty = d
        radial = divide(
            1 + r2 * (k1 + r2 * (k2 + r2 * k3)),
            1 + r2 * (k4 + r2 * (k5 + r2 * k6)),
            where_zero=1.0,
        )
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
        if tx or ty:
            h = _tilt(tx, ty) @ np.stack([xd, yd, np.ones_like(xd)], -1)[..., None]
            return divide(h[..., :2, 0], h[..., 2, :])
        return np.stack([xd, yd], -1)

    def undistort(self, xy: ndarray) -> ndarray:
        """Distorted normalised coordinates (..., 2) to ideal ones. Points that no direction
        maps to (beyond the fold) give NaN.
        """
        target = np.asarray(xy, float)
        if not self.distorted:
            return target.copy()
        guess = (
            self._fisheye_angle(target)
            if self.model == FISHEYE
            else self._newton(target)
        )
        found = np.linalg.norm(self.distort(guess) - target, axis=-1) <= 1e-6
        guess[~found | (np.linalg.norm(guess, axis=-1) > self.max_radius)] = np.nan
        return guess

    def _fisheye_angle(self, target: ndarray) -> ndarray:
        """Newton in the angle to the axis: up to 90 degrees, where no step in x/z, y/z leads."""
        k1, k2, k3, k4 = self.distortion
        distorted = np.polynomial.Polynomial([0, 1, 0, k1, 0, k2, 0, k3, 0, k4])
        slope, radius = distorted.deriv(), np.linalg.norm(target, axis=-1)
        angle = np.minimum(radius, np.pi / 2)
        for _ in range(20):
            missed = distorted(angle) - radius
            angle = np.clip(angle - divide(missed, slope(angle)), 0, np.pi / 2)
        ratio = divide(np.tan(angle), radius, where_zero=1.0)
        return np.asarray(target * ratio[..., None])

    def stretch(self, xy: ndarray) -> ndarray:
        """(..., 2, 2) change of `distort` with ideal coordinates (..., 2): central differences."""
        h = 1e-6
        ends = [
            self.distort(xy + axis) - self.distort(xy - axis)
            for axis in h * np.eye(2)
        ]
        return np.stack(ends, -1) / (2 * h)

    def _newton(self, target: ndarray) -> ndarray:
        """Near a fold cv2.undistortPoints, a fixed-point iteration, ends beside the answer."""
        guess = target.copy()
        # each point until its own steps end, whatever points are beside it
        todo = np.ones(target.shape[:-1], bool)
        for _ in range(12):
            at = guess[todo]
            if not len(at):
                break
            missed = target[todo] - self.distort(at)
            along_x, along_y = np.moveaxis(self.stretch(at), -1, 0)
            change = np.stack([_cross(missed, along_y), _cross(along_x, missed)], -1)
            step = divide(change, _cross(along_x, along_y)[..., None])
            size = np.linalg.norm(step, axis=-1, keepdims=True)
            # damped near a fold
            guess[todo] = at + step * np.minimum(
                1.0, divide(0.3, size, where_zero=1.0)
            )
            todo[todo] = size[..., 0] > 1e-12
        return guess

    def project(self, points_camera: ndarray) -> ndarray:
        """Points (..., 3) in camera coordinates, metres, to pixels (..., 2).
        NaN for points closer than EPS_DEPTH_M in front of the camera, or beyond the
        distortion's fold. Agrees with cv2.projectPoints to 1e-9 px inside."""
        p = np.asarray(points_camera, float)
        z = p[..., 2]
        ok = z > EPS_DEPTH_M
        xy = p[..., :2] / np.where(ok, z, 1.0)[..., None]
        ok &= xy[..., 0] ** 2 + xy[..., 1] ** 2 <= self.max_radius**2
        focal, centre = (self.fx, self.fy), (self.cx, self.cy)
        uv = self.distort(np.where(ok[..., None], xy, 0.0)) * focal + centre
        return np.where(ok[..., None], uv, np.nan)

    def normalised(self, pixels: ndarray) -> ndarray:
        """Pixels (..., 2) to ideal normalised coordinates (x/z, y/z); NaN where no
        direction maps there.
        """
        return self.undistort(
            (np.asarray(pixels, float) - [self.cx, self.cy]) / [self.fx, self.fy]
        )

    def directions(self, pixels: ndarray) -> ndarray:
        """Pixels (..., 2) to viewing directions (..., 3) with z = 1 (not unit length)."""
        n = self.normalised(pixels)
        return np.concatenate([n, np.ones_like(n[..., :1])], -1)

    def scaled_to(self, width: int, height: int, pixel_aspect: float = 1.0) -> Camera:
        """The same lens for another picture size.
        pixel_aspect : of the wanted pixels; the calibration may be of these or of the
        square ones that are displayed
        Raises InputError if the aspect ratio differs by more than 0.5 % from both."""
        if (width, height) == (self.width, self.height):
            return self
        stretch = width * self.height / (height * self.width)
        if min(abs(stretch - 1), abs(stretch * pixel_aspect - 1)) > 0.005:
            what = (
                f"camera calibration {self.source or ''} is for {self.width}x{self.height},"
                f" the clip is {width}x{height}"
            )
            hint = (
                "the aspect ratios differ: calibrate with the same camera mode (crop) as"
                " the clip"
            )
            raise InputError(what, hint)
        grown = np.array([width / self.width, height / self.height])
        m = self.matrix.copy()
        m[:2] *= grown[:, None]
        # pixel centres at integers: the picture's edge is at -0.5
        m[:2, 2] = (self.matrix[:2, 2] + 0.5) * grown - 0.5
        m[2] = [0, 0, 1]
        return replace(self, width=width, height=height, matrix=m)

    @staticmethod
    def guess(
        width: int,
        height: int,
        horizontal_fov_deg: float = 65.0,
        pixel_aspect: float = 1.0,
    ) -> Camera:
        """A pinhole with a typical phone's field of view along the long side as displayed;
        `guessed` is set.
        pixel_aspect : width of a pixel over its height"""
        longest = max(width * pixel_aspect, height)
        f = longest / 2 / np.tan(np.radians(horizontal_fov_deg) / 2)
        cx, cy = (width - 1) / 2, (height - 1) / 2
        m = np.array([[f / pixel_aspect, 0, cx], [0, f, cy], [0, 0, 1]])
        source = f"guess ({horizontal_fov_deg:g} deg along the long side)"
        return Camera(width, height, m, source=source, guessed=True)


def _cross(a: ndarray, b: ndarray) -> ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _tilt(tx: float, ty: float) -> ndarray:
    """OpenCV's tilted-sensor homography from angles in radians."""
    r = Rotation.from_euler("xy", (-tx, -ty)).as_matrix()
    return np.array([[r[2, 2], 0, -r[0, 2]], [0, r[2, 2], -r[1, 2]], [0, 0, 1]]) @ r
