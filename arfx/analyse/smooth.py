"""Smooths the poses of one shot with past and future, in the metric of the measurement.

What is minimised is not a distance between poses but the misfit of the marker corners in picture pixels plus the
unlikeliness of the motion: a direction that the corners hardly fix (the tilt of a frontal marker) is filled in from
the neighbours, one that they fix well (its place in the picture) is left alone, so nothing swims. Gauss-Newton on
SE(3), linearised anew in every pass; each pass is one RTS smoother (chain.py).

The motion's noise is learned from the clip by expectation-maximisation, per axis and with a time window, so that a
marker at rest stands rock-steady in the same clip in which it moves fast at another time.
Axes: rotation about the camera's x, y, z; the place of the markers' centre as x/z, y/z and ln z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.analyse.chain import ChainSolution, Links, noise_moments, solve_chain
from arfx.analyse.geometry import Observed, huber_cost, residuals, view_jacobian
from arfx.core.pose import rotation_from_rotvec, rotvec_from_rotation, skew

LEARNING, FINAL = 12, 4  # passes that learn the motion's noise, and at most so many with it held
WINDOW_S = 0.25  # standard deviation of the window in which the motion's noise is one
WHOLE_CLIP_SHARE = 0.05  # weight of the whole clip's noise in each window: holds where a window has few frames
# Axes whose noise is one number: turning about the picture's two axes, about the line of sight; sideways; distance.
_GROUPS = ((0, 1), (2,), (3, 4), (5,))
# Least density of noise, (rad, 1)^2 / s^3: an hour's drift of 1e-4 rad; keeps a perfectly still clip regular.
_FLOOR = 1e-15
_CEILING = 1e4


@dataclass(frozen=True)
class Smoothed:
    """rotation (n, 3, 3), translation_m (n, 3), covariance (n, 6, 6) of the left perturbation [rad, m] in the camera
    frame; density (4,) learned noise, median over the shot, of the groups turn, roll, sideways, distance."""

    rotation: np.ndarray
    translation_m: np.ndarray
    covariance: np.ndarray
    density: np.ndarray


def smooth_poses(
    rotation: np.ndarray, translation: np.ndarray, seen: Observed, times_s: np.ndarray, strength: float = 1.0
) -> Smoothed:
    """Smooth n frames of one shot.

    rotation, translation : start, also in frames without corners (any sensible in-between)
    seen : corners, weight 0 where none;  times_s : (n,) increasing;  strength : factor on the time scale, > 0
    """
    rotation, translation = rotation.copy(), translation.copy()
    n = len(rotation)
    on = seen.weight > 0
    centre = seen.points_m[on].mean(0)
    dt = np.maximum(np.diff(times_s), 1e-4)
    density = _first_guess(rotation, translation, seen, dt, centre)
    solution: ChainSolution | None = None
    for k in range(LEARNING + FINAL):
        # the motion's noise is learned as it is; only then is it taken for smaller or larger than that
        used = density if k < LEARNING else np.clip(density / strength**3, _FLOOR, _CEILING)
        links = _links(rotation, translation, centre, dt, used)
        solution = solve_chain(*_measurement(rotation, translation, seen, centre), links)
        step = solution.mean[:, :6]
        limit = min(1.0, 0.3 / max(float(np.abs(step[:, :3]).max()), 1e-12))  # so far linearisation holds
        rotation, translation = _moved(rotation, translation, step * limit, centre)
        if k < LEARNING - 1:
            density = _relearned(density, noise_moments(solution, links), times_s)
        elif k >= LEARNING and np.abs(step).max() < 1e-8:
            break
    assert solution is not None
    to_left = _left_from_axes(rotation, translation, centre)
    covariance = to_left @ solution.covariance[:, :6, :6] @ np.swapaxes(to_left, 1, 2)
    middle = np.array([np.median(density[:, list(group)]) for group in _GROUPS]) if n > 1 else np.zeros(len(_GROUPS))
    return Smoothed(rotation, translation, covariance, middle)


def _place(rotation: np.ndarray, translation: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre in camera coordinates (n, 3) and as x/z, y/z, ln z."""
    p = rotation @ centre + translation
    z = np.maximum(p[:, 2], 1e-4)
    return p, np.stack([p[:, 0] / z, p[:, 1] / z, np.log(z)], -1)


