"""Pigment: how thick the paint lies, and what colour that makes: C' = C (1 - (1 - C) (d - 1)), d = 1 as it is.

Thickness varies with a slow turbulence (carried with the sites, it belongs to the wash), with the paper's grain (fixed to
the paper) and towards the border of a wash, where water leaves its pigment. Cost: O(pixels).
Source: Bousseau et al. 2006, docs/methods/watercolor.md#pigment. Leaves out: wet-in-wet flow, drips, white gaps."""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np

from arfx.stages.watercolor.sites import STEPS

PAPER_PX = 512  # side of the paper's texture, repeated
WOBBLE_PX = 256  # of the borders'
_FAST = {"contract", "nsz", "arcp"}


def smooth_noise(side: int, wavelength_px: float, rng: np.random.Generator) -> np.ndarray:
    """(side, side) float64 band of noise that repeats without a seam, variance 1; made in the frequency domain."""
    spectrum = np.fft.rfft2(rng.standard_normal((side, side)))
    fy, fx = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None]
    f = np.hypot(fx, fy) * wavelength_px
    picture = np.fft.irfft2(spectrum * f * np.exp(-f * f), (side, side))
    made: np.ndarray = picture / max(float(picture.std()), 1e-12)
    return made


def paper_grain(seed: int, grain_px: float) -> np.ndarray:
    """(PAPER_PX, PAPER_PX) float32 height of the paper, -1..1, about .4 rms: bumps of `grain_px` on a slower felt."""
    rng = np.random.default_rng([seed, 0x9A9E])
    h = 0.8 * smooth_noise(PAPER_PX, grain_px * 2, rng) + 0.5 * smooth_noise(
        PAPER_PX, grain_px * 5, rng
    )
    out: np.ndarray = np.tanh(0.45 * h).astype(np.float32)
    return out


def wobble_tile(
    seed: int, amplitude_px: float, wavelength_px: float, at: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """(2, WOBBLE_PX, WOBBLE_PX) float32 displacement, in whole 1/STEPS px, that repeats without a seam. at : (x, y) px of the
    noise at which the first pixel lies"""
    fy, fx = np.fft.fftfreq(WOBBLE_PX)[:, None], np.fft.rfftfreq(WOBBLE_PX)[None]
    turn = np.exp(2j * np.pi * fy * at[1]) * np.exp(2j * np.pi * fx * at[0])
    tile = np.fft.irfft2(_wobble_spectra(seed, wavelength_px) * turn, (WOBBLE_PX, WOBBLE_PX))
    out: np.ndarray = np.round(
        np.clip(tile * amplitude_px / 2, -amplitude_px, amplitude_px) * STEPS
    ).astype(np.float32)
    return out


@lru_cache(maxsize=2)
def _wobble_spectra(seed: int, wavelength_px: float) -> np.ndarray:
    rng = np.random.default_rng([seed, 0x30BB])
    return np.stack([np.fft.rfft2(smooth_noise(WOBBLE_PX, wavelength_px, rng)) for _ in range(2)])


def repeat_tile(tile: np.ndarray, x0: int, y0: int, width: int, height: int) -> np.ndarray:
    """(..., height, width) of a repeated tile (..., n, n), from (x0, y0) of it on."""
    side = tile.shape[-1]
    start = x0 % side
    wide = np.concatenate([tile] * (-(-(start + width) // side)), axis=-1)[
        ..., start : start + width
    ]
    return np.ascontiguousarray(wide[..., np.arange(y0, y0 + height) % side, :])


def turbulence(u: np.ndarray, v: np.ndarray, seed: int, wavelength_px: float) -> np.ndarray:
    """(n,) float32 slow noise at positions (u, v), px, about -1..1: three octaves from `wavelength_px` down."""
    return np.asarray(
        _turbulence(u, v, np.uint32(seed & 0xFFFFFFFF), np.float32(1 / wavelength_px))
    )


@numba.njit(cache=True, nogil=True)
def _turbulence(u, v, seed, frequency):  # pragma: no cover - compiled
    out = np.zeros(u.shape[0], np.float32)
    for k in range(u.shape[0]):
        f, a, total = np.float64(frequency), 1.0, 0.0
        for octave in range(3):
            x, y = u[k] * f, v[k] * f
            i, j = np.int64(np.floor(x)), np.int64(np.floor(y))
            s, t = x - i, y - j
            s, t = s * s * (3 - 2 * s), t * t * (3 - 2 * t)
            n00, n10 = _lattice(seed, i, j, octave), _lattice(seed, i + 1, j, octave)
            n01, n11 = _lattice(seed, i, j + 1, octave), _lattice(seed, i + 1, j + 1, octave)
            total += a * ((n00 + s * (n10 - n00)) * (1 - t) + (n01 + s * (n11 - n01)) * t)
            f, a = 2 * f, 0.6 * a
        out[k] = total
    return out


@numba.njit(cache=True, nogil=True, inline="always")
def _lattice(seed, i, j, octave):  # pragma: no cover - compiled
    """-1..1 at a node of the noise (murmur finaliser)."""
    z = (
        np.uint64(seed)
        + np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
        + np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    )
    z += np.uint64(octave) * np.uint64(0x165667B19E3779F9)
    z = (z ^ (z >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    z = (z ^ (z >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    return np.float64(z >> np.uint64(40)) / float(1 << 23) - 1.0
