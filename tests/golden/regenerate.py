"""Renders expected pictures anew, of sample scenes and presets: `python -m
tests.golden.regenerate [NAME…]`, or `make golden`.

Look at every picture that changed before committing it.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from arfx.measure.verification import read_tolerance
from tests.golden.pictures import (
    PRESETS,
    SCENES,
    differences,
    frames_side_by_side,
    read_rgb,
    verified,
    write_rgb,
)
from tests.golden.test_presets import expected_file, first_frame, source_clip


def main(names: list[str]) -> None:
    for scene in sorted(
        p for p in SCENES.iterdir() if p.is_dir() and (not names or p.name in names)
    ):
        with tempfile.TemporaryDirectory() as work:
            done = verified(scene, Path(work), lambda m: print(f"  note: {m}"))
            picture = frames_side_by_side(
                done.output, read_tolerance(scene)["golden"]["frames"]
            )
        save(scene.name, scene / "expected.png", picture, done.broken)
    with tempfile.TemporaryDirectory() as work:
        clip = None
        for preset in [p for p in PRESETS if not names or p.stem in names]:
            clip = clip or source_clip(Path(work) / "clip")
            save(
                preset.stem,
                expected_file(preset),
                first_frame(preset, clip, Path(work)),
                [],
            )


def save(name: str, path: Path, picture: np.ndarray, broken: list[str]) -> None:
    change = differences(picture, read_rgb(path)) if path.exists() else "new"
    path.parent.mkdir(exist_ok=True)
    write_rgb(path, picture)
    print(f"{name}: {change}", *broken, sep="\n  ", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
