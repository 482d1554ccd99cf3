"""Small text inputs: calibrations in every format, marker maps, poses; bombs of aliases,
devices in a file's place.
"""

from __future__ import annotations

import io
import itertools
import json
import os
import random
import shutil
from pathlib import Path

import numpy as np

from tests.fuzz.case import (
    Build,
    Case,
    mutated_bytes,
    mutated_text,
    mutated_tree,
    process,
)
from tests.fuzz.material import CAMERAS

OPENCV = (
    "%YAML:1.0\n---\nimage_width: 160\nimage_height: 120\ncamera_matrix: !!opencv-matrix\n "
    " rows: 3\n  cols: 3\n  dt: d\n  data: [{matrix}]\ndistortion_coefficients: [{lens}]\n"
)
_EIGHT = [(b, ", ".join([f"*{a}"] * 8)) for a, b in itertools.pairwise("abcdefghi")]
ALIASES = "a: &a [1, 1]\n" + "".join(f"{b}: &{b} [{eight}]\n" for b, eight in _EIGHT)
MERGES = "a: &a {x: 1}\n" + "".join(
    f"{b}: &{b} {{<<: [{eight}]}}\n" for b, eight in _EIGHT
)
DOUBLED = "a0: &a0 {" + ", ".join(f"k{i}: 1" for i in range(1000)) + "}\n"
DOUBLED += "".join(
    f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 25)
)


def text(content: str, name: str = "camera.yaml") -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        (folder / name).write_text(content, errors="surrogateescape")
        return Case(folder, process(folder, material, camera=name))

    return build


def matrix(
    values: str, lens: str = "0, 0, 0, 0, 0", codes: tuple[int, ...] = (3,)
) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        (folder / "camera.yaml").write_text(OPENCV.format(matrix=values, lens=lens))
        return Case(
            folder,
            process(folder, material, camera="camera.yaml"),
            codes=frozenset(codes),
        )

    return build


def device(option: str, path: str = "") -> Build:
    """A device, or a pipe that nobody writes to, where a file is expected."""

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        if not path:
            os.mkfifo(folder / "pipe")
        if option == "depth":
            return Case(
                folder,
                process(folder, material, depth=path or "pipe"),
                codes=frozenset({2, 3}),
            )
        if option == "set":
            return Case(
                folder,
                process(folder, material, set=f"light.environment={path or 'pipe'}"),
                codes=frozenset({2, 3}),
            )
        return Case(
            folder,
            process(folder, material, **{option: path or "pipe"}),
            codes=frozenset({2, 3}),
        )

    return build


def damaged(rng: random.Random, folder: Path, material: Path) -> Case:
    name = rng.choice(("camera.yaml", "camera.yaml", *CAMERAS))
    source = (material / name).read_text()
    if rng.random() < 0.1:
        (folder / name).write_bytes(mutated_bytes(rng, source.encode()))
    elif name.endswith(".json") and rng.random() < 0.7:
        (folder / name).write_text(
            json.dumps(mutated_tree(rng, json.loads(source))), errors="replace"
        )
    else:
        (folder / name).write_text(mutated_text(rng, source), errors="replace")
    return Case(
        folder, process(folder, material, camera=name), note=f"damaged {name}"
    )


def packed(rng: random.Random, folder: Path, material: Path) -> Case:
    """NumPy's archive, OpenCV's XML."""
    k = np.array([[152.0, 0, 79.5], [0, 152, 59.5], [0, 0, 1]])
    archive = io.BytesIO()
    np.savez(archive, mtx=k, dist=np.zeros(5), image_width=160, image_height=120)
    numbers = " ".join(map(str, k.ravel()))
    xml = (
        "<opencv_storage><image_size>160"
        f" 120</image_size><camera_matrix><data>{numbers}</data></camera_matrix></opencv_storage>"
    )
    name, data = rng.choice(
        (
            ("c.npz", archive.getvalue()),
            ("c.xml", xml.encode()),
        )
    )
    (folder / name).write_bytes(mutated_bytes(rng, data))
    return Case(
        folder, process(folder, material, camera=name), note=f"damaged {name}"
    )


def absurd(rng: random.Random, folder: Path, material: Path) -> Case:
    """A calibration that is well formed and says what no lens does."""
    k = [152.0, 0, 79.5, 0, 152.0, 59.5, 0, 0, 1]
    for _ in range(rng.choice((0, 1, 1, 2))):
        k[rng.randrange(9)] = rng.choice(
            (0, -1, 1e-300, 1e-6, 1.0, 79.5, 1e6, 1e9, 1e38, 1e308, -152.0, 1e-3)
        )
    lens = [
        rng.choice((0.0, 0.1, -0.5, 10.0, -1e3, 1e9, 1e-300, 1e308))
        for _ in range(rng.choice((0, 1, 2, 4, 5, 6, 8, 12, 14)))
    ]
    content = OPENCV.format(
        matrix=", ".join(map(repr, k)), lens=", ".join(map(repr, lens))
    )
    if rng.random() < 0.3:
        content += "distortion_model: equidistant\n"
    if rng.random() < 0.2:
        content = content.replace(
            "160", rng.choice(("0", "-160", "1", "320", "1000000", "4294967296"))
        )
    (folder / "camera.yaml").write_text(content)
    return Case(
        folder, process(folder, material, camera="camera.yaml"), note=f"{k} {lens}"
    )


