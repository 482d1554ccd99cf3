"""OBJ as people have it: any encoding, several lists of materials, faces of any number of
corners, colours of vertices behind their place.

Numbers of corners count from 1, negative ones from the last one of the file back."""

from __future__ import annotations

import contextlib
import io
import re
import unicodedata
from collections.abc import Iterator
from itertools import count, pairwise

import numpy as np

from arfx.core.model import Material
from arfx.errors import InputError
from arfx.media.model_files import ModelFile
from arfx.media.model_parts import Placed, linear_colours, plain_material
from arfx.media.mtl_files import mtl_material

_FILE = re.compile(r'"([^"]+)"|(\S.*?\.mtl(?=\s|$)|\S+)', re.IGNORECASE)


def decoded(data: bytes) -> str:
    """Text in UTF-16 or UTF-8, with or without a mark, or Latin-1: the first that it can be."""
    code = "utf-8"
    if (nul := data[:200].find(b"\0")) >= 0:  # no text in UTF-8 holds it
        code = "utf-16-le" if nul % 2 else "utf-16-be"
    try:
        return data.decode(code).removeprefix("\ufeff")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def obj_meshes(file: ModelFile) -> Iterator[Placed]:
    """The faces of a file by material. Nobody promises an OBJ's winding: both sides are shown.

    Raises InputError: more faces or parts than can be handled; ValueError, IndexError: damage."""
    rows: dict[str, list[str]] = {"v": [], "vt": [], "vn": [], "mtllib": []}
    faces_of: dict[str, list[str]] = {}
    faces = faces_of.setdefault("", [])
    text = re.sub(r"\\\r?\n", " ", decoded(file.data)).replace("\t", " ")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    # ten lines of a face: its own, three corners with place, coordinates and normal each
    file.check_counts(text.count("\n") // 10)
    for line in io.StringIO(text):
        kind, _, rest = line.strip().partition(" ")
        if kind == "f":
            faces.append(rest)
        elif kind in rows:
            rows[kind].append(rest)
        elif kind == "usemtl":
            faces = faces_of.setdefault(_key(rest), [])
            file.check_counts(0, len(faces_of) - 1)
    file.check_counts(sum(map(len, faces_of.values())))
    materials = _materials(file, rows["mtllib"], list(faces_of)[1:])
    places = _table(rows["v"], 6)
    # By what `part_of` calls them, and their number's place in a corner; v counts from the bottom.
    tables = {
        ("vertices", 0): places[:, :3],
        ("uv", 1): _table(rows["vt"], 2) * (1, -1) + (0, 1),
        ("normals", 2): _table(rows["vn"], 3),
    }
    coloured = np.isfinite(places[:-1, 5])
    if coloured.any() and coloured.all():
        most = 255.0 if np.nanmax(places[:, 3:]) > 1.0 else 1.0
        tables["colours", 0] = linear_colours(places[:, 3:] / most)
    elif coloured.any():
        file.notices.append("colours of vertices left out: not all have them")
    plain = plain_material(("colours", 0) in tables, double_sided=True)
    for name, lines in faces_of.items():
        triangles, corners = _triangles(lines)
        own = {
            kind: table[corners[:, column] - 1]
            for (kind, column), table in tables.items()
            if len(table) > 1
        }
        if len(triangles):
            yield triangles, own, np.eye(4), materials.get(name, plain)


def _materials(
    file: ModelFile, lists: list[str], used: list[str]
) -> dict[str, Material]:
    """Those that are used and described."""
    stated: dict[str, list[str]] = {}
    lost = False
    for name in dict.fromkeys(name for line in lists for name in _names(file, line)):
        try:
            text = decoded(file.read(name)).replace("\\\n", " ")
        except InputError:  # a notice tells
            lost = True
            continue
        for block in re.split(r"(?mi)^\s*newmtl\b", text)[1:]:
            name, *lines = block.splitlines()
            stated.setdefault(_key(name), lines)
    stated = {name.casefold(): stated[name] for name in reversed(stated)} | stated
    found: dict[str, Material] = {}
    missing: list[str] = []
    left_out: dict[str, None] = {}
    for name in used:
        described = stated.get(name, stated.get(name.casefold()))
        if described is None:
            missing.append(name[:60])
        else:
            found[name] = mtl_material(file, name, described, left_out)
    if missing and not lost:
        names = ", ".join([*missing[:5], "…"][: len(missing)])
        what = f"no MTL file describes {len(missing)} of its materials: {names}"
        file.notices.append(what)
    if left_out:
        file.notices.append(f"left out of its materials: {', '.join(left_out)}")
    return found


def _names(file: ModelFile, line: str) -> list[str]:
    """Of a line of mtllib: one name with blanks, or several."""
    with contextlib.suppress(InputError):
        file.find(line)
        return [line]
    return [quoted or plain for quoted, plain in _FILE.findall(line)]


def _key(name: str) -> str:
    """Exporters write one name composed and decomposed, in quotation marks, with other blanks."""
    return " ".join(unicodedata.normalize("NFC", name).strip().strip("\"'").split())


def _table(rows: list[str], columns: int) -> np.ndarray:
    """(n + 1, columns) of numbers, NaN where there is none, and in the last row: to numbers
    less one, it is what 0 stands for, and what negative ones are counted from."""
    out = np.full((len(rows) + 1, columns), np.nan)
    try:
        given = np.loadtxt(rows, ndmin=2) if rows else out[:-1]
    except ValueError:  # not all rows have as many
        words = [[*row.partition("#")[0].split(), *["nan"] * columns] for row in rows]
        given = np.array([row[:columns] for row in words], float)
    out[:-1, : given.shape[1]] = given[:, :columns]
    return out


def _triangles(lines: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Faces as fans: (m, 3) numbers of corners, and of these (k, 3) what the file counts by:
    place, texture coordinates, normal; 0 = none."""
    faces = [line.partition("#")[0].split() for line in lines]
    pairs = ((face[0], pair) for face in faces for pair in pairwise(face[1:]))
    fans = [word for first, pair in pairs for word in (first, *pair)]
    number = dict(zip(dict.fromkeys(fans), count(), strict=False))
    filled = (word.rstrip("/").replace("//", "/0/") for word in number)
    corners = np.array([(*word.split("/"), "0", "0")[:3] for word in filled], int)
    triangles = np.array([number[word] for word in fans], int)
    return triangles.reshape(-1, 3), corners.reshape(-1, 3)
