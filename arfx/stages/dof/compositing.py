"""Compiled: blurred layers over one another.

Two layers make the silhouette of the virtual object exact: behind it is the clean plate with the
shadow, as the composite has it, so what a blurred edge lets through is known."""

# mypy: disable-error-code="no-untyped-def, call-arg"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.dof.aperture import SHARP_PX

_FLAGS = {"contract", "nsz", "arcp"}
_SHARP_PX2 = np.float32(SHARP_PX**2)


@numba.njit(nogil=True, fastmath=_FLAGS)
def sharp_share(radius, sharp_px2):  # pragma: no cover - compiled
    """Fraction of a pixel's light that is not spread."""
    share = (sharp_px2 - radius * radius) / (sharp_px2 - _SHARP_PX2)
    return min(max(share, np.float32(0)), np.float32(1))


@line_kernel(fastmath=_FLAGS)
def lay_real(out, touched, spread, light, radius, sharp_px2):  # pragma: no cover - compiled
    """out (h, w, 3) = the real scene, and touched (h, w) = 1, where light was spread to.

    spread (h, w, 4) : that light;  light (h, w, 4) : before it was spread, from pixels of radius
    """
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            if spread[y, x, 3] > 0:
                share = sharp_share(radius[y, x], sharp_px2)
                inverse = np.float32(1) / (spread[y, x, 3] + share * light[y, x, 3])
                touched[y, x] = 1
                for c in range(3):
                    out[y, x, c] = (spread[y, x, c] + share * light[y, x, c]) * inverse
            else:
                for c in range(3):
                    out[y, x, c] = light[y, x, c]


@line_kernel(fastmath=_FLAGS)
def lay_over(out, touched, spread, light, radius, sharp_px2):  # pragma: no cover - compiled
    """out (h, w, 3) under a layer before it; touched (h, w) = 1 where light of it was spread to.

    spread, light (h, w, 5) : the last is the weight of what the layer lets through"""
    one = np.float32(1)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            share = sharp_share(radius[y, x], sharp_px2)
            weight = spread[y, x, 3] + share * light[y, x, 3]
            if weight > 0:
                inverse = one / (weight + spread[y, x, 4] + share * light[y, x, 4])
                rest = max(one - weight * inverse, np.float32(0))
                if spread[y, x, 3] > 0:
                    touched[y, x] = 1
                for c in range(3):
                    own = (spread[y, x, c] + share * light[y, x, c]) * inverse
                    out[y, x, c] = out[y, x, c] * rest + own
