"""Which views take part. Of a video: sharp frames, and the most varied of the views in
them. Copies are dropped, views that disagree with the others are rejected, then single
wrong corners.

Rejection starts from the subset of views that agrees best with the most others (as in
RANSAC), so that some views of another board or camera cannot drag the solution to
themselves first."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from arfx.calibrate.corners import View
from arfx.calibrate.solve import FIRST_MODEL, Fit, LensModel, fit, pose_residual, rms
from arfx.errors import NothingToDoError

# Two views whose corners lie within this share of the picture's width of each other are one
# view seen twice: they would count the same noise, and the same bent board, as if they were
# independent. 2 px at 640.
SAME_VIEW_FRACTION = 0.003
# A view is rejected when its rms is this many robust standard deviations above the median
# of all, and twice the median. With views that differ only by chance (n corners each, rms
# spread about 1/sqrt(2n)) neither is reached in 10,000 views.
REJECT_SIGMA, REJECT_RATIO = 5.0, 2.0
# below this a view is fine whatever the others do: corner noise of the best pictures
FLOOR_PX = 0.05
SUBSETS, SUBSET_SIZE = 12, 5
# A corner is left out when it misses by this many times the typical miss: chance does so
# once in exp(20) = 5e8 corners.
CORNER_RATIO = 4.5
# views with less than this share of the median corner sharpness are left out: blur moves
# corners
BLUR_FRACTION = 0.7
MOST_CORNERS = (
    0.1  # of a view; one that would lose more stays as it is, for `reject_views` to judge
)


class Rejected(NamedTuple):
    """A view left out. reason : in words, with figures"""

    name: str
    reason: str


def drop_copies(views: Sequence[View]) -> tuple[list[View], list[Rejected]]:
    """Keep of each group of equal views the sharpest."""
    kept: dict[int, View] = {}
    dropped: list[Rejected] = []
    for i, view in sorted(enumerate(views), key=lambda numbered: -numbered[1].sharpness):
        moved, twin = min(
            ((_moved_px(view, k), k.name) for k in kept.values()), default=(np.inf, "")
        )
        if moved < SAME_VIEW_FRACTION * view.size[0]:
            reason = f"the same view as {twin}: its corners moved {moved:.2f} px"
            dropped.append(Rejected(view.name, reason))
        else:
            kept[i] = view
    return [kept[i] for i in sorted(kept)], dropped


def _moved_px(a: View, b: View) -> float:
    """Root mean square distance of the corners both have; inf if they share fewer than
    half. Half turns count as equal.
    """
    shared, ia, ib = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(shared) < max(len(a.ids), len(b.ids)) / 2:
        return float("inf")
    straight = rms(a.pixels[ia] - b.pixels[ib])
    return (
        min(straight, rms(a.pixels[ia] - b.pixels[ib][::-1]))
        if len(shared) == len(a.ids) == len(b.ids)
        else straight
    )


def reject_views(
    views: Sequence[View], model: LensModel = FIRST_MODEL
) -> tuple[Fit, list[Rejected]]:
    """The fit of the views that agree, and the views that do not.

    Raises NothingToDoError if no three views agree.
    """
    subsets = [views]
    if len(views) > SUBSET_SIZE:
        rng = np.random.default_rng(0)
        subsets += [
            [views[i] for i in rng.choice(len(views), SUBSET_SIZE, replace=False)]
            for _ in range(SUBSETS)
        ]
    # A majority must agree; what the others say does not matter. A small subset must be
    # clearly better: its intrinsics are weaker, so equal agreement speaks for all views.
    errors, best = np.zeros(len(views)), float("inf")
    for subset in subsets:
        with contextlib.suppress(NothingToDoError):
            found = _errors(views, fit(subset, model))
            score = float(np.quantile(found, 0.6)) * (0.7 if subset is views else 1.0)
            if score < best:
                errors, best = found, score
    inside: list[View] = []
    fitted = None
    for _ in range(10):
        limit = rejection_limit_px(errors)
        chosen = [v for v, e in zip(views, errors, strict=True) if e <= limit]
        if len(chosen) < 3 or chosen == inside:
            if fitted is not None:
                break
            chosen = list(views)
        inside = chosen
        fitted = fit(inside, model)
        errors = _errors(views, fitted)
    assert fitted is not None
    usual = float(np.median([typical_px(r) for r in fitted.residuals]))
    left_out = [
        Rejected(
            v.name,
            f"its corners miss by {e:.2f} px with the camera of the other views, which miss"
            f" by {usual:.2f} px",
        )
        for v, e in zip(views, errors, strict=True)
        if v not in inside
    ]
    return fitted, left_out


def _errors(views: Sequence[View], fitted: Fit) -> np.ndarray:
    """(V,) how far each view misses with a camera, px."""
    return np.array([typical_px(pose_residual(v, fitted.camera)) for v in views])


def typical_px(residuals: np.ndarray) -> float:
    """The rms length of residuals (n, 2) estimated from their median (of a round Gaussian,
    median of squares = ln 2 x mean): a few wrong corners do not make a wrong view."""
    return float(np.sqrt(np.median((residuals**2).sum(1)) / np.log(2)))


def drop_corners(fitted: Fit) -> tuple[list[View], int]:
    """The views without corners that miss by far, and how many those were.

    One by one, the worst first, with the pose found anew each time: a wrong corner drags
    its neighbours' residuals along."""
    limit = CORNER_RATIO * max(FLOOR_PX, typical_px(np.concatenate(fitted.residuals)))
    out, dropped = [], 0
    for view, residual in zip(fitted.views, fitted.residuals, strict=True):
        trimmed = view
        while (misses := np.linalg.norm(residual, axis=1)).max() > limit:
            kept = np.arange(len(misses)) != misses.argmax()
            arrays = {name: getattr(trimmed, name) for name in View.OF_CORNERS}
            trimmed = replace(trimmed, **{k: a[kept] for k, a in arrays.items()})
            if len(view.ids) - len(trimmed.ids) > MOST_CORNERS * len(view.ids):
                trimmed = view
                break
            residual = pose_residual(trimmed, fitted.camera)
        dropped += len(view.ids) - len(trimmed.ids)
        out.append(trimmed)
    return out, dropped


