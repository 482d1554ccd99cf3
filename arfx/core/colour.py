"""Transfer functions and luma/chroma matrices: how coded values relate to linear light.

Sources: IEC 61966-2-1 (sRGB), ITU-R BT.709-6, BT.1886, BT.601-7, BT.2020-2 (matrix coefficients).
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from arfx.core.codec import Plain
from arfx.errors import ConfigError

# BT.709's 1.099 and 0.018 unrounded (BT.2020 table 4): rounded, the curve steps back at the joint.
_ALPHA, _BETA = 1.09929682680944, 0.018053968510807
# (Kr, Kb) by matrix name; the names are FFmpeg's.
LUMA_COEFFICIENTS = {
    "bt709": (0.2126, 0.0722),
    "bt601": (0.299, 0.114),
    "smpte240m": (0.212, 0.087),
    "fcc": (0.30, 0.11),
    "bt2020": (0.2627, 0.0593),
}


@dataclass(frozen=True)
class Transfer(Plain):
    """A transfer function by name: srgb, bt709, bt1886 or gamma:X (X > 0)."""

    name: str = "srgb"

    def __post_init__(self) -> None:
        kind, _, value = self.name.partition(":")
        with contextlib.suppress(ValueError):
            if self.name in ("srgb", "bt709", "bt1886") or (
                kind == "gamma" and 0.1 <= float(value) <= 10
            ):
                return
        raise ConfigError(
            f"unknown transfer {self.name!r}", "one of srgb, bt709, bt1886, gamma:2.2"
        )

    def to_json(self) -> str:
        return self.name

    @staticmethod
    def from_json(name: str) -> Transfer:
        return Transfer(name)

    @property
    def curve(self) -> tuple[float, float, float, float]:
        """(toe, slope, alpha, power): a line v / slope up to the coded value `toe`, ((v +
        alpha - 1) / alpha)^power above.
        """
        if self.name == "srgb":
            return 0.04045, 12.92, 1.055, 2.4
        if self.name == "bt709":
            return 4.5 * _BETA, 4.5, _ALPHA, 1 / 0.45
        return (
            0.0,
            1.0,
            1.0,
            2.4 if self.name == "bt1886" else float(self.name.partition(":")[2]),
        )

    def decode(self, v: np.ndarray) -> np.ndarray:
        """Coded value (0..1; outside is mirrored through zero) to linear light, same shape
        and float type.
        """
        v = np.asarray(v)
        a = np.abs(v)
        toe, slope, alpha, power = self.curve
        lin = np.where(a <= toe, a / slope, ((a + (alpha - 1)) / alpha) ** power)
        return np.copysign(lin, v).astype(v.dtype if v.dtype.kind == "f" else float)

    def encode(self, lin: np.ndarray) -> np.ndarray:
        """Linear light to coded value; the inverse of decode."""
        lin = np.asarray(lin)
        a = np.abs(lin)
        toe, slope, alpha, power = self.curve
        v = np.where(a <= toe / slope, a * slope, alpha * a ** (1 / power) - (alpha - 1))
        return np.copysign(v, lin).astype(lin.dtype if lin.dtype.kind == "f" else float)


SRGB = Transfer("srgb")


def yuv_from_rgb(matrix: str) -> np.ndarray:
    """(3, 3) float64 from coded R'G'B' to Y'CbCr with Y' in 0..1 and Cb, Cr in -0.5..0.5
    (full scale). Raises ConfigError for an unknown matrix name."""
    if matrix not in LUMA_COEFFICIENTS:
        raise ConfigError(
            f"unknown colour matrix {matrix!r}", "one of " + ", ".join(LUMA_COEFFICIENTS)
        )
    kr, kb = LUMA_COEFFICIENTS[matrix]
    kg = 1 - kr - kb
    y = np.array([kr, kg, kb])
    cb = (np.array([0.0, 0.0, 1.0]) - y) / (2 * (1 - kb))
    cr = (np.array([1.0, 0.0, 0.0]) - y) / (2 * (1 - kr))
    return np.stack([y, cb, cr])
