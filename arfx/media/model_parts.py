"""Triangles of a file under their node's transform made into a part of the model, whatever the
format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arfx.core.model import Material, Part
from arfx.core.numerics import normalise
from arfx.errors import InputError
from arfx.media.model_normals import smooth_by_angle, with_tangents

# Squared double area below which a triangle has no plane, as a fraction of the model's extent to
# the fourth power: float32 coordinates are exact to 6e-8 of the extent, a height below is rounding.
_DEGENERATE = (6e-8) ** 4


@dataclass(frozen=True, eq=False)
class FileMesh:
    """Triangles of one material as a file gives them, in the mesh's own axes.

    faces : (m, 3) int
    rows : by name what each vertex has: "vertices" (n, 3), and where the file gives them "normals",
        "uv", "second_uv", "colours", "tangents", as of core.model.Part; unusable ones are left out
    face_colours : (m, 4) linear, or None"""

    faces: np.ndarray
    rows: dict[str, np.ndarray]
    face_colours: np.ndarray | None = None


def part_of(
    mesh: FileMesh,
    model_from_mesh: np.ndarray,
    material: Material,
    path: Path,
) -> tuple[Part | None, int]:
    """A part of the model, None where no face is left; and the number of faces without area.

    model_from_mesh : (4, 4);  path : of the model, for messages
    Raises InputError: faces of vertices that there are not, numbers that are not finite."""
    if not len(mesh.faces):
        return None, 0
    _check(mesh, model_from_mesh, path)
    rows, faces, linear = _usable(mesh.rows), mesh.faces, model_from_mesh[:3, :3]
    side = float(np.sign(np.linalg.det(linear))) or 1.0
    rows["vertices"] = rows["vertices"] @ linear.T + model_from_mesh[:3, 3]
    if side < 0:  # a mirror turns every triangle inside out
        faces = faces[:, ::-1]
    keep = _have_area(rows["vertices"], faces)
    lost = int((~keep).sum())
    faces = faces[keep]
    if not len(faces):
        return None, lost
    if mesh.face_colours is not None:  # no corner can be shared
        rows = _of_vertices(rows, faces.ravel())
        rows["colours"] = np.repeat(mesh.face_colours[keep], 3, 0)
        faces = np.arange(faces.size).reshape(-1, 3)
    if "normals" in rows:
        rows["normals"] = normalise(rows["normals"] @ (side * _cofactors(linear)).T)
    if "normals" not in rows or not (np.abs(rows["normals"][faces]).sum(-1) > 0).all():
        rows.pop("tangents", None)  # they belong to the file's normals
        split = not rows.keys().isdisjoint(("uv", "second_uv", "colours"))
        faces, source, normals = smooth_by_angle(rows["vertices"], faces, split)
        rows = _of_vertices(rows, source) | {"normals": normals}
    if "tangents" in rows:
        along = normalise(rows["tangents"][:, :3] @ linear.T)
        rows["tangents"] = np.column_stack(
            [along, side * np.sign(rows["tangents"][:, 3])]
        )
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    return (
        with_tangents(Part(faces=faces, material=material, **_of_vertices(rows, used))),
        lost,
    )


def _check(mesh: FileMesh, model_from_mesh: np.ndarray, path: Path) -> None:
    given, faces = mesh.rows["vertices"], mesh.faces
    if faces.min() < 0 or faces.max() >= len(given):
        what = f"faces refer to vertex {faces.max()}, there are {len(given)}"
        raise InputError(f"model {path}: {what}", "the file is damaged")
    if not np.isfinite(model_from_mesh).all():
        raise InputError(f"model {path}: a node's transform is not finite")
    if bad := int((~np.isfinite(given)).any(1).sum()):
        what = f"{bad} of {len(given)} vertices are not finite numbers"
        raise InputError(f"model {path}: {what}", "export it again; look for NaN or inf")


def _usable(rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Those of the right length, with all numbers finite; of texture coordinates single ones may
    be 0."""
    out = {}
    for name, values in rows.items():
        finite = np.isfinite(values).all(1)
        if len(values) == len(rows["vertices"]) and (name.endswith("uv") or finite.all()):
            out[name] = np.where(finite[:, None], values, 0.0)
    return out


def _have_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(m,) bool."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    extent = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    return np.asarray((np.cross(b - a, c - a) ** 2).sum(1) > _DEGENERATE * extent**4)


def _of_vertices(rows: dict[str, np.ndarray], which: np.ndarray) -> dict[str, np.ndarray]:
    return {name: values[which] for name, values in rows.items()}


def _cofactors(linear: np.ndarray) -> np.ndarray:
    """The inverse transpose times the determinant: turns normals rightly under any matrix.

    A mirror turns them inwards: times -1 they keep to the outside."""
    x, y, z = linear
    return np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
