"""Vectors of three numbers as tuples, inside compiled loops: each call becomes its own lines."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba


@numba.njit(inline="always")
def vector(rows, i, first):  # pragma: no cover - compiled
    """Three columns of row i."""
    return rows[i, first], rows[i, first + 1], rows[i, first + 2]


@numba.njit(inline="always")
def dot(a, b):  # pragma: no cover - compiled
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(inline="always")
def cross(a, b):  # pragma: no cover - compiled
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@numba.njit(inline="always")
def minus(a, b):  # pragma: no cover - compiled
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit(inline="always")
def scaled(a, by):  # pragma: no cover - compiled
    return a[0] * by, a[1] * by, a[2] * by


@numba.njit(inline="always")
def divided(a, by):  # pragma: no cover - compiled
    return a[0] / by, a[1] / by, a[2] / by


@numba.njit(inline="always")
def shifted(a, by, b):  # pragma: no cover - compiled
    """a + by * b"""
    return a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]


@numba.njit(inline="always")
def rotated(rotation, a):  # pragma: no cover - compiled
    """rotation (3, 3) @ a"""
    return (
        dot(vector(rotation, 0, 0), a),
        dot(vector(rotation, 1, 0), a),
        dot(vector(rotation, 2, 0), a),
    )