def rejection_limit_px(view_rms_px: np.ndarray) -> float:
    """Largest rms of a view that agrees with views of these rms."""
    median = float(np.median(view_rms_px))
    spread = 1.4826 * float(np.median(np.abs(view_rms_px - median)))
    return max(FLOOR_PX, REJECT_RATIO * median, median + REJECT_SIGMA * spread)


def picture_sharpness(gray: np.ndarray) -> float:
    """Variance of the Laplacian of the picture at about 640 px width; only comparable
    between frames of one clip.
    """
    factor = max(1, round(gray.shape[1] / 640))
    small = cv2.resize(
        gray, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA
    )
    return float(cv2.Laplacian(small, cv2.CV_32F).var())


def sharpest_of_each(
    frames: Iterable[tuple[str, np.ndarray]], group: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Of every `group` frames (name, gray) in a row the sharpest, so that 1 in `group` is
    searched for the board.
    """
    groups = itertools.groupby(enumerate(frames), lambda numbered: numbered[0] // group)
    for _, some in groups:
        yield max((f for _, f in some), key=lambda f: picture_sharpness(f[1]))


def most_varied(views: Sequence[View], keep: int) -> list[View]:
    """At most `keep` sharp views that differ most in place, size and tilt, in their order
    (farthest point selection).
    """
    if len(views) <= keep:
        return list(views)
    usual = float(np.median([v.sharpness for v in views]))
    sharp = [v for v in views if v.sharpness >= BLUR_FRACTION * usual]
    if len(sharp) <= keep:
        return sharp
    features = np.array([_features(v) for v in sharp])
    chosen = [int(np.argmax([v.sharpness * len(v.ids) for v in sharp]))]
    nearest = np.linalg.norm(features - features[chosen[0]], axis=1)
    while len(chosen) < keep:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(
            nearest, np.linalg.norm(features - features[chosen[-1]], axis=1)
        )
    return [sharp[i] for i in sorted(chosen)]


def _features(view: View) -> np.ndarray:
    """Place (2), size, and foreshortening (2) of a board, each about 1 over its range.

    Foreshortening: the perspective terms of the homography times the board's size; 0 facing
    the camera.
    """
    xy = view.board_m[:, :2] - view.board_m[:, :2].mean(0)
    h = cv2.findHomography(xy / np.ptp(xy, axis=0).max(), view.pixels)[0]
    h = np.eye(3) if h is None else h
    # turned to the picture's axes, so that a board lying on its side with the same tilt is
    # the same view
    lean = 3 * complex(*h[2, :2]) * np.exp(1j * np.arctan2(h[1, 0], h[0, 0]))
    width, extent = view.size[0], np.ptp(view.pixels, axis=0).max()
    return np.array([*view.pixels.mean(0) / width, extent / width, lean.real, lean.imag])
