"""How bright the light is in every frame: what the prints show of it, as steady as their noise
is large, and as quick as the light changes.

The prints' levels are logarithms of what they show over what the lamps' model gives them. The
object is lit as the print that it stands on; all prints, each with its own constant error,
tell the exposure, which is tied to what the print that is stood on shows beside it. So a hand
over another print changes nothing.

A level rests, but where it clearly changes: over 5 or 15 readings it differs by more than
its noise explains. Chroma, the difference of the channels from their mean, is held to more
than luma.
Source: random walk by banded Cholesky (Rue and Held 2005, 2.4); docs/methods/light.md#update.
Cost: some 10 us a reading."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide

SCALES = (5, 15)  # readings before and after, over which a change is looked for
SURE = (6.0, 6.0)  # deviations that a change of luma takes over each
MOVES = (
    1.2  # such a change over its readings, by which the level may then move in each
)
# A codec takes one or two steps of 8-bit chroma at a key frame, 2 % of white's blue each, and
# leaves them: beyond the noise within seconds, chroma is off by so many deviations of it.
CHROMA_NOISE, CHROMA_SURE = 4.0, (15.0, 6.0)
# Where a codec repeats blocks nothing seems to be noise: it is so much of what is stated.
STATED, MOST_STATED = 0.25, 0.004
DRIFT, CHROMA_DRIFT = (
    0.003,
    0.001,
)  # of the logarithm at rest, over the root of a second
HUBER = 1.345  # deviations beyond which a print disagrees with the others, and counts less
LEAST_SIGMA = 3e-4
NOISE_OVER = 31  # readings, of which the noise is told
# A step of luma's logarithm from one reading to the next: the light was switched. So much, and
# so many deviations, and but for this share what it is between so many before and after.
STEP, STEP_SURE, ALIKE, STEP_OVER = 0.05, 11.0, 0.4, 3
_PASSES = 30  # of alternating means: few prints that are seen in turn take that many


def brightness(
    times_s: ndarray,
    frame: ndarray,
    print_: ndarray,
    level: ndarray,
    variance: ndarray,
    stood_on: ndarray,
) -> ndarray:
    """(t, 3) logarithm of every frame's brightness.

    times_s : (t,) of all frames;  frame : (k,) int of each reading;  print_ : (k,) int from 0
    level : (k, 3) logarithms;  variance : (k,) of them, relative to each other
    stood_on : (k,) bool, of the print on which the object stands
    """
    exposure, offsets = common_level(frame, print_, level, variance)
    seen, index = np.unique(frame, return_inverse=True)
    information = np.bincount(index, 1 / variance)
    out = _smoothed(times_s, seen, exposure, 1 / information)
    if stood_on.any() and not stood_on.all():
        own, which = np.unique(frame[stood_on], return_index=True)
        beside = (level - offsets[print_] - exposure[index])[stood_on][which]
        out += _smoothed(times_s, own, beside, variance[stood_on][which])
    return out


def common_level(
    frame: ndarray, print_: ndarray, level: ndarray, variance: ndarray
) -> tuple[ndarray, ndarray]:
    """((frames that have readings, 3), (prints, 3)): level = the frame's + the print's, whose
    mean over the readings is 0. Robust: most of a frame's prints decide.
    Arguments as of `brightness`.
    """
    index = np.unique(frame, return_inverse=True)[1]
    agrees = weight = 1 / variance
    offsets = np.zeros((print_.max() + 1, 3))
    common = group_means(index, level, weight)
    for _ in range(_PASSES):
        offsets = group_means(print_, level - common[index], agrees)
        offsets -= np.average(offsets[print_], axis=0, weights=weight)
        common = group_means(index, level - offsets[print_], agrees)
        off = np.abs(level - offsets[print_] - common[index])
        sigma = 1.4826 * np.median(off, 0) + LEAST_SIGMA
        agrees = weight * np.minimum(
            1, divide(HUBER, (off / sigma).max(1), where_zero=1.0)
        )
    return common, offsets


def steps(times_s: ndarray, level: ndarray) -> ndarray:
    """(s,) times between readings at which luma jumps: by far more than noise, and by as much
    as all that lies before and after differs. So neither a ramp is one, nor a frame that
    disagrees.

    times_s : (n,) ascending;  level : (n, 3) logarithms of successive readings
    """
    luma = level.mean(1, keepdims=True)
    jump, over = np.diff(luma[:, 0]), _difference(luma, STEP_OVER)[1:, 0]
    sure = np.maximum(STEP, STEP_SURE * _noise(luma)[1:, 0])
    clear = (np.abs(jump) > sure) & (np.abs(over - jump) < ALIKE * np.abs(jump))
    return (times_s[:-1] + times_s[1:])[clear] / 2


def _smoothed(
    times_s: ndarray,
    seen: ndarray,
    level: ndarray,
    variance: ndarray,
) -> ndarray:
    """(t, 3) levels of all frames out of those of `seen` (n,): level (n, 3), variance (n,)."""
    usual = float(np.median(variance))
    size = np.clip(variance / usual, 0.25, 1e4)[:, None]
    least = min(STATED * np.sqrt(usual), MOST_STATED) + LEAST_SIGMA
    root_s = np.sqrt(np.diff(times_s[seen]).clip(1e-6))
    luma = level.mean(1, keepdims=True)
    out = _followed(luma, size, least, DRIFT * root_s, SURE)
    rest, size = CHROMA_DRIFT * root_s, size * CHROMA_NOISE**2
    out = out + _followed(level - luma, size, least, rest, CHROMA_SURE)
    return np.stack(
        [np.interp(times_s, times_s[seen], column) for column in out.T], -1
    )


def _followed(
    value: ndarray,
    size: ndarray,
    least: float,
    walk: ndarray,
    sure: tuple[float, ...],
) -> ndarray:
    """(n, c) of value (n, c), seen with noise of relative variance `size` (n, 1), whose
    deviation is `least` at least: a random walk that moves where something clearly changes.

    walk : (n - 1,) deviation of each step at rest;  sure : deviations that a change takes
    """
    noise = size * np.maximum(_noise(value), least) ** 2
    out = _solve(value, noise, walk)
    for scale, many in zip(SCALES, sure, strict=True):
        off = value - out
        found = np.abs(_difference(off, scale))
        deviation = 1.25 * np.sqrt(2 / scale) * np.maximum(_noise(off), least)
        clear = (found > many * deviation).any(1)
        walk = np.maximum(walk, MOVES * (clear * found.max(1) / scale)[1:])
        out = _solve(value, noise, walk)
    return out


def _solve(value: ndarray, noise: ndarray, walk: ndarray) -> ndarray:
    """(n, c) random walk seen with noise, from all of past and future.

    value, noise : (n, c), its variance;  walk : (n - 1,) deviation of each step
    """
    from scipy.linalg import solveh_banded

    if len(value) == 1:  # LAPACK takes no matrix of one
        return value
    tie = 1 / walk**2
    out = np.empty_like(value)
    for c, seen in enumerate(1 / noise.T):
        sums = seen + np.append(tie, 0) + np.append(0, tie)
        bands = np.stack([np.append(0, -tie), sums])
        out[:, c] = solveh_banded(bands, value[:, c] * seen)
    return out


def _difference(value: ndarray, scale: int) -> ndarray:
    """(n, c) median of `scale` values from there on, less that of as many before; nearer to
    the ends that of the first, and of the last, that has as many.
    """
    out = np.zeros_like(value)
    if len(value) >= 2 * scale:
        middle = _medians(value, scale)
        inside = middle[scale:] - middle[:-scale]
        out[:] = np.pad(inside, ((scale, scale - 1), (0, 0)), mode="edge")
    return out


def _noise(value: ndarray) -> ndarray:
    """(n, c) deviation of white noise in successive values (n, c), over the readings around."""
    if len(value) < 4:
        return np.ones_like(value)
    bent = np.abs(np.diff(value, 3, axis=0)) / np.sqrt(20)  # of white noise, as it is
    before = NOISE_OVER // 2 + 1
    padded = np.pad(
        bent, ((before, NOISE_OVER + 2 - before), (0, 0)), mode="symmetric"
    )
    return 1.4826 * np.maximum(_medians(padded, NOISE_OVER), np.median(bent, 0))


def _medians(value: ndarray, count: int) -> ndarray:
    """(n - count + 1, c) of each `count` successive values (n, c)."""
    windows = np.lib.stride_tricks.sliding_window_view(value, count, axis=0)
    return np.asarray(np.median(windows, -1))


def group_means(group: ndarray, value: ndarray, weight: ndarray) -> ndarray:
    """(groups, c) weighted means of value (k, c). group : (k,) int, all from 0 on"""
    total = np.bincount(group, weight)
    columns = [np.bincount(group, weight * column) / total for column in value.T]
    return np.stack(columns, -1)
