"""The layout of several markers from the clip: relative poses by vote, then bundle
adjustment, O(frames * markers^2).

world = the axes of the first configured marker that was seen. Source: docs/methods/pose.md#map.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.pose.planar import (
    Observed,
    apply_step,
    huber_cost,
    jacobian,
    refine_poses,
    residuals,
    rms_px,
    stack,
    view_jacobian,
)
from arfx.core.numerics import EPS_DEPTH_M, condition
from arfx.core.pose import Pose, skew

# frames that the adjustment uses, evenly spread over those with two or more markers
MAX_FRAMES = 200
_VOTERS, _JUDGES = 40, 60


@dataclass(frozen=True)
class View:
    """One marker in one frame, as the mapping needs it.

    solutions : its planar poses, best first.
    """

    key: str
    corners_m: np.ndarray
    ideal: np.ndarray
    px_per_ideal: np.ndarray
    sigma_px: float
    solutions: tuple[Pose, ...]


@dataclass(frozen=True)
class MarkerMap:
    """world_from_marker by key;  unmapped keys;  frames used;  rms_px of the adjustment, 0
    without one
    standard_deviation_m : of each marker's centre;  condition : of the reduced normal
    matrix, 1 without one
    """

    world_from_marker: dict[str, Pose]
    unmapped: tuple[str, ...] = ()
    frames: int = 0
    rms_px: float = 0.0
    standard_deviation_m: Mapping[str, float] | None = None
    condition: float = 1.0


def map_markers(frames: Sequence[Sequence[View]], keys: Sequence[str]) -> MarkerMap:
    """frames : the markers of each frame (ones without solutions are ignored);  keys :
    configured order.
    """
    usable = [[v for v in views if v.solutions] for views in frames]
    present = [k for k in keys if any(v.key == k for views in usable for v in views)]
    if not present:
        return MarkerMap({})
    together = [
        {v.key: v for v in views} for views in usable if len({v.key for v in views}) > 1
    ]
    start = _spanning_tree(together, present)
    unmapped = tuple(k for k in present if k not in start)
    if len(start) == 1:
        return MarkerMap(start, unmapped)
    chosen = [f for f in together if sum(k in start for k in f) > 1]
    if len(chosen) > MAX_FRAMES:
        chosen = [
            chosen[i]
            for i in np.linspace(0, len(chosen) - 1, MAX_FRAMES).round().astype(int)
        ]
    return _adjust(chosen, start, unmapped)


def _spanning_tree(together: list[dict[str, View]], present: list[str]) -> dict[str, Pose]:
    """Grow the map from the first marker along the pairs that agree best."""
    edges: dict[tuple[str, str], tuple[float, Pose]] = {}
    out = {present[0]: Pose.identity()}
    while len(out) < len(present):
        best: tuple[float, str, Pose] | None = None
        for a in out:
            for b in present:
                if b in out:
                    continue
                if (a, b) not in edges:
                    edges[a, b] = _relative_pose(
                        [f for f in together if a in f and b in f], a, b
                    )
                misfit, a_from_b = edges[a, b]
                if np.isfinite(misfit) and (best is None or misfit < best[0]):
                    best = (misfit, b, out[a] @ a_from_b)
        if best is None:
            break
        out[best[1]] = best[2]
    return out


def _relative_pose(frames: list[dict[str, View]], a: str, b: str) -> tuple[float, Pose]:
    """(misfit, pose of b in a): the candidate under which b's corners fit best in the other
    frames, medians of px.

    The misfit is divided by the root of the number of frames, so that a pair often seen
    together is preferred."""
    if not frames:
        return np.inf, Pose.identity()
    sampled = [
        frames[i]
        for i in np.unique(np.linspace(0, len(frames) - 1, _VOTERS).round().astype(int))
    ]
    judges = [
        frames[i]
        for i in np.unique(np.linspace(0, len(frames) - 1, _JUDGES).round().astype(int))
    ]
    candidates = [
        pa.inverse() @ pb for f in sampled for pa in f[a].solutions for pb in f[b].solutions
    ]
    corners = np.stack(
        [c.apply(frames[0][b].corners_m) for c in candidates]
    )  # (c, 4, 3) in a
    error = np.empty((len(candidates), len(judges)))
    for k, f in enumerate(judges):
        distances = []
        s = f[b].px_per_ideal
        for p in f[a].solutions:
            q = p.apply(corners)
            d = q[..., :2] / np.maximum(q[..., 2:], EPS_DEPTH_M) - f[b].ideal
            x, y = (s[:, i, 0] * d[..., 0] + s[:, i, 1] * d[..., 1] for i in range(2))
            distances.append(np.sqrt((x * x + y * y).mean(-1)))
        error[:, k] = np.min(distances, axis=0)
    typical = np.median(error, axis=1)
    best = int(typical.argmin())
    return float(typical[best] / np.sqrt(len(frames))), candidates[best]


def _adjust(
    frames: list[dict[str, View]], start: dict[str, Pose], unmapped: tuple[str, ...]
) -> MarkerMap:
    keys = list(start)
    n, m = len(frames), len(keys)
    corners_m = {v.key: v.corners_m for frame in frames for v in frame.values()}
    local = np.stack([corners_m.get(k, np.zeros((4, 3))) for k in keys])
    seen = observe([frame.values() for frame in frames], start, keys)
    map_r, map_t = stack([*start.values()])
    now, first = _placed(seen, map_r, map_t, local), []
    for k, frame in enumerate(
        frames
    ):  # from the planar solution that fits all its markers best
        candidates = [
            p @ start[key].inverse()
            for key, v in frame.items()
            if key in start
            for p in v.solutions
        ]
        one = now.take(np.full(len(candidates), k))
        first.append(
            candidates[
                int(huber_cost(residuals(*stack(candidates), one), one.weight)[0].argmin())
            ]
        )
    rotation, translation, _ = refine_poses(*stack(first), now)
    damping, cost = 1e-6, np.inf
    reduced = np.eye(6 * (m - 1))
    for _ in range(30):
        now = _placed(seen, map_r, map_t, local)
        r = residuals(rotation, translation, now)
        rho, factor = huber_cost(r, now.weight)
        if abs(cost - rho.sum()) < 1e-10 * (1 + rho.sum()):
            break
        cost = float(rho.sum())
        w = now.weight * factor
        jf = jacobian(rotation, translation, now)
        # (n, p, 2, 6) px per left perturbation, in world axes, of the marker that carries
        # the corner
        world = now.points_m
        q = np.einsum("nij,npj->npi", rotation, world) + translation[:, None]
        lever = np.concatenate(
            [-skew(world), np.broadcast_to(np.eye(3), (*world.shape, 3))], -1
        )
        jm = now.px_per_ideal @ view_jacobian(q) @ rotation[:, None] @ lever
        jfw = np.swapaxes((jf * w[..., None, None]).reshape(n, 8 * m, 6), 1, 2)
        hff = jfw @ jf.reshape(n, 8 * m, 6)
        gf = (jfw @ r.reshape(n, 8 * m, 1))[..., 0]
        jmw = (jm * w[..., None, None]).reshape(n, m, 8, 6)
        hfm = np.swapaxes(jf.reshape(n, m, 8, 6), 2, 3) @ jmw
        hmm = (np.swapaxes(jmw, 2, 3) @ jm.reshape(n, m, 8, 6)).sum(0)
        gm = (np.swapaxes(jmw, 2, 3) @ r.reshape(n, m, 8, 1))[..., 0].sum(0)
        hff = hff + np.einsum("nii->ni", hff)[:, :, None] * damping * np.eye(6)
        inverse = np.linalg.inv(hff)
        couple = np.swapaxes(hfm, 2, 3) @ inverse[:, None]  # (n, m, 6, 6)
        left, middle = (
            couple.transpose(1, 2, 0, 3).reshape(6 * m, 6 * n),
            hfm.transpose(0, 2, 1, 3).reshape(6 * n, 6 * m),
        )
        reduced_full = -(left @ middle).reshape(m, 6, m, 6)
        for i in range(m):
            reduced_full[i, :, i, :] += hmm[i] * (1 + damping * np.eye(6))
        reduced = reduced_full[1:, :, 1:, :].reshape(
            6 * (m - 1), -1
        )  # the first marker is the world: it stays
        right = (gm - np.einsum("nmij,nj->mi", couple, gf))[1:].reshape(-1)
        step_m = np.zeros((m, 6))
        step_m[1:] = -np.linalg.solve(reduced, right).reshape(m - 1, 6)
        step_f = -np.einsum(
            "nij,nj->ni", inverse, gf + np.einsum("nmij,mj->ni", hfm, step_m)
        )
        map_r, map_t = apply_step(map_r, map_t, step_m)
        rotation, translation = apply_step(rotation, translation, step_f)
    now = _placed(seen, map_r, map_t, local)
    rms = float(
        np.sqrt(np.mean(rms_px(residuals(rotation, translation, now), now.weight) ** 2))
    )
    covariance = np.linalg.pinv(reduced)
    spread = {keys[0]: 0.0}
    for i, key in enumerate(keys[1:]):
        # centre moves by rotation x centre + translation of the left perturbation
        c = map_t[i + 1]
        lever = np.concatenate([-skew(c), np.eye(3)], 1)
        block = covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        spread[key] = float(np.sqrt(max(np.trace(lever @ block @ lever.T), 0.0)))
    poses = {k: Pose(map_r[i], map_t[i]) for i, k in enumerate(keys)}
    return MarkerMap(poses, unmapped, n, rms, spread, condition(reduced))


def observe(
    frames: Sequence[Iterable[View]],
    world_from_marker: Mapping[str, Pose],
    keys: Sequence[str],
) -> Observed:
    """The corners of these markers, four places per key."""
    slot = {k: i for i, k in enumerate(keys)}
    n, p = len(frames), 4 * max(len(slot), 1)
    out = Observed(
        np.zeros((n, p, 3)), np.zeros((n, p, 2)), np.zeros((n, p, 2, 2)), np.zeros((n, p))
    )
    for k, views in enumerate(frames):
        for v in views:
            if v.key in slot:
                part = slice(4 * slot[v.key], 4 * slot[v.key] + 4)
                out.points_m[k, part] = world_from_marker[v.key].apply(v.corners_m)
                out.ideal[k, part], out.px_per_ideal[k, part] = v.ideal, v.px_per_ideal
                out.weight[k, part] = v.sigma_px**-2.0
    return out


def _placed(
    seen: Observed, map_r: np.ndarray, map_t: np.ndarray, local: np.ndarray
) -> Observed:
    """The same observations with the corners where the map now puts them, in world coordinates."""
    world = (np.einsum("mij,mpj->mpi", map_r, local) + map_t[:, None]).reshape(1, -1, 3)
    return Observed(
        np.broadcast_to(world, seen.points_m.shape),
        seen.ideal,
        seen.px_per_ideal,
        seen.weight,
    )