def others(rng: random.Random, folder: Path, material: Path) -> Case:
    """Marker map, poses, depth, environment."""
    kind = rng.choice(
        (
            "map.toml",
            "map.json",
            "poses.txt",
            "depth",
            "environment.png",
            "environment.hdr",
        )
    )
    if kind == "depth":
        shutil.copytree(material / "depth", folder / "depth")
        victim = folder / "depth" / f"000{rng.randrange(4)}.png"
        what = rng.randrange(4)
        if what == 0:
            victim.unlink()
        elif what == 3:
            victim.unlink()
            os.mkfifo(victim)
        elif what == 1:
            victim.rename(
                victim.with_name(
                    rng.choice(
                        ("a.exr", "1e309.5.png", "nan.png", "9" * 200 + ".png")
                    )
                )
            )
        else:
            victim.write_bytes(mutated_bytes(rng, victim.read_bytes()))
        return Case(folder, process(folder, material, depth="depth"), note=kind)
    data = (material / kind).read_bytes()
    if kind.startswith("environment"):
        data = mutated_bytes(rng, data)
    elif kind.endswith("json") and rng.random() < 0.7:
        data = json.dumps(mutated_tree(rng, json.loads(data))).encode(
            errors="replace"
        )
    else:
        data = mutated_text(rng, data.decode()).encode(errors="replace")
    (folder / kind).write_bytes(data)
    if kind == "poses.txt":
        shutil.copytree(material / "depth", folder / "depth")
        return Case(
            folder,
            process(folder, material, anchor="plane", depth="depth", poses=kind),
            note=kind,
        )
    option = "environment" if kind.startswith("environment") else "marker_map"
    return Case(
        folder, process(folder, material, **{option: kind}), note=f"damaged {kind}"
    )


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    return rng.choices((damaged, packed, absurd, others), (3, 1, 2, 2))[0](
        rng, folder, material
    )


SEEDS: dict[str, Build] = {
    "aliases": text(ALIASES),
    "merges": text(MERGES),
    "merges of merges": text(DOUBLED),
    "an alias of itself": text("camera_matrix: &a [*a]\n"),
    "deep yaml": text("[" * 100_000),
    "deep json": text('{"a":' * 100_000, "camera.json"),
    "deep mapping": text("".join(" " * i + "a:\n" for i in range(2000))),
    "5,000 digits": text(
        OPENCV.format(
            matrix="9" * 5000 + ", 0, 79.5, 0, 152, 59.5, 0, 0, 1", lens="0"
        )
    ),
    "5,000 digits, json": text(
        '{"camera_matrix": ['
        + "9" * 5000
        + ', 0, 0, 0, 1, 0, 0, 0, 1], "image_size": [160, 120]}',
        "c.json",
    ),
    "a date as a number": text(
        "image_width: 2001-12-14\nimage_height: 120\ncamera_matrix: [152, 0, 79.5, 0, 152,"
        " 59.5, 0, 0, 1]\n"
    ),
    "a python object": text("!!python/object/apply:os.system ['true']\n"),
    "two documents": text("---\na: 1\n---\nb: 2\n"),
    "no text": text("\udcff\udcfe" * 50),
    "transposed": matrix("152, 0, 0, 0, 152, 0, 79.5, 59.5, 1"),
    "third row": matrix("152, 0, 79.5, 0, 152, 59.5, 0, 0.1, 1"),
    "focal lengths 10^4 apart": matrix("152, 0, 79.5, 0, 1520000, 59.5, 0, 0, 1"),
    "centre far outside": matrix("152, 0, 79500, 0, 152, 59.5, 0, 0, 1"),
    "focal length 1e-6": matrix("1e-6, 0, 79.5, 0, 1e-6, 59.5, 0, 0, 1"),
    "focal length 1e308": matrix("1e308, 0, 79.5, 0, 1e308, 59.5, 0, 0, 1"),
    "distortion 1e9": matrix(
        "152, 0, 79.5, 0, 152, 59.5, 0, 0, 1", "1e9, 1e9, 0, 0, 0", (0, 3, 4)
    ),
    "/dev/zero": device("camera", "/dev/zero"),
    "/dev/random": device("camera", "/dev/urandom"),
    "a pipe": device("camera"),
    "clip /dev/zero": device("clip", "/dev/zero"),
    "clip a pipe": device("clip"),
    "model a pipe": device("model"),
    "marker map /dev/zero": device("marker_map", "/dev/zero"),
    "depth a pipe": device("depth"),
    "environment /dev/zero": device("environment", "/dev/zero"),
    "poses a pipe": device("poses"),
    "tradeoff /dev/zero": device("tradeoff", "/dev/zero"),
    "job file /dev/zero": device("config", "/dev/zero"),
    "job file a pipe": device("config"),
    "/proc/self/mem": device("camera", "/proc/self/mem"),
}
