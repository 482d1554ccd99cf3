"""The JSON of a glTF file before anything is made of it: version, extensions, what is left out."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from arfx.core.opener import parse_json
from arfx.errors import InputError

_LISTS: tuple[str, ...] = ("accessors", "animations", "bufferViews", "buffers", "images")
_LISTS += ("materials", "meshes", "nodes", "samplers", "scenes", "skins", "textures")
# What is done with each extension: "" = read, else what will be missing where it is only used.
# Those that are not in the table, or not read, must not be in extensionsRequired.
_EXTENSIONS = {
    "KHR_materials_emissive_strength": "",
    "KHR_materials_ior": "",
    "KHR_materials_specular": "",
    "EXT_texture_webp": "",
    "KHR_xmp_json_ld": "",
    "KHR_lights_punctual": "its lamps: the clip's own light is used",
    "KHR_materials_variants": "its variants: the default one is shown",
    "KHR_materials_clearcoat": "",
    "KHR_materials_transmission": "transmission: glass looks solid",
    "KHR_materials_volume": "colour by depth of glass",
    "KHR_materials_sheen": "",
    "KHR_materials_iridescence": "iridescence",
    "KHR_materials_anisotropy": "anisotropic highlights",
    "KHR_materials_dispersion": "dispersion",
    "KHR_materials_unlit": "",
    "KHR_materials_pbrSpecularGlossiness": "",
    "KHR_mesh_quantization": "",
    "KHR_texture_transform": "",
    "KHR_node_visibility": "",
    "EXT_mesh_gpu_instancing": "",
    "KHR_animation_pointer": "animation",
    "KHR_texture_basisu": "textures in the KTX2 format",
}
_CONVERT = "npx @gltf-transform/cli"
_CONVERTERS = {
    "KHR_draco_mesh_compression": "copy",
    "EXT_meshopt_compression": "copy",
    "KHR_texture_basisu": "ktxdecompress",
    "EXT_texture_avif": "png",
}


def gltf_header(data: bytes, kind: str, path: Path) -> dict[str, Any]:
    """The JSON of a .glb or .gltf, {} for other kinds. Raises InputError."""
    if kind not in ("glb", "gltf"):
        return {}
    text = data
    if kind == "glb":
        if len(data) < 20 or data[:4] != b"glTF":
            raise _damaged(path, "it does not begin as a GLB file")
        text = data[20 : 20 + struct.unpack("<I", data[12:16])[0]]
    try:
        header = parse_json(text)
    except UnicodeDecodeError:
        raise _damaged(path, "its JSON is not UTF-8") from None
    except json.JSONDecodeError as e:
        raise _damaged(
            path, f"its JSON breaks off or is wrong at line {e.lineno}, column {e.colno}"
        ) from None
    except ValueError as e:
        raise _damaged(path, f"its JSON: {e}") from None
    if not isinstance(header, dict):
        raise _damaged(path, "its JSON is no object")
    _check_version(header, path)
    for name in _LISTS:
        rows = header.get(name, [])
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise _damaged(path, f"{name} is no list of objects")
    return header


def check_gltf(header: dict[str, Any], path: Path) -> list[str]:
    """Notices of what is left out. Raises InputError: an extension that is required is not read."""
    left_out = _check_extensions(header, path)
    at_rest = [
        f"{len(header[key])} {what}{'s' if len(header[key]) > 1 else ''}"
        for key, what in (("animations", "animation"), ("skins", "skin"))
        if header.get(key)
    ]
    if any("targets" in p for m in header.get("meshes", []) for p in m["primitives"]):
        at_rest.append("morph targets")
    notices = []
    if at_rest:
        what = " and ".join(at_rest)
        notices.append(f"{what} left out: it is shown as it stands at rest")
    return notices + [f"left out {what}" for what in left_out]


def _check_version(header: dict[str, Any], path: Path) -> None:
    asset = header.get("asset", {})
    if not isinstance(asset, dict):
        raise _damaged(path, "its asset is no object")
    version = json.dumps(asset.get("version", "2.0") or "of no version").strip('"')[:20]
    if not version.startswith("2."):
        hint = (
            "export it again as glTF 2.0; Blender and `npx gltf-pipeline -i OLD -o NEW` do"
        )
        raise InputError(f"model {path} is glTF {version}, glTF 2.0 is read", hint)


def _check_extensions(header: dict[str, Any], path: Path) -> list[str]:
    """What extensions that are used leave out.

    Raises InputError: one that is required is not read.
    """
    keys = ("extensionsRequired", "extensionsUsed")
    required, used = ([name[:80] for name in header.get(key, [])] for key in keys)
    for name in required:
        if _EXTENSIONS.get(name) != "":
            how = (
                f": {_CONVERT} {_CONVERTERS[name]} {path.name} NEW.glb"
                if name in _CONVERTERS
                else ""
            )
            raise InputError(
                f"model {path} requires {name}, which is not read",
                f"export it without{how}",
            )
    texts = {name: _EXTENSIONS.get(name, "an extension that is not read") for name in used}
    return [f"{text} ({name})" for name, text in texts.items() if text]


def _damaged(path: Path, what: str) -> InputError:
    return InputError(
        f"cannot read model {path}: {what}", "the file is damaged or not what its name says"
    )
