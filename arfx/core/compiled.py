"""How loops are compiled that hand parts of arrays on to other compiled functions, line by line."""

from __future__ import annotations

from typing import Any

# Options of `numba.njit` for a function that counts no references to arrays. Every part of an array that is made or handed on
# costs two locked additions otherwise: a fifth of the time of a kernel that goes by lines, and more where two threads count
# the same array's. Such a function makes no arrays: one that counts makes the room to work in, holds what it is given, and
# calls it.
UNCOUNTED: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False}
