"""Lights that change: the simplest account of a whole clip that holds.

1. constant: one fit for all;
2. switched: the lamps are all on or all off between one step of the light and the next; or
   segments: the directions of the clip, colours and brightness of their own in between;
3. shared: the same, with a factor for every frame where frames show several normals, else in
   windows of a few seconds;
4. windows: a fit for each segment that holds alone, or for each window.
The next one is tried where the one before does not explain the observations, or only with a
second light. A light that is refused for another reason stays refused: cut into pieces, its
evidence only gets less. Source: docs/methods/light.md#time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy import ndarray

from arfx.analyse.light.fit import LightFit, doubted, fit
from arfx.analyse.light.hypotheses import (
    LIKELY,
    LIMIT_DEG,
    MEASURED,
    NO_CONE_DEG,
    REFUSED,
    Params,
)
from arfx.analyse.light.sphere import DEG_4, nearest_cell
from arfx.core.light import harmonics
from arfx.core.numerics import angle_between, divide

CONSTANT, SWITCHED, SEGMENTS, SHARED, WINDOWS = (
    "constant",
    "switched",
    "segments",
    "shared",
    "windows",
)
# between the halves of a clip whose brightness wanders while one normal is seen at a time
_AGREE_DEG = 3.0
_GOOD_ERROR = 0.006  # model error up to which an account holds
_MOST_DRIFT = (
    0.02  # of the level: an account under which normals change more does not hold
)
_DRIFT_S = 0.25
LONGEST_WINDOW_S = 2.0  # changing light is treated as constant for so long at most
_LEAST_PIECE = 8  # observations of a segment whose light can be asked for
# length of a frame's mean normal, below which its normals are apart: 28 degrees between two
_APART, _SOMEWHAT_APART = 0.97, np.cos(np.radians(5.0))
_LEAST_FRAMES = 0.8  # share of the frames that show normals apart
_PASSES = 60


@dataclass(frozen=True, eq=False)
class Span:
    """From start_s up to stop_s the light is that of `group` of `fit`."""

    start_s: float
    stop_s: float
    fit: LightFit
    group: int = 0


@dataclass(frozen=True, eq=False)
class _Observations:
    """times_s : (k,) ascending;  normals, irradiance, variance : (k, 3);  group : (k,) int"""

    params: Params
    times_s: ndarray
    normals: ndarray
    irradiance: ndarray
    variance: ndarray
    group: ndarray

    def __getitem__(self, rows: slice | ndarray) -> _Observations:
        arrays = (getattr(self, f.name) for f in fields(self)[1:])
        return _Observations(self.params, *(a[rows] for a in arrays))

    def spans(self, windows: Sequence[tuple[int, LightFit, int]]) -> list[Span]:
        """windows : in order, the first observation of each, its fit and its group"""
        starts = [start for start, _, _ in windows]
        edges_s = np.append(self.times_s[starts], self.times_s[-1]).tolist()
        rows = zip(pairwise(edges_s), windows, strict=True)
        return [Span(a, b, found, group) for (a, b), (_, found, group) in rows]

    def pieces(self, starts: Sequence[int]) -> list[_Observations]:
        """starts : of `window_starts`"""
        return [self[a:b] for a, b in pairwise([*starts, len(self.times_s)])]

    def grouped(self, starts: Sequence[int]) -> _Observations:
        sizes = np.diff([*starts, len(self.times_s)])
        return replace(self, group=np.repeat(np.arange(len(sizes)), sizes))

    def fit(self, lights: int = 2, lit: ndarray | None = None) -> LightFit:
        few = replace(self.params, most_lights=min(self.params.most_lights, lights))
        return fit(self.normals, self.irradiance, self.variance, self.group, few, lit)

    def steady(self, found: LightFit) -> bool:
        if found.model_error > _GOOD_ERROR:
            return False
        drifts = drift(self.times_s, self.normals, self.irradiance, self.group)
        return drifts <= _MOST_DRIFT

    def confirmed(self, found: LightFit) -> LightFit:
        """With its first light's cone widened to what the first and the last half say: beyond
        what frames with one normal each allow likely, beyond the limit refused.

        What prints of one frame show beside each other does not change with the exposure:
        where frames show several normals, lights that do not explain it are none."""
        if not found.claimed:
            return found
        apart = (
            np.mean(_mean_lengths(self.times_s, self.normals) < _SOMEWHAT_APART) > 0.5
        )
        if apart and found.model_error > _GOOD_ERROR:
            return _refused(found, "prints beside each other do not show one light")
        agree_deg = LIMIT_DEG if apart else _AGREE_DEG
        first, off = found.lights[0], 0.0
        early = self.times_s <= np.median(self.times_s)
        for half in (early, ~early):
            lights = self[half].fit(len(found.lights)).lights
            angles = [angle_between(li.direction, first.direction) for li in lights]
            off = max(off, float(np.degrees(min(angles, default=np.inf))))
        likely = self.params.likely and found.model_error <= _GOOD_ERROR
        if off <= agree_deg:
            first = replace(first, confidence_deg=max(first.confidence_deg, off))
            return replace(found, lights=(first, *found.lights[1:]))
        if off > (LIMIT_DEG if likely else agree_deg):
            why = (
                "the light or the exposure changes, and no two parts of the clip agree on a"
                " direction"
            )
            return _refused(found, why)
        doubt = (
            f"its direction differs by {off:.0f} degrees between parts of the clip"
        )
        first = doubted(first, max(first.confidence_deg, 2 * off))
        reason = f"{found.reason}; {doubt}"
        lights = (first, *found.lights[1:])
        return replace(found, verdict=LIKELY, reason=reason, lights=lights)


def _refused(found: LightFit, why: str) -> LightFit:
    return replace(
        found, verdict=REFUSED, reason=why, lights=(), ambient_rgb=found.seen_rgb
    )


def fit_over_time(
    times_s: ndarray,
    normals: ndarray,
    irradiance: ndarray,
    variance: ndarray,
    breaks_s: Sequence[float] = (),
    params: Params = Params(),  # noqa: B008 - frozen
) -> tuple[str, list[Span]]:
    """(CONSTANT, SWITCHED, SEGMENTS, SHARED or WINDOWS, spans in order, without gaps, from
    the first to the last observation).

    times_s : (k,) of each observation, one at least, any order;  normals, irradiance,
    variance : (k, 3) as in fit.fit, finite
    breaks_s : times at which the light steps (brightness.steps); no span crosses one
    """
    order = np.argsort(times_s, kind="stable")
    seen = _Observations(
        params, times_s, normals, irradiance, variance, np.zeros(len(times_s), int)
    )[order]
    constant = refusal = seen.fit()
    if seen.steady(constant):
        return CONSTANT, seen.spans([(0, constant, 0)])
    segments = window_starts(seen.times_s, breaks_s)
    held = [_switched(seen, segments)]
    sure = held[0] is not None and (
        held[0][1].verdict == MEASURED or len(held[0][1].lights) == 1
    )
    for name, longest_s in (SEGMENTS, np.inf), (SHARED, LONGEST_WINDOW_S):
        starts = window_starts(seen.times_s, breaks_s, longest_s)
        if sure or (name == SEGMENTS and len(starts) < 2):
            continue
        if name == SHARED and (pumped := _exposure_drift_fit(seen)) is not None:
            return SHARED, seen.spans([(0, pumped, 0)])
        grouped = seen.grouped(starts)
        found = grouped.fit()
        if found.model_error <= _GOOD_ERROR < refusal.model_error:
            refusal = found
        if not found.claimed or not grouped.steady(found):
            continue
        if name == SHARED:
            found = grouped.confirmed(found)
        if found.claimed:
            windows = [(start, found, group) for group, start in enumerate(starts)]
            held.append((name, found, seen.spans(windows)))
            break
    shared = min(
        (h for h in held if h is not None),
        key=lambda h: (h[1].verdict != MEASURED, len(h[1].lights)),
        default=None,
    )
    if shared is not None and len(shared[1].lights) == 1:
        return shared[0], shared[2]
    windows = []
    for start, piece in zip(segments, seen.pieces(segments), strict=True):
        found, large = piece.fit(), len(piece.times_s) >= _LEAST_PIECE
        holds = large and found.claimed and piece.steady(found)
        # one light of its own in each segment, or two for all: the former is simpler
        if shared is not None and large and not (holds and len(found.lights) == 1):
            return shared[0], shared[2]
        if holds:
            windows.append((start, found, 0))
            continue
        inner = window_starts(piece.times_s, (), LONGEST_WINDOW_S)
        for first, part in zip(inner, piece.pieces(inner), strict=True):
            windows.append((start + first, part.confirmed(part.fit()), 0))
    if any(found.claimed for _, found, _ in windows):
        return WINDOWS, seen.spans(windows)
    last = seen.confirmed(constant)
    if not last.claimed and not refusal.claimed:
        last = replace(last, reason=refusal.reason)
    return CONSTANT, seen.spans([(0, last, 0)])


def _switched(
    seen: _Observations, segments: Sequence[int]
) -> tuple[str, LightFit, list[Span]] | None:
    """The account of lamps that are all on or all off, where that holds."""
    if (lit := switches(seen.times_s, seen.irradiance, segments)) is None:
        return None
    grouped = seen.grouped(segments)
    found = grouped.fit(lit=lit)
    by_state = replace(grouped, group=lit[grouped.group].astype(int))
    if not found.claimed or not by_state.steady(found):
        return None
    dark = replace(found, lights=tuple(li for li in found.lights if li.dome))
    states = [
        (a, found if on else dark, 0) for a, on in zip(segments, lit, strict=True)
    ]
    return SWITCHED, found, seen.spans(states)


def switches(
    times_s: ndarray, irradiance: ndarray, starts: Sequence[int]
) -> ndarray | None:
    """(g,) 1 where the lamps are on, 0 where off, in the segments that begin at these
    observations; None where steps do not go down and up in turn.

    What a step does is seen from the observations, times ascending, right before and after it."""
    light, signs = irradiance.mean(1), []
    for start in starts[1:]:
        last = light[:start][times_s[:start] == times_s[start - 1]]
        first = light[start:][times_s[start:] == times_s[start]]
        signs.append(np.sign(first.mean() - last.mean()))
    if not signs or not all(signs) or any(a == b for a, b in pairwise(signs)):
        return None
    return np.array([signs[0] < 0, *(s > 0 for s in signs)], float)


def window_starts(
    times_s: ndarray, breaks_s: Sequence[float], window_s: float = np.inf
) -> list[int]:
    """Which observations, times ascending, begin a window: the first after each break, and
    between breaks those of even windows of at most window_s. None is empty: a clip may stand
    still for years."""
    n = len(times_s)
    begins = np.searchsorted(times_s, [b for b in breaks_s if np.isfinite(b)])
    begins = np.unique(np.append(0, begins[begins < n]))
    starts = []
    for a, b in pairwise([*begins.tolist(), n]):
        since_s = times_s[a:b] - times_s[a]
        pieces = max(np.ceil(since_s[-1] / window_s - 1e-9), 1)
        width_s = max(since_s[-1] / pieces, 1e-9)
        number = np.minimum(np.floor(since_s / width_s + 1e-9), pieces - 1)
        starts += (a + np.unique(number, return_index=True)[1]).tolist()
    return starts


def _mean_lengths(times: ndarray, n: ndarray) -> ndarray:
    """(frames,) length of each frame's mean normal: below 1 where its normals are apart.

    times : ascending"""
    _, first, count = np.unique(times, return_index=True, return_counts=True)
    return np.linalg.norm(np.add.reduceat(n, first) / count[:, None], axis=1)


def _exposure_drift_fit(seen: _Observations) -> LightFit | None:
    """The light under one factor per frame (`gains`); None where that is not to be had,
    does not hold, or is refused.

    A second light is left soft: what the factors are off by looks like one."""
    n, E = seen.normals, seen.irradiance
    if (g := gains(seen.times_s, n, E)) is None:
        return None
    frame = np.unique(seen.times_s, return_inverse=True)[1]
    # harmonics bend where a lamp sets: the factors once more, from the lights themselves
    for sigma in (0.0, seen.params.gamma_sigma):
        even = replace(
            seen,
            irradiance=E / g[:, None],
            variance=seen.variance / g[:, None] ** 2,
            params=replace(seen.params, gamma_sigma=sigma),
        )
        found = even.fit()
        if not found.claimed:
            return None
        g = matched(frame, found.irradiance(n).mean(1), E.mean(1))[frame]
        if not (g > 1e-3).all():
            return None
    off = drift(seen.times_s, n, E / g[:, None])
    if found.model_error > _GOOD_ERROR or off > _MOST_DRIFT:
        return None
    soft = (
        replace(li, confidence_deg=NO_CONE_DEG, verdict=REFUSED)
        for li in found.lights[1:]
    )
    return replace(found, lights=(found.lights[0], *soft))


def drift(
    times_s: ndarray,
    normals: ndarray,
    irradiance: ndarray,
    group: ndarray | int = 0,
) -> float:
    """Root mean square over time, relative to the level, of how normals differ from
    themselves at other times of a group.

    times_s : (k,);  normals, irradiance : (k, 3);  group : (k,) int. Means of a quarter of
    a second, so that noise is little.
    """
    light = irradiance.mean(1)
    level = np.percentile(light, 90)
    if level <= 0:
        return 0.0
    H = harmonics(normals)  # slope within a cell taken out
    off = (light - H @ np.linalg.lstsq(H, light, rcond=1e-6)[0]) / level
    cell = np.unique(
        group * DEG_4 + nearest_cell(normals, DEG_4), return_inverse=True
    )[1]
    count = np.bincount(cell)
    off = off - (np.bincount(cell, off) / count)[cell]
    # numbered without holes: a clip may stand still for years
    window = np.unique(
        np.floor((times_s - times_s.min()) / _DRIFT_S), return_inverse=True
    )[1]
    many = np.bincount(window, count[cell] > 1)
    mean = divide(np.bincount(window, off), many)
    return float(np.sqrt(divide((many * mean**2).sum(), many.sum())))


def gains(times_s: ndarray, normals: ndarray, irradiance: ndarray) -> ndarray | None:
    """(k,) factor of each observation's frame, median 1; None where frames do not show
    several normals apart.

    Alternating least squares of the factors and of the irradiance in harmonics up to degree 2.
    """
    if np.mean(_mean_lengths(times_s, normals) < _APART) < _LEAST_FRAMES:
        return None
    frame = np.unique(times_s, return_inverse=True)[1]
    light, H = irradiance.mean(1), harmonics(normals)
    g = np.ones(frame.max() + 1)
    for _ in range(_PASSES):
        model = H @ np.linalg.lstsq(g[frame, None] * H, light, rcond=1e-6)[0]
        last, g = g, matched(frame, model, light)
        if np.abs(g - last).max() < 1e-5:
            break
    return g[frame] if (g > 1e-3).all() else None


def matched(frame: ndarray, model: ndarray, light: ndarray) -> ndarray:
    """(frames,) factors that bring the model (k,) to the light (k,) seen, median 1.

    frame : (k,) int from 0 on, no gaps
    """
    g = divide(np.bincount(frame, model * light), np.bincount(frame, model * model))
    return divide(g, float(np.median(g)), where_zero=1.0)
