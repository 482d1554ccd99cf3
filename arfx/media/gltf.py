"""A glTF file before anything is made of it: its JSON, what of it is left out, its numbers and
bytes: buffers, views of them, accessors (glTF 2.0 section 3.6).

Materials of a glTF file (glTF 2.0 section 3.9 and KHR_materials_*) as core.model.Material.

Unlit materials become emission, specular-glossiness becomes metallic-roughness."""

import base64
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB
from arfx.core.model import CLAMP, MIRROR, OPAQUE, REPEAT, Material, Texture
from arfx.core.opener import parse_json
from arfx.errors import InputError
from arfx.media.model_files import DAMAGED, MAX_FACES, TABLES, ModelFile
from arfx.media.model_parts import checked, resized, shares

_CONVERT = "npx @gltf-transform/cli"
_ACCESSORS = TABLES["accessors"]
Json = dict[str, Any]
_WRAPS = {33071: CLAMP, 33648: MIRROR}
_NEAREST = 9728
_ROWS = 256  # of a picture, worked on at a time
_DIELECTRIC = 0.04  # reflected by what is no metal
_TINTS = ("specularTexture", "specularColorTexture", "specularColorFactor")


class Gltf:
    """Its JSON and buffers, read at once.

    file : gets notices of what is left out;  header : its JSON
    Raises InputError: of no glTF 2, an extension that is required is not read, a buffer is
    missing or cut short; what Python raises where it does not fit together."""

    def __init__(self, file: ModelFile) -> None:
        self.file = file
        data, self._chunk = (
            file.data,
            b"",
        )  # the second: behind the JSON of a GLB file
        if file.kind == "glb":
            if len(data) < 20 or data[:4] != b"glTF":
                raise InputError("it does not begin as a GLB file", DAMAGED)
            end = 20 + int.from_bytes(data[12:16], "little")
            size = int.from_bytes(data[end : end + 4], "little")
            data, self._chunk = data[20:end], data[end + 8 : end + 8 + size]
        try:
            self.header: Json = parse_json(data.decode("utf-8-sig"))
        except ValueError as e:
            raise InputError(f"its JSON: {e}", DAMAGED) from None
        _check(self.header, file)
        self._views = self.header.get("bufferViews", [])
        self._buffers: list[bytes] = []
        for buffer in self.header.get("buffers", []):
            content, size = self.content(buffer), buffer.get("byteLength", 0)
            if len(content) < size:
                what = f"a buffer holds {len(content)} of {size} bytes"
                raise InputError(what, DAMAGED)
            self._buffers.append(content)

    def content(self, given: Json) -> bytes:
        """Of a buffer or a picture: a view, what is written in its address, a file beside the
        model, or what a GLB file holds behind its JSON. Raises InputError."""
        if "bufferView" in given:
            view = self._views[given["bufferView"]]
            start = view.get("byteOffset", 0)
            return self._buffers[view["buffer"]][start : start + view["byteLength"]]
        uri: str | None = given.get("uri")
        if uri is None:
            return self._chunk
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self.file.read(uri)

    def array(self, number: int, columns: int | None = None) -> ndarray:
        """(count, columns) of an accessor, sparse values put in; normalised numbers are floats.

        columns : how many there must be, None = any. Raises InputError."""
        accessor = self.header["accessors"][number]
        count, found = accessor["count"], _ACCESSORS[accessor["type"]]
        if not 0 <= count <= 3 * MAX_FACES:
            raise InputError(f"accessor {number} counts {count}", DAMAGED)
        if columns not in (None, found):
            raise InputError(
                f"accessor {number} is of type {accessor['type']}", DAMAGED
            )
        out = np.zeros((count, found), _ACCESSORS[str(accessor["componentType"])])
        if "bufferView" in accessor:
            out[:] = self._values(accessor, count, found)
        if sparse := accessor.get("sparse"):
            rows = self._values(sparse["indices"], sparse["count"], 1)[:, 0]
            values = {"componentType": accessor["componentType"], **sparse["values"]}
            out[rows] = self._values(values, sparse["count"], found)
        return shares(out) if accessor.get("normalized") else out

    def _values(self, place: Json, count: int, columns: int) -> ndarray:
        """place : an accessor, or a part of a sparse one"""
        view = self._views[place["bufferView"]]
        kind = np.dtype(_ACCESSORS[str(place["componentType"])])
        start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * columns)
        content = self._buffers[view["buffer"]]
        return ndarray(
            (count, columns), kind, content, start, (stride, kind.itemsize)
        )


def _check(header: Json, file: ModelFile) -> None:
    """Notices of what is left out. Raises InputError."""
    version = str(header.get("asset", {}).get("version") or "2.0")
    if not version.startswith("2."):
        hint = "export it again as glTF 2.0; Blender and `npx gltf-pipeline -i OLD -o NEW` do"
        raise InputError(f"it is glTF {version[:20]}, glTF 2.0 is read", hint)
    for name in header.get("extensionsRequired", []):
        if TABLES["extensions"].get(name) != "":
            hint = "export it without"
            if command := TABLES["converters"].get(name):
                hint += f": {_CONVERT} {command} {file.path.name} NEW.glb"
            raise InputError(f"it requires {name[:80]}, which is not read", hint)
    for name in header.get("extensionsUsed", []):
        if text := TABLES["extensions"].get(name, "an extension that is not read"):
            file.notices.append(f"left out {text} ({name[:80]})")
    at_rest = [key for key in ("animations", "skins") if header.get(key)]
    if any("targets" in p for m in header.get("meshes", []) for p in m["primitives"]):
        at_rest.append("morph targets")
    if at_rest:
        what = " and ".join(at_rest)
        file.notices.append(f"{what} left out: it is shown as it stands at rest")


