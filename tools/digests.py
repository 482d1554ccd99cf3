"""Digests of every decoded frame of all sample scenes and presets, to hold one state of the code against another.

`python tools/digests.py make FILE.json [NAME…]` runs them, losslessly (about five minutes);  `… compare OLD.json NEW.json`
says where they differ. Source clips are made once and kept in the folder that --clips names, so that both see the same ones.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

from arfx.config.load import load
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.synth.clip import make_clip
from arfx.synth.description import load_scene

ROOT = Path(__file__).parents[1]
SCENES, PRESETS = ROOT / "sample_scenes", ROOT / "configs"
OF_PRESETS = "0041-indirect-light"  # the clip that presets are applied to


def made(scene: str, clips: Path) -> Path:
    folder = clips / scene
    if not (folder / "truth.jsonl").is_file():
        make_clip(load_scene(SCENES / scene / "scene.toml"), folder, SCENES / scene, lambda *_: None, overwrite=True)
    return folder


def jobs() -> Iterator[tuple[str, str, Path | None]]:
    """Name, scene, preset or None = the scene's own settings."""
    for scene in sorted(p.parent.name for p in SCENES.glob("*/scene.toml")):
        yield scene, scene, None
    for preset in sorted(PRESETS.glob("*.toml")):
        yield f"preset {preset.stem}", OF_PRESETS, preset


def digests(clip: Path, preset: Path | None, work: Path) -> list[str]:
    changed = {} if preset is None else tomllib.loads(preset.read_text())
    changed["output"] = {"path": str(work / "out.mkv"), "codec": "ffv1"}
    process(load(clip / "job.toml", changed, parameters()), Options(overwrite=True, notice=lambda _: None))
    with ClipReader(probe(work / "out.mkv")) as reader:
        return [hashlib.sha256(frame.rgb8().tobytes()).hexdigest()[:16] for frame in reader.frames()]


def make(out: Path, clips: Path, names: list[str]) -> None:
    found = {}
    for name, scene, preset in jobs():
        if not names or name in names:
            with tempfile.TemporaryDirectory() as work:
                found[name] = digests(made(scene, clips), preset, Path(work))
            print(name, hashlib.sha256("".join(found[name]).encode()).hexdigest()[:16], flush=True)
    out.write_text(json.dumps(found, indent=0))


def compare(old: Path, new: Path) -> int:
    a, b = (json.loads(path.read_text()) for path in (old, new))
    differ = 0
    for name in sorted(a.keys() | b.keys()):
        frames = [k for k, (x, y) in enumerate(zip(a.get(name, []), b.get(name, []), strict=False)) if x != y]
        if a.get(name) != b.get(name):
            differ += 1
            print(f"{name}: {len(a.get(name, []))} and {len(b.get(name, []))} frames; differ: {frames}")
    print(f"{differ} of {len(a.keys() | b.keys())} differ")
    return differ


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("make", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("more", nargs="*")
    parser.add_argument("--clips", type=Path, default=Path(tempfile.gettempdir()) / "arfx-digest-clips")
    given = parser.parse_intermixed_args()
    if given.what == "make":
        make(given.file, given.clips, given.more)
    else:
        sys.exit(bool(compare(given.file, Path(given.more[0]))))
