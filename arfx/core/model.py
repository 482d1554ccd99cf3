"""A virtual model as triangles with materials, whatever file it came from."""

import itertools
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy import ndarray

OPAQUE, MASK, BLEND = "OPAQUE", "MASK", "BLEND"
REPEAT, CLAMP, MIRROR = "repeat", "clamp", "mirror"
# A material's textures, and whether their colour is sRGB coded; alpha and all else are linear.
TEXTURE_SLOTS = {
    "base_texture": True,
    "metallic_roughness_texture": False,
    "emissive_texture": True,
    "normal_texture": False,
    "occlusion_texture": False,
    "clearcoat_texture": False,
    "clearcoat_roughness_texture": False,
    "sheen_colour_texture": True,
    "sheen_roughness_texture": False,
}


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture and how it lies on a surface (glTF 2.0 section 3.8, KHR_texture_transform).

    picture : (h, w, 4) uint8, row 0 on top; all textures of one picture share the array
    uv_set : 0 or 1, which texture coordinates of the part
    picture_from_uv : (2, 3) float64, to coordinates in which the picture is 1 x 1, v = 0 on top
    wrap : along u and along v, what lies beyond the picture: REPEAT, CLAMP or MIRROR
    nearest : texels show as squares; else they are mixed"""

    picture: ndarray
    uv_set: int = 0
    picture_from_uv: ndarray = field(default_factory=lambda: np.eye(2, 3))
    wrap: tuple[str, str] = (REPEAT, REPEAT)
    nearest: bool = False


@dataclass(frozen=True, eq=False)
class Material:
    """Material of glTF 2.0 (section 3.9, KHR_materials_*).

    A texture multiplies the factor of its name.
    Channels of textures, where they are not a colour: metallic in blue, roughness in green;
    occlusion and clear coat in red, clear coat's roughness in green, sheen's roughness in alpha.

    base_colour : (4,) linear RGB and alpha
    metallic, roughness : 0..1
    specular : F0 of what is no metal / 0.08, 0.5 = 4 %
    emissive : (3,) linear radiance
    normal_texture : t in 0..1 is the normal (2 t - 1) * (normal_scale, normal_scale, 1) in the
        frame of tangent, bitangent, normal
    occlusion_texture : t in 0..1 leaves 1 + occlusion_strength * (t - 1) of the indirect light
    clearcoat, clearcoat_roughness : 0..1
    sheen_colour : (3,) linear;  sheen_roughness : 0..1
    alpha_mode : OPAQUE, MASK (cut at alpha_cutoff) or BLEND"""

    name: str = "default"
    base_colour: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    base_texture: Texture | None = None
    metallic: float = 0.0
    roughness: float = 0.9
    metallic_roughness_texture: Texture | None = None
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emissive_texture: Texture | None = None
    specular: float = 0.5
    alpha_mode: str = OPAQUE
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    normal_texture: Texture | None = None
    normal_scale: float = 1.0
    occlusion_texture: Texture | None = None
    occlusion_strength: float = 1.0
    clearcoat: float = 0.0
    clearcoat_texture: Texture | None = None
    clearcoat_roughness: float = 0.0
    clearcoat_roughness_texture: Texture | None = None
    sheen_colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sheen_colour_texture: Texture | None = None
    sheen_roughness: float = 0.0
    sheen_roughness_texture: Texture | None = None

    @property
    def textures(self) -> dict[str, Texture]:
        """Those that it has, by name, in the order of TEXTURE_SLOTS."""
        given = {name: getattr(self, name) for name in TEXTURE_SLOTS}
        return {
            name: texture for name, texture in given.items() if texture is not None
        }


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles that share a material, in the model's own axes after its scene graph is applied.

    vertices : (n, 3) float64, file units;  faces : (m, 3) int32;  normals : (n, 3) unit
    uv, second_uv : (n, 2) texture coordinates, v = 0 at the top row of a picture, or None
    colours : (n, 4) linear RGBA that multiply base_colour, or None
    tangents : (n, 4) where the material has a normal texture, else None: unit vectors along the
        picture's rows to the right, and a sign; sign * cross(normal, tangent), the bitangent, is
        the picture's way up"""

    vertices: ndarray
    faces: ndarray
    normals: ndarray
    material: Material = field(default_factory=Material)
    uv: ndarray | None = None
    colours: ndarray | None = None
    second_uv: ndarray | None = None
    tangents: ndarray | None = None

    def uv_on(self, texture: Texture) -> ndarray | None:
        """(n, 2) where the vertices lie on the texture's picture; None: the part has no such
        coordinates."""
        uv = self.second_uv if texture.uv_set else self.uv
        matrix = texture.picture_from_uv
        return None if uv is None else uv @ matrix[:, :2].T + matrix[:, 2]

    @property
    def opacity(self) -> float:
        """Of where it lets the least light pass, 0..1."""
        m = self.material
        if m.alpha_mode == OPAQUE:
            return 1.0
        alpha = m.base_colour[3]
        if m.base_texture is not None:
            alpha *= int(m.base_texture.picture[..., 3].max()) / 255
        if self.colours is not None:
            alpha *= float(self.colours[:, 3].max())
        return (
            float(alpha >= m.alpha_cutoff)
            if m.alpha_mode == MASK
            else min(alpha, 1.0)
        )


@dataclass(frozen=True, eq=False)
class Model:
    """All parts of a model.

    up : "x", "y" or "z", which file axis points up;  source : path, for messages
    notices : what was left out or repaired while reading, for the user
    files : all files that it was read from, the model's own first"""

    parts: tuple[Part, ...]
    up: str = "y"
    source: str = ""
    notices: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    @cached_property
    def bounds(self) -> ndarray:
        """(2, 3) lowest and highest corner in file axes and units, of vertices that a face uses."""
        used = [p.vertices[np.unique(p.faces)] for p in self.parts]
        corners = np.concatenate(used)
        return np.stack([corners.min(0), corners.max(0)])

    @property
    def corners(self) -> ndarray:
        """(8, 3) of the box of these bounds."""
        return np.array(list(itertools.product(*self.bounds.T)))

    @property
    def face_count(self) -> int:
        return sum(len(p.faces) for p in self.parts)

    @property
    def textures_per_face(self) -> float:
        """In the mean over all faces."""
        textures = sum(len(p.faces) * len(p.material.textures) for p in self.parts)
        return textures / max(self.face_count, 1)

    @property
    def vertices(self) -> ndarray:
        """(n, 3) of all parts together, file axes and units."""
        return np.concatenate([p.vertices for p in self.parts])
