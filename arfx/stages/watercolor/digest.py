"""A number for the content of arrays, to know a frame that was painted before. equal by chance once in 10^9."""

from __future__ import annotations

import numba
import numpy as np

from arfx.stages.bands import by_bands

_SMALL = 4096  # rows: below it threads cost more than they save
LANES = 64  # independent ones, so that none waits for another


def digest(array: np.ndarray) -> int:
    """Of a contiguous array of 4 bytes each, at the speed of memory; any other array is copied first."""
    flat = np.ascontiguousarray(array).reshape(-1)
    if flat.itemsize != 4:
        flat = np.pad(flat.view(np.uint8), (0, -flat.nbytes % 4))
    words = flat.view(np.uint32)
    whole = words[: words.size // LANES * LANES].reshape(-1, LANES)
    small = whole.shape[0] < _SMALL
    parts = (
        [int(_digest(whole, 0, whole.shape[0]))] if small else by_bands(lambda a, b: int(_digest(whole, a, b)), whole.shape[0])
    )
    return hash((tuple(parts), words[whole.size :].tobytes(), array.shape))


@numba.njit(cache=True, nogil=True)
def _digest(words, a, b):  # pragma: no cover - compiled
    """Both halves in turns: memory that is read in two places comes half as fast again."""
    lanes, odd = np.full((2, LANES), np.uint32(0x9E3779B9), np.uint32), np.empty(LANES, np.uint32)
    for k in range(LANES):
        odd[k] = np.uint32(0x85EBCA6B + 2 * k * 0x27D4EB)
    half = (b - a) // 2
    for row in range(a, a + half):
        for k in range(LANES):
            v = (lanes[0, k] ^ words[row, k]) * odd[k]
            lanes[0, k] = v ^ (v >> np.uint32(15))
        for k in range(LANES):
            v = (lanes[1, k] ^ words[row + half, k]) * odd[k]
            lanes[1, k] = v ^ (v >> np.uint32(15))
    for row in range(a + 2 * half, b):
        for k in range(LANES):
            v = (lanes[1, k] ^ words[row, k]) * odd[k]
            lanes[1, k] = v ^ (v >> np.uint32(15))
    out = np.uint64(14695981039346656037)
    for h in range(2):
        for k in range(LANES):
            out = (out ^ np.uint64(lanes[h, k])) * np.uint64(1099511628211)
            out ^= out >> np.uint64(29)
    return out
