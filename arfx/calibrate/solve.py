"""Least squares intrinsics from views of a board, with covariance; and which lens model the
views call for.

Source: Zhang 2000 through cv2.calibrateCamera; covariance: delete-one-view jackknife,
linearised at the solution
(Efron and Stein 1981; Bell and McCaffrey 2002), because the errors of corners in one
picture are not independent (blur, light, a bent board) and sigma^2 (J^T J)^-1, which
assumes that they are, is then too small. The model is the simplest that predicts views it
has not seen as well as the best does: one-standard-error rule (Hastie, Tibshirani and
Friedman, The Elements of Statistical Learning, 7.10) of a cross-validation by view. Leaving
out single corners, or an information criterion that counts corners as independent, favours
models that are too rich.
Cost: 10 ms for 14 views of 54 corners, .1-.3 s for 40 views of 77; (models x folds) times
that for the choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from arfx.calibrate.corners import View
from arfx.core.camera import Camera
from arfx.core.numerics import condition, divide
from arfx.errors import ArfxError, NothingToDoError

FOLDS = 7
# An improvement of the held-out error by less than this is not worth a parameter, however
# certain it is.
LEAST_GAIN = 0.005
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)


COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
# What keeps OpenCV from estimating the coefficients from the first, second, … on.
FIXED = {
    0: cv2.CALIB_FIX_K1,
    1: cv2.CALIB_FIX_K2,
    2: cv2.CALIB_ZERO_TANGENT_DIST,
    4: cv2.CALIB_FIX_K3,
}


class LensModel(NamedTuple):
    """A nested lens model. free : how many of OpenCV's coefficients are estimated, from the
    first on; the others are zero.
    """

    free: int

    @property
    def name(self) -> str:
        names = {0: "pinhole", len(COEFFICIENTS): "rational"}
        return names.get(self.free, " ".join(COEFFICIENTS[: self.free]))

    @property
    def flags(self) -> int:
        rational = cv2.CALIB_RATIONAL_MODEL * (self.free > 5)
        return rational + sum(flag for i, flag in FIXED.items() if i >= self.free)

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("fx", "fy", "cx", "cy", *COEFFICIENTS[: self.free])

    def by_parameters(self, jacobian: np.ndarray) -> np.ndarray:
        """(2n, p) of OpenCV's derivatives of projected points those by `parameters`."""
        return jacobian[:, 6 : 10 + self.free]


MODELS = tuple(map(LensModel, (0, 1, 2, 4, 5, 8)))  # each holds the one before it
FIRST_MODEL = MODELS[2]  # for telling good views from bad ones, before a model is chosen


class Fit(NamedTuple):
    """A least squares solution.

    views : the V views it rests on; rotations, translations : (V, 3) board to camera,
    Rodrigues vectors and metres
    residuals : per view (n, 2) px, found minus predicted; rms_px over both coordinates
    together (as OpenCV counts)
    """

    model: LensModel
    camera: Camera
    views: tuple[View, ...]
    rotations: np.ndarray
    translations: np.ndarray
    residuals: tuple[np.ndarray, ...]

    @property
    def rms_px(self) -> float:
        return rms(np.concatenate(self.residuals))

    @property
    def view_rms_px(self) -> np.ndarray:
        return np.array([rms(r) for r in self.residuals])

    @property
    def values(self) -> np.ndarray:
        c = self.camera
        return np.array([c.fx, c.fy, c.cx, c.cy, *c.distortion[: self.model.free]])


