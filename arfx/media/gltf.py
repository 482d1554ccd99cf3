"""The JSON of a glTF file, looked at before anything is made of it: what would hang or fill the memory, and what is left out."""

from __future__ import annotations

import json
import struct
from collections import deque
from pathlib import Path
from typing import Any

from arfx.core.opener import parse_json
from arfx.errors import InputError

MAX_FACES = 5_000_000  # of all instances together: 1.5 GB while the edges are looked for
MAX_PARTS = 10_000  # mesh instances: each is a part with a transform of its own, a hundred parts take a second
LISTS: tuple[str, ...] = ("accessors", "animations", "bufferViews", "buffers", "images", "materials", "meshes", "nodes")
LISTS += ("samplers", "scenes", "skins", "textures")
_COMPONENTS = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}  # glTF 2.0 section 3.6.2.2
SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
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
_TYPES = {"POSITION": "VEC3", "NORMAL": "VEC3", "TEXCOORD_0": "VEC2"}


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
        raise _damaged(path, f"its JSON breaks off or is wrong at line {e.lineno}, column {e.colno}") from None
    except ValueError as e:
        raise _damaged(path, f"its JSON: {e}") from None
    if not isinstance(header, dict):
        raise _damaged(path, "its JSON is no object")
    _check_version(header, path)
    for name in LISTS:
        rows = header.get(name, [])
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise _damaged(path, f"{name} is no list of objects")
    return header


def check_gltf(header: dict[str, Any], path: Path) -> list[str]:
    """Notices of what is left out. Raises InputError: damaged, or more faces or parts than can be handled."""
    try:
        left_out = _check_extensions(header, path)
        faces = _faces_of_meshes(header, path)
        _count_instances(header, faces, path)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as e:
        raise _damaged(path, _in_words(e)) from e
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
        hint = "export it again as glTF 2.0; Blender and `npx gltf-pipeline -i OLD -o NEW` do"
        raise InputError(f"model {path} is glTF {version}, glTF 2.0 is read", hint)


def _check_extensions(header: dict[str, Any], path: Path) -> list[str]:
    """What extensions that are used leave out. Raises InputError: one that is required is not read."""
    keys = ("extensionsRequired", "extensionsUsed")
    required, used = ([name[:80] for name in header.get(key, [])] for key in keys)
    for name in required:
        if _EXTENSIONS.get(name) != "":
            how = f": {_CONVERT} {_CONVERTERS[name]} {path.name} NEW.glb" if name in _CONVERTERS else ""
            raise InputError(f"model {path} requires {name}, which is not read", f"export it without{how}")
    texts = {name: _EXTENSIONS.get(name, "an extension that is not read") for name in used}
    return [f"{text} ({name})" for name, text in texts.items() if text]


def _in_words(e: Exception) -> str:
    """What the JSON lacks, without Python's terms."""
    if isinstance(e, KeyError):
        return f"{e.args[0]} is missing"
    return str(e) if isinstance(e, (ValueError, IndexError)) else "a value in its JSON is of the wrong kind"


def _faces_of_meshes(header: dict[str, Any], path: Path) -> list[tuple[int, int]]:
    """(faces, primitives) of every mesh."""
    accessors, views = header.get("accessors", []), header.get("bufferViews", [])
    sizes = []
    for number, a in enumerate(accessors):
        if a.get("componentType") not in _COMPONENTS or a.get("type") not in SHAPES:
            raise _damaged(path, f"accessor {number}: its componentType or type is missing or not one of glTF 2.0")
        count = _whole(a["count"])
        size = count * _COMPONENTS[a["componentType"]] * SHAPES[a["type"]]
        if "bufferView" in a and "byteStride" not in (view := views[_index(a["bufferView"], views)]):
            if _whole(a.get("byteOffset", 0)) + size > _whole(view["byteLength"]):
                raise _damaged(path, f"accessor {number} is longer than its buffer")
        elif count > 3 * MAX_FACES:
            raise _damaged(path, f"accessor {number} counts {count}")
        sizes.append(count)
    out = []
    for number, mesh in enumerate(header.get("meshes", [])):
        total = 0
        for p in mesh["primitives"]:
            if _whole(p.get("mode", 4)) > 6:
                raise _damaged(path, f"mesh {number}: mode {p['mode']} is not known")
            for name, at in p["attributes"].items():
                a = accessors[_index(at, accessors)]
                if a["type"] != _TYPES.get(name, a["type"]):
                    raise _damaged(path, f"mesh {number}: {name} is of type {a['type']}, not {_TYPES[name]}")
            index = p.get("indices", p["attributes"].get("POSITION"))
            if "indices" in p and (accessors[_index(index, accessors)]["componentType"] not in (5121, 5123, 5125)):
                raise _damaged(path, f"mesh {number}: indices are not whole numbers from 0 on")
            if "material" in p:
                _index(p["material"], header.get("materials", []))
            total += 0 if index is None else sizes[_index(index, accessors)] // (3 if p.get("mode", 4) == 4 else 1)
        out.append((total, len(mesh["primitives"])))
    return out


def _count_instances(header: dict[str, Any], of_mesh: list[tuple[int, int]], path: Path) -> None:
    """Walks the nodes as a tree, which they have to be."""
    nodes, scenes = header.get("nodes", []), header.get("scenes", [])
    roots = scenes[_index(header.get("scene", 0), scenes)].get("nodes", []) if scenes else []
    waiting, seen = deque(roots), set()
    faces = parts = 0
    while waiting:
        at = _index(waiting.pop(), nodes)
        if at in seen:
            raise _damaged(path, f"node {at} is below itself or below two others: nodes must form a tree")
        seen.add(at)
        waiting.extend(nodes[at].get("children", []))
        if "mesh" in nodes[at]:
            f, p = of_mesh[_index(nodes[at]["mesh"], of_mesh)]
            faces, parts = faces + f, parts + p
    if faces > MAX_FACES:
        raise InputError(f"model {path} has {faces} faces with all its instances", f"at most {MAX_FACES}: simplify it first")
    if parts > MAX_PARTS:
        raise InputError(f"model {path} shows its meshes {parts} times", f"at most {MAX_PARTS}: join them first")


def _index(value: Any, rows: list) -> int:
    if _whole(value) >= len(rows):
        raise IndexError(f"it refers to entry {value}, counted from 0, of a list of {len(rows)}")
    return int(value)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{json.dumps(value)[:80]} is not a whole number, 0 or more")
    return value


def _damaged(path: Path, what: str) -> InputError:
    return InputError(f"cannot read model {path}: {what}", "the file is damaged or not what its name says")
