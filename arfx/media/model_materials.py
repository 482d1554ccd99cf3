"""Materials of a trimesh mesh in arfx's terms: linear factors, 8-bit textures of a bounded size, alpha modes.

glTF: metallic-roughness as written (glTF 2.0 section 3.9). MTL: Kd is a display colour (sRGB), Ns a Blinn-Phong exponent
turned into roughness = sqrt(2 / (Ns + 2)) to the half (Karis 2013), d < 1 is BLEND. `Tr` is ignored: exporters disagree
on whether 1 means clear or solid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, MASK, OPAQUE, Material
from arfx.errors import InputError

_BRIGHTEST = 1e6  # emission, where white paper in full light is 1
MAX_TEXELS = 8192**2 + 2 * 4096**2  # of a model together: 20 bytes each while it is drawn, 2 GB
MAX_TEXTURE_PX = 8192  # an 8k texture takes seconds and a gigabyte in software OpenGL; beyond it drivers refuse


class Textures:
    """The pictures of a model as arrays, each decoded once. path : of the model, for messages"""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._made: dict[tuple[int, str], tuple[Any, np.ndarray]] = {}  # the picture too: its id stays unique while it lives
        self._texels = 0

    def of(self, image: Any, mode: str) -> np.ndarray | None:
        """(h, w, channels) uint8 of a Pillow picture, None for None. Raises InputError: too large, damaged."""
        if image is None:
            return None
        key = id(image), mode
        if key not in self._made:
            width, height = image.size
            if max(width, height) > MAX_TEXTURE_PX:
                raise InputError(
                    f"model {self.path}: a texture is {width}x{height} px", f"at most {MAX_TEXTURE_PX} px a side: scale it down"
                )
            self._texels += width * height
            if self._texels > MAX_TEXELS:
                raise InputError(
                    f"model {self.path}: its textures hold more than {MAX_TEXELS / 1e6:.0f} megapixels", "scale them down"
                )
            try:
                self._made[key] = image, np.ascontiguousarray(np.asarray(image.convert(mode), np.uint8))
            except (OSError, ValueError, SyntaxError) as e:  # Pillow decodes late
                raise InputError(f"model {self.path}: cannot decode a texture ({e})", "the image is damaged or cut short") from e
        return self._made[key][1]

    def close(self) -> None:
        """Lets go of the pictures, the arrays stay: trimesh's objects refer to each other in circles and live on for long."""
        for image, _ in self._made.values():
            image.close()


def material_of(mesh: Any, textures: Textures, two_sided: bool, factors: dict[str, Any], has_colours: bool) -> Material:
    """The Material of a mesh. factors : from `precise_factors`;  has_colours : vertex colours multiply white."""
    given = getattr(mesh.visual, "material", None)
    kind = type(given).__name__
    if given is None or _is_placeholder(given):
        return Material(base_colour=(1.0, 1.0, 1.0, 1.0) if has_colours else (0.8, 0.8, 0.8, 1.0), double_sided=two_sided)
    made = _from_pbr(given, textures, factors) if kind == "PBRMaterial" else _from_simple(given, textures, two_sided)
    numbers = [*made.base_colour, *made.emissive, made.metallic, made.roughness, made.specular, made.alpha_cutoff]
    written = getattr(given, "kwargs", None) or {}  # of an MTL file: trimesh has rounded them to 8 bits by now
    numbers += [_first_number(v, 0.0) for key in ("kd", "d", "ns") for v in np.ravel(written.get(key, 0.0))]
    if not (np.abs(numbers) <= _BRIGHTEST).all():
        raise InputError(
            f"model {textures.path}: material {made.name!r} holds numbers that are not finite, or above {_BRIGHTEST:g}",
            "export it again",
        )
    return made


def _from_pbr(given: Any, textures: Textures, factors: dict[str, Any]) -> Material:
    name = str(given.name or "default")
    own = factors.get(name, {})
    mode = str(given.alphaMode or OPAQUE).upper()
    texture = textures.of(given.baseColorTexture, "RGBA")
    mr = textures.of(given.metallicRoughnessTexture, "RGB")
    emissive_texture = textures.of(given.emissiveTexture, "RGB")
    emissive = np.zeros(3) if given.emissiveFactor is None else np.asarray(given.emissiveFactor, float).ravel()[:3]
    emissive = emissive * own.get("strength", 1.0)
    cutoff = given.alphaCutoff
    return Material(
        name=name,
        base_colour=_quad(own.get("base", given.baseColorFactor)),
        base_texture=texture,
        metallic=_unit(given.metallicFactor, 1.0),
        roughness=_unit(given.roughnessFactor, 1.0),
        metallic_roughness_texture=None if mr is None else np.ascontiguousarray(mr[..., [2, 1]]),  # blue, green
        emissive=(float(emissive[0]), float(emissive[1]), float(emissive[2])),
        emissive_texture=emissive_texture if emissive.any() else None,
        specular=own.get("specular", 0.5),
        alpha_mode=mode if mode in (OPAQUE, MASK, BLEND) else OPAQUE,
        alpha_cutoff=0.5 if cutoff is None else float(cutoff),
        double_sided=bool(given.doubleSided),
    )


