"""Which views may take part: copies are dropped, views that disagree with the others are rejected, then single wrong corners.

Rejection starts from the subset of views that agrees best with the most others (as in RANSAC), so that some views of another
board or camera cannot drag the solution to themselves first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from arfx.calibrate.corners import View
from arfx.calibrate.solve import FIRST_MODEL, Fit, LensModel, fit, pose_residual, rms
from arfx.errors import NothingToDoError

# Two views whose corners lie within this share of the picture's width of each other are one view seen twice: they would count
# the same noise, and the same bent board, as if they were independent. 2 px at 640.
SAME_VIEW_SHARE = 0.003
# A view is rejected when its rms is this many robust standard deviations above the median of all, and twice the median. With
# views that differ only by chance (n corners each, rms spread about 1/sqrt(2n)) neither is reached in 10,000 views.
REJECT_SIGMA, REJECT_RATIO = 5.0, 2.0
FLOOR_PX = 0.05  # below this a view is fine whatever the others do: corner noise of the best pictures
SUBSETS, SUBSET_SIZE = 12, 5
# A corner is left out when it misses by this many times the typical miss: chance does so once in exp(20) = 5e8 corners.
CORNER_RATIO = 4.5
MOST_CORNERS = 0.1  # of a view; one that would lose more stays as it is, for `reject_views` to judge


@dataclass(frozen=True, slots=True)
class Rejected:
    """A view left out. reason : in words, with figures"""

    name: str
    reason: str


def drop_copies(views: Sequence[View]) -> tuple[list[View], list[Rejected]]:
    """Keep of each group of equal views the sharpest."""
    kept: list[View] = []
    dropped: list[Rejected] = []
    for view in sorted(views, key=lambda v: -v.sharpness):
        twin = next((k for k in kept if _moved_px(view, k) < SAME_VIEW_SHARE * view.size[0]), None)
        if twin is None:
            kept.append(view)
        else:
            moved = _moved_px(view, twin)
            dropped.append(Rejected(view.name, f"the same view as {twin.name}: its corners moved {moved:.2f} px"))
    order = {id(v): i for i, v in enumerate(views)}
    return sorted(kept, key=lambda v: order[id(v)]), dropped


def _moved_px(a: View, b: View) -> float:
    """Root mean square distance of the corners both have; inf if they share fewer than half. Half turns count as equal."""
    shared, ia, ib = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(shared) < max(len(a.ids), len(b.ids)) / 2:
        return float("inf")
    straight = rms(a.pixels[ia] - b.pixels[ib])
    return min(straight, rms(a.pixels[ia] - b.pixels[ib][::-1])) if len(shared) == len(a.ids) == len(b.ids) else straight


def reject_views(views: Sequence[View], model: LensModel = FIRST_MODEL) -> tuple[Fit, list[Rejected]]:
    """The fit of the views that agree, and the views that do not.

    Raises NothingToDoError if no three views agree.
    """
    start = _most_agreed(views, model)
    inside = [v for v in views if start is None or v in start]
    fitted = fit(inside, model)
    for _ in range(10):
        errors = np.array([typical_px(pose_residual(v, fitted.camera)) for v in views])
        limit = rejection_limit_px(np.array([typical_px(r) for r in fitted.residuals]))
        chosen = [v for v, e in zip(views, errors, strict=True) if e <= limit]
        if len(chosen) < 3:
            break
        if chosen == inside:
            break
        inside = chosen
        fitted = fit(inside, model)
    errors = np.array([typical_px(pose_residual(v, fitted.camera)) for v in views])
    usual = float(np.median([typical_px(r) for r in fitted.residuals]))
    left_out = [
        Rejected(v.name, f"its corners miss by {e:.2f} px with the camera of the other views, which miss by {usual:.2f} px")
        for v, e in zip(views, errors, strict=True)
        if v not in inside
    ]
    return fitted, left_out


def typical_px(residuals: np.ndarray) -> float:
    """The rms length of residuals (n, 2) as their median tells it (of a round Gaussian, median of squares = ln 2 x mean):
    a few wrong corners do not make a wrong view."""
    return float(np.sqrt(np.median((residuals**2).sum(1)) / np.log(2)))


def drop_corners(fitted: Fit) -> tuple[list[View], int]:
    """The views without corners that miss by far, and how many those were.

    One by one, the worst first, with the pose found anew each time: a wrong corner drags its neighbours' residuals along.
    """
    limit = CORNER_RATIO * max(FLOOR_PX, typical_px(np.concatenate(fitted.residuals)))
    out, dropped = [], 0
    for view, residual in zip(fitted.views, fitted.residuals, strict=True):
        kept = np.ones(len(view.ids), bool)
        trimmed = view
        while (misses := np.linalg.norm(residual, axis=1)).max() > limit:
            kept[np.flatnonzero(kept)[misses.argmax()]] = False
            trimmed = replace(view, ids=view.ids[kept], board_m=view.board_m[kept], pixels=view.pixels[kept])
            if (~kept).sum() > MOST_CORNERS * len(kept):
                kept[:] = True
                break
            residual = pose_residual(trimmed, fitted.camera)
        if kept.all():
            out.append(view)
            continue
        dropped += int((~kept).sum())
        out.append(replace(trimmed, alternative=None if view.alternative is None else view.alternative[kept]))
    return out, dropped


def rejection_limit_px(view_rms_px: np.ndarray) -> float:
    """Largest rms of a view that agrees with views of these rms."""
    median = float(np.median(view_rms_px))
    spread = 1.4826 * float(np.median(np.abs(view_rms_px - median)))
    return max(FLOOR_PX, REJECT_RATIO * median, median + REJECT_SIGMA * spread)


def _most_agreed(views: Sequence[View], model: LensModel) -> list[View] | None:
    """The views that the best of some small subsets agrees with; None if all views together are as good."""
    if len(views) <= SUBSET_SIZE:
        return None
    rng = np.random.default_rng(0)
    candidates: list[Sequence[View]] = [views]
    candidates += [[views[i] for i in rng.choice(len(views), SUBSET_SIZE, replace=False)] for _ in range(SUBSETS)]
    best, best_score, best_index = None, float("inf"), 0
    for index, subset in enumerate(candidates):
        try:
            camera = fit(subset, model).camera
        except NothingToDoError:
            continue
        errors = np.array([typical_px(pose_residual(v, camera)) for v in views])
        score = float(np.quantile(errors, 0.6))  # a majority must agree; what the others say does not matter
        # a small subset must be clearly better: its intrinsics are weaker, so equal agreement speaks for all views
        if score < best_score * (1.0 if best_index else 0.7) or best is None:
            best, best_score, best_index = errors, score, index
    if best is None or best_index == 0:
        return None
    limit = max(FLOOR_PX, 3.0 * float(np.quantile(best, 0.3)))
    agreed = [v for v, e in zip(views, best, strict=True) if e <= limit]
    return agreed if len(agreed) >= 3 else None
