"""Equality that nothing escapes: types, bits, dtypes, memory layout, order."""

from __future__ import annotations

import struct
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def identical(a: Any, b: Any) -> bool:
    """Whether a and b are the same to every reader of them, deep down."""
    if type(a) is not type(b):
        return False
    if isinstance(a, float) and not isinstance(a, np.generic):
        return struct.pack("<d", a) == struct.pack("<d", b)
    if isinstance(a, np.ndarray | np.generic):
        alike = (a.dtype, a.shape) == (
            b.dtype,
            b.shape,
        ) and a.tobytes() == b.tobytes()
        return alike and (not a.size or a.strides == b.strides)
    if isinstance(a, dict):
        return len(a) == len(b) and all(
            identical(x, y) for x, y in zip(a.items(), b.items(), strict=True)
        )
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(
            identical(x, y) for x, y in zip(a, b, strict=True)
        )
    if is_dataclass(a):
        return all(
            identical(getattr(a, f.name), getattr(b, f.name)) for f in fields(a)
        )
    return bool(a == b)
