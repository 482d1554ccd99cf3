"""Transfer functions over lines of samples, compiled: between coded values and linear light, without tables.

A power is 2^(p log2 x), each by a short series, in steps of which the compiler makes vector code: three times as quick as
looking values up, and no table competes with the picture for the cache. Error: below 2e-6 of the value, and of the power.
"""

# mypy: no-check-untyped-defs
from __future__ import annotations

from functools import lru_cache

import numpy as np

from arfx.core.colour import Transfer
from arfx.core.compiled import line_kernel

# Under this linear value a pure power is replaced by the chord to zero: less than 1e-7 of white in coded values.
_DARKEST = 1e-17
FAST = {"contract", "nsz", "arcp"}


@lru_cache(maxsize=8)
def decode_curve(transfer: Transfer) -> np.ndarray:
    """(7,) float32 for `apply_curve`: from coded values to linear light."""
    toe, slope, alpha, power = transfer.curve
    if toe == 0:
        toe = _DARKEST ** (1 / power)
        slope = toe / _DARKEST
    return np.array([toe, 1 / slope, alpha - 1, 1 / alpha, power, 1, 0], np.float32)


@lru_cache(maxsize=8)
def encode_curve(transfer: Transfer) -> np.ndarray:
    """(7,) float32 for `apply_curve`: from linear light to coded values."""
    toe, slope, alpha, power = transfer.curve
    if toe == 0:
        slope = _DARKEST ** (1 / power) / _DARKEST
        toe = _DARKEST * slope
    return np.array([toe / slope, slope, 0, 1, 1 / power, alpha, alpha - 1], np.float32)


@line_kernel(fastmath=FAST, error_model="numpy")
def apply_curve(values, curve, base, mantissa, out):
    """out[k] = the curve of values[k] (n,) float32, odd in the value; base, mantissa (n,) float32 : room to work in.

    curve : toe, factor of the line up to it, then what is added, factor, power, factor and what is taken off above it
    """
    n = values.shape[0]
    toe, line, add, scale, power, gain, minus = curve[0], curve[1], curve[2], curve[3], curve[4], curve[5], curve[6]
    for k in range(n):
        base[k] = max((abs(values[k]) + add) * scale, np.float32(1e-30))
    _raise(base[:n], power, mantissa[:n], out)
    for k in range(n):
        v = values[k]
        a = abs(v)
        c = a * line if a <= toe else gain * out[k] - minus
        out[k] = c if v >= np.float32(0) else -c


@line_kernel(fastmath=FAST, error_model="numpy")
def power_of(values, power, base, mantissa, out):
    """out[k] = values[k]^power (n,) float32 of values >= 0; base, mantissa (n,) float32 : room to work in."""
    n = values.shape[0]
    for k in range(n):
        base[k] = max(values[k], np.float32(1e-30))
    _raise(base[:n], power, mantissa[:n], out)


@line_kernel(fastmath=FAST, error_model="numpy")
def _raise(base, power, mantissa, out):
    """out = base^power (n,) of positive normal float32; `base` and `mantissa` are used up."""
    one, middle, shift = np.float32(1), np.int32(0x3F3504F3), np.int32(23)  # the bits of sqrt(1/2)
    bits, inner = base.view(np.int32), mantissa.view(np.int32)
    for k in range(bits.shape[0]):
        inner[k] = bits[k] - (((bits[k] - middle) >> shift) << shift)  # sqrt(1/2) .. sqrt(2)
    for k in range(bits.shape[0]):
        m = mantissa[k]
        z = (m - one) / (m + one)
        q = z * z
        series = np.float32(0.577078016) + q * (np.float32(0.412198583) + q * np.float32(0.320598898))
        series = z * (np.float32(2.885390082) + q * (np.float32(0.961796694) + q * series))  # log2 m
        x = power * (np.float32((bits[k] - middle) >> shift) + series)
        x = min(max(x, np.float32(-126)), np.float32(127))
        whole = np.int32(x + np.float32(128.5)) - np.int32(128)
        f = x - np.float32(whole)  # -0.5 .. 0.5
        two = np.float32(0.00961812911) + f * (np.float32(0.00133335581) + f * np.float32(0.000154035304))
        two = np.float32(0.240226507) + f * (np.float32(0.0555041087) + f * two)
        out[k] = one + f * (np.float32(0.693147181) + f * two)  # 2^f
        bits[k] = (whole + np.int32(127)) << shift
    for k in range(bits.shape[0]):
        out[k] *= base[k]
