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

from collections.abc import Callable

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide

WITNESS_PX = (64, 36)  # of the small pictures that are compared
WITHIN = 112  # of middle grey, coded: such pixels say how the exposure changed
GAMMA = 2.2  # of coded luma, about
LEAST_CHANGE = 0.012  # of the background's logarithm: less is its noise, it rests
OFF = 0.25  # of what the background shows, by which it is off
# of a level's logarithm for a radian by which a print turns under lights that nobody knows
TURN, CHROMA_TURN = 1.0, 0.3
SCALES = (3, 8, 24)  # readings before and after, over which a change is looked for
SURE, DOUBTED = (
    4.0,
    10.0,
)  # deviations that a change takes; where the background shows none
# A codec takes one or two steps of 8-bit chroma at a key frame, 2 % of white's blue each, and
# leaves them: beyond the noise within seconds, chroma is off by so many deviations of it.
CHROMA_SURE, CHROMA_NOISE, CHROMA_JUMP = 6.0, 4.0, 15.0
# Where a codec repeats blocks nothing seems to be noise: it is so much of what is stated.
STATED, MOST_STATED = 0.25, 0.004
# of the background's change in that of the prints, from which it bears it out
BORNE_OUT = 0.3
DRIFT, CHROMA_DRIFT = (
    0.003,
    0.001,
)  # of the logarithm at rest, over the root of a second
HUBER = 1.345  # deviations beyond which a print disagrees with the others, and counts less
LEAST_SIGMA = 3e-4
NOISE_OVER = 31  # readings, of which the noise is told
# A step of luma's logarithm from one reading to the next: the light was switched. So much, and
# so many deviations, and but for this share what it is between what lies before and after.
STEP, STEP_SURE, ALIKE = 0.05, 11.0, 0.4
_PASSES = 30  # of alternating means: few prints that are seen in turn take that many


