"""What a surface mirrors: the split sum of GGX with Smith's height-correlated G and Schlick's F.

Of what lies about the mirrored direction F0 x a + b is reflected, over the microfacets that the viewer sees, as the
reference traces it. Source: Karis 2013 (split sum); Heitz 2014 (G), 2018 (visible normals); docs/methods/gi.md#gloss.
Leaves out: light from microfacet to microfacet."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache

import numpy as np

from arfx.core.compiled import line_kernel

ROUGHNESSES, COSINES = 16, 32  # entries of the split sum's table
_MICROFACETS = 512
_SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror
_BEND = 0.5  # normals of neighbours that differ by more lie on two sides of an edge


def mirror_tangent(roughness: np.ndarray | float) -> np.ndarray:
    """Tangent of the half-angle of a cone about the mirrored direction that blurs like a GGX lobe of width roughness^2.

    Half of the microfacets' normals lie within atan(a) (GGX: D integrates to tan^2 / (a^2 + tan^2)); the mirrored
    direction turns twice as far. Of a cone, half lies within 1 / sqrt(2) of its half-angle: so it is that much wider."""
    a = np.clip(np.asarray(roughness, float), 0.0, 1.0) ** 2
    return np.clip(np.tan(np.minimum(np.sqrt(8) * np.arctan(a), np.radians(50))), 0.01, None)


def gloss_weights(roughness: float, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(a, b), each (n,): F0 x a + b of what lies about the mirrored direction is reflected. cosine (n,) : of the view"""
    at = np.full(len(cosine), roughness * (ROUGHNESSES - 1)), cosine * (COSINES - 1)
    from scipy.ndimage import map_coordinates

    a, b = (
        map_coordinates(part, at, order=1, mode="nearest")
        for part in np.moveaxis(split_sum(), 2, 0)
    )
    return a, b


@line_kernel(fastmath={"contract", "nsz", "arcp"})
def table_entry(table, roughness, cosine):  # pragma: no cover - compiled
    """(a, b) of one view. table : `split_sum`, linear between entries"""
    one, zero = np.float32(1), np.float32(0)
    s = min(max(roughness, zero), one) * np.float32(table.shape[0] - 1)
    t = min(max(cosine, zero), one) * np.float32(table.shape[1] - 1)
    i, j = min(int(s), table.shape[0] - 2), min(int(t), table.shape[1] - 2)
    fs, ft = s - np.float32(i), t - np.float32(j)
    low, high = table[i], table[i + 1]
    a = (one - fs) * (low[j, 0] + ft * (low[j + 1, 0] - low[j, 0]))
    a += fs * (high[j, 0] + ft * (high[j + 1, 0] - high[j, 0]))
    b = (one - fs) * (low[j, 1] + ft * (low[j + 1, 1] - low[j, 1]))
    return a, b + fs * (high[j, 1] + ft * (high[j + 1, 1] - high[j, 1]))


def widened_roughness(
    roughness: np.ndarray, coverage: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """(h, w) roughness whose lobe is as wide as what one pixel of the curved surface mirrors, if that is more than its own.

    Neighbours whose normals differ by d mirror directions 2 d apart: half of that is the half-angle. Without it a
    mirror's rim shows every n-th pixel of what it squeezes together. roughness, coverage (h, w);  normal (h, w, 3)"""
    most = np.zeros(coverage.shape, np.float32)
    for axis in (0, 1):
        apart = (np.diff(normal, axis=axis) ** 2).sum(-1)
        covered = coverage > 0
        first, last = ([slice(None)] * 2 for _ in range(2))
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        before, after = tuple(first), tuple(last)
        apart *= covered[before] & covered[after] & (apart < _BEND * _BEND)
        most[before] = np.maximum(most[before], apart)
        most[after] = np.maximum(most[after], apart)
    # mirror_tangent: about sqrt(8) roughness^2
    return np.maximum(roughness, np.sqrt(0.35355 * np.sqrt(most)))


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
    a2, light = a * a, np.clip(nl, 1e-6, None)
    view = np.sqrt(a2 + (1 - a2) * nv * nv)
    # G2 over G1 of the view
    lit = light * view + nv * np.sqrt(a2 + (1 - a2) * light * light)
    unmasked = np.where(nl > 0, light * (nv + view) / lit, 0.0)
    grazing = (1 - vh) ** 5
    out = np.stack([((1 - grazing) * unmasked).mean(-1), (grazing * unmasked).mean(-1)], -1)
    return np.ascontiguousarray(out, np.float32)
