"""Vectors of three numbers in compiled loops, tuples or rows of arrays, and places in rows."""

# mypy: disable-error-code="no-untyped-def"
import numpy as np

from arfx.core.compiled import FAST, line_kernel


@line_kernel(fastmath=FAST)
def vector(values):  # pragma: no cover - compiled
    """A row of an array as a tuple."""
    return values[0], values[1], values[2]


@line_kernel(fastmath=FAST)
def dot(a, b):  # pragma: no cover - compiled
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@line_kernel(fastmath=FAST)
def cross(a, b):  # pragma: no cover - compiled
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@line_kernel(fastmath=FAST)
def scaled(by, a):  # pragma: no cover - compiled
    return by * a[0], by * a[1], by * a[2]


@line_kernel(fastmath=FAST)
def minus(a, b):  # pragma: no cover - compiled
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@line_kernel(fastmath=FAST)
def shifted(a, by, b):  # pragma: no cover - compiled
    """a + by * b"""
    return a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]


@line_kernel(fastmath=FAST)
def mixed(a, b, share):  # pragma: no cover - compiled
    """a where the share is 0, b where it is 1"""
    return shifted(a, share, minus(b, a))


@line_kernel(fastmath=FAST, error_model="numpy")
def unit(a):  # pragma: no cover - compiled
    """a with length 1; nothing stays nothing."""
    return scaled(np.float32(1) / np.sqrt(max(dot(a, a), np.float32(1e-12))), a)


@line_kernel(fastmath=FAST)
def turned(matrix, a):  # pragma: no cover - compiled
    """matrix (3, 3 or more) @ a, of the first three columns"""
    return dot(matrix[0], a), dot(matrix[1], a), dot(matrix[2], a)


@line_kernel(fastmath=FAST)
def placed(matrix, a):  # pragma: no cover - compiled
    """matrix (3, 4 or more) @ (a, 1), of the first four columns"""
    x, y, z = turned(matrix, a)
    return x + matrix[0, 3], y + matrix[1, 3], z + matrix[2, 3]


@line_kernel(fastmath=FAST)
def cell(t, count):  # pragma: no cover - compiled
    """(first, share): between which two of `count` places in a row t lies, and how far from the
    first, 0..1; beyond them at the outermost."""
    inside = min(max(np.float32(0), t), np.float32(count - 1.001))
    first = np.int64(inside)
    return first, inside - np.float32(first)