def small_luma(luma: ndarray) -> ndarray:
    """(36, 64) float32 of a frame's luma (h, w) uint8, for `background_change`."""
    width, height = WITNESS_PX
    thin = max(1, min(luma.shape[0] // (4 * height), luma.shape[1] // (4 * width)))
    picture = np.ascontiguousarray(luma[::thin, ::thin])
    return np.asarray(
        cv2.resize(picture, WITNESS_PX, interpolation=cv2.INTER_AREA), np.float32
    )


def background_change(before: ndarray, after: ndarray) -> float:
    """Logarithm of the light of what both small pictures show, after over before; NaN where
    that is next to nothing.

    A hand's motion is taken out as a shift. Most of the picture decides."""
    window = cv2.createHanningWindow(WITNESS_PX, cv2.CV_32F)
    a, b = (cv2.log(p + 1) for p in (before, after))
    (x, y), _ = cv2.phaseCorrelate(a - a.mean(), b - b.mean(), window)
    shift = np.array([[1, 0, x], [0, 1, y]])
    moved = cv2.warpAffine(before, shift, WITNESS_PX, flags=cv2.INTER_LINEAR)
    inside = (np.abs(np.stack([moved, after]) - 128) < WITHIN).all(0)
    if inside.mean() < 0.1:
        return float("nan")
    return float(GAMMA * np.median(np.log(after[inside] / moved[inside])))


def brightness(
    times_s: ndarray,
    frame: ndarray,
    print_: ndarray,
    level: ndarray,
    variance: ndarray,
    stood_on: ndarray,
    change: ndarray,
    turn: ndarray,
) -> ndarray:
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
        out += _smoothed(
            times_s, own, beside, variance[stood_on][which], rests, rests
        )
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
    jump, over = np.diff(luma[:, 0]), _difference(luma, SCALES[0])[1:, 0]
    sure = np.maximum(STEP, STEP_SURE * _noise(luma)[1:, 0])
    clear = (np.abs(jump) > sure) & (np.abs(over - jump) < ALIKE * np.abs(jump))
    return (times_s[:-1] + times_s[1:])[clear] / 2


def _smoothed(
    times_s: ndarray,
    seen: ndarray,
    level: ndarray,
    variance: ndarray,
    change: ndarray,
    turn: ndarray,
) -> ndarray:
    """(t, 3) levels of all frames out of those of `seen` (n,): level (n, 3), variance (n,)."""
    from scipy.ndimage import maximum_filter1d

    usual = float(np.median(variance))
    size = np.clip(variance / usual, 0.25, 1e4)[:, None]
    least = min(STATED * np.sqrt(usual), MOST_STATED) + LEAST_SIGMA

    def between(of_frames: ndarray) -> ndarray:
        """(n - 1,) sums from each frame that was seen to the next."""
        return np.diff(np.cumsum(of_frames)[seen])

    unknown = np.append(True, between(np.isnan(change)) > 0)
    shown = np.append(0, between(np.nan_to_num(change))) * ~unknown
    clear = np.abs(shown) > np.maximum(
        LEAST_CHANGE, SURE * _noise(shown[:, None])[:, 0]
    )
    expected = np.where(clear, shown, 0.0)
    moves = maximum_filter1d(OFF * np.abs(expected), 3)
    root_s = np.sqrt(np.diff(times_s[seen]).clip(1e-6))
    turned = between(turn)

    def borne_out(found: ndarray, scale: int) -> ndarray:
        """(n, 1) deviations that a change of luma takes: what the background shows as well
        takes fewer.
        """
        around = np.convolve(shown, np.ones(2 * scale - 1))[scale - 1 :][: len(seen)]
        fine = unknown | (around * found[:, 0] > BORNE_OUT * found[:, 0] ** 2)
        return np.where(fine, SURE, DOUBTED)[:, None]

    luma = level.mean(1, keepdims=True)
    rest = np.hypot(DRIFT * root_s, TURN * turned)
    out = _followed(luma, size, least, rest, moves, expected, borne_out)
    size, still = size * CHROMA_NOISE**2, np.zeros(len(seen))
    rest = np.hypot(CHROMA_DRIFT * root_s, CHROMA_TURN * turned)
    takes = {scale: CHROMA_SURE for scale in SCALES} | {SCALES[0]: CHROMA_JUMP}
    chroma = level - luma
    out = out + _followed(
        chroma, size, least, rest, still, still, lambda _, scale: takes[scale]
    )
    return np.stack(
        [np.interp(times_s, times_s[seen], column) for column in out.T], -1
    )


def _followed(
    value: ndarray,
    size: ndarray,
    least: float,
    rest: ndarray,
    moves: ndarray,
    expected: ndarray,
    takes: Callable[[ndarray, int], ndarray | float],
) -> ndarray:
    """(n, c) of value (n, c), seen with noise of relative variance `size` (n, 1), whose
    deviation is `least` at least: a random walk that moves where something clearly changes.

    rest : (n - 1,) deviation of each step at rest;  moves : (n,) where it is known to move
    expected : (n,) step that leads there;  takes : deviations that a change (n, c) takes
    """
    noise = size * np.maximum(_noise(value), least) ** 2
    out = _solve(value, noise, np.hypot(rest, moves[1:]), expected)
    for scale in SCALES:
        off = value - out
        found = _difference(off, scale)
        deviation = 1.25 * np.sqrt(2 / scale) * np.maximum(_noise(off), least)
        clear = (np.abs(found) > takes(found, scale) * deviation).any(1)
        moves = np.maximum(moves, clear * np.abs(found).max(1) / scale)
        out = _solve(value, noise, np.hypot(rest, moves[1:]), expected)
    return out


def _solve(
    value: ndarray, noise: ndarray, walk: ndarray, expected: ndarray
) -> ndarray:
    """(n, c) random walk seen with noise, from all of past and future.

    value, noise : (n, c), its variance;  walk : (n - 1,) deviation of each step
    expected : (n,) of the step that leads there
    """
    from scipy.linalg import solveh_banded

    if len(value) == 1:  # LAPACK takes no matrix of one
        return value
    tie = 1 / walk**2
    pull = np.diff(tie * expected[1:], prepend=0, append=0)
    out = np.empty_like(value)
    for c, seen in enumerate(1 / noise.T):
        sums = seen + np.append(tie, 0) + np.append(0, tie)
        bands = np.stack([np.append(0, -tie), sums])
        out[:, c] = solveh_banded(bands, value[:, c] * seen - pull)
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
