"""Which lens model the views call for: the simplest that predicts views it has not seen as well as the best does.

Cross-validation by view: corners of one picture share their errors, so leaving out single corners, or an information
criterion that counts corners as independent, favours models that are too rich.
Source: one-standard-error rule, Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 7.10.
Cost: (models x folds) fits, .5-4 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.calibrate.corners import View
from arfx.calibrate.solve import MODELS, Fit, LensModel, fit, pose_residual, rms
from arfx.core.camera import Camera
from arfx.core.numerics import divide
from arfx.errors import NothingToDoError

FOLDS = 7
# An improvement of the held-out error by less than this is not worth a parameter, however certain it is.
LEAST_GAIN = 0.005


@dataclass(frozen=True, eq=False)
class Evidence:
    """One model's showing. held_out_px : (V,) rms per view, predicted from the other views, in the order of the views;
    rejected : why it cannot be used, or empty"""

    model: LensModel
    fitted: Fit | None
    held_out_px: np.ndarray
    rejected: str = ""

    @property
    def held_out_rms_px(self) -> float:
        return float(np.sqrt(np.mean(self.held_out_px**2)))


def choose_model(views: Sequence[View]) -> tuple[Evidence, list[Evidence]]:
    """The chosen model's evidence, and that of all. Raises NothingToDoError if no model can be fitted."""
    table = [weigh(views, m) for m in MODELS]
    usable = [e for e in table if not e.rejected]
    if not usable:
        raise NothingToDoError(
            f"no lens model fits the {len(views)} views: {table[0].rejected}",
            "take pictures with the board tilted by 20 to 45 degrees in different directions",
        )
    best = min(usable, key=lambda e: e.held_out_rms_px)
    return next(e for e in usable if _as_good(e, best)), table


def _as_good(simple: Evidence, best: Evidence) -> bool:
    """Whether the mean of the squared held-out errors is higher by no more than one standard error of its difference."""
    difference = simple.held_out_px**2 - best.held_out_px**2
    error = float(np.std(difference, ddof=1) / np.sqrt(len(difference))) if len(difference) > 1 else 0.0
    return float(np.mean(difference)) <= max(error, LEAST_GAIN * 2 * best.held_out_rms_px**2)


def weigh(views: Sequence[View], model: LensModel) -> Evidence:
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
    if not folds:
        held_out = fitted.view_rms_px * _inflation(fitted)
    if not one_to_one(fitted.camera):
        return Evidence(model, fitted, held_out, "its distortion folds the picture over")
    if not np.isfinite(held_out).all():
        return Evidence(model, fitted, held_out, "a view that it was not fitted to has no pose")
    return Evidence(model, fitted, held_out)


def _inflation(fitted: Fit) -> float:
    """With too few views to hold one out: residuals times sqrt(N / degrees of freedom), what fitting took away."""
    numbers = 2 * sum(len(r) for r in fitted.residuals)
    used = len(fitted.model.parameters) + 6 * len(fitted.views)
    return float(np.sqrt(divide(numbers, max(1, numbers - used))))


def one_to_one(camera: Camera) -> bool:
    """Whether every pixel on the picture's border has one viewing direction: the distortion does not fold inside."""
    w, h = camera.width, camera.height
    x, y = np.linspace(0, w - 1, 25), np.linspace(0, h - 1, 25)
    border = np.concatenate([np.stack([x, x * 0], -1), np.stack([x, x * 0 + h - 1], -1), np.stack([y * 0, y], -1),
                             np.stack([y * 0 + w - 1, y], -1)])  # fmt: skip
    return bool(np.isfinite(camera.normalised(border)).all())