def _from_simple(given: Any, textures: Textures, two_sided: bool) -> Material:
    kwargs = {str(k).lower(): v for k, v in (getattr(given, "kwargs", None) or {}).items()}
    diffuse = getattr(given, "diffuse", None)
    texture = textures.of(getattr(given, "image", None), "RGBA")
    white = diffuse is None or (texture is not None and "kd" not in kwargs)  # trimesh fills in a grey
    colour = np.ones(4) if white else np.asarray(diffuse, float).ravel() / 255.0
    rgb = SRGB.decode(colour[:3])
    alpha = _first_number(kwargs.get("d"), 1.0)
    shininess = _first_number(kwargs.get("ns"), 0.0)
    return Material(
        name=str(getattr(given, "name", None) or "default"),
        base_colour=(float(rgb[0]), float(rgb[1]), float(rgb[2]), float(np.clip(alpha, 0.0, 1.0))),
        base_texture=texture,
        roughness=float(np.clip((2.0 / (np.clip(shininess, 0.0, None) + 2.0)) ** 0.25, 0.05, 1.0)),
        alpha_mode=BLEND if alpha < 1.0 else OPAQUE,
        double_sided=two_sided,
    )


def vertex_colours(mesh: Any, keep: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Linear RGBA (n, 4) by vertex, or (m, 4) by kept face, or neither. keep : (faces,) bool
    glTF colours are linear; PLY, OBJ and STL ones are display colours (sRGB)."""
    visual = mesh.visual
    if visual.kind == "vertex":
        raw, linear = np.asarray(visual.vertex_colors), mesh.metadata.get("from_gltf_primitive") is not None
    elif visual.kind == "face":
        return None, _linear(np.asarray(visual.face_colors)[keep], False)
    elif "_ply_raw" in mesh.metadata:
        return _ply_colours(mesh, keep)
    else:
        attributes = getattr(visual, "vertex_attributes", {})
        if "color" not in attributes:
            return None, None
        raw, linear = np.asarray(attributes["color"]), type(getattr(visual, "material", None)).__name__ == "PBRMaterial"
    if len(raw) != len(mesh.vertices):
        return None, None
    return _linear(raw, linear), None


def _ply_colours(mesh: Any, keep: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """As `vertex_colours`, of a PLY file with texture coordinates: trimesh reads its colours, and drops them."""
    from trimesh.geometry import triangulate_quads

    elements = mesh.metadata["_ply_raw"]
    colours = {}
    for name in ("vertex", "face"):
        channels = [c for c in ("red", "green", "blue", "alpha") if c in elements[name]["properties"]]
        if len(channels) > 2:
            colours[name] = _linear(np.column_stack([elements[name]["data"][c] for c in channels]), False)
    if "vertex" not in colours:
        return None, colours["face"][keep] if len(colours.get("face", ())) == len(keep) else None
    data = elements["face"]["data"]
    index = next(c for c in elements["face"]["properties"] if c in ("vertex_index", "vertex_indices"))
    given = triangulate_quads(data[index]["f1"] if isinstance(data, np.ndarray) else data[index])
    source = np.zeros(len(mesh.vertices), int)  # trimesh parts vertices, and leaves the order of the faces
    source[mesh.faces.ravel()] = given.ravel()
    return colours["vertex"][source], None


def _linear(raw: np.ndarray, already: bool) -> np.ndarray:
    c = raw.astype(float) / (np.iinfo(raw.dtype).max if raw.dtype.kind in "ui" else 1.0)
    c = np.clip(np.where(np.isfinite(c), c, 1.0), 0.0, 1.0)  # a colour that is no number leaves the factor alone
    if c.shape[1] == 3:
        c = np.concatenate([c, np.ones((len(c), 1))], 1)
    if not already:
        c[:, :3] = SRGB.decode(c[:, :3])
    return c


def precise_factors(header: dict[str, Any]) -> dict[str, Any]:
    """By material name, what trimesh rounds to 8 bits or leaves out of a glTF file: base colour, emissive strength.
    header : JSON of a glTF file in which every material has a name of its own, {} of other files"""
    out: dict[str, Any] = {}
    for m in header.get("materials", []):
        pbr, ext = m.get("pbrMetallicRoughness", {}), m.get("extensions", {})
        ior = float(ext.get("KHR_materials_ior", {}).get("ior", 1.5))
        f0 = ((ior - 1.0) / (ior + 1.0)) ** 2 if ior > 0 else 0.04
        out[m["name"]] = {
            "base": np.array(pbr.get("baseColorFactor", [1.0] * 4), float),
            "strength": float(ext.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)),
            "specular": float(ext.get("KHR_materials_specular", {}).get("specularFactor", 1.0)) * f0 / 0.08,
        }
    return out


def _is_placeholder(given: Any) -> bool:
    """trimesh puts a 2x2 grey picture where a file has texture coordinates and no texture."""
    image = getattr(given, "image", None)
    return (
        type(given).__name__ == "SimpleMaterial"
        and image is not None
        and image.size == (2, 2)
        and image.format is None  # read from no file
        and not getattr(given, "kwargs", None)
    )


def _quad(value: Any) -> tuple[float, float, float, float]:
    c = np.ones(4) if value is None else np.ravel(value)
    c = np.append(c / 255.0 if c.dtype.kind in "ui" else c, 1.0)
    return float(c[0]), float(c[1]), float(c[2]), float(c[3])


def _unit(value: Any, default: float) -> float:
    return default if value is None else float(np.clip(float(value), 0.0, 1.0))


def _first_number(value: Any, default: float) -> float:
    try:
        return float(np.ravel(value)[0]) if value is not None else default
    except (ValueError, IndexError):
        return default