def _place_jacobian(p: np.ndarray) -> np.ndarray:
    """(n, 3, 3) of the camera point with respect to x/z, y/z, ln z."""
    out = np.zeros((len(p), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = p[:, 2]
    out[:, :, 2] = p
    return out


def _left_from_axes(rotation: np.ndarray, translation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(n, 6, 6) from a step in this module's axes to the left perturbation of the pose."""
    p, _ = _place(rotation, translation, centre)
    out = np.zeros((len(p), 6, 6))
    out[:, :3, :3] = np.eye(3)
    out[:, 3:, :3] = skew(p)
    out[:, 3:, 3:] = _place_jacobian(p)
    return out


def _moved(rotation: np.ndarray, translation: np.ndarray, step: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    _, place = _place(rotation, translation, centre)
    place = place + step[:, 3:]
    z = np.exp(place[:, 2])
    p = np.stack([place[:, 0] * z, place[:, 1] * z, z], -1)
    turned = rotation_from_rotvec(step[:, :3]) @ rotation
    return turned, p - turned @ centre


def _measurement(
    rotation: np.ndarray, translation: np.ndarray, seen: Observed, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Information (n, 6, 6) and right-hand side (n, 6) of the corners, linearised here."""
    p, _ = _place(rotation, translation, centre)
    arm = np.einsum("nij,npj->npi", rotation, seen.points_m - centre)
    view = seen.px_per_ideal @ view_jacobian(arm + p[:, None])
    j = np.concatenate([view @ -skew(arm), view @ _place_jacobian(p)[:, None]], -1)
    r = residuals(rotation, translation, seen)
    _, factor = huber_cost(r, seen.weight)
    jw = j * (seen.weight * factor)[..., None, None]
    return np.einsum("npki,npkj->nij", jw, j), -np.einsum("npki,npk->ni", jw, r)


def _links(rotation: np.ndarray, translation: np.ndarray, centre: np.ndarray, dt: np.ndarray, density: np.ndarray) -> Links:
    """Constant velocity between frames: Log(R_k+1 R_k^T) and the place's difference, minus dt times the velocity."""
    n = len(dt)
    _, place = _place(rotation, translation, centre)
    turn = rotvec_from_rotation(rotation[1:] @ np.swapaxes(rotation[:-1], 1, 2))
    bend = skew(turn) / 2  # inverse Jacobians of SO(3), left and right, to second order in the turn between frames
    before, after = np.zeros((n, 12, 12)), np.zeros((n, 12, 12))
    i = np.arange(6)
    after[:, i, i] = 1
    before[:, i, i] = -1
    after[:, :3, :3] -= bend
    before[:, :3, :3] -= bend
    before[:, i, i + 6] = -dt[:, None]
    after[:, i + 6, i + 6] = 1
    before[:, i + 6, i + 6] = -1
    offset = np.zeros((n, 12))
    offset[:, :3], offset[:, 3:6] = turn, np.diff(place, axis=0)
    return Links(before, after, offset, dt, density)


def _first_guess(rotation: np.ndarray, translation: np.ndarray, seen: Observed, dt: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(n - 1, 6) noise density as if all second differences were motion: too large, EM brings it down."""
    if len(dt) == 0:
        return np.zeros((0, 6))
    _, place = _place(rotation, translation, centre)
    turn = rotvec_from_rotation(rotation[1:] @ np.swapaxes(rotation[:-1], 1, 2))
    rate = np.concatenate([turn, np.diff(place, axis=0)], -1) / dt[:, None]
    out = np.full(6, 1e-4)
    if len(dt) > 1:
        gap = (dt[1:] + dt[:-1])[:, None] / 2
        out = np.median(np.diff(rate, axis=0) ** 2 / gap, axis=0) / 0.45  # median of chi squared with one degree
    out = _grouped(np.broadcast_to(np.clip(out, 1e-8, _CEILING), (len(dt), 6)).copy())
    return out


def _grouped(density: np.ndarray) -> np.ndarray:
    out = density.copy()
    for group in _GROUPS:
        out[:, list(group)] = density[:, list(group)].mean(1, keepdims=True)
    return out


def _relearned(density: np.ndarray, moments: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """EM's new densities, averaged over a time window; steps taken further than EM would (it is slow downwards)."""
    if not len(moments):
        return density
    moments = _grouped(moments)
    at = (times_s[1:] + times_s[:-1]) / 2
    clip = moments.mean(0)
    out = np.empty_like(moments)
    reach = 4 * WINDOW_S
    first, last = np.searchsorted(at, at - reach), np.searchsorted(at, at + reach)
    for k in range(len(at)):
        part = slice(first[k], last[k])
        w = np.exp(-0.5 * ((at[part] - at[k]) / WINDOW_S) ** 2)
        out[k] = (w[:, None] * moments[part]).sum(0) / w.sum()
    out = (1 - WHOLE_CLIP_SHARE) * out + WHOLE_CLIP_SHARE * np.minimum(clip, 10 * out)
    ratio = np.clip(np.maximum(out, _FLOOR) / np.maximum(density, _FLOOR), 1e-3, 1e3)
    return np.clip(density * ratio**1.6, _FLOOR, _CEILING)
