"""From radiance to coded values: exposure, noise, clipping, transfer curve. Everything in linear light until the last step."""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.colour import Transfer
from arfx.synth.description import SceneFile


def gain_at(scene: SceneFile, time_s: float) -> float:
    """The exposure's gain at a time: the stated one, wandering as automatic exposure does."""
    stops = (scene.exposure.drift_stops + scene.hidden.drift_stops) * np.sin(2 * np.pi * time_s / scene.exposure.drift_period_s)
    return float(scene.exposure.gain * 2.0**stops)


def develop(scene: SceneFile, radiance: np.ndarray, frame: int, time_s: float) -> np.ndarray:
    """Coded colours (h, w, 3) float32 in 0..1 of a frame's radiance (h, w, 3).

    Sensor value = gain * radiance + bias + noise, clipped; noise has variance read² + shot * value, as read after the
    gain, correlated over a Gaussian of the stated sigma without changing its variance.
    """
    signal = gain_at(scene, time_s) * radiance + scene.exposure.bias
    noise = scene.noise
    if noise.read > 0 or noise.shot > 0:
        sigma = np.sqrt(noise.read**2 + noise.shot * np.clip(signal, 0, 1))
        rng = np.random.default_rng([scene.seed, 101, frame])
        signal = signal + sigma * unit_noise(rng, signal.shape, max(noise.correlation_px, scene.hidden.noise_correlation_px))
    return Transfer(scene.hidden.transfer).encode(np.clip(signal, 0, 1)).astype(np.float32)


def unit_noise(rng: np.random.Generator, shape: tuple[int, ...], correlation_px: float) -> np.ndarray:
    """Normal noise of variance 1, white or with a Gaussian spatial correlation."""
    white = rng.standard_normal(shape, np.float32)
    if correlation_px <= 0:
        return white
    radius = max(int(np.ceil(4 * correlation_px)), 1)
    kernel = cv2.getGaussianKernel(2 * radius + 1, correlation_px, cv2.CV_64F)[:, 0]
    blurred = cv2.sepFilter2D(white, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred / np.float32((kernel**2).sum()))  # variance of a separable filter: (sum k²)², its root