def gltf_material(gltf: Gltf, number: int, coloured: bool) -> Material:
    """coloured : the mesh has colours by vertex

    Raises InputError: a texture is too large or damaged, a number out of range."""
    given, notices = gltf.header["materials"][number], gltf.file.notices
    extensions = given.get("extensions", {})
    fields: Json = {
        name: _texture(gltf, _stated(given, path))
        for name, path in TABLES["textures"].items()
    }
    for name, (path, default) in TABLES["factors"].items():
        value, several = _stated(given, path, default), isinstance(default, list)
        fields[name] = tuple(map(float, value)) if several else float(value)
    if (glossy := extensions.get("KHR_materials_pbrSpecularGlossiness")) is not None:
        fields |= _glossy(gltf, glossy)
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
            # on a surface that sends nothing back
            *colour, alpha = fields["base_colour"]
            fields = {
                "base_colour": (0.0, 0.0, 0.0, alpha),
                "base_texture": fields["base_texture"],
                "roughness": 1.0,
                "emissive": tuple(colour),
                "emissive_texture": fields["base_texture"],
                "specular": 0.0,
                "alpha_cutoff": fields["alpha_cutoff"],
            }
    return checked(
        Material(
            name,
            alpha_mode=str(given.get("alphaMode", OPAQUE)),
            double_sided=bool(given.get("doubleSided", False)),
            **fields,
        )
    )


def _glossy(gltf: Gltf, given: Json) -> Json:
    """Metallic-roughness of specular-glossiness, texel by texel where it has textures."""
    specular = given.get("specularFactor", [1.0] * 3)
    shine = [*specular, given.get("glossinessFactor", 1.0)]
    factors = np.array([given.get("diffuseFactor", [1.0] * 4), shine], np.float32)
    keys = "diffuseTexture", "specularGlossinessTexture"
    matt, shiny = textures = [_texture(gltf, given.get(key)) for key in keys]
    laid, rough_laid = matt or shiny, shiny or matt
    if laid is None or rough_laid is None:
        base, rough = _metallic(*factors)
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
        part = np.stack([p[rows] for p in pictures]) / np.float32(255)
        part[..., :3] = SRGB.decode(part[..., :3])
        colour, matte = _metallic(*(part * factors[:, None, None]))
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


def _texture(gltf: Gltf, slot: Json | None) -> Texture | None:
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
    sampler: Json = {}
    if "sampler" in texture:
        sampler = gltf.header["samplers"][texture["sampler"]]
    across, down = (_WRAPS.get(sampler.get(k, 0), REPEAT) for k in ("wrapS", "wrapT"))
    angle = float(change.get("rotation", 0))
    c, s = np.cos(angle), np.sin(angle)
    wide, high = change.get("scale", (1, 1))
    x, y = change.get("offset", (0, 0))
    return Texture(
        picture,
        uv_set,
        np.array([[wide * c, high * s, x], [-wide * s, high * c, y]], float),
        (across, down),
        sampler.get("magFilter") == _NEAREST,
    )


def _stated(tree: Json, path: str, default: Any = None) -> Any:
    *way, last = path.split("/")
    for key in way:
        tree = tree.get(key, {})
    return tree.get(last, default)


def _metallic(diffuse: ndarray, shine: ndarray) -> tuple[ndarray, ndarray]:
    """Base colour and alpha (..., 4); roughness and metallic (..., 2).

    diffuse : (..., 4) colour and alpha;  shine : (..., 4) specular colour and glossiness
    Source: Khronos' convert-between-workflows; brightness: root of the weighted squares (HSP).
    """
    colour, specular = diffuse[..., :3], shine[..., :3]
    weights = np.array([0.299, 0.587, 0.114])
    d, s = np.sqrt(colour**2 @ weights), np.sqrt(specular**2 @ weights)
    rest = (1.0 - specular.max(-1)) / (1.0 - _DIELECTRIC)
    b = d * rest + s - 2 * _DIELECTRIC
    square = b * b - 4 * _DIELECTRIC * (_DIELECTRIC - s)
    share = (np.sqrt(np.maximum(square, 0.0)) - b) / (2 * _DIELECTRIC)
    metal = np.where(s < _DIELECTRIC, 0.0, np.clip(share, 0.0, 1.0))
    m = metal[..., None]
    matt = colour * rest[..., None] / np.maximum(1.0 - m, 1e-6)
    shiny = (specular - _DIELECTRIC * (1.0 - m)) / np.maximum(m, 1e-6)
    return np.concatenate(
        [np.clip(matt + (shiny - matt) * m * m, 0.0, 1.0), diffuse[..., 3:]], -1
    ), np.stack([1.0 - shine[..., 3], metal], -1)
