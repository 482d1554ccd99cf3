"""Lights that change: the simplest account of a whole clip that holds.

1. constant: one fit for all;
2. switched: the lamps are all on or all off between one step of the light and the next;
3. segments: the directions of the clip, colours and brightness of their own between one
   step and the next;
4. shared: the same, with a factor for every frame where frames show several normals, else
   in windows of a few seconds;
5. windows: a fit for each segment that holds alone, or for each window.
The next one is tried where the one before does not explain the observations, or only with a
second light. A light that is refused for another reason stays refused: cut into pieces, its
evidence only gets less. Source: docs/methods/light.md#time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from arfx.analyse.light.fit import LightFit, doubted, fit
from arfx.analyse.light.hypotheses import LIKELY, MEASURED, NO_CONE_DEG, REFUSED, Params
from arfx.analyse.light.icosphere import icosphere
from arfx.core.light import harmonics
from arfx.core.numerics import angle_between, divide

_APART_DEG = 10.0
# between the halves of a clip whose brightness wanders while one normal is seen at a time
_AGREE_DEG = 3.0
CONSTANT, SWITCHED, SEGMENTS, SHARED, WINDOWS = (
    "constant",
    "switched",
    "segments",
    "shared",
    "windows",
)
_GOOD_ERROR = 0.006  # model error up to which an account holds
_MOST_DRIFT = (
    0.02  # of the level, `drift`: an account under which normals change more does not hold
)
_CELL_LEVEL = 4  # 4 degrees: within, normals count as one
_WINDOW_S = 0.25
LONGEST_WINDOW_S = 2.0  # changing light is treated as constant for so long at most
_LEAST_PIECE = 8  # observations of a segment whose light can be asked for
_LEAST_FRAMES = 0.8  # share of the frames that show normals apart
# length of a frame's mean normal, below which its normals are apart: 28 degrees between two
_APART = 0.97
_PASSES = 60


@dataclass(frozen=True, eq=False)
class Span:
    """From start_s up to stop_s the light is that of `group` of `fit`."""

    start_s: float
    stop_s: float
    fit: LightFit
    group: int = 0


def fit_over_time(
    times_s: np.ndarray,
    normals: np.ndarray,
    irradiance: np.ndarray,
    variance: np.ndarray,
    breaks_s: Sequence[float] = (),
    params: Params = Params(),  # noqa: B008 - frozen
) -> tuple[str, list[Span]]:
    """(CONSTANT, SWITCHED, SEGMENTS, SHARED or WINDOWS, spans in order, without gaps, from
    the first to the last observation).

    times_s : (k,) of each observation, one at least, any order;  normals, irradiance,
    variance : (k, 3) as in fit.fit, finite
    breaks_s : times at which the light steps (brightness.steps); no span crosses one
    """
    order = np.argsort(times_s, kind="stable")  # what lies between two times is a slice
    times, n, E, v = (a[order] for a in (times_s, normals, irradiance, variance))
    start, stop, every = float(times[0]), float(times[-1]), slice(0, len(times))

    def run(
        rows: slice,
        group: np.ndarray | None = None,
        lights: int = 2,
    ) -> LightFit:
        p = replace(params, most_lights=min(params.most_lights, lights))
        return fit(
            n[rows], E[rows], v[rows], None if group is None else group[rows], p
        )

    # where most frames show normals that are apart, changing light is distinguished from a
    # changing direction
    several = np.mean(_mean_lengths(times, n) < np.cos(np.radians(_APART_DEG / 2))) > 0.5
    agree_deg = params.limit_deg if several else min(params.limit_deg, _AGREE_DEG)

    def confirmed(
        found: LightFit, rows: slice, middle_s: float, group: np.ndarray | None = None
    ) -> LightFit:
        """With its first light's cone widened to what the halves say, up to and from a
        time: beyond agree_deg likely, beyond the limit refused.
        """
        if not found.claimed:
            return found
        middle = int(np.searchsorted(times, middle_s, side="right"))
        middle = min(max(middle, rows.start), rows.stop)
        first, off = found.lights[0], 0.0
        for half in (slice(rows.start, middle), slice(middle, rows.stop)):
            lights = run(half, group, len(found.lights)).lights
            apart = [angle_between(li.direction, first.direction) for li in lights]
            off = max(off, float(np.degrees(min(apart, default=np.inf))))
        if off <= agree_deg:
            first = replace(first, confidence_deg=max(first.confidence_deg, off))
            return replace(found, lights=(first, *found.lights[1:]))
        likely = params.likely and found.model_error <= _GOOD_ERROR
        if off > (params.limit_deg if likely else agree_deg):
            why = (
                "the light or the exposure changes, and no two parts of the clip agree on a"
                " direction"
            )
            return replace(
                found, verdict=REFUSED, reason=why, lights=(), ambient_rgb=found.seen_rgb
            )
        doubt = f"its direction differs by {off:.0f} degrees between parts of the clip"
        first = doubted(first, max(first.confidence_deg, 2 * off), doubt)
        return replace(
            found,
            verdict=LIKELY,
            reason=f"{found.reason}; {doubt}",
            lights=(first, *found.lights[1:]),
        )

    def holds(
        found: LightFit, group: np.ndarray | None = None, rows: slice = every
    ) -> bool:
        if not found.claimed or found.model_error > _GOOD_ERROR:
            return False
        return drift(times[rows], n[rows], E[rows], group) <= _MOST_DRIFT

    constant = run(every)
    if constant.model_error <= _GOOD_ERROR and drift(times, n, E) <= _MOST_DRIFT:
        return CONSTANT, [Span(start, stop, constant)]
    segments = window_edges(start, stop, breaks_s, np.inf)
    # the account whose refusal says most: the first that explains what was seen
    best_refusal = constant
    held: list[tuple[str, LightFit, list[Span]]] = []  # accounts that explain it
    for name, window_s in ((SEGMENTS, np.inf), (SHARED, LONGEST_WINDOW_S)):
        edges = window_edges(start, stop, breaks_s, window_s)
        if name == SHARED:
            if held:
                continue
            pumped = _exposure_drift_fit(times, n, E, v, params)
            if pumped is not None and pumped.model_error <= _GOOD_ERROR:
                return SHARED, [Span(start, stop, pumped)]
        elif len(edges) < 3 or any(
            f.verdict == MEASURED or len(f.lights) == 1 for _, f, _ in held
        ):
            continue
        group = _group(times, edges)
        found = run(every, group)
        if found.model_error <= _GOOD_ERROR < best_refusal.model_error:
            best_refusal = found
        if holds(found, group):
            if name == SHARED:
                found = confirmed(found, every, (start + stop) / 2, group)
            if found.claimed:
                present = np.unique(group)  # the groups that fit numbers
                spans = [
                    Span(a, b, found, int(np.abs(present - g).argmin()))
                    for g, (a, b) in enumerate(pairwise(edges))
                ]
                held.append((name, found, spans))
    name, best, spans = min(
        held,
        key=lambda h: (h[1].verdict != MEASURED, len(h[1].lights)),
        default=(WINDOWS, None, []),
    )
    if best is not None and len(best.lights) == 1:
        return name, spans

    def between(a: float, b: float) -> slice:
        """From a up to b; the last observation is in the last one."""
        return slice(*np.searchsorted(times, [a, b] if b < stop else [a, np.inf]).tolist())

    pieces = [between(a, b) for a, b in pairwise(segments)]
    alone = [run(rows) for rows in pieces]
    steady = [holds(f, None, rows) for f, rows in zip(alone, pieces, strict=True)]
    if best is not None and not all(
        ok and len(f.lights) == 1
        for f, rows, ok in zip(alone, pieces, steady, strict=True)
        if rows.stop - rows.start >= _LEAST_PIECE
    ):
        return name, spans
    spans = []  # one light of its own in each segment, or two for all: the former is simpler
    for (a, b), found, ok in zip(pairwise(segments), alone, steady, strict=True):
        if ok:
            spans.append(Span(a, b, found))
            continue
        for c, d in pairwise(window_edges(a, b, (), LONGEST_WINDOW_S)):
            inside = between(c, d)
            spans.append(Span(c, d, confirmed(run(inside), inside, (c + d) / 2)))
    if any(s.fit.claimed for s in spans):
        return WINDOWS, spans
    last = confirmed(constant, every, (start + stop) / 2)
    if not last.claimed and not best_refusal.claimed:
        last = replace(last, reason=best_refusal.reason)
    return CONSTANT, [Span(start, stop, last)]


def switches(
    times_s: np.ndarray, irradiance: np.ndarray, edges: Sequence[float]
) -> np.ndarray | None:
    """(g,) 1 where the lamps are on, 0 where off, between the edges (g + 1,); None where
    steps do not go down and up in turn.

    What a step does is seen from the observations, times ascending, right before and after it."""
    light, t = irradiance.mean(1), times_s
    signs = []
    for edge in edges[1:-1]:
        at = int(np.searchsorted(t, edge))
        if not 0 < at < len(t):
            return None
        signs.append(
            np.sign(
                light[at:][t[at:] == t[at]].mean() - light[:at][t[:at] == t[at - 1]].mean()
            )
        )
    if not signs or not all(signs) or any(a == b for a, b in pairwise(signs)):
        return None
    return np.array([signs[0] < 0, *(s > 0 for s in signs)], float)


def window_edges(
    start_s: float, stop_s: float, breaks_s: Sequence[float], window_s: float
) -> list[float]:
    """Ascending times from start to stop: every break inside, and even cuts between that
    are at most window_s apart.
    """
    inside = sorted({float(b) for b in breaks_s if np.isfinite(b) and start_s < b < stop_s})
    out = [start_s]
    for a, b in pairwise([start_s, *inside, stop_s]):
        pieces = max(1, int(np.ceil((b - a) / max(window_s, 1e-6) - 1e-9)))
        out += [a + (b - a) * (i + 1) / pieces for i in range(pieces)]
    return out


def _mean_lengths(times: np.ndarray, n: np.ndarray) -> np.ndarray:
    """(frames,) length of each frame's mean normal: below 1 where its normals are apart.

    times : ascending"""
    _, first, count = np.unique(times, return_index=True, return_counts=True)
    return np.linalg.norm(np.add.reduceat(n, first) / count[:, None], axis=1)


def _group(times: np.ndarray, edges: list[float]) -> np.ndarray:
    return np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(edges) - 2)


def _exposure_drift_fit(
    times: np.ndarray, n: np.ndarray, E: np.ndarray, v: np.ndarray, params: Params
) -> LightFit | None:
    """The light under one factor per frame (`gains`); None where that is not to be had,
    does not hold, or is refused.

    A second light is left soft: what the factors are off by looks like one."""
    if (g := gains(times, n, E)) is None:
        return None
    frame = np.unique(times, return_inverse=True)[1]
    # harmonics bend where a lamp sets: the factors once more, from the lights themselves
    for p in (replace(params, gamma_sigma=0.0), params):
        found = fit(n, E / g[:, None], v / g[:, None] ** 2, None, p)
        if not found.claimed:
            return None
        g = matched(frame, found.irradiance(n).mean(1), E.mean(1))[frame]
        if not (g > 1e-3).all():
            return None
    if drift(times, n, E / g[:, None]) > _MOST_DRIFT:
        return None
    soft = (
        replace(li, confidence_deg=NO_CONE_DEG, verdict=REFUSED) for li in found.lights[1:]
    )
    return replace(found, lights=(found.lights[0], *soft))


def drift(
    times_s: np.ndarray,
    normals: np.ndarray,
    irradiance: np.ndarray,
    group: np.ndarray | None = None,
) -> float:
    """Root mean square over time, relative to the level, of how normals differ from
    themselves at other times of a group.

    times_s : (k,);  normals, irradiance : (k, 3);  group : (k,) int. Means of a quarter of
    a second, so that noise is little.
    """
    light = np.asarray(irradiance, float).mean(1)
    level = float(np.percentile(light, 90)) if len(light) else 0.0
    if level <= 0:
        return 0.0
    H = harmonics(normals)
    off = (
        light - H @ np.linalg.lstsq(H, light, rcond=1e-6)[0]
    ) / level  # slope within a cell taken out
    g = np.zeros(len(light), int) if group is None else np.asarray(group)
    cell = np.unique(
        g * len(icosphere(_CELL_LEVEL).vertices) + icosphere(_CELL_LEVEL).nearest(normals),
        return_inverse=True,
    )[1]
    count = np.bincount(cell)
    off = off - (np.bincount(cell, off) / count)[cell]
    repeated = count[cell] > 1
    window = np.unique(
        np.floor((times_s - times_s.min()) / _WINDOW_S), return_inverse=True
    )[1]
    many = np.bincount(window, repeated)
    mean = divide(np.bincount(window, off), many)
    return float(np.sqrt(divide((many * mean**2).sum(), many.sum())))


def gains(
    times_s: np.ndarray, normals: np.ndarray, irradiance: np.ndarray
) -> np.ndarray | None:
    """(k,) factor of each observation's frame, median 1; None where frames do not show
    several normals apart.

    Alternating least squares of the factors and of the irradiance in harmonics up to degree 2.
    """
    if np.mean(_mean_lengths(times_s, normals) < _APART) < _LEAST_FRAMES:
        return None
    frame = np.unique(times_s, return_inverse=True)[1]
    light, H = np.asarray(irradiance, float).mean(1), harmonics(normals)
    g = np.ones(frame.max() + 1)
    for _ in range(_PASSES):
        rows = g[frame, None] * H
        model = H @ np.linalg.lstsq(rows, light, rcond=1e-6)[0]
        last, g = g, matched(frame, model, light)
        if np.abs(g - last).max() < 1e-5:
            break
    return g[frame] if (g > 1e-3).all() else None


def matched(frame: np.ndarray, model: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(frames,) factors that bring the model (k,) to the light (k,) seen, median 1.

    frame : (k,) int from 0 on, no gaps
    """
    g = divide(np.bincount(frame, model * light), np.bincount(frame, model * model))
    return divide(g, float(np.median(g)), where_zero=1.0)
