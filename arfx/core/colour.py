"""Transfer functions and luma/chroma matrices: how coded values relate to linear light.

Sources: IEC 61966-2-1 (sRGB), ITU-R BT.709-6, BT.1886, BT.601-7, BT.2020-2 (matrix
coefficients), BT.2100-2 (HLG, PQ), BT.2408 (their white).
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

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


# (x, y) of red, green and blue by number (ITU-T H.273 table 2): BT.709, BT.2020, P3 of displays
_BT709 = 1
PRIMARIES = {
    _BT709: ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060)),
    9: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    12: ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
}
_D65 = (0.3127, 0.3290)
WHITE_CD_M2 = 203.0  # of diffuse white in HDR video (ITU-R BT.2408): linear 1
HLG, PQ = "hlg", "pq"
_NAMED = ("srgb", "bt709", "bt1886", HLG, PQ)
# ITU-R BT.2100-2 table 4 (PQ) and table 5 (HLG)
_M1, _M2, _C1, _C2, _C3 = 1305 / 8192, 2523 / 32, 107 / 128, 2413 / 128, 2392 / 128
_PQ_CD_M2, _PQ_MOST = 10000.0, 1.9  # the formula has a pole at 1.99
_A = 0.17883277
_B, _C = 1 - 4 * _A, 0.5 - _A * math.log(4 * _A)
# Light of the signal .75, which a display of 1000 cd/m2 shows as white of 203 (BT.2408 table 1)
_HLG_WHITE = (math.exp((0.75 - _C) / _A) + _B) / 12


@dataclass(frozen=True)
class Transfer(Plain):
    """A transfer function by name: srgb, bt709, bt1886, hlg, pq or gamma:X (X > 0).

    Linear 1 is the white of the coded value 1, of hlg and pq diffuse white at 203 cd/m2.
    HLG is light of the scene, before a display's own gamma."""

    name: str = "srgb"

    def __post_init__(self) -> None:
        kind, _, value = self.name.partition(":")
        with contextlib.suppress(ValueError):
            if self.name in _NAMED or (kind == "gamma" and 0.1 <= float(value) <= 10):
                return
        raise ConfigError(
            f"unknown transfer {self.name!r}",
            f"one of {', '.join(_NAMED)}, gamma:2.2",
        )

    def to_json(self) -> str:
        return self.name

    @staticmethod
    def from_json(name: str) -> Transfer:
        return Transfer(name)

    @property
    def _curve(self) -> tuple[float, float, float, float]:
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

    def decode(self, v: ndarray) -> ndarray:
        """Coded value (0..1; outside is mirrored through zero) to linear light, same shape
        and float type.
        """
        v = np.asarray(v)
        a = np.abs(v)
        if self.name == HLG:
            dark = a * a / 3
            lin = (
                np.where(a <= 0.5, dark, (np.exp((a - _C) / _A) + _B) / 12)
                / _HLG_WHITE
            )
        elif self.name == PQ:
            root = np.minimum(a, _PQ_MOST) ** (1 / _M2)
            share = np.maximum(root - _C1, 0) / (_C2 - _C3 * root)
            lin = share ** (1 / _M1) * (_PQ_CD_M2 / WHITE_CD_M2)
        else:
            toe, slope, alpha, power = self._curve
            lin = np.where(a <= toe, a / slope, ((a + (alpha - 1)) / alpha) ** power)
        return np.copysign(lin, v).astype(v.dtype if v.dtype.kind == "f" else float)

    def encode(self, lin: ndarray) -> ndarray:
        """Linear light to coded value; the inverse of decode."""
        lin = np.asarray(lin)
        a = np.abs(lin)
        if self.name == HLG:
            light = a * _HLG_WHITE
            bright = _A * np.log(np.maximum(12 * light - _B, _A)) + _C
            v = np.where(light <= 1 / 12, np.sqrt(3 * light), bright)
        elif self.name == PQ:
            root = (a * (WHITE_CD_M2 / _PQ_CD_M2)) ** _M1
            v = ((_C1 + _C2 * root) / (1 + _C3 * root)) ** _M2
            v = np.where(a > 0, v, 0)
        else:
            toe, slope, alpha, power = self._curve
            v = np.where(
                a <= toe / slope, a * slope, alpha * a ** (1 / power) - (alpha - 1)
            )
        return np.copysign(v, lin).astype(
            lin.dtype if lin.dtype.kind == "f" else float
        )


SRGB = Transfer("srgb")


def yuv_from_rgb(matrix: str) -> ndarray:
    """(3, 3) float64 from coded R'G'B' to Y'CbCr with Y' in 0..1 and Cb, Cr in -0.5..0.5
    (full scale). Raises ConfigError for an unknown matrix name."""
    if matrix not in LUMA_COEFFICIENTS:
        raise ConfigError(
            f"unknown colour matrix {matrix!r}",
            "one of " + ", ".join(LUMA_COEFFICIENTS),
        )
    kr, kb = LUMA_COEFFICIENTS[matrix]
    kg = 1 - kr - kb
    y = np.array([kr, kg, kb])
    cb = (np.array([0.0, 0.0, 1.0]) - y) / (2 * (1 - kb))
    cr = (np.array([1.0, 0.0, 0.0]) - y) / (2 * (1 - kr))
    return np.stack([y, cb, cr])


def from_bt709(primaries: int) -> ndarray | None:
    """(3, 3) float64 from linear RGB of BT.709 to that of other primaries (ITU-T H.273
    table 2), white to white; None for those that are the same or not known."""
    if primaries == _BT709 or primaries not in PRIMARIES:
        return None
    return np.linalg.solve(_xyz_from_rgb(primaries), _xyz_from_rgb(_BT709))


def _xyz_from_rgb(primaries: int) -> ndarray:
    corners, white = (
        np.array([(x / y, 1.0, (1 - x - y) / y) for x, y in points]).T
        for points in (PRIMARIES[primaries], [_D65])
    )
    return corners * np.linalg.solve(corners, white).T
