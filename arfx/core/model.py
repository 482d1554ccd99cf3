"""A virtual model as triangles with materials, whatever file it came from."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

OPAQUE, MASK, BLEND = "OPAQUE", "MASK", "BLEND"


@dataclass(frozen=True, eq=False)
class Material:
    """Metallic-roughness material (glTF 2.0 section 3.9). Factors multiply their textures.

    base_colour : (4,) linear RGB and alpha
    base_texture : (h, w, 4) uint8, sRGB coded colour and linear alpha, row 0 on top; None = white
    metallic, roughness : 0..1;  metallic_roughness_texture : (h, w, 2) uint8 (metallic, roughness) or None
    emissive : (3,) linear radiance;  emissive_texture : (h, w, 3) uint8 sRGB or None
    specular : dielectric F0 / 0.08, 0.5 = 4 %
    alpha_mode : OPAQUE, MASK (cut at alpha_cutoff) or BLEND"""

    name: str = "default"
    base_colour: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    base_texture: np.ndarray | None = None
    metallic: float = 0.0
    roughness: float = 0.9
    metallic_roughness_texture: np.ndarray | None = None
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emissive_texture: np.ndarray | None = None
    specular: float = 0.5
    alpha_mode: str = OPAQUE
    alpha_cutoff: float = 0.5
    double_sided: bool = False


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles that share a material, in the model's own axes after its scene graph is applied.
    vertices (n, 3) float64, file units;  faces (m, 3) int32;  normals (n, 3) unit;
    uv (n, 2) with v = 0 at the top row of the texture, or None;  colours (n, 4) linear RGBA, or None"""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    material: Material = field(default_factory=Material)
    uv: np.ndarray | None = None
    colours: np.ndarray | None = None

    @property
    def opacity(self) -> float:
        """Of where it lets the least light pass, 0..1."""
        m = self.material
        if m.alpha_mode == OPAQUE:
            return 1.0
        alpha = m.base_colour[3]
        if m.base_texture is not None:
            alpha *= int(m.base_texture[..., 3].max()) / 255
        if self.colours is not None:
            alpha *= float(self.colours[:, 3].max())
        return float(alpha >= m.alpha_cutoff) if m.alpha_mode == MASK else min(alpha, 1.0)


@dataclass(frozen=True, eq=False)
class Model:
    """All parts of a model. up : "x", "y" or "z", which file axis points up; source : path, for messages.
    notices : what was left out or repaired while reading, for the user
    files : all files that it was read from, the model's own first"""

    parts: tuple[Part, ...]
    up: str = "y"
    source: str = ""
    notices: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, 3) lowest and highest corner in file axes and units, of vertices that a face uses."""
        used = [p.vertices[np.unique(p.faces)] for p in self.parts]
        every = np.concatenate(used)
        return np.stack([every.min(0), every.max(0)])

    @property
    def face_count(self) -> int:
        return sum(len(p.faces) for p in self.parts)

    @property
    def vertices(self) -> np.ndarray:
        """(n, 3) of all parts together, file axes and units."""
        return np.concatenate([p.vertices for p in self.parts])
