"""Compiled: blurred layers over one another.

Two layers make the silhouette of the virtual object exact: behind it is the clean plate with the
shadow, as the composite has it, so what a blurred edge lets through is known."""

# mypy: disable-error-code="no-untyped-def, call-arg"
from __future__ import annotations

import numpy as np

from arfx.core.compiled import FAST, line_kernel
from arfx.stages.dof.aperture import SHARP_PX

_SHARP_PX2 = np.float32(SHARP_PX**2)


@line_kernel(fastmath=FAST)
def lay_over(out, touched, spread, light, radius, sharp_px2):  # pragma: no cover - compiled
    """out (h, w, 3) under a layer before it; touched (h, w) = 1 where light of it was spread to.

    spread (h, w, c) : that light;  light (h, w, c) : before it was spread, from pixels of radius.
    Of 5 channels the last is the weight of what the layer lets through"""
    zero = np.float32(0)
    one = np.float32(1)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            # fraction of a pixel's light that is not spread
            share = (sharp_px2 - radius[y, x] * radius[y, x]) / (sharp_px2 - _SHARP_PX2)
            share = min(max(share, zero), one)
            weight = spread[y, x, 3] + share * light[y, x, 3]
            if weight > zero:
                total = weight
                for c in range(4, light.shape[2]):
                    total += spread[y, x, c] + share * light[y, x, c]
                inverse = one / total
                rest = max(one - weight * inverse, zero)
                if spread[y, x, 3] > zero:
                    touched[y, x] = 1
                for c in range(3):
                    own = (spread[y, x, c] + share * light[y, x, c]) * inverse
                    out[y, x, c] = out[y, x, c] * rest + own
