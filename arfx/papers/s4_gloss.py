"""Gloss in step 4 of Yao, Tao, Wu 2018: how wide the mirror cone of a rough surface is, and how
much it reflects.

The paper speaks of one narrow cone and leaves both open. Here GGX microfacets: Karis 2013 (split
sum), Heitz 2014 (Smith's G), 2018 (normals that the viewer sees)."""

from __future__ import annotations

from functools import cache

import numpy as np

ROUGHNESSES, COSINES = 16, 32  # entries of the table
MICROFACETS = 512
SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror


def mirror_tangent(roughness: np.ndarray | float) -> np.ndarray:
    """Tangent of the half-angle of a cone about the mirrored direction that blurs like a GGX lobe
    of width roughness^2.

    Half of the microfacets' normals lie within atan(a) (GGX: D integrates to tan^2 / (a^2 +
    tan^2)); the mirrored direction turns twice as far. Of a cone, half lies within 1 / sqrt(2) of
    its half-angle: so it is that much wider."""
    a = np.clip(np.asarray(roughness, float), 0.0, 1.0) ** 2
    half_angle = np.minimum(np.sqrt(8) * np.arctan(a), np.radians(50))
    return np.clip(np.tan(half_angle), 0.01, None)


def fresnel(roughness: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(a, b), (m, 1) each: F0 a + b of the mirrored light is reflected. roughness, cosine of view
    (m,)"""
    row = np.rint(np.clip(roughness, 0, 1) * (ROUGHNESSES - 1)).astype(int)
    column = np.rint(np.clip(cosine, 0, 1) * (COSINES - 1)).astype(int)
    entry = split_sum()[row, column]
    return entry[:, :1], entry[:, 1:]


@cache
def split_sum() -> np.ndarray:
    """(ROUGHNESSES, COSINES, 2) float32 (a, b) for roughness and cosine of view from 0 to 1, both
    ends included."""
    a = np.maximum(np.linspace(0, 1, ROUGHNESSES), SMOOTHEST)[:, None, None] ** 2
    nv = np.maximum(np.linspace(0, 1, COSINES), 1e-3)[:, None]
    across = np.sqrt(1 - nv * nv)
    # the view direction where the surface is stretched to a half ball, of which it sees a disc
    stretched = np.hypot(a * across, nv)
    sx, sz = a * across / stretched, nv / stretched
    k = np.arange(MICROFACETS)
    r = np.sqrt((k + 0.5) / MICROFACETS)
    phi = 2 * np.pi * (k * 0.6180339887498949 % 1)
    x, y = r * np.cos(phi), r * np.sin(phi)
    s = (1 + sz) / 2
    y = (1 - s) * np.sqrt(1 - x * x) + s * y
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    # the microfacet's normal, shrunk back
    hx, hy, hz = a * (z * sx - y * sz), a * x, np.maximum(y * sx + z * sz, 1e-9)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hz = hx / length, hz / length
    vh = np.clip(across * hx + nv * hz, 0, 1)
    nl = 2 * vh * hz - nv
    a2, light = a * a, np.clip(nl, 1e-6, None)
    view = np.sqrt(a2 + (1 - a2) * nv * nv)
    shaded = light * view + nv * np.sqrt(a2 + (1 - a2) * light * light)
    unmasked = np.where(nl > 0, light * (nv + view) / shaded, 0.0)  # G2 over G1 of the view
    grazing = (1 - vh) ** 5
    table = np.stack([((1 - grazing) * unmasked).mean(-1), (grazing * unmasked).mean(-1)], -1)
    return np.ascontiguousarray(table, np.float32)
