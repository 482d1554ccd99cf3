"""Four channels at once: read before any is written, so that the compiler's SLP pass makes one
vector of them.

Nothing here looks whether a place is inside of its array; indices are unsigned, which spares a
test for negative ones."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

_U = np.uintp


@numba.njit(nogil=True)
def put_four(out, at, a, b, c, d):  # pragma: no cover - compiled
    """out[at : at + 4] = a, b, c, d. out : flat. Three and one to be overwritten are quicker
    written than three."""
    i = _U(at)
    out[i], out[i + _U(1)], out[i + _U(2)], out[i + _U(3)] = a, b, c, d
