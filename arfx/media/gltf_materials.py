"""Materials of a glTF file (glTF 2.0 section 3.9 and KHR_materials_*) as core.model.Material.

Unlit materials become emission, specular-glossiness becomes metallic-roughness."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import CLAMP, MIRROR, OPAQUE, REPEAT, Material, Texture
from arfx.media.gltf import Buffers
from arfx.media.model_files import ModelFile
from arfx.media.model_materials import checked, resized

_WRAPS = {33071: CLAMP, 33648: MIRROR}
_NEAREST = 9728
_ROWS = 256  # of a picture, worked on at a time
_DIELECTRIC = 0.04  # reflected by what is no metal
_COAT = "extensions/KHR_materials_clearcoat/clearcoat"
_SHEEN = "extensions/KHR_materials_sheen/sheen"
# Fields of Material, and where a glTF material holds them.
_TEXTURES = {
    "base_texture": "pbrMetallicRoughness/baseColorTexture",
    "metallic_roughness_texture": "pbrMetallicRoughness/metallicRoughnessTexture",
    "emissive_texture": "emissiveTexture",
    "normal_texture": "normalTexture",
    "occlusion_texture": "occlusionTexture",
    "clearcoat_texture": f"{_COAT}Texture",
    "clearcoat_roughness_texture": f"{_COAT}RoughnessTexture",
    "clearcoat_normal_texture": f"{_COAT}NormalTexture",
    "sheen_colour_texture": f"{_SHEEN}ColorTexture",
    "sheen_roughness_texture": f"{_SHEEN}RoughnessTexture",
}
# With the default.
_FACTORS: dict[str, tuple[str, float | tuple[float, ...]]] = {
    "base_colour": ("pbrMetallicRoughness/baseColorFactor", (1.0, 1.0, 1.0, 1.0)),
    "metallic": ("pbrMetallicRoughness/metallicFactor", 1.0),
    "roughness": ("pbrMetallicRoughness/roughnessFactor", 1.0),
    "emissive": ("emissiveFactor", (0.0, 0.0, 0.0)),
    "clearcoat": (f"{_COAT}Factor", 0.0),
    "clearcoat_roughness": (f"{_COAT}RoughnessFactor", 0.0),
    "sheen_colour": (f"{_SHEEN}ColorFactor", (0.0, 0.0, 0.0)),
    "sheen_roughness": (f"{_SHEEN}RoughnessFactor", 0.0),
    "normal_scale": ("normalTexture/scale", 1.0),
    "occlusion_strength": ("occlusionTexture/strength", 1.0),
    "clearcoat_normal_scale": (f"{_COAT}NormalTexture/scale", 1.0),
    "alpha_cutoff": ("alphaCutoff", 0.5),
}
_TINTS = ("specularTexture", "specularColorTexture", "specularColorFactor")


class GltfMaterials:
    """The materials of a file, each made where it is first asked for."""

    def __init__(self, file: ModelFile, header: dict[str, Any], buffers: Buffers) -> None:
        self._file, self._header, self._buffers = file, header, buffers
        self.of = cache(self._material)

    def _material(self, number: int, coloured: bool) -> Material:
        """coloured : the mesh has colours by vertex

        Raises InputError: a texture is too large or damaged, a number out of range."""
        given = self._header["materials"][number]
        extensions = given.get("extensions", {})
        fields: dict[str, Any] = {
            name: self._texture(_stated(given, path)) for name, path in _TEXTURES.items()
        }
        for name, (path, default) in _FACTORS.items():
            value, several = _stated(given, path, default), isinstance(default, tuple)
            fields[name] = tuple(map(float, value)) if several else float(value)
        glossy = extensions.get("KHR_materials_pbrSpecularGlossiness")
        if glossy is not None:
            fields |= self._glossy(glossy)
        strength = _stated(
            extensions, "KHR_materials_emissive_strength/emissiveStrength", 1
        )
        fields["emissive"] = tuple(float(strength) * v for v in fields["emissive"])
        if not any(fields["emissive"]):
            fields["emissive_texture"] = None
        if fields["clearcoat_normal_texture"] is not None:
            self._file.notices.append("left out bumps of clear coat: it lies evenly")
        specular = extensions.get("KHR_materials_specular", {})
        if not specular.keys().isdisjoint(_TINTS):
            what = "left out textures and tints of KHR_materials_specular"
            self._file.notices.append(what)
        ior = float(_stated(extensions, "KHR_materials_ior/ior", 1.5))
        f0 = ((ior - 1.0) / (ior + 1.0)) ** 2 if ior > 0 else _DIELECTRIC
        material = Material(
            name=f"{given.get('name', 'material')} {number}",
            specular=float(specular.get("specularFactor", 1)) * f0 / 0.08,
            alpha_mode=str(given.get("alphaMode", OPAQUE)),
            double_sided=bool(given.get("doubleSided", False)),
            **fields,
        )
        if "KHR_materials_unlit" in extensions:
            if not coloured:
                return checked(_unlit(material))
            # colours by vertex are no part of emission
            text = f"material {material.name} is unlit with colours by vertex: it is shown lit"
            self._file.notices.append(text)
        return checked(material)

    def _glossy(self, given: dict[str, Any]) -> dict[str, Any]:
        """Metallic-roughness of specular-glossiness, texel by texel where it has textures."""
        shine = [
            *given.get("specularFactor", [1.0] * 3),
            given.get("glossinessFactor", 1.0),
        ]
        factors = given.get("diffuseFactor", [1.0] * 4), shine
        keys = "diffuseTexture", "specularGlossinessTexture"
        matt, shiny = textures = [self._texture(given.get(key)) for key in keys]
        laid, rough_laid = matt or shiny, shiny or matt
        if laid is None or rough_laid is None:
            base, rough = _metallic(*(np.array(f, np.float32) for f in factors))
            return {
                "base_colour": tuple(base.tolist()),
                "roughness": float(rough[0]),
                "metallic": float(rough[1]),
            }
        size = max(t.picture.shape[1::-1] for t in (laid, rough_laid))
        white = np.full((1, 1, 4), 255, np.uint8)
        pictures = [resized(white if t is None else t.picture, *size) for t in textures]
        base, rough = np.full((2, *pictures[0].shape), 255, np.uint8)
        for a in range(0, len(base), _ROWS):
            rows = slice(a, a + _ROWS)
            linear = (
                _linear(p[rows]) * np.array(f, np.float32)
                for p, f in zip(pictures, factors, strict=True)
            )
            colour, matte = _metallic(*linear)
            colour[..., :3] = SRGB.encode(colour[..., :3])
            base[rows] = np.round(colour * 255)
            rough[rows, :, 1:3] = np.round(matte * 255)
        return {
            "base_colour": (1.0, 1.0, 1.0, 1.0),
            "base_texture": replace(laid, picture=base),
            "metallic": 1.0,
            "roughness": 1.0,
            "metallic_roughness_texture": replace(rough_laid, picture=rough),
        }

    def _texture(self, slot: dict[str, Any] | None) -> Texture | None:
        if slot is None:
            return None
        change = _stated(slot, "extensions/KHR_texture_transform", {})
        texture = self._header["textures"][slot["index"]]
        source = _stated(texture, "extensions/EXT_texture_webp", texture).get("source")
        if source is None:
            return None
        image, of = self._header["images"][source], self._buffers
        picture = self._file.picture(
            source,
            lambda: (
                of.view(image["bufferView"])
                if "bufferView" in image
                else of.file(image["uri"])
            ),
        )
        uv_set = change.get("texCoord", slot.get("texCoord", 0))
        if picture is None or uv_set not in (0, 1):
            if picture is not None:
                what = "left out a texture laid by a third set of coordinates"
                self._file.notices.append(what)
            return None
        samplers = self._header.get("samplers", [])
        sampler = samplers[texture["sampler"]] if "sampler" in texture else {}
        wrap = [_WRAPS.get(sampler.get(k, 0), REPEAT) for k in ("wrapS", "wrapT")]
        nearest = sampler.get("magFilter") == _NEAREST
        matrix = _picture_from_uv(change)
        return Texture(picture, uv_set, matrix, (wrap[0], wrap[1]), nearest)


def _unlit(material: Material) -> Material:
    """Its colour as emission, on a surface that sends nothing back."""
    red, green, blue, alpha = material.base_colour
    return Material(
        material.name,
        base_colour=(0.0, 0.0, 0.0, alpha),
        base_texture=material.base_texture,
        roughness=1.0,
        emissive=(red, green, blue),
        emissive_texture=material.base_texture,
        specular=0.0,
        alpha_mode=material.alpha_mode,
        alpha_cutoff=material.alpha_cutoff,
        double_sided=material.double_sided,
    )


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


def _linear(texels: np.ndarray) -> np.ndarray:
    """Of sRGB in linear light, alpha as it is, float32."""
    out = texels / np.float32(255)
    out[..., :3] = SRGB.decode(out[..., :3])
    return out


def _metallic(diffuse: np.ndarray, shine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Base colour and alpha (..., 4); roughness and metallic (..., 2).

    diffuse : (..., 4) colour and alpha;  shine : (..., 4) specular colour and glossiness
    Source: Khronos' convert-between-workflows; brightness: root of the weighted squares (HSP).
    """
    colour, specular = diffuse[..., :3], shine[..., :3]
    d, s = _brightness(colour), _brightness(specular)
    rest = (1.0 - specular.max(-1)) / (1.0 - _DIELECTRIC)
    b = d * rest + s - 2 * _DIELECTRIC
    square = b * b - 4 * _DIELECTRIC * (_DIELECTRIC - s)
    share = (np.sqrt(np.maximum(square, 0.0)) - b) / (2 * _DIELECTRIC)
    metal = np.where(s < _DIELECTRIC, 0.0, np.clip(share, 0.0, 1.0))
    m = metal[..., None]
    matt = colour * rest[..., None] / np.maximum(1.0 - m, 1e-6)
    shiny = (specular - _DIELECTRIC * (1.0 - m)) / np.maximum(m, 1e-6)
    base = np.clip(matt + (shiny - matt) * m * m, 0.0, 1.0)
    rough = np.stack([1.0 - shine[..., 3], metal], -1)
    return np.concatenate([base, diffuse[..., 3:]], -1), rough


def _brightness(colour: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(colour**2 @ np.array([0.299, 0.587, 0.114])))
