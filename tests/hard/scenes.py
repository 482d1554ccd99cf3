"""One hard scene in a job of its own, held against its truth: a row of the table. A module,
so that processes can run it.
"""

from __future__ import annotations

import json
import re
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from arfx.measure.verification import read_tolerance, verify

Row = tuple[
    str, str, str, str, float
]  # case, what was asked, verdict, largest deviation from truth or bound, seconds


def scene_row(scene: Path) -> Row:
    asked = tomllib.loads((scene / "scene.toml").read_text(encoding="utf-8"))[
        "description"
    ].removeprefix("Hard: ")
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as work:
        done = verify(scene, Path(work), lambda *_: None, lambda _: None)
    limits = read_tolerance(scene)["truth"].get("max", {})
    used = [
        (_figure(done.figures, key) / limit, key)
        for key, limit in limits.items()
        if limit > 0
    ]
    share, key = max(((s, k) for s, k in used if np.isfinite(s)), default=(0.0, ""))
    bad = len(re.findall("NaN|Infinity", json.dumps(done.report)))
    verdict = (
        "holds"
        if not done.broken and not bad
        else "; ".join([*done.broken, *([f"{bad} not finite"] if bad else [])])
    )
    return (
        scene.name,
        asked,
        verdict,
        f"{share:.0%} of the bound ({key})",
        time.perf_counter() - start,
    )


def _figure(figures: dict[str, Any], dotted: str) -> float:
    value: Any = figures
    for part in dotted.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return float(value) if isinstance(value, (int, float)) else float("nan")
