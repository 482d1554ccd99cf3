"""Materials of a glTF file (glTF 2.0 section 3.9 and KHR_materials_*) as core.model.Material.

Unlit materials become emission, specular-glossiness becomes metallic-roughness."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from arfx.core.model import CLAMP, MIRROR, OPAQUE, REPEAT, Material, Texture
from arfx.media.gltf import Gltf
from arfx.media.model_files import TABLES
from arfx.media.model_parts import checked, resized

_WRAPS = {33071: CLAMP, 33648: MIRROR}
_NEAREST = 9728
_ROWS = 256  # of a picture, worked on at a time
_DIELECTRIC = 0.04  # reflected by what is no metal
_TINTS = ("specularTexture", "specularColorTexture", "specularColorFactor")


def gltf_material(gltf: Gltf, number: int, coloured: bool) -> Material:
    """coloured : the mesh has colours by vertex

    Raises InputError: a texture is too large or damaged, a number out of range."""
    given, notices = gltf.header["materials"][number], gltf.file.notices
    extensions = given.get("extensions", {})
    fields: dict[str, Any] = {
        name: _texture(gltf, _stated(given, path))
        for name, path in TABLES["textures"].items()
    }
    for name, (path, default) in TABLES["factors"].items():
        value, several = _stated(given, path, default), isinstance(default, list)
        fields[name] = tuple(map(float, value)) if several else float(value)
    if (glossy := extensions.get("KHR_materials_pbrSpecularGlossiness")) is not None:
        fields |= _metallic(gltf, glossy)
    strength = _stated(
        extensions, "KHR_materials_emissive_strength/emissiveStrength", 1
    )
    fields["emissive"] = tuple(float(strength) * v for v in fields["emissive"])
    if not any(fields["emissive"]):
        fields["emissive_texture"] = None
    if fields["clearcoat_normal_texture"] is not None:
        notices.append("left out bumps of clear coat: it lies evenly")
    specular = extensions.get("KHR_materials_specular", {})
    if not specular.keys().isdisjoint(_TINTS):
        notices.append("left out textures and tints of KHR_materials_specular")
    ior = float(_stated(extensions, "KHR_materials_ior/ior", 1.5))
    f0 = ((ior - 1.0) / (ior + 1.0)) ** 2 if ior > 0 else _DIELECTRIC
    fields["specular"] = float(specular.get("specularFactor", 1)) * f0 / 0.08
    name = f"{given.get('name', 'material')} {number}"
    if "KHR_materials_unlit" in extensions:
        if coloured:  # they are no part of emission
            text = f"material {name} is unlit with colours by vertex: it is shown lit"
            notices.append(text)
        else:
            fields = _emission(fields)
    return checked(
        Material(
            name,
            alpha_mode=str(given.get("alphaMode", OPAQUE)),
            double_sided=bool(given.get("doubleSided", False)),
            **fields,
        )
    )


def _emission(fields: dict[str, Any]) -> dict[str, Any]:
    """Of an unlit material: its colour as emission, on a surface that sends nothing back."""
    *colour, alpha = fields["base_colour"]
    return {
        "base_colour": (0.0, 0.0, 0.0, alpha),
        "base_texture": fields["base_texture"],
        "roughness": 1.0,
        "emissive": tuple(colour),
        "emissive_texture": fields["base_texture"],
        "specular": 0.0,
        "alpha_cutoff": fields["alpha_cutoff"],
    }


def _metallic(gltf: Gltf, given: dict[str, Any]) -> dict[str, Any]:
    """Metallic-roughness of specular-glossiness, texel by texel where it has textures."""
    from PIL import Image
    from trimesh.visual.gloss import specular_to_pbr

    keys = "diffuseTexture", "specularGlossinessTexture"
    matt, shiny = textures = [_texture(gltf, given.get(key)) for key in keys]
    factors = {key: value for key, value in given.items() if key.endswith("Factor")}
    laid, rough_laid = matt or shiny, shiny or matt
    if laid is None or rough_laid is None:
        found = specular_to_pbr(**factors)
        return {
            "base_colour": tuple(map(float, found["baseColorFactor"])),
            "roughness": float(found["roughnessFactor"]),
            "metallic": float(found["metallicFactor"]),
        }
    size = max(t.picture.shape[1::-1] for t in (laid, rough_laid))
    white = np.full((1, 1, 4), 255, np.uint8)
    pictures = [resized(white if t is None else t.picture, *size) for t in textures]
    base, rough = np.full((2, *pictures[0].shape), 255, np.uint8)
    for a in range(0, len(base), _ROWS):
        rows = slice(a, a + _ROWS)
        texels = {
            k: Image.fromarray(p[rows]) for k, p in zip(keys, pictures, strict=True)
        }
        found = specular_to_pbr(**(factors | texels))
        base[rows] = found["baseColorTexture"]
        rough[rows, :, 1:3] = np.array(found["metallicRoughnessTexture"])[..., 1:]
    return {
        "base_colour": (1.0, 1.0, 1.0, 1.0),
        "base_texture": replace(laid, picture=base),
        "metallic": 1.0,
        "roughness": 1.0,
        "metallic_roughness_texture": replace(rough_laid, picture=rough),
    }


def _texture(gltf: Gltf, slot: dict[str, Any] | None) -> Texture | None:
    if slot is None:
        return None
    change = _stated(slot, "extensions/KHR_texture_transform", {})
    texture = gltf.header["textures"][slot["index"]]
    source = _stated(texture, "extensions/EXT_texture_webp", texture).get("source")
    if source is None:
        return None
    image = gltf.header["images"][source]
    picture = gltf.file.picture(source, lambda: gltf.content(image))
    uv_set = change.get("texCoord", slot.get("texCoord", 0))
    if picture is None:
        return None
    if uv_set not in (0, 1):
        what = "left out a texture laid by a third set of coordinates"
        gltf.file.notices.append(what)
        return None
    sampler: dict[str, Any] = {}
    if "sampler" in texture:
        sampler = gltf.header["samplers"][texture["sampler"]]
    across, down = (_WRAPS.get(sampler.get(k, 0), REPEAT) for k in ("wrapS", "wrapT"))
    nearest = sampler.get("magFilter") == _NEAREST
    return Texture(picture, uv_set, _picture_from_uv(change), (across, down), nearest)


def _stated(tree: dict[str, Any], path: str, default: Any = None) -> Any:
    *way, last = path.split("/")
    for key in way:
        tree = tree.get(key, {})
    return tree.get(last, default)


def _picture_from_uv(change: dict[str, Any]) -> np.ndarray:
    """(2, 3) of a KHR_texture_transform."""
    angle = float(change.get("rotation", 0))
    c, s = np.cos(angle), np.sin(angle)
    wide, high = change.get("scale", (1, 1))
    x, y = change.get("offset", (0, 0))
    return np.array([[wide * c, high * s, x], [-wide * s, high * c, y]], float)
