"""How bright the light is in every frame: what the prints show of it, as steady as their noise
is large, and as quick as the picture changes.

The prints' levels are logarithms of what they show over what the lamps' model gives them. The
object is lit as the print that it stands on; all prints, each with its own constant error,
tell the exposure, which is tied to what the print that is stood on shows beside it. So a hand
over another print changes nothing.

A level rests, but where it clearly changes: over 3, 8 or 24 readings it differs by more than
its noise explains. The background is the witness: what it does not show has to be far beyond
the noise. Chroma, the difference of the channels from their mean, is held to more than luma.
Source: random walk by banded Cholesky (Rue and Held 2005, 2.4); docs/methods/light.md#update.
Cost: some 10 us a reading."""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.numerics import divide

WITNESS_PX = (64, 36)  # of the small pictures that are compared
DARKEST, BRIGHTEST = (
    16,
    240,
)  # coded luma between which a pixel says how the exposure changed
GAMMA = 2.2  # of coded luma, about
LEAST_CHANGE = 0.012  # of the background's logarithm: less is its noise, it rests
OFF = 0.2  # of what the background shows, by which it is off
# of a level's logarithm for a radian by which a print turns under lights that nobody knows
TURN, CHROMA_TURN = 1.0, 0.3
SCALES = (3, 8, 24)  # readings before and after, over which a change is looked for
SURE, DOUBTED = 4.0, 10.0  # deviations that a change takes; where the background shows none
# A codec takes one or two steps of 8-bit chroma at a key frame, 2 % of white's blue each, and
# leaves them: beyond the noise within seconds, chroma is off by so many deviations of it.
CHROMA_SURE, CHROMA_NOISE, CHROMA_JUMP = 6.0, 4.0, 15.0
# Where a codec repeats blocks nothing seems to be noise: it is so much of what is stated.
STATED, MOST_STATED = 0.25, 0.004
# of the background's change in that of the prints, from which it bears it out
BORNE_OUT = 0.3
DRIFT, CHROMA_DRIFT = 0.003, 0.001  # of the logarithm at rest, over the root of a second
HUBER = 1.345  # deviations beyond which a print disagrees with the others, and counts less
LEAST_SIGMA = 3e-4
NOISE_OVER = 31  # readings, of which the noise is told
# A step of luma's logarithm from one reading to the next: the light was switched. So much, and
# so many deviations, beyond what the readings around, this many on either side, change by.
STEP, STEP_SURE, AROUND = 0.05, 8.0, 3
STANDS_OUT = 3.0  # times the largest of these
_PASSES = 30  # of alternating means: few prints that are seen in turn take that many


