"""Compiling loops that hand parts of arrays on to other compiled functions, line by line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def uncounted(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator as `numba.njit(cache=True, nogil=True, ...)`, of which the compiled function counts no references to arrays:
    every part of an array that is made or handed on costs two locked additions otherwise, a fifth of a kernel's time that
    goes by lines, and more where two threads count the same array's. Such a function makes no arrays: one that counts makes
    the room that it works in, holds what it is given, and calls it.
    """
    decorate: Callable[[Callable[..., Any]], Any] = numba.njit(cache=True, nogil=True, _nrt=False, **options)
    return decorate
