"""Between stored samples and linear light, over a rectangle: two compiled loops.

A pixel's coded values come from its planes by one matrix, chroma being linear between its
samples; what they mean in linear light, and the way back, are tables of the transfer
function with straight lines between their entries. Nothing is clipped when reading: values
beyond black and white come out below 0 and above 1. RGB and grey go the same way, with
another matrix.

A table has 64 entries for each step of the samples (up to 12 bits) when it is read, and when
it is written a 16th of a step lies between two (a 4th from 13 bits on), so that what is not
changed keeps its bits and what is lies within a step."""

# mypy: disable-error-code="no-untyped-def, index, assignment, call-arg, var-annotated"
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.colour import Transfer, yuv_from_rgb
from arfx.core.compiled import FAST, kernel, line_kernel

if TYPE_CHECKING:
    from arfx.media.clip import ClipInfo

_F, _I, _U = np.float32, np.int32, np.uint32
MARGIN = 16  # values by which lines of chroma are longer than the picture's part
CODED_LEAST, CODED_MOST = (
    -1.5,
    2.5,
)  # beyond every sum that the matrices make of samples
DARKEST, BRIGHTEST = (
    -32,
    8,
)  # first and last octave of linear light that is told apart

Rows = tuple[tuple[np.float32, ...], ...]


class Samples(NamedTuple):
    """What stored samples stand for.

    size : columns and rows of the picture;  steps : log2 of the chroma step (x, y), 0 or 1
    levels : (3, 5) of each plane's samples: that of 0, size of a step, steps up to 1, lowest
    and highest legal one
    rgb_from_planes, planes_from_rgb : (3, 3), coded
    middle : 0 where chroma lies on the left luma sample of its group, 0.5 in its middle; of
    rows it lies in the middle
    taps : weights in chroma of the luma samples before, at and behind the first of a group
    of two; 1 where there are no groups
    decoding, encoding : (n,) float32 tables;  scale : entries of the first to one;  shift :
    bits of a float that the second leaves out
    """

    size: tuple[int, int]
    steps: tuple[int, int]
    levels: Rows
    rgb_from_planes: Rows
    planes_from_rgb: Rows
    middle: np.float32
    taps: ndarray
    decoding: ndarray
    encoding: ndarray
    scale: np.float32
    shift: np.int32


def decoding_table(transfer: Transfer, bits: int) -> ndarray:
    """(n,) float32 linear light of coded values from CODED_LEAST to CODED_MOST, 2^bits to one."""
    coded = np.arange(CODED_LEAST * 2**bits, CODED_MOST * 2**bits + 1) / 2**bits
    return transfer.decode(coded).astype(np.float32)


def encoding_table(transfer: Transfer, bits: int) -> ndarray:
    """(n,) float32 coded values of linear ones, 2^bits an octave from DARKEST on: each from
    a float's exponent and first bits to the next."""
    k = np.arange((127 + DARKEST) << bits, (127 + BRIGHTEST) << bits)
    first = (k << (23 - bits)).astype(np.uint32).view(np.float32).astype(float)
    middle = first * (1 + 2.0 ** -(bits + 2))
    middle[0] = 0
    return transfer.encode(middle).astype(np.float32)


# Places in a table and what lies there in loops apart: the first becomes vector code, and the
# second is twice as quick alone.
@line_kernel(fastmath=FAST)
def _looked_up(table, places, out):
    for i in range(out.shape[0]):
        out[i] = table[places[i]]


@line_kernel(fastmath=FAST)
def _chroma_line(s, plane, level, row, left, samples, out):
    """out[: w + 2^step] = a line of chroma at the luma columns from the group of `left` on,
    up to the last of w = len(out) - MARGIN. samples : scratch"""
    (width, height), (sx, sy) = s.size, s.steps
    last = (height - 1) >> sy
    place = min(max((_F(row) + _F(0.5)) / _F(1 << sy) - _F(0.5), _F(0)), _F(last))
    r0 = _I(place)
    share = place - _F(r0)
    first = (left >> sx) - 1  # with one sample more at both ends
    n = ((left + out.shape[0] - MARGIN - 1) >> sx) - first + 2
    a, b = max(-first, 0), min(n, -(-width >> sx) - first)
    above = plane[r0][first + a : first + b]
    below = plane[min(r0 + 1, last)][first + a : first + b]
    inner = samples[a:b]
    for k in range(b - a):
        top = _F(above[k])
        inner[k] = (top + share * (_F(below[k]) - top) - level[0]) * level[1]
    samples[0], samples[n - 1] = samples[a], samples[b - 1]
    if sx == 0:
        for k in range(n - 2):
            out[k] = samples[k + 1]
        return
    before, behind = s.middle * _F(0.5), _F(0.5) - s.middle * _F(0.5)
    for k in range(n - 2):
        x = samples[k + 1]
        out[2 * k] = x + before * (samples[k] - x)
        out[2 * k + 1] = x + behind * (samples[k + 2] - x)


