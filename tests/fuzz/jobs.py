"""Job files and other arguments: wrong types, deep nesting, numbers of 5,000 digits, keys
twice, files that are no text.
"""

from __future__ import annotations

import random
import re
import shutil
from pathlib import Path

from tests.fuzz.case import (
    NUMBERS,
    WORDS,
    Build,
    Case,
    mutated_bytes,
    mutated_text,
    process,
)

OPTIONS = (
    "marker", "fit", "scale", "offset", "rotate", "up", "pipeline", "quality", "budget", "fps", "max-error", "light", "formula",
    "depth-scale", "anchor", "set", "start", "end", "codec", "crf", "pixel-format", "workers",
)  # fmt: skip
SHAPES = (
    "{}",
    "{}s",
    "{}cm",
    "36h11:3:{}mm",
    "36h11:{}:10cm",
    "{},0,0",
    "{0},{0},{0}",
    "{},45,1,1,1",
    "1:{}",
    "output.crf={}",
    "{}.{}={}",
)


def job(content: str, *more: str) -> Build:
    """The job file `content`; {usual} is the usual one."""

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        usual = (material / "job.toml").read_text()
        (folder / "job.toml").write_text(
            content.replace("{usual}", usual), errors="surrogateescape"
        )
        return Case(folder, _with_file(folder, material) + list(more))

    return build


def _with_file(folder: Path, material: Path) -> list[str]:
    for name in ("clip.mp4", "camera.yaml", "model.glb"):
        shutil.copy(material / name, folder / name)
    return ["process", "--config", "job.toml", "--json"]


def option(name: str, value: str) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        return Case(folder, process(folder, material, **{name: value}))

    return build


def damaged(rng: random.Random, folder: Path, material: Path) -> Case:
    args = _with_file(folder, material)
    text = (material / "job.toml").read_text()
    if rng.random() < 0.15:
        (folder / "job.toml").write_bytes(mutated_bytes(rng, text.encode()))
    else:
        # an output elsewhere would be written there, as the file says
        damaged = re.sub(
            r'^(path\s*=\s*)"[^"\n]*[/\\][^"\n]*"',
            r'\1"out.mp4"',
            mutated_text(rng, text),
            flags=re.MULTILINE,
        )
        (folder / "job.toml").write_text(damaged, errors="replace")
    return Case(folder, args, _output(folder), note="damaged job.toml")


def _output(folder: Path) -> str:
    """Where a damaged job file says that the output goes, as far as one can tell."""
    found = re.search(
        r'^path\s*=\s*"([^"\n]*)"',
        (folder / "job.toml").read_text(errors="replace"),
        re.MULTILINE,
    )
    return found[1] if found else "out.mp4"


def hostile(rng: random.Random, folder: Path, material: Path) -> Case:
    """An option of the command line with a value that nobody expects."""
    name = rng.choice(OPTIONS)
    value = (
        rng.choice(SHAPES)
        .replace("{0}", "{}")
        .replace("{}", rng.choice(NUMBERS + WORDS))
    )
    value = value.replace("\0", "")[:100_000]
    args = process(folder, material)
    args += [f"--{name}={value}"]
    return Case(folder, args, note=f"--{name}={value[:60]!r}")


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    return rng.choices((damaged, hostile), (2, 1))[0](rng, folder, material)


SEEDS: dict[str, Build] = {
    "5,000 digits": job("{usual}\n[plain]\ngain = " + "9" * 5000),
    "5,000 digits on the command line": option("set", "lightmap.faint=" + "9" * 5000),
    "deep list": job("a = " + "[" * 100_000),
    "deep list on the command line": option("set", "lightmap.faint=" + "[" * 50_000),
    "deep table": job("a = " + "{a=" * 5000),
    "deep key": job("a." * 50_000 + "b = 1"),
    "deep table name": job("[" + "a." * 50_000 + "b]"),
    "deep key on the command line": option("set", "a." * 20_000 + "b=1"),
    "a section twice": job("{usual}\n[raster]\nsamples = 4\n"),
    "a key twice": job("{usual}\nsamples = 5\n"),
    "a list for a table": job("raster = [1]\n"),
    "tables for a table": job("[[raster]]\nsamples = 4\n"),
    "nulls in a name": job('[input]\nclip = "a\\u0000b"\n'),
    "a surrogate": job('[input]\nclip = "a\\uD800b"\n'),
    "no text": job("\udcff\udcfe" * 40),
    "empty": job(""),
    "a million keys": job("".join(f"k{i} = 1\n" for i in range(200_000))),
    "a marker of 1e-300 m": option("marker", "36h11:3:1e-300m"),
    "a marker of 1e300 m": option("marker", "36h11:3:1e300m"),
    "smoothing inf": job(
        "{usual}\n".replace("{usual}", "[analyse]\nsmoothing = inf\n"), "--quiet"
    ),
    "smoothing inf on the command line": option("set", "analyse.smoothing=inf"),
    "smoothing nan": option("set", "analyse.smoothing=nan"),
    "seed beyond 64 bits": option("set", "pipeline.seed=" + "9" * 30),
    "a time of 1e308 s": option("start", "1e308s"),
    "a time of nan": option("end", "nan"),
    "scale 1e-320": option("scale", "1e-320"),
    "scale 1e308": option("scale", "1e308"),
    "no marker in sight": option("marker", "36h11:99:10cm"),
    "two workers": option("workers", "2"),
    "workers 10^9": option("workers", "1000000000"),
}
