"""Models: damaged files of every format, addresses outside the folder, impossible numbers,
textures that are something else.
"""

from __future__ import annotations

import base64
import json
import os
import random
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz.case import (
    WORDS,
    Build,
    Case,
    mutated_bytes,
    mutated_text,
    mutated_tree,
    process,
)
from tests.fuzz.material import MODELS

Document = dict[str, Any]
BESIDE = (
    "model.bin",
    "gltf_buffer_0.bin",
    "gltf_buffer_1.bin",
    "gltf_buffer_2.bin",
    "gltf_buffer_3.bin",
    "texture.png",
    "model.mtl",
)
SUFFIXES = (
    "glb",
    "gltf",
    "obj",
    "ply",
    "stl",
    "off",
    "dae",
    "3mf",
    "zip",
    "xyz",
    "svg",
    "dxf",
    "xaml",
    "json",
    "ctm",
    "tar.gz",
)
EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n0 0 8 8 rectfill\nshowpage\n%%EOF\n"
ADDRESSES = (
    "../outside/secret.png", "../outside/secret.bin", "http://127.0.0.1:9/a.png", "file:///etc/hostname", "/etc/hostname",
    "/dev/zero", "..", "", "a/../../outside/secret.png", "..%2foutside%2fsecret.png", "\\\\127.0.0.1\\a", "link.png",
    "data:,", "data:image/png;base64,AAAA", "data:application/octet-stream;base64,!!", "data:x" * 1000,
)  # fmt: skip