class Uncertainty(NamedTuple):
    """covariance : (p, p) of `model.parameters`: that of independent errors, each parameter's
    deviation enlarged to the jackknife's; independent, jackknife : (p,) standard deviations;
    sigma_px : noise of one coordinate of one corner;
    condition : of the normal matrix with unit diagonal (poses eliminated); inf = something
    cannot be determined
    """

    covariance: np.ndarray
    independent: np.ndarray
    jackknife: np.ndarray
    sigma_px: float
    condition: float

    @property
    def standard_deviations(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def rms(residuals: np.ndarray) -> float:
    """Root mean square length of residuals (n, 2), px; 0 for none."""
    return float(np.sqrt(divide((residuals**2).sum(), len(residuals))))


def fit(views: Sequence[View], model: LensModel) -> Fit:
    """Intrinsics and one pose per view.

    Raises NothingToDoError if they do not determine a camera at all.
    """
    if len(views) < 3:
        raise NothingToDoError(
            f"{len(views)} different views of the board",
            "at least 3 are needed, 15 are good",
        )
    boards = [v.board_m.astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32).reshape(-1, 1, 2) for v in views]
    try:
        _, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(
            boards,
            pixels,
            views[0].size,
            np.eye(3),
            np.zeros(max(5, model.free)),
            flags=model.flags,
            criteria=STOP,
        )
        lens = np.ravel(distortion)[: max(5, model.free)]
        camera = Camera(*views[0].size, matrix, lens)  # refuses what is not finite
    except (cv2.error, ArfxError):
        raise NothingToDoError(
            f"{len(views)} views of the board do not determine a camera",
            "take pictures with the board tilted by 20 to 45 degrees in different"
            " directions",
        ) from None
    r, t = np.reshape(rvecs, (-1, 3)), np.reshape(tvecs, (-1, 3))
    residuals = tuple(
        v.pixels - _projected(v, r[i], t[i], camera) for i, v in enumerate(views)
    )
    return Fit(model, camera, tuple(views), r, t, residuals)


def _projected(
    view: View, rvec: np.ndarray, tvec: np.ndarray, camera: Camera
) -> np.ndarray:
    return cv2.projectPoints(view.board_m, rvec, tvec, camera.matrix, camera.distortion)[
        0
    ].reshape(-1, 2)


def pose_residual(view: View, camera: Camera) -> np.ndarray:
    """Residuals (n, 2) px of a view that the camera was not fitted to: only its pose is.
    Infinite where there is no pose.
    """
    try:
        ok, rvec, tvec = cv2.solvePnP(
            view.board_m, view.pixels, camera.matrix, camera.distortion
        )
    except cv2.error:
        ok = False
    if not ok:
        return np.full(view.pixels.shape, np.inf)
    out = view.pixels - _projected(view, rvec, tvec, camera)
    return np.where(np.isfinite(out), out, np.inf)


def without_pose(by_intrinsics: np.ndarray, by_pose: np.ndarray) -> np.ndarray:
    """What of the intrinsics' derivatives (2n, p) no motion of the board can imitate: the
    projection off `by_pose` (2n, 6).
    """
    # a pose direction of less than 1e-10 does not move the corners at all
    scaled = divide(by_pose, np.linalg.norm(by_pose, axis=0)[None])
    return by_intrinsics - scaled @ np.linalg.lstsq(scaled, by_intrinsics, 1e-10)[0]


def information(fitted: Fit) -> list[np.ndarray]:
    """Per view, J (2n, p): sum of J^T J is the normal matrix of the intrinsics with all
    poses eliminated.
    """
    out = []
    for view, rvec, tvec in zip(
        fitted.views, fitted.rotations, fitted.translations, strict=True
    ):
        j = cv2.projectPoints(
            view.board_m, rvec, tvec, fitted.camera.matrix, fitted.camera.distortion
        )[1]
        out.append(without_pose(fitted.model.by_parameters(j), j[:, :6]))
    return out


def uncertainty(fitted: Fit) -> Uncertainty:
    """How far the intrinsics can be off, from the residuals and the geometry.

    See the header for the method.
    """
    js = information(fitted)
    p, n = len(fitted.model.parameters), len(js)
    # unit diagonal, so that pixels, and distortion coefficients of 1e-3, weigh alike in the
    # inverses
    total = np.zeros((p, p)) + sum(j.T @ j for j in js)
    scale = divide(1.0, np.sqrt(np.diag(total)), where_zero=1.0)
    js = [j * scale for j in js]
    normal = total * np.outer(scale, scale)
    points = sum(len(r) for r in fitted.residuals)
    degrees = max(1, 2 * points - p - 6 * n)
    sigma = float(np.sqrt(sum((r**2).sum() for r in fitted.residuals) / degrees))
    independent = sigma**2 * _inverse(normal)
    steps = np.array(
        [
            _inverse(normal - j.T @ j) @ (j.T @ r.ravel())
            for j, r in zip(js, fitted.residuals, strict=True)
        ]
    )
    steps -= steps.mean(0)
    a = np.sqrt(np.diag(independent))
    b = np.sqrt((n - 1) / n * (steps**2).sum(0))
    # the correlations of independent errors: with few views the jackknife's are blind to some
    # directions
    factor = scale * np.maximum(1.0, divide(b, a))
    covariance = independent * np.outer(factor, factor)
    return Uncertainty(covariance, a * scale, b * scale, sigma, condition(normal))


