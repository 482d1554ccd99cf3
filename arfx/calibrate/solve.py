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

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.calibrate.corners import View
from arfx.core.camera import Camera
from arfx.core.numerics import condition, divide
from arfx.errors import ArfxError, NothingToDoError

FOLDS = 7
# An improvement of the held-out error by less than this is not worth a parameter, however
# certain it is.
LEAST_GAIN = 0.005
TILT_MORE = (
    "take pictures with the board tilted by 20 to 45 degrees in different directions"
)
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)


COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


class LensModel(NamedTuple):
    """free : how many of OpenCV's coefficients are estimated, from the first on; the others
    are zero;  flags : of OpenCV's, which say so
    """

    name: str
    free: int
    flags: int

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("fx", "fy", "cx", "cy", *COEFFICIENTS[: self.free])

    def by_parameters(self, jacobian: ndarray) -> ndarray:
        """(2n, p) of OpenCV's derivatives of projected points those by `parameters`."""
        return jacobian[:, 6 : 10 + self.free]


_RADIAL = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
MODELS = (  # each holds the one before it
    LensModel("pinhole", 0, cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | _RADIAL),
    LensModel("k1", 1, cv2.CALIB_FIX_K2 | _RADIAL),
    LensModel("k1 k2", 2, _RADIAL),
    LensModel("k1 k2 p1 p2", 4, cv2.CALIB_FIX_K3),
    LensModel("k1 k2 p1 p2 k3", 5, 0),
    LensModel("rational", 8, cv2.CALIB_RATIONAL_MODEL),
)
FIRST_MODEL = MODELS[
    2
]  # for telling good views from bad ones, before a model is chosen


class Fit(NamedTuple):
    """A least squares solution.

    views : the V views it rests on; rotations : (V, 3) board to camera, Rodrigues vectors
    residuals : per view (n, 2) px, found minus predicted; derivatives : per view (2n, p) of
    the predicted by the model's parameters, as far as no motion of the board can imitate
    them: sum of J^T J is the normal matrix with all poses eliminated
    """

    model: LensModel
    camera: Camera
    views: tuple[View, ...]
    rotations: ndarray
    residuals: list[ndarray]
    derivatives: list[ndarray]

    @property
    def rms_px(self) -> float:
        """Over both coordinates together (as OpenCV counts)."""
        return rms(np.concatenate(self.residuals))

    @property
    def noise_px(self) -> float:
        """Standard deviation of one coordinate of one corner, if errors are independent."""
        points = sum(map(len, self.residuals))
        free = 2 * points - len(self.model.parameters) - 6 * len(self.views)
        return self.rms_px * float(np.sqrt(points / max(1, free)))

    @property
    def view_rms_px(self) -> ndarray:
        return np.array([rms(r) for r in self.residuals])

    @property
    def values(self) -> ndarray:
        c = self.camera
        return np.array([c.fx, c.fy, c.cx, c.cy, *c.distortion[: self.model.free]])


class Uncertainty(NamedTuple):
    """covariance : (p, p) of `model.parameters`: that of independent errors, each parameter's
    deviation enlarged to the jackknife's;
    condition : of the normal matrix with unit diagonal (poses eliminated); inf = something
    cannot be determined
    """

    covariance: ndarray
    condition: float

    @property
    def standard_deviations(self) -> ndarray:
        return np.sqrt(np.diag(self.covariance))


def rms(residuals: ndarray) -> float:
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
    pixels = [v.pixels.astype(np.float32) for v in views]
    try:
        _, matrix, distortion, rotations, translations = cv2.calibrateCamera(
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
            TILT_MORE,
        ) from None
    residuals, derivatives = [], []
    for view, rvec, tvec in zip(views, rotations, translations, strict=True):
        predicted, jacobian = cv2.projectPoints(
            view.board_m, rvec, tvec, camera.matrix, camera.distortion
        )
        residuals.append(view.pixels - predicted[:, 0])
        own = model.by_parameters(jacobian)
        derivatives.append(without_pose(own, jacobian[:, :6]))
    turns = np.reshape(rotations, (-1, 3))
    return Fit(model, camera, tuple(views), turns, residuals, derivatives)


def pose_residual(view: View, camera: Camera) -> ndarray:
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
    predicted, _ = cv2.projectPoints(
        view.board_m, rvec, tvec, camera.matrix, camera.distortion
    )
    out = view.pixels - predicted[:, 0]
    return np.where(np.isfinite(out), out, np.inf)