@line_kernel(fastmath=False)  # so sums of three products are rounded alike everywhere
def _coded_line(s, planes, row, left, scratch, out):
    """out (w, 3) = R'G'B' of one line from column `left` on. scratch : lines"""
    w, level, (red, green, blue) = out.shape[0] // 3, s.levels[0], s.rgb_from_planes
    for c in range(2):
        line = scratch[c][: w + MARGIN]
        _chroma_line(s, planes[1 + c], s.levels[1 + c], row, left, scratch[2], line)
    start = left & s.steps[0]
    u, v = scratch[0][start:], scratch[1][start:]
    luma = planes[0][row][left : left + w]
    one, two, three = np.uintp(1), np.uintp(2), np.uintp(3)
    for k in range(w):
        i, y = np.uintp(k) * three, (_F(luma[k]) - level[0]) * level[1]
        out[i] = red[0] * y + red[1] * u[k] + red[2] * v[k]
        out[i + one] = green[0] * y + green[1] * u[k] + green[2] * v[k]
        out[i + two] = blue[0] * y + blue[1] * u[k] + blue[2] * v[k]


@kernel(fastmath=FAST)
def read(s, planes, rect, out):
    """out (h, w, 3) float32 linear RGB of coded `rect` (x0, y0, x1, y1)."""
    w = out.shape[1]
    lines, places = np.empty((3, w + MARGIN), _F), np.empty(3 * w, _U)
    last = _I(s.decoding.shape[0] - 1)
    for j in range(out.shape[0]):
        line = out[j].reshape(-1)
        _coded_line(s, planes, rect[1] + j, rect[0], lines, line)
        for i in range(line.shape[0]):
            place = _I((line[i] - _F(CODED_LEAST)) * s.scale + _F(0.5))
            places[i] = _U(max(min(place, last), _I(0)))
        _looked_up(s.decoding, places, line)


@kernel(fastmath=FAST)
def add(s, planes, target, rect, before, after):
    """Adds the difference of two pictures to stored samples.

    planes : as they are read;  target : copies of them, which are changed;  rect : coded
    before, after : (h, w, 3) float32 linear light; equal values change nothing
    Only chroma samples of the rectangle, grown to their grid, can change. Returns whether
    `after` is finite; else `target` is worth nothing."""
    (x0, y0, x1, y1), (sx, sy), w = rect, s.steps, before.shape[1]
    lines, places = np.empty((3, w + MARGIN), _F), np.empty(3 * w, _U)
    values = np.empty((2, 3 * w), _F)
    origin, top = x0 >> sx, y0 >> sy
    sums = np.zeros((2, -(-y1 >> sy) - top, -(-x1 >> sx) - origin), _F)
    for j in range(before.shape[0]):
        old, new = before[j].reshape(-1), after[j].reshape(-1)
        first, last = 0, old.shape[0]
        while first < last and old[first] == new[first]:
            first += 1
        while last > first and old[last - 1] == new[last - 1]:
            last -= 1
        first, last = first // 3, (last + 2) // 3
        if last <= first:
            continue
        old, new = old[3 * first : 3 * last], new[3 * first : 3 * last]
        row, left = y0 + j, x0 + first
        coded, wanted = values[0][: old.shape[0]], values[1][: old.shape[0]]
        _coded_line(s, planes, row, left, lines, coded)
        if not _differences(s, old, new, coded, wanted, places):
            return False
        luma = target[0][row][left : x0 + last]
        _add_line(s, luma, row, left, coded, rect, lines, sums)
    for c in range(2):
        for r in range(sums.shape[1]):
            _add_steps(target[1 + c][top + r][origin:], sums[c, r], s.levels[1 + c])
    return True


@line_kernel(fastmath=FAST)
def _differences(s, before, after, coded, wanted, places):
    """coded (3 n,), of `before`, becomes the difference to that of `after`, which is kept
    between black and white or where it already lay beyond. Returns whether `after` is
    finite. wanted, places : scratch"""
    bits = after.view(np.int32)
    infinite, highest = _I(0x7F800000), _I(0)  # all bits of the exponent are set
    for i in range(bits.shape[0]):
        highest = max(highest, _I(bits[i] & infinite))
    last, first = _I(s.encoding.shape[0] - 1), _I((127 + DARKEST) << 23)
    none, positive = _I(0), _I(0x7FFFFFFF)
    for i in range(bits.shape[0]):
        place = _I(_I(_I(bits[i] & positive) - first) >> s.shift)
        places[i] = _U(max(min(place, last), none))
    _looked_up(s.encoding, places, wanted)
    zero, one = _F(0), _F(1)
    for i in range(before.shape[0]):
        old, new = coded[i], wanted[i] if after[i] >= zero else -wanted[i]
        new = min(max(new, min(old, zero)), max(old, one))
        coded[i] = zero if before[i] == after[i] else new - old
    return highest < infinite


