"""Renders expected.png of the sample scenes anew: `python -m tests.golden.regenerate [NAME…]`, or `make golden`.

Look at every picture that changed before committing it.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from arfx.measure.verification import read_tolerance, verify
from tests.golden.pictures import SCENES, differences, frames_side_by_side, read_rgb, write_rgb


def main(names: list[str]) -> None:
    for scene in sorted(p for p in SCENES.iterdir() if p.is_dir() and (not names or p.name in names)):
        with tempfile.TemporaryDirectory() as work:
            done = verify(scene, Path(work), lambda *_: None, lambda m: print(f"  note: {m}"))
            picture = frames_side_by_side(done.output, read_tolerance(scene)["golden"]["frames"])
        path = scene / "expected.png"
        change = differences(picture, read_rgb(path)) if path.exists() else "new"
        write_rgb(path, picture)
        print(f"{scene.name}: {change}", *done.broken, sep="\n  ", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
