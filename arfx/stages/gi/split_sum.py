"""How much of what lies about the mirrored direction a glossy surface reflects: F0 x a + b, by roughness and cosine of view.

The split sum of GGX with Smith's height-correlated G and Schlick's F, summed up once over the microfacets that the viewer
sees, as the reference traces it. Karis' fit of it (2014, for phones) is a fifth too dark for metal of roughness .4, and below
zero for what is rough and dark. Source: Karis 2013 (split sum); Heitz 2014 (G), 2018 (visible normals). Leaves out: light that
goes from microfacet to microfacet.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np

ROUGHNESSES, COSINES = 16, 32
_MICROFACETS = 512
_SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror
_FAST = {"contract", "nsz", "arcp"}


@lru_cache(maxsize=1)
def split_sum() -> np.ndarray:
    """(ROUGHNESSES, COSINES, 2) float32 (a, b) for roughness and cosine of view from 0 to 1, both ends included."""
    a = np.maximum(np.linspace(0, 1, ROUGHNESSES), _SMOOTHEST)[:, None, None] ** 2
    nv = np.maximum(np.linspace(0, 1, COSINES), 1e-3)[:, None]
    k = np.arange(_MICROFACETS)
    r, phi = np.sqrt((k + 0.5) / _MICROFACETS), 2 * np.pi * (k * 0.6180339887498949 % 1)
    across = np.sqrt(1 - nv * nv)
    # the view direction where the surface is stretched to a half ball, of which it sees a disc
    sx, sz = a * across / np.hypot(a * across, nv), nv / np.hypot(a * across, nv)
    x, y = r * np.cos(phi), r * np.sin(phi)
    s = (1 + sz) / 2
    y = (1 - s) * np.sqrt(1 - x * x) + s * y
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    # across the view, up the disc (both unit) and along the view; then shrunk back
    hx, hy, hz = a * (z * sx - y * sz), a * x, np.maximum(y * sx + z * sz, 1e-9)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hz = hx / length, hz / length
    vh = np.clip(across * hx + nv * hz, 0, 1)
    nl = 2 * vh * hz - nv
    a2, lit = a * a, np.clip(nl, 1e-6, None)
    seen = np.sqrt(a2 + (1 - a2) * nv * nv)
    # G2 over G1 of the view
    left = np.where(nl > 0, lit * (nv + seen) / (lit * seen + nv * np.sqrt(a2 + (1 - a2) * lit * lit)), 0.0)
    grazing = (1 - vh) ** 5
    out = np.stack([((1 - grazing) * left).mean(-1), (grazing * left).mean(-1)], -1)
    return np.ascontiguousarray(out, np.float32)


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def gloss_weights(table, roughness, cosine):  # pragma: no cover - compiled
    """(a, b) : F0 x a + b of what lies about the mirrored direction is reflected. table : `split_sum`, linear between entries"""
    one, zero = np.float32(1), np.float32(0)
    s = min(max(roughness, zero), one) * np.float32(table.shape[0] - 1)
    t = min(max(cosine, zero), one) * np.float32(table.shape[1] - 1)
    i, j = min(int(s), table.shape[0] - 2), min(int(t), table.shape[1] - 2)
    fs, ft = s - np.float32(i), t - np.float32(j)
    w00, w01, w10, w11 = (one - fs) * (one - ft), (one - fs) * ft, fs * (one - ft), fs * ft
    a = w00 * table[i, j, 0] + w01 * table[i, j + 1, 0] + w10 * table[i + 1, j, 0] + w11 * table[i + 1, j + 1, 0]
    b = w00 * table[i, j, 1] + w01 * table[i, j + 1, 1] + w10 * table[i + 1, j, 1] + w11 * table[i + 1, j + 1, 1]
    return a, b