def png(width: int, height: int, rows: int = 1) -> bytes:
    """A picture of one colour whose header says width x height; it holds `rows` rows."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data))
            + kind
            + data
            + struct.pack(">I", zlib.crc32(kind + data))
        )

    packer = zlib.compressobj(9)
    line = bytes(1 + 3 * width)
    pixels = b"".join(packer.compress(line) for _ in range(rows)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", pixels)
        + chunk(b"IEND", b"")
    )


def copied(folder: Path, material: Path, name: str) -> Path:
    for other in (name, *BESIDE):
        if (material / other).exists():
            shutil.copy(material / other, folder / other)
    return folder / name


def glb(document: Document, binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    body = (
        struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def unpacked(data: bytes) -> tuple[Document, bytes]:
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def changed(change: Callable[[Document], None], binary: bool = False) -> Build:
    """The glTF file with a change in its document."""

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        name = "model.glb" if binary else "model.gltf"
        path = copied(folder, material, name)
        if binary:
            document, blob = unpacked(path.read_bytes())
            change(document)
            path.write_bytes(glb(document, blob))
        else:
            document = json.loads(path.read_text())
            change(document)
            path.write_text(json.dumps(document))
        return Case(folder, process(folder, material, model=name))

    return build


def edited(name: str, old: str, new: str) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        path = copied(folder, material, name)
        assert old in path.read_text(), f"{old!r} is not in {name}"
        path.write_text(path.read_text().replace(old, new))
        model = "model.obj" if name == "model.mtl" else name
        if name == "model.mtl":
            copied(folder, material, model)
            path.write_text((material / name).read_text().replace(old, new))
        return Case(folder, process(folder, material, model=model))

    return build


def texture(data: bytes | Callable[[Path], None], cold: bool = False) -> Build:
    """The glTF file whose texture.png holds something else.

    cold : in a process that holds nothing but its own work
    """

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        copied(folder, material, "model.gltf")
        if callable(data):
            (folder / "texture.png").unlink()
            data(folder / "texture.png")
        else:
            (folder / "texture.png").write_bytes(data)
        return Case(folder, process(folder, material, model="model.gltf"), cold=cold)

    return build


def set_at(*path: Any, value: Any) -> Callable[[Document], None]:
    def change(document: Document) -> None:
        at: Any = document
        for key in path[:-1]:
            at = at.setdefault(key, {}) if isinstance(at, dict) else at[key]
        at[path[-1]] = value

    return change


def _cycle(document: Document) -> None:
    document["nodes"] = [{"mesh": 0, "children": [1]}, {"children": [0]}]
    document["scenes"], document["scene"] = [{"nodes": [0]}], 0


def _instances(document: Document) -> None:
    document["nodes"] = [{"mesh": 0, "translation": [i, 0, 0]} for i in range(20_000)]
    document["scenes"], document["scene"] = [{"nodes": list(range(20_000))}], 0


def _doubling(document: Document) -> None:
    """Thirty nodes that each hold the next one twice: a billion instances."""
    document["nodes"] = [{"children": [i + 1, i + 1]} for i in range(30)] + [
        {"mesh": 0}
    ]
    document["scenes"], document["scene"] = [{"nodes": [0]}], 0


def _animated(document: Document) -> None:
    document["animations"] = [{"channels": [], "samplers": []}]


def damaged(rng: random.Random, folder: Path, material: Path) -> Case:
    name = rng.choice(MODELS)
    victim = rng.choice([name, name, name, "texture.png"])
    path, target = copied(folder, material, name), folder / victim
    if victim == name and name == "model.glb" and rng.random() < 0.6:
        document, binary = unpacked(path.read_bytes())
        path.write_bytes(
            glb(
                mutated_tree(rng, document),
                binary if rng.random() < 0.7 else mutated_bytes(rng, binary),
            )
        )
    elif victim == name and name == "model.gltf" and rng.random() < 0.8:
        path.write_text(
            json.dumps(mutated_tree(rng, json.loads(path.read_text()))),
            errors="replace",
        )
    elif (
        target.suffix in (".obj", ".off")
        or target.name.startswith("text.")
        or rng.random() < 0.1
    ):
        target.write_text(
            mutated_text(rng, target.read_text(errors="replace")), errors="replace"
        )
        if name == "model.obj" and rng.random() < 0.4:
            (folder / "model.mtl").write_text(
                mutated_text(rng, (material / "model.mtl").read_text()),
                errors="replace",
            )
    else:
        target.write_bytes(mutated_bytes(rng, target.read_bytes()))
    given = name
    if rng.random() < 0.08:
        given = f"other.{rng.choice(SUFFIXES)}"
        path.rename(folder / given)
    return Case(
        folder,
        process(folder, material, model=given),
        note=f"damaged {victim} of {name}",
    )


def addressed(rng: random.Random, folder: Path, material: Path) -> Case:
    address = rng.choice(ADDRESSES if rng.random() < 0.8 else WORDS)
    if address.startswith("../") and rng.random() < 0.3:
        address = str(folder.parent / address[3:])
    (folder / "link.png").symlink_to(folder.parent / "outside" / "secret.png")
    if rng.random() < 0.6:
        path = copied(folder, material, "model.gltf")
        document = json.loads(path.read_text())
        rng.choice([*document["buffers"], *document["images"]])["uri"] = address
        path.write_text(json.dumps(document), errors="replace")
        return Case(
            folder,
            process(folder, material, model="model.gltf"),
            note=f"address {address[:80]!r}",
        )
    copied(folder, material, "model.obj")
    victim, old = rng.choice(
        (("model.obj", "mtllib model.mtl"), ("model.mtl", "map_Kd texture.png"))
    )
    path = folder / victim
    path.write_text(
        path.read_text().replace(old, f"{old.split()[0]} {address}"), errors="replace"
    )
    return Case(
        folder,
        process(folder, material, model="model.obj"),
        note=f"address {address[:80]!r}",
    )


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    return rng.choices((damaged, addressed), (4, 1))[0](rng, folder, material)


def inline(data: bytes) -> str:
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


SEEDS: dict[str, Build] = {
    "buffer outside": changed(
        set_at("buffers", 0, "uri", value="../outside/secret.bin")
    ),
    "buffer of the system": changed(
        set_at("buffers", 0, "uri", value="/etc/hostname")
    ),
    "buffer at an address": changed(
        set_at("buffers", 0, "uri", value="http://127.0.0.1:9/a.bin")
    ),
    "picture outside": changed(
        set_at("images", 0, "uri", value="../outside/secret.png")
    ),
    "picture outside, named in a glb": changed(
        set_at("images", 0, value={"uri": "../outside/secret.png"}), binary=True
    ),
    "picture that is not there": changed(
        set_at("images", 0, "uri", value="none.png")
    ),
    "picture by a link outside": texture(
        lambda p: p.symlink_to(p.parent.parent / "outside" / "secret.png")
    ),
    "material library outside": edited(
        "model.obj", "mtllib model.mtl", "mtllib ../outside/secret.mtl"
    ),
    "obj picture outside": edited(
        "model.mtl", "map_Kd texture.png", "map_Kd ../outside/secret.png"
    ),
    "eps named png": texture(EPS),
    "picture that never ends": texture(lambda p: p.symlink_to("/dev/zero")),
    "picture that is a pipe": texture(lambda p: os.mkfifo(p)),
    "picture bomb": texture(png(65000, 65000)),
    "picture of 8192 x 8192": texture(png(8192, 8192, 8192), cold=True),
    "cyclic nodes": changed(_cycle),
    "doubling nodes": changed(_doubling),
    "20,000 instances": changed(_instances),
    "animation": changed(_animated),
    "accessor of no type": changed(set_at("accessors", 0, "type", value="VEC9")),
    "accessor of a list": changed(set_at("accessors", 0, "type", value=[])),
    "accessor component type": changed(
        set_at("accessors", 0, "componentType", value=1)
    ),
    "accessor of 4 billion": changed(set_at("accessors", 0, "count", value=2**32)),
    "accessor offset": changed(set_at("accessors", 0, "byteOffset", value=-4)),
    "material NaN": changed(
        set_at(
            "materials",
            0,
            "pbrMetallicRoughness",
            "roughnessFactor",
            value=float("nan"),
        )
    ),
    "material infinity": changed(
        set_at(
            "materials",
            0,
            "pbrMetallicRoughness",
            "baseColorFactor",
            value=[1e400, 1, 1, 1],
        )
    ),
    "emission 1e308": changed(
        set_at("materials", 0, "emissiveFactor", value=[1e308] * 3)
    ),
    "node of nothing": changed(set_at("nodes", value=[{"mesh": 7}])),
    "transform of NaN": changed(
        set_at("nodes", 0, "matrix", value=[float("nan")] * 16)
    ),
    "vt 0": edited("model.obj", "vt ", "vt 0\n#"),
    "f 0": edited("model.obj", "f 1/1", "f 0/0"),
    "Kd nan": edited("model.mtl", "Kd 0.8", "Kd nan"),
    "ply of 10^12 vertices": edited(
        "text.ply", "element vertex 8", "element vertex 1000000000000"
    ),
    "empty stl": edited("text.stl", "facet", "fac"),
}
