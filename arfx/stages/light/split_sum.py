"""What a rough surface mirrors of even light, by roughness and angle: the split sum's second part.

GGX with Smith's height-correlated shadowing and Schlick's Fresnel term, over the
microfacets that the viewer sees. Karis' fit of it (2014, for phones) is a fifth too dark
for metal of roughness .4, and below zero for what is rough and dark.
Source: Karis 2013; Heitz 2014 (shadowing), 2018 (visible normals)."""

# mypy: disable-error-code="no-untyped-def"
from functools import lru_cache

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel

ROUGHNESSES, COSINES = 16, 32  # entries of the table
_MICROFACETS = 512
_SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror
_GOLDEN = 0.6180339887498949


@lru_cache(maxsize=1)
def split_sum() -> ndarray:
    """(ROUGHNESSES, COSINES, 2) float32 (a, b) for roughness and cosine of view from 0 to
    1, both ends included: F0 x a + b is mirrored."""
    a = np.maximum(np.linspace(0, 1, ROUGHNESSES), _SMOOTHEST)[:, None, None] ** 2
    nv = np.maximum(np.linspace(0, 1, COSINES), 1e-3)[:, None]
    k = np.arange(_MICROFACETS)
    r, phi = np.sqrt((k + 0.5) / _MICROFACETS), 2 * np.pi * (k * _GOLDEN % 1)
    across = np.sqrt(1 - nv * nv)
    # the view direction where the surface is stretched to a half ball, of which it sees a disc
    length = np.hypot(a * across, nv)
    sx, sz = a * across / length, nv / length
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
    a2, light = a * a, np.clip(nl, 1e-6, None)
    view = np.sqrt(a2 + (1 - a2) * nv * nv)
    shadowed = light * view + nv * np.sqrt(a2 + (1 - a2) * light * light)
    unmasked = np.where(
        nl > 0, light * (nv + view) / shadowed, 0.0
    )  # G2 over G1 of the view
    grazing = (1 - vh) ** 5
    out = np.stack(
        [((1 - grazing) * unmasked).mean(-1), (grazing * unmasked).mean(-1)], -1
    )
    return np.ascontiguousarray(out, np.float32)


@line_kernel(fastmath=FAST)
def table_entry(table, roughness, cosine):  # pragma: no cover - compiled
    """The two values of a table (m, n, 2) over roughness and cosine, 0..1 each, linear
    between its entries.
    """
    one, zero = np.float32(1), np.float32(0)
    s = min(max(roughness, zero), one) * np.float32(table.shape[0] - 1)
    t = min(max(cosine, zero), one) * np.float32(table.shape[1] - 1)
    i, j = (
        np.uintp(min(int(s), table.shape[0] - 2)),
        np.uintp(min(int(t), table.shape[1] - 2)),
    )
    fs, ft = s - np.float32(i), t - np.float32(j)
    below, right = i + np.uintp(1), j + np.uintp(1)
    w00, w01 = (one - fs) * (one - ft), (one - fs) * ft
    w10, w11 = fs * (one - ft), fs * ft
    a = w00 * table[i, j, 0] + w01 * table[i, right, 0]
    a += w10 * table[below, j, 0] + w11 * table[below, right, 0]
    b = w00 * table[i, j, 1] + w01 * table[i, right, 1]
    b += w10 * table[below, j, 1] + w11 * table[below, right, 1]
    return a, b