def _inverse(normal: np.ndarray) -> np.ndarray:
    """Of a normal matrix of unit diagonal.

    What rounding hides counts as hardly known: a pseudo-inverse would call it certain.
    """
    values, vectors = np.linalg.eigh(normal)
    return (vectors / np.maximum(values, len(values) * np.finfo(float).eps)) @ vectors.T


class Evidence(NamedTuple):
    """One model's showing. held_out_px : (V,) rms per view, predicted from the other views,
    in the order of the views;
    rejected : why it cannot be used, or empty"""

    model: LensModel
    fitted: Fit | None
    held_out_px: np.ndarray
    rejected: str = ""

    @property
    def held_out_rms_px(self) -> float:
        return float(np.sqrt(np.mean(self.held_out_px**2)))


def choose_model(views: Sequence[View]) -> tuple[Evidence, list[Evidence]]:
    """The chosen model's evidence, and that of all.

    Raises NothingToDoError if no model can be fitted.
    """
    table = [cross_validate(views, m) for m in MODELS]
    usable = [e for e in table if not e.rejected]
    if not usable:
        raise NothingToDoError(
            f"no lens model fits the {len(views)} views: {table[0].rejected}",
            "take pictures with the board tilted by 20 to 45 degrees in different"
            " directions",
        )
    best = min(usable, key=lambda e: e.held_out_rms_px)
    # its mean squared held-out error is higher by no more than one standard error of the
    # difference
    for simple in usable:
        difference = simple.held_out_px**2 - best.held_out_px**2
        error = np.std(difference, ddof=1) / np.sqrt(len(difference))
        if np.mean(difference) <= max(error, LEAST_GAIN * 2 * best.held_out_rms_px**2):
            return simple, table
    return best, table


def cross_validate(views: Sequence[View], model: LensModel) -> Evidence:
    """Fit a model to all views and predict each from the others."""
    held_out = np.full(len(views), np.inf)
    try:
        fitted = fit(views, model)
        # a fold must leave at least 3 views
        folds = min(FOLDS, len(views)) if len(views) > 3 else 0
        for k in range(folds):
            out = range(k, len(views), folds)
            camera = fit([v for i, v in enumerate(views) if i not in out], model).camera
            for i in out:
                held_out[i] = rms(pose_residual(views[i], camera))
    except NothingToDoError as e:
        return Evidence(model, None, held_out, e.message)
    # too few views to hold one out: residuals times sqrt(N / degrees of freedom), what
    # fitting took away
    if not folds:
        numbers = 2 * sum(len(r) for r in fitted.residuals)
        used = len(fitted.model.parameters) + 6 * len(fitted.views)
        held_out = fitted.view_rms_px * float(
            np.sqrt(divide(numbers, max(1, numbers - used)))
        )
    if not one_to_one(fitted.camera):
        return Evidence(model, fitted, held_out, "its distortion folds the picture over")
    if not np.isfinite(held_out).all():
        return Evidence(
            model, fitted, held_out, "a view that it was not fitted to has no pose"
        )
    return Evidence(model, fitted, held_out)


def one_to_one(camera: Camera) -> bool:
    """Whether every pixel of the picture has one viewing direction: the distortion
    does not fold inside.
    """
    return bool(np.isfinite(camera.normalised(grid_pixels(camera, 25, 25))).all())


def grid_pixels(camera: Camera, across: int, down: int) -> np.ndarray:
    """(n, 2) pixels spread evenly over the picture, borders included."""
    x, y = np.meshgrid(
        np.linspace(0, camera.width - 1, across), np.linspace(0, camera.height - 1, down)
    )
    return np.stack([x.ravel(), y.ravel()], -1)
