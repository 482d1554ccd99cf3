"""Pigment: how thick the paint lies, and what colour that makes.

C' = C (1 - (1 - C) (d - 1)), d = 1 as it is. Thickness varies with a slow turbulence (carried with
the sites, it belongs to the wash), with the paper's grain (fixed to the paper) and towards the
border of a wash, where water leaves its pigment. Cost: O(cells).
Source: Bousseau et al. 2006, docs/methods/watercolor.md#pigment. Leaves out: wet-in-wet flow,
drips, white gaps."""

from functools import lru_cache

import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.stages.watercolor.sites import STEPS

PAPER_PX = 512  # side of the paper's texture, repeated
GRAIN_PX = 2.0  # size of the paper's bumps
FLOW_PX = 160.0  # size of the turbulence
WOBBLE_PX = 256  # side of the tile by which borders stray


def smooth_noise(
    side: int, wavelength_px: float, rng: np.random.Generator
) -> ndarray:
    """(side, side) float64 band of noise that repeats without a seam, variance 1; made in the
    frequency domain."""
    spectrum = np.fft.rfft2(rng.standard_normal((side, side)))
    fy = np.fft.fftfreq(side)[:, None]
    fx = np.fft.rfftfreq(side)[None]
    f = np.hypot(fx, fy) * wavelength_px
    picture = np.fft.irfft2(spectrum * f * np.exp(-f * f), (side, side))
    return np.asarray(picture / max(float(picture.std()), 1e-12))


def paper_grain(seed: int) -> ndarray:
    """(PAPER_PX, PAPER_PX) float32 height of the paper, -1..1, about .4 rms: bumps of GRAIN_PX on
    a slower felt."""
    rng = np.random.default_rng([seed, 0x9A9E])
    bumps = smooth_noise(PAPER_PX, GRAIN_PX * 2, rng)
    felt = smooth_noise(PAPER_PX, GRAIN_PX * 5, rng)
    return np.asarray(np.tanh(0.45 * (0.8 * bumps + 0.5 * felt)).astype(np.float32))


def wobble_tile(
    seed: int, amplitude_px: float, first: tuple[float, float] = (0.0, 0.0)
) -> ndarray:
    """(2, WOBBLE_PX, WOBBLE_PX) float32 displacement, in whole 1/STEPS px, that repeats without a
    seam. first : (x, y) px of the noise at which the first pixel lies"""
    fy = np.fft.fftfreq(WOBBLE_PX)[:, None]
    fx = np.fft.rfftfreq(WOBBLE_PX)[None]
    turn = np.exp(2j * np.pi * (fy * first[1] + fx * first[0]))
    spectra = _wobble_spectra(seed, 4 * amplitude_px + 6)
    tile = np.fft.irfft2(spectra * turn, (WOBBLE_PX, WOBBLE_PX)) * (amplitude_px / 2)
    out: ndarray = np.round(np.clip(tile, -amplitude_px, amplitude_px) * STEPS)
    return out.astype(np.float32)


@lru_cache(maxsize=2)
def _wobble_spectra(seed: int, wavelength_px: float) -> ndarray:
    rng = np.random.default_rng([seed, 0x30BB])
    return np.stack(
        [np.fft.rfft2(smooth_noise(WOBBLE_PX, wavelength_px, rng)) for _ in range(2)]
    )


def turbulence(u: ndarray, v: ndarray, seed: int) -> ndarray:
    """(n,) float32 slow noise at positions (u, v) (n,) float32 px, about -1..1: three octaves from
    FLOW_PX down."""
    out: ndarray = _turbulence(
        u, v, np.uint32(seed & 0xFFFFFFFF), np.float32(1 / FLOW_PX)
    )
    return out


@kernel()
def _turbulence(u, v, seed, frequency):  # pragma: no cover - compiled
    out = np.zeros(u.shape[0], np.float32)
    for k in range(u.shape[0]):
        f = np.float64(frequency)
        amplitude = 1.0
        total = 0.0
        for octave in range(3):
            x = u[k] * f
            y = v[k] * f
            i = np.int64(np.floor(x))
            j = np.int64(np.floor(y))
            s = x - i
            t = y - j
            s = s * s * (3 - 2 * s)
            t = t * t * (3 - 2 * t)
            n00 = _lattice(seed, i, j, octave)
            n10 = _lattice(seed, i + 1, j, octave)
            n01 = _lattice(seed, i, j + 1, octave)
            n11 = _lattice(seed, i + 1, j + 1, octave)
            above = n00 + s * (n10 - n00)
            below = n01 + s * (n11 - n01)
            total += amplitude * (above * (1 - t) + below * t)
            f = 2 * f
            amplitude = 0.6 * amplitude
        out[k] = total
    return out


@kernel(inline="always")
def _lattice(seed, i, j, octave):  # pragma: no cover - compiled
    """-1..1 at a node of the noise (murmur finaliser)."""
    z = np.uint64(seed) + np.uint64(octave) * np.uint64(0x165667B19E3779F9)
    z += np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(j) * np.uint64(
        0xC2B2AE3D27D4EB4F
    )
    z = (z ^ (z >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    z = (z ^ (z >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    return np.float64(z >> np.uint64(40)) / float(1 << 23) - 1.0
