"""Path-traced references of indirect light, by Mitsuba 3: what `gi` is compared with.
Shares no code with arfx.

    pip install .[reference]
    python tools/render_references.py [--samples 1024] [NAME ...]

Reads sample_scenes/0041-indirect-light/path-traced/scenes.toml and writes its pictures beside it.
"""

from __future__ import annotations

import argparse
import struct
import time
import tomllib
import zlib
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

FOLDER = (
    Path(__file__).parents[1]
    / "sample_scenes"
    / "0041-indirect-light"
    / "path-traced"
)
RADIUS_M = 0.06
FAR_M = 60.0
BITS = 10  # of a channel: four steps a grey level, in the upper bits of a 16-bit PNG


def rgb(value: list[float], scale: float = 1.0) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) * scale for v in value]}


def described(
    document: dict[str, Any], name: str, samples: int, with_object: bool
) -> dict[str, Any]:
    """The scene as Mitsuba takes it."""
    place, camera, light, scene = (
        mi.ScalarTransform4f,
        document["camera"],
        document["light"],
        document["scene"][name],
    )
    plane = {
        "type": "twosided",
        "inner": {
            "type": "diffuse",
            "reflectance": rgb(document["planes"]["albedo"]),
        },
    }
    out: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 10},
        "surroundings": {"type": "constant", "radiance": rgb(light["ambient"])},
        # irradiance over pi is the radiance of a white diffuse surface
        "lamp": {
            "type": "directional", "direction": [-v for v in scene["towards_lamp"]], "irradiance": rgb(light["lamp"], np.pi)
        },
        "sensor": {
            "type": "perspective", "fov_axis": "x",
            "fov": float(2 * np.degrees(np.arctan(camera["width"] / 2 / camera["focal_px"]))),
            "to_world": place().look_at(origin=camera["eye"], target=camera["target"], up=[0, 0, 1]),
            "film": {
                "type": "hdrfilm", "width": camera["width"], "height": camera["height"], "rfilter": {"type": "box"},
                "pixel_format": "rgb", "component_format": "float32",
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        },
        "floor": {"type": "rectangle", "to_world": place().scale([FAR_M, FAR_M, 1]), "bsdf": plane},
    }  # fmt: skip
    if "wall_normal" in scene:
        n = np.array(scene["wall_normal"]) / np.linalg.norm(scene["wall_normal"])
        m = np.eye(4)
        m[:3, 0], m[:3, 1], m[:3, 2] = (
            np.cross([0, 0, 1], n) * FAR_M,
            np.array([0, 0, 1]) * FAR_M,
            n,
        )
        m[:3, 3] = scene["wall_point"]
        out["wall"] = {"type": "rectangle", "to_world": place(m), "bsdf": plane}
    if not with_object:
        return out
    mirror = {
        "type": "conductor",
        "material": "none",
        "specular_reflectance": rgb(scene["albedo"]),
    }
    surface = (
        mirror
        if scene.get("mirror")
        else {"type": "diffuse", "reflectance": rgb(scene["albedo"])}
    )
    if scene["shape"] == "ball":
        body: dict[str, Any] = {
            "type": "sphere",
            "center": [0, 0, RADIUS_M],
            "radius": RADIUS_M,
        }
    else:
        body = {
            "type": "cube",
            "to_world": place().translate([0, 0, RADIUS_M]).scale([RADIUS_M] * 3),
        }
    out["object"] = {**body, "bsdf": surface}
    if "emission" in scene:
        out["object"]["emitter"] = {
            "type": "area",
            "radiance": rgb(scene["emission"]),
        }
    return out


def coded(linear: np.ndarray) -> np.ndarray:
    """sRGB in BITS bits, in the upper bits of uint16."""
    x = np.clip(linear, 0, 1)
    curve = np.where(
        x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055
    )
    top = 2**BITS - 1
    return np.asarray(
        np.round(curve * top).astype(np.uint32) * 65535 // top, np.uint16
    )


def write_png(path: Path, pixels: np.ndarray) -> None:
    """(h, w, 3) uint16; lines as differences to the pixel on the left, which a smooth
    picture packs best as.
    """
    rows = (
        pixels.astype(">u2")
        .reshape(len(pixels), -1)
        .view(np.uint8)
        .reshape(len(pixels), -1)
    )
    left = np.concatenate([np.zeros((len(rows), 6), np.uint8), rows[:, :-6]], 1)
    lines = np.concatenate([np.ones((len(rows), 1), np.uint8), rows - left], 1)
    parts = [
        (b"IHDR", struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b""),
    ]  # fmt: skip
    body = b"".join(
        struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d))
        for k, d in parts
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--out", type=Path, default=FOLDER)
    parser.add_argument("names", nargs="*")
    given = parser.parse_args()
    mi.set_variant("scalar_rgb")
    document = tomllib.loads((FOLDER / "scenes.toml").read_text(encoding="utf-8"))
    for name in given.names or document["scene"]:
        # a lone plane without an object is even: albedo x light, known without a picture
        for with_object in (
            (True, False) if "wall_normal" in document["scene"][name] else (True,)
        ):
            start = time.perf_counter()
            picture = np.array(
                mi.render(
                    mi.load_dict(
                        described(document, name, given.samples, with_object)
                    )
                )
            )
            path = given.out / f"{name}{'' if with_object else '-empty'}.png"
            write_png(path, coded(picture))
            print(
                f"{path.name}: {time.perf_counter() - start:.1f} s,"
                f" {path.stat().st_size / 1000:.0f} kB"
            )


if __name__ == "__main__":
    main()
