"""OBJ, PLY, STL, OFF and DAE through trimesh: its meshes as FileMesh, its materials in arfx's
terms."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, MASK, OPAQUE, Material
from arfx.media.model_files import check_parts
from arfx.media.model_materials import check_material, plain_material, unit
from arfx.media.model_parts import FileMesh, ModelFile
from arfx.media.obj_files import ObjFile, decoded, read_obj


class TrimeshScene:
    """All meshes of a file. Nobody promises the winding of these formats: both sides are shown.

    Raises InputError: limits, damaged materials; what trimesh's parsers raise."""

    def __init__(self, file: ModelFile) -> None:
        import trimesh

        self._textures, self._notices = file.textures, file.notices
        self._materials: dict[int, tuple[Any, Material]] = {}  # both: ids stay unique
        self._obj = read_obj(file) if file.kind == "obj" else ObjFile(file.data, {})
        data = self._obj.text
        self.textures_named = 0
        if file.kind == "ply":
            head, end, body = data.partition(b"end_header")
            named = re.findall(rb"\ncomment\s+TextureFile\s", head, re.IGNORECASE)
            self.textures_named = len(named)
            data = decoded(head).encode() + end + body
        self._scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=file.kind,
            resolver=file.folder,  # type: ignore[arg-type]
            process=False,
        )
        check_parts(len(self._scene.graph.nodes_geometry), file.folder.path)

    def __iter__(self) -> Iterator[tuple[FileMesh | None, np.ndarray, Material]]:
        """Each set of triangles, (4, 4) its place in the model, and its material; None for points
        and lines."""
        covered = 0
        for node in self._scene.graph.nodes_geometry:
            model_from_mesh, name = self._scene.graph[node]
            mesh = self._scene.geometry[name]
            if not hasattr(mesh, "faces"):
                yield None, np.eye(4), Material()
                continue
            given = self._mesh(mesh)
            has_colours = "colours" in given.rows or given.face_colours is not None
            material = self._material(mesh, has_colours)
            if material.base_texture is not None and "_ply_raw" in mesh.metadata:
                # both show the same surface
                covered += given.rows.pop("colours", None) is not None
            yield given, np.asarray(model_from_mesh, float), material
        if covered:
            self._notices.append("its colours by vertex are left out: its texture is shown")

    def _mesh(self, mesh: Any) -> FileMesh:
        rows = {"vertices": np.asarray(mesh.vertices, float)}
        # trimesh would make normals up on access; only the file's own are wanted
        if "vertex_normals" in mesh._cache:
            rows["normals"] = np.array(mesh.vertex_normals, float)
        uv = getattr(mesh.visual, "uv", None)
        if uv is not None:
            # trimesh counts v from the bottom
            rows["uv"] = np.array(uv, float)[:, :2] * (1, -1) + (0, 1)
        colours, face_colours = _colours(mesh)
        if self._obj.vertices is not None and self._obj.colours is not None:
            number = rows["vertices"][:, 0].astype(int)
            rows["vertices"], colours = (
                self._obj.vertices[number],
                self._obj.colours[number],
            )
        if colours is not None:
            rows["colours"] = colours
        return FileMesh(np.asarray(mesh.faces), rows, face_colours)

    def _material(self, mesh: Any, has_colours: bool) -> Material:
        given: Any = getattr(mesh.visual, "material", None)
        name, image = getattr(given, "name", None), getattr(given, "image", None)
        if name in self._obj.materials:
            return self._obj.materials[name]
        if given is None or id(given) not in self._materials:
            material = plain_material(has_colours, double_sided=True)
            if type(given).__name__ == "PBRMaterial":
                material = check_material(self._of_collada(given), self._textures.path)
            elif image is not None and image.format:  # else trimesh's own grey
                material = Material(
                    base_colour=(1.0, 1.0, 1.0, 1.0),
                    base_texture=self._textures.texture(image),
                    roughness=1.0,
                    double_sided=True,
                )
            self._materials[id(given)] = given, material
        return self._materials[id(given)][1]

    def _of_collada(self, given: Any) -> Material:
        mode = str(given.alphaMode or OPAQUE).upper()
        factor = np.ravel(
            [255] * 4 if given.baseColorFactor is None else given.baseColorFactor
        )
        red, green, blue, alpha = (float(c) for c in factor / 255.0)
        glow = (
            (0.0, 0.0, 0.0)
            if given.emissiveFactor is None
            else np.ravel(given.emissiveFactor)
        )
        metallic, roughness = given.metallicFactor, given.roughnessFactor
        return Material(
            name=str(given.name or "default"),
            base_colour=(red, green, blue, alpha),
            base_texture=self._textures.texture(given.baseColorTexture),
            metallic=1.0 if metallic is None else unit(metallic),
            roughness=1.0 if roughness is None else unit(roughness),
            emissive=(float(glow[0]), float(glow[1]), float(glow[2])),
            emissive_texture=(
                self._textures.texture(given.emissiveTexture) if any(glow) else None
            ),
            alpha_mode=mode if mode in (OPAQUE, MASK, BLEND) else OPAQUE,
            double_sided=bool(given.doubleSided),
        )


def _colours(mesh: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Linear RGBA (n, 4) by vertex, or (m, 4) by face, or neither: files hold display colours
    (sRGB)."""
    visual = mesh.visual
    if visual.kind == "vertex":
        return _linear(np.asarray(visual.vertex_colors)), None
    if visual.kind == "face":
        return None, _linear(np.asarray(visual.face_colors))
    if "_ply_raw" in mesh.metadata:
        return _ply_colours(mesh)
    return None, None


def _ply_colours(mesh: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    """As `_colours`, of a PLY file with texture coordinates: trimesh reads its colours, and drops
    them."""
    from trimesh.geometry import triangulate_quads

    elements = mesh.metadata["_ply_raw"]
    colours = {}
    for name in ("vertex", "face"):
        properties = elements[name]["properties"]
        channels = [c for c in ("red", "green", "blue", "alpha") if c in properties]
        if len(channels) > 2:
            columns = [elements[name]["data"][c] for c in channels]
            colours[name] = _linear(np.column_stack(columns))
    if "vertex" not in colours:
        by_face = colours.get("face", np.zeros((0, 4)))
        return None, by_face if len(by_face) == len(mesh.faces) else None
    data = elements["face"]["data"]
    names = ("vertex_index", "vertex_indices")
    index = next(name for name in elements["face"]["properties"] if name in names)
    given = triangulate_quads(
        data[index]["f1"] if isinstance(data, np.ndarray) else data[index]
    )
    # trimesh parts vertices, and leaves the order of the faces
    source = np.zeros(len(mesh.vertices), int)
    source[mesh.faces.ravel()] = given.ravel()
    return colours["vertex"][source], None


def _linear(raw: np.ndarray) -> np.ndarray:
    """(n, 4) of display colours (n, 3 or 4); what is no number leaves the factor alone."""
    largest = np.iinfo(raw.dtype).max if raw.dtype.kind in "ui" else 1.0
    values = raw.astype(float) / largest
    out = np.ones((len(values), 4))
    out[:, : values.shape[1]] = np.clip(
        np.where(np.isfinite(values), values, 1.0), 0.0, 1.0
    )
    out[:, :3] = SRGB.decode(out[:, :3])
    return out