def without_pose(by_intrinsics: ndarray, by_pose: ndarray) -> ndarray:
    """What of the intrinsics' derivatives (2n, p) no motion of the board can imitate: the
    projection off `by_pose` (2n, 6).
    """
    # a pose direction of less than 1e-10 does not move the corners at all
    scaled = divide(by_pose, np.linalg.norm(by_pose, axis=0)[None])
    return by_intrinsics - scaled @ np.linalg.lstsq(scaled, by_intrinsics, 1e-10)[0]


def uncertainty(fitted: Fit) -> Uncertainty:
    """How far the intrinsics can be off, from the residuals and the geometry.

    See the header for the method.
    """
    # unit diagonal, so that pixels, and distortion coefficients of 1e-3, weigh alike in the
    # inverses
    size = np.linalg.norm(np.concatenate(fitted.derivatives), axis=0)
    scale = divide(1.0, size, where_zero=1.0)
    js = [j * scale for j in fitted.derivatives]
    normal = np.sum([j.T @ j for j in js], axis=0)
    independent = fitted.noise_px**2 * _inverse(normal)
    steps = [
        _inverse(normal - j.T @ j) @ (j.T @ r.ravel())
        for j, r in zip(js, fitted.residuals, strict=True)
    ]
    jackknife = np.std(steps, axis=0) * np.sqrt(len(steps) - 1)
    # the correlations of independent errors: with few views the jackknife's are blind to some
    # directions
    larger = np.maximum(1.0, divide(jackknife, np.sqrt(np.diag(independent))))
    covariance = independent * np.outer(scale * larger, scale * larger)
    return Uncertainty(covariance, condition(normal))


def _inverse(normal: ndarray) -> ndarray:
    """Of a normal matrix of unit diagonal.

    What rounding hides counts as hardly known: a pseudo-inverse would call it certain.
    """
    values, vectors = np.linalg.eigh(normal)
    return (
        vectors / np.maximum(values, len(values) * np.finfo(float).eps)
    ) @ vectors.T


class Evidence(NamedTuple):
    """One model's showing. held_out_px : (V,) rms per view, predicted from the other views,
    in the order of the views;
    rejected : why it cannot be used, or empty"""

    model: LensModel
    fitted: Fit | None
    held_out_px: ndarray
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
            TILT_MORE,
        )
    best = min(usable, key=lambda e: e.held_out_rms_px)
    # its mean squared held-out error is higher by no more than one standard error of the
    # difference
    for simple in usable:
        difference = simple.held_out_px**2 - best.held_out_px**2
        error = np.std(difference, ddof=1) / np.sqrt(len(difference))
        if np.mean(difference) <= max(
            error, LEAST_GAIN * 2 * best.held_out_rms_px**2
        ):
            return simple, table
    return best, table


def cross_validate(views: Sequence[View], model: LensModel) -> Evidence:
    """Fit a model to all views and predict each from the others."""
    held_out = np.full(len(views), np.inf)
    folds = min(FOLDS, len(views))
    try:
        fitted = fit(views, model)
        if folds == 3:  # none can be held out: residuals, and what fitting took away
            held_out[:] = fitted.noise_px * np.sqrt(2)
        for k in range(folds) if folds > 3 else ():
            others = [v for i, v in enumerate(views) if i % folds != k]
            camera = fit(others, model).camera
            held_out[k::folds] = [
                rms(pose_residual(v, camera)) for v in views[k::folds]
            ]
    except NothingToDoError as e:
        return Evidence(model, None, held_out, e.message)
    rejected = ""
    if not one_to_one(fitted.camera):
        rejected = "its distortion folds the picture over"
    elif not np.isfinite(held_out).all():
        rejected = "a view that it was not fitted to has no pose"
    return Evidence(model, fitted, held_out, rejected)


def one_to_one(camera: Camera) -> bool:
    """Whether every pixel of the picture has one viewing direction: the distortion
    does not fold inside.
    """
    return bool(np.isfinite(camera.normalised(grid_pixels(camera, 25, 25))).all())


def grid_pixels(camera: Camera, across: int, down: int) -> ndarray:
    """(n, 2) pixels spread evenly over the picture, borders included."""
    x = np.linspace(0, camera.width - 1, across)
    y = np.linspace(0, camera.height - 1, down)
    return np.dstack(np.meshgrid(x, y)).reshape(-1, 2)
