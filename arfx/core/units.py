"""Lengths and times as people write them."""

import math
import re

from arfx.errors import ConfigError

METRES_PER = {
    "um": 1e-6,
    "mm": 1e-3,
    "cm": 1e-2,
    "m": 1.0,
    "in": 0.0254,
    "ft": 0.3048,
}
MAX_TIME_S = 1e9
MAX_LENGTH_M = 1e7  # no scene is larger than the Earth


def length_m(text: str, what: str = "length") -> float:
    """'25mm', '0.165m', '6.5in', '-2cm' to metres. A unit is required. Raises ConfigError."""
    m = re.fullmatch(
        r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zA-Z]+)?\s*", text
    )
    if m and m[2] is None and float(m[1]) == 0:
        return 0.0
    if not m or (m[2] or "").lower() not in METRES_PER:
        raise ConfigError(
            f"{what}: {text!r} is not a length",
            "a number with a unit: 25mm, 0.165m, 6.5in, 4cm",
        )
    value = float(m[1]) * METRES_PER[m[2].lower()]
    if not abs(value) <= MAX_LENGTH_M:
        raise ConfigError(
            f"{what}: {value:g} m is out of range", f"at most {MAX_LENGTH_M:g} m"
        )
    return value


def time_s(text: str) -> float:
    """'1.5', '1.5s', '90s', '2min', '01:02.5', '1:02:03' to seconds. Raises ConfigError."""
    t = text.strip()
    value = math.nan
    if m := re.fullmatch(r"(?:(\d+):)?(\d+):(\d+(?:\.\d+)?)", t):
        value = float(m[1] or 0) * 3600 + float(m[2]) * 60 + float(m[3])
    elif m := re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*(ms|s|min|h)?", t):
        value = (
            float(m[1])
            * {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}[m[2] or "s"]
        )
    if not value <= MAX_TIME_S:
        shown = text if len(text) <= 40 else f"{text[:40]}…"
        raise ConfigError(
            f"time: {shown!r} is not a time",
            "seconds (1.5, 90s), 2min, or h:mm:ss; at most 30 years",
        )
    return value
