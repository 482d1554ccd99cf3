"""Which views take part. Of a video: sharp frames, and the most varied of the views in
them. Copies are dropped, views that disagree with the others are rejected, then single
wrong corners.

Rejection starts from the subset of views that agrees best with the most others (as in
RANSAC), so that some views of another board or camera cannot drag the solution to
themselves first."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

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
# of a view; one that would lose more stays as it is, for `reject_views` to judge
MOST_CORNERS = 0.1


class Rejected(NamedTuple):
    """A view left out. reason : in words, with figures"""

    name: str
    reason: str


def drop_copies(views: Sequence[View]) -> tuple[list[View], list[Rejected]]:
    """Keep of each group of equal views the sharpest."""
    kept, dropped = list[View](), list[Rejected]()
    for view in sorted(views, key=lambda v: -v.sharpness):
        moved = [_moved_px(view, k) for k in kept]
        nearest = min(moved, default=np.inf)
        if nearest < SAME_VIEW_FRACTION * view.size[0]:
            twin = kept[moved.index(nearest)].name
            reason = f"the same view as {twin}: its corners moved {nearest:.2f} px"
            dropped.append(Rejected(view.name, reason))
        else:
            kept.append(view)
    return sorted(kept, key=list(views).index), dropped


def _moved_px(a: View, b: View) -> float:
    """Root mean square distance of the corners both have; inf if they share fewer than
    half. Half turns count as equal.
    """
    shared, ia, ib = np.intersect1d(a.ids, b.ids, return_indices=True)
    if 2 * len(shared) < max(len(a.ids), len(b.ids)):
        return float("inf")
    moved = rms(a.pixels[ia] - b.pixels[ib])
    if len(shared) == len(a.ids) == len(b.ids):
        moved = min(moved, rms(a.pixels[ia] - b.pixels[ib][::-1]))
    return moved


def reject_views(
    views: Sequence[View], model: LensModel = FIRST_MODEL
) -> tuple[Fit, list[Rejected]]:
    """The fit of the views that agree, and the views that do not.

    Raises NothingToDoError if they do not determine a camera.
    """

    def errors_by(some: Sequence[View]) -> ndarray:
        """(V,) how far each view misses with the camera of some, px."""
        try:
            camera = fit(some, model).camera
        except NothingToDoError:
            return np.full(len(views), 1e9)  # farther than any
        return np.array([typical_px(pose_residual(v, camera)) for v in views])

    rng = np.random.default_rng(0)
    tries = [
        errors_by([views[i] for i in rng.permutation(len(views))[:SUBSET_SIZE]])
        for _ in range(SUBSETS)
    ]
    # A majority must agree; what the others say does not matter. A small subset must be
    # clearly better: its intrinsics are weaker, so equal agreement speaks for all views.
    tries.append(0.7 * errors_by(views))
    errors = min(tries, key=lambda found: float(np.quantile(found, 0.6)))
    inside: list[View] = []
    for _ in range(10):
        limit = max(np.sort(errors)[2], rejection_limit_px(errors))  # three at least
        chosen = [v for v, e in zip(views, errors, strict=True) if e <= limit]
        if chosen == inside:
            break
        inside, errors = chosen, errors_by(chosen)
    usual = float(np.median(errors))
    left_out = [
        Rejected(
            v.name,
            f"its corners miss by {e:.2f} px with the camera of the other views, which miss"
            f" by {usual:.2f} px",
        )
        for v, e in zip(views, errors, strict=True)
        if v not in inside
    ]
    return fit(inside, model), left_out


def typical_px(residuals: ndarray) -> float:
    """The rms length of residuals (n, 2) estimated from their median (of a round Gaussian,
    median of squares = ln 2 x mean): a few wrong corners do not make a wrong view."""
    return float(np.sqrt(np.median((residuals**2).sum(1)) / np.log(2)))


def drop_corners(fitted: Fit) -> list[View]:
    """The views without corners that miss by far.

    One by one, the worst first, with the pose found anew each time: a wrong corner drags
    its neighbours' residuals along."""
    limit = CORNER_RATIO * max(FLOOR_PX, typical_px(np.concatenate(fitted.residuals)))

    def trimmed(view: View, residual: ndarray) -> View:
        rest = view
        while (misses := np.linalg.norm(residual, axis=1)).max() > limit:
            if len(rest.ids) <= (1 - MOST_CORNERS) * len(view.ids):
                return view
            rest = rest.without(int(misses.argmax()))
            residual = pose_residual(rest, fitted.camera)
        return rest

    return [*map(trimmed, fitted.views, fitted.residuals)]


def rejection_limit_px(view_rms_px: ndarray) -> float:
    """Largest rms of a view that agrees with views of these rms."""
    median = float(np.median(view_rms_px))
    spread = 1.4826 * float(np.median(np.abs(view_rms_px - median)))
    return max(FLOOR_PX, REJECT_RATIO * median, median + REJECT_SIGMA * spread)


def picture_sharpness(gray: ndarray) -> float:
    """Variance of the Laplacian of the picture at about 640 px width; only comparable
    between frames of one clip.
    """
    share = 1 / max(1, round(gray.shape[1] / 640))
    small = cv2.resize(gray, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_32F).var())


def sharpest_of_each(
    frames: Iterable[tuple[str, ndarray]], group: int
) -> Iterator[tuple[str, ndarray]]:
    """Of every `group` frames (name, gray) in a row the sharpest, so that 1 in `group` is
    searched for the board.
    """
    number = itertools.count()
    for _, some in itertools.groupby(frames, lambda _: next(number) // group):
        yield max(some, key=lambda frame: picture_sharpness(frame[1]))


def most_varied(views: Sequence[View], keep: int) -> list[View]:
    """At most `keep` sharp views whose corners lie farthest from each other's, in their order
    (farthest point selection).
    """
    if len(views) <= keep:
        return list(views)
    usual = float(np.median([v.sharpness for v in views]))
    sharp = [v for v in views if v.sharpness >= BLUR_FRACTION * usual]
    chosen = [max(sharp, key=lambda v: v.sharpness * len(v.ids))]
    nearest = np.full(len(sharp), np.inf)
    while len(chosen) < min(keep, len(sharp)):
        nearest = np.minimum(nearest, [_moved_px(v, chosen[-1]) for v in sharp])
        chosen.append(sharp[nearest.argmax()])
    return [v for v in sharp if v in chosen]