@line_kernel(fastmath=FAST)
def _add_steps(line, differences, level):
    """Differences (n,) in steps, rounded, to stored samples; legal ones stay legal, others
    go no further out."""
    scale, low, high = level[2], level[3], level[4]
    for k in range(differences.shape[0]):
        old = _F(line[k])
        new = old + np.rint(differences[k] * scale)
        line[k] = _I(min(max(new, min(old, low)), max(old, high)))


@line_kernel(fastmath=FAST)
def _add_line(s, luma, row, left, coded, rect, scratch, sums):
    """Adds the differences `coded` (n, 3) of one line to its luma and to the sums of chroma.
    Beyond the line they are zero, beyond the picture its edge goes on."""
    (width, height), (sx, sy), (to_y, to_u, to_v) = s.size, s.steps, s.planes_from_rgb
    n, top, origin = luma.shape[0], rect[1] >> sy, rect[0] >> sx
    start = (left & sx) + sx  # place of the first pixel in a line
    end = start + n
    y, u, v = scratch[0][:n], scratch[1][start:end], scratch[2][start:end]
    one, two, three = np.uintp(1), np.uintp(2), np.uintp(3)
    for k in range(n):
        i = np.uintp(k) * three
        r, g, b = coded[i], coded[i + one], coded[i + two]
        y[k] = to_y[0] * r + to_y[1] * g + to_y[2] * b
        u[k] = to_u[0] * r + to_u[1] * g + to_u[2] * b
        v[k] = to_v[0] * r + to_v[1] * g + to_v[2] * b
    _add_steps(luma, y, s.levels[0])
    for c in range(1, 3):
        line = scratch[c]
        line[:start] = line[start] if left == 0 else _F(0)
        line[end : end + 2 + sx] = line[end - 1] if left + n == width else _F(0)
    first, last = (left >> sx) - origin, ((left + n - 1) >> sx) + 2 - origin
    group = row >> sy
    weight = _F(1) / _F(1 << sy)
    if row == height - 1:  # it stands for those beyond as well
        weight *= _F(((group + 1) << sy) - row)
    for c in range(2):
        line = sums[c][group - top][first:last]  # ends with the rectangle
        _add_reduced(scratch[1 + c], s.taps, weight, line)


@line_kernel(fastmath=FAST)
def _add_reduced(line, taps, weight, out):
    """out[i] += weight times the sum of the samples of `line` about i's group, or of the i-th."""
    if taps.shape[0] == 1:
        for i in range(out.shape[0]):
            out[i] += weight * line[i]
        return
    a, b, c = weight * taps[0], weight * taps[1], weight * taps[2]
    for i in range(out.shape[0]):
        out[i] += a * line[2 * i] + b * line[2 * i + 1] + c * line[2 * i + 2]


def _float32(values: Any) -> Any:
    """Nested tuples of them: the compiler knows that nobody writes to these."""
    if np.ndim(values):
        return tuple(map(_float32, values))
    return np.float32(values)


@lru_cache(maxsize=8)
def samples_of(clip: "ClipInfo") -> Samples:
    """What the samples of a clip stand for."""
    layout = clip.layout
    luma, chroma = (
        (zero, 1 / n, n, *legal) for zero, n, *legal in layout.stored(clip.full_range)
    )
    from_rgb = yuv_from_rgb(clip.matrix)
    to_rgb = np.linalg.inv(from_rgb)
    if layout.kind == "rgb":  # as green, blue, red
        from_rgb, chroma = np.eye(3)[[1, 2, 0]], luma
        to_rgb = from_rgb.T
    elif (
        layout.kind == "gray"
    ):  # three times the same plane: no difference of "chroma"
        from_rgb, to_rgb = from_rgb * [[1], [0], [0]], np.ones((3, 3)) * [1, 0, 0]
    cosited = clip.chroma_location == "left"
    halved = (0.25, 0.5, 0.25) if cosited else (0, 0.5, 0.5)
    taps = np.array(halved if layout.sub_x else (1,), np.float32)
    fine = min(layout.depth + 2, 14)
    return Samples(
        (clip.coded_width, clip.coded_height),
        (layout.sub_x, layout.sub_y),
        _float32((luma, chroma, chroma)),
        _float32(to_rgb),
        _float32(from_rgb),
        np.float32(0 if cosited else 0.5),
        taps,
        decoding_table(clip.transfer, fine + 4),
        encoding_table(clip.transfer, fine),
        np.float32(2 ** (fine + 4)),
        np.int32(23 - fine),
    )


def three(planes: list[ndarray]) -> Any:
    """The planes for the loops: grey three times."""
    return tuple((planes * 3)[:3])
