"""A number for the content of arrays, to know a frame that was painted before. Equal by chance once in 10^9.

Source: NH, the sum of products of UMAC (Black et al. 1999), over rows of 4 KB, which are then chained."""

from __future__ import annotations

import numba
import numpy as np

from arfx.core.parallel import parallel_rows

ROW = 512  # words of 64 bits
_SMALL = 4096  # rows: below it threads cost more than they save
_U = np.uint64
# Random; both halves are negative numbers, so that none hides a pixel by being its equal
_KEYS = np.random.default_rng(0xD16E57).integers(0, 1 << 63, ROW, np.uint64) | _U(
    0x8000000080000000
)


def digest(array: np.ndarray) -> int:
    """Of a contiguous array, at the speed of memory; any other is copied first."""
    data = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    words = data[: data.size // 8 * 8].view(_U)
    rows = words.size // ROW
    whole, rest = words[: rows * ROW].reshape(-1, ROW), words[rows * ROW :]
    parts = (
        parallel_rows(lambda a, b: int(_digest(whole, a, b)), rows)
        if rows >= _SMALL
        else [int(_digest(whole, 0, rows))]
    )
    return hash(
        (tuple(parts), int(_row(rest, rest.size)), data[words.size * 8 :].tobytes(), array.shape)
    )


@numba.njit(cache=True, nogil=True, inline="always")
def _row(words, n):  # pragma: no cover - compiled
    """Sum of products of both halves of every word, each with a key: in steps of a vector unit."""
    total = _U(0)
    for k in range(n):
        v = words[k] ^ _KEYS[k]
        total += (v & _U(0xFFFFFFFF)) * (v >> _U(32))
    return total


@numba.njit(cache=True, nogil=True)
def _digest(words, a, b):  # pragma: no cover - compiled
    out = _U(14695981039346656037)
    for row in range(a, b):
        out = (out ^ _row(words[row], ROW)) * _U(0x9E3779B97F4A7C15)
        out ^= out >> _U(29)
    return out