def small_luma(luma: np.ndarray) -> np.ndarray:
    """(36, 64) float32 of a frame's luma (h, w) uint8, for `background_change`."""
    width, height = WITNESS_PX
    thin = max(1, min(luma.shape[0] // (4 * height), luma.shape[1] // (4 * width)))
    picture = np.ascontiguousarray(luma[::thin, ::thin])
    return np.asarray(
        cv2.resize(picture, WITNESS_PX, interpolation=cv2.INTER_AREA), np.float32
    )


def background_change(before: np.ndarray, after: np.ndarray) -> float:
    """Logarithm of the light of what both small pictures show, after over before; NaN where
    that is next to nothing.

    A hand's motion is taken out as a shift. Most of the picture decides."""
    window = cv2.createHanningWindow(WITNESS_PX, cv2.CV_32F)
    a, b = (cv2.log(p + 1) for p in (before, after))
    (x, y), _ = cv2.phaseCorrelate(a - a.mean(), b - b.mean(), window)
    shift = np.array([[1, 0, x], [0, 1, y]])
    moved = cv2.warpAffine(before, shift, WITNESS_PX, flags=cv2.INTER_LINEAR)
    inside = (
        (moved > DARKEST) & (moved < BRIGHTEST) & (after > DARKEST) & (after < BRIGHTEST)
    )
    if inside.mean() < 0.1:
        return float("nan")
    return float(GAMMA * np.median(np.log(after[inside] / moved[inside])))


def brightness(
    times_s: np.ndarray,
    frame: np.ndarray,
    print_: np.ndarray,
    level: np.ndarray,
    variance: np.ndarray,
    stood_on: np.ndarray,
    change: np.ndarray,
    turn: np.ndarray,
) -> np.ndarray:
    """(t, 3) logarithm of every frame's brightness.

    times_s : (t,) of all frames;  frame : (k,) int of each reading;  print_ : (k,) int from 0
    level : (k, 3) logarithms;  variance : (k,) of them, relative to each other
    stood_on : (k,) bool, of the print on which the object stands
    change : (t,) of the background against the frame before, NaN = not known
    turn : (t,) radians by which prints turned since the frame before, under lights that are
    not known: then a level says little about the next
    """
    exposure, offsets = common_level(frame, print_, level, variance)
    seen, index = np.unique(frame, return_inverse=True)
    information = np.bincount(index, 1 / variance)
    out = _smoothed(times_s, seen, exposure, 1 / information, change, turn)
    if stood_on.any() and not stood_on.all():
        own, which = np.unique(frame[stood_on], return_index=True)
        beside = (level - offsets[print_] - exposure[index])[stood_on][which]
        rests = np.zeros(len(times_s))
        out += _smoothed(times_s, own, beside, variance[stood_on][which], rests, rests)
    return out


def common_level(
    frame: np.ndarray, print_: np.ndarray, level: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """((frames that have readings, 3), (prints, 3)): level = the frame's + the print's, whose
    mean over the readings is 0. Robust: most of a frame's prints decide.
    Arguments as of `brightness`.
    """
    index = np.unique(frame, return_inverse=True)[1]
    agrees = weight = 1 / variance
    offsets = np.zeros((print_.max() + 1, 3))
    common = _medians(index, level, weight)
    for _ in range(_PASSES):
        offsets = _means(print_, level - common[index], agrees)
        offsets -= np.average(offsets[print_], axis=0, weights=weight)
        common = _means(index, level - offsets[print_], agrees)
        off = np.abs(level - offsets[print_] - common[index])
        sigma = 1.4826 * np.median(off, 0) + LEAST_SIGMA
        agrees = weight * np.minimum(1, divide(HUBER, (off / sigma).max(1), where_zero=1.0))
    return common, offsets


def steps(times_s: np.ndarray, level: np.ndarray) -> np.ndarray:
    """(s,) times between readings at which luma jumps: by far more, and otherwise, than before
    and after, and not back at once.

    times_s : (n,) ascending;  level : (n, 3) logarithms of successive readings
    """
    if len(level) < 2 * AROUND + 2:
        return np.zeros(0)
    jump = np.diff(level.mean(1))
    off = np.abs(jump - np.median(_neighbours(jump), 1))
    clear = off > max(STEP, STEP_SURE * 1.4826 * float(np.median(off)))
    # a frame that disagrees is two in a row, and what turns past a lamp several
    clear &= off > STANDS_OUT * _neighbours(off).max(1)
    clear[:AROUND] = clear[-AROUND:] = False
    at = np.flatnonzero(clear)
    return (times_s[at] + times_s[at + 1]) / 2


def _neighbours(value: np.ndarray) -> np.ndarray:
    """(n, 2 AROUND) of value (n,), without itself."""
    padded = np.pad(value, AROUND, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
    return np.delete(windows, AROUND, axis=1)


def _smoothed(
    times_s: np.ndarray,
    seen: np.ndarray,
    level: np.ndarray,
    variance: np.ndarray,
    change: np.ndarray,
    turn: np.ndarray,
) -> np.ndarray:
    """(t, 3) levels of all frames out of those of `seen` (n,): level (n, 3), variance (n,)."""
    luma = level.mean(1, keepdims=True)
    usual = float(np.median(variance))
    size = variance / usual
    floor = min(STATED * np.sqrt(usual), MOST_STATED)
    background = np.append(np.nan, [change[a + 1 : b + 1].sum() for a, b in _pairs(seen)])
    turned = np.append(0, [turn[a + 1 : b + 1].sum() for a, b in _pairs(seen)])
    of_luma = _followed(times_s, seen, luma, size, floor, background, TURN * turned)
    of_chroma = _followed(
        times_s, seen, level - luma, size, floor, None, CHROMA_TURN * turned
    )
    return of_luma + of_chroma


def _pairs(seen: np.ndarray) -> list[tuple[int, int]]:
    return list(zip(seen[:-1].tolist(), seen[1:].tolist(), strict=True))


def _followed(
    times_s: np.ndarray,
    seen: np.ndarray,
    value: np.ndarray,
    size: np.ndarray,
    floor: float,
    background: np.ndarray | None,
    turned: np.ndarray,
) -> np.ndarray:
    """(t, c) of value (n, c) seen in frames `seen` with noise of relative variance `size`,
    whose deviation is `floor` at least.

    background : (n,) its change from one of these to the next, NaN = not known; None = it is
    chroma, of which it says nothing
    """
    chroma = background is None
    sigma = np.maximum(_noise(value), floor + LEAST_SIGMA)
    noise = (
        np.clip(size, 0.25, 1e4)[:, None] * (sigma * (CHROMA_NOISE if chroma else 1)) ** 2
    )
    drift = CHROMA_DRIFT if chroma else DRIFT
    rest = np.hypot(drift * np.sqrt(np.maximum(np.diff(times_s[seen]), 1e-6)), turned[1:])
    moves = np.zeros(len(seen))
    expected = np.zeros((len(seen), 1))
    if background is not None:
        known = np.nan_to_num(background)
        noise_of_it = _noise(known[:, None])[:, 0]
        shows = np.abs(known) > np.maximum(LEAST_CHANGE, SURE * noise_of_it)
        expected[:, 0] = np.where(shows, known, 0.0)
        near = OFF * np.pad(np.abs(expected[:, 0]), 1)
        moves = np.maximum(np.maximum(near[:-2], near[1:-1]), near[2:])
    out = _solve(value, noise, np.hypot(rest, moves[1:]), expected)
    for scale in SCALES:
        off = value - out
        found = _difference(off, scale)
        sure = np.array([CHROMA_JUMP if scale == SCALES[0] else CHROMA_SURE])
        if background is not None:
            shown = _around(known, scale)
            borne_out = np.isnan(background) | (
                shown * found[:, 0] > BORNE_OUT * found[:, 0] ** 2
            )
            sure = np.where(borne_out, SURE, DOUBTED)[:, None]
        deviation = 1.25 * np.sqrt(2 / scale) * np.maximum(_noise(off), floor + LEAST_SIGMA)
        clear = (np.abs(found) > sure * deviation).any(1)
        moves = np.maximum(moves, clear * np.abs(found).max(1) / scale)
        out = _solve(value, noise, np.hypot(rest, moves[1:]), expected)
    return _between(times_s, times_s[seen], out)


def _solve(
    value: np.ndarray, noise: np.ndarray, walk: np.ndarray, expected: np.ndarray
) -> np.ndarray:
    """(n, c) random walk seen with noise, from all of past and future.

    value, noise : (n, c), its variance;  walk : (n - 1,) deviation of each step
    expected : (n, 1) of the step that leads there
    """
    from scipy.linalg import solveh_banded

    if len(value) == 1:  # LAPACK takes no matrix of one
        return value
    tie = 1 / walk**2
    pull = tie[:, None] * expected[1:]
    out = np.empty_like(value)
    for c in range(value.shape[1]):
        seen = 1 / noise[:, c]
        bands = np.zeros((2, len(value)))
        bands[0, 1:] = -tie
        bands[1] = seen
        bands[1, 1:] += tie
        bands[1, :-1] += tie
        right = value[:, c] * seen
        right[1:] += pull[:, 0]
        right[:-1] -= pull[:, 0]
        out[:, c] = solveh_banded(bands, right)
    return out


def _between(times_s: np.ndarray, seen_s: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(t, c) linear in time between those that were seen, and held beyond."""
    columns = [np.interp(times_s, seen_s, column) for column in value.T]
    return np.stack(columns, -1)


def _difference(value: np.ndarray, scale: int) -> np.ndarray:
    """(n, c) median of `scale` values from there on, less that of as many before; nearer to
    the ends that of the first, and of the last, that has as many.
    """
    out = np.zeros_like(value)
    if len(value) >= 2 * scale:
        windows = np.lib.stride_tricks.sliding_window_view(value, scale, axis=0)
        middle = np.median(windows, -1)
        inside = middle[scale:] - middle[:-scale]
        out[:] = np.pad(inside, ((scale, scale - 1), (0, 0)), mode="edge")
    return out


def _around(value: np.ndarray, scale: int) -> np.ndarray:
    """(n,) sums of value (n,) over fewer than `scale` before and after."""
    total = np.append(0.0, np.cumsum(value))
    at = np.arange(len(value))
    after = np.minimum(at + scale, len(value))
    return np.asarray(total[after] - total[np.maximum(at - scale + 1, 0)])


def _noise(value: np.ndarray) -> np.ndarray:
    """(n, c) deviation of white noise in successive values (n, c), over the readings around."""
    if len(value) < 4:
        return np.ones_like(value)
    bent = np.abs(np.diff(value, 3, axis=0)) / np.sqrt(20)  # of white noise, as it is
    before = NOISE_OVER // 2 + 1
    padded = np.pad(bent, ((before, NOISE_OVER + 2 - before), (0, 0)), mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, NOISE_OVER, axis=0)
    local, usual = np.median(windows, -1), np.median(bent, 0)
    return 1.4826 * np.maximum(local, usual)


def _means(group: np.ndarray, value: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(groups, c) weighted means of value (k, c). group : (k,) int, all from 0 on"""
    total = np.bincount(group, weight)
    columns = [np.bincount(group, weight * column) / total for column in value.T]
    return np.stack(columns, -1)


def _medians(group: np.ndarray, value: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(groups, c) weighted medians of value (k, c). group : (k,) int, all from 0 on"""
    columns = []
    ends = np.cumsum(np.bincount(group))
    for column in value.T:
        order = np.lexsort((column, group))
        total = np.cumsum(weight[order])
        before = np.append(0.0, total[ends[:-1] - 1])
        half = (before + total[ends - 1]) / 2
        at = np.minimum(np.searchsorted(total, half), ends - 1)
        columns.append(column[order][at])
    return np.stack(columns, -1)
