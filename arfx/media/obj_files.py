"""OBJ as people have it, made into what trimesh reads; its materials and colours are read here.

trimesh takes one `mtllib`, no options of maps, drops colours of vertices beside texture
coordinates, and is silent about what it does not find."""

from __future__ import annotations

import codecs
import contextlib
import itertools
import re
import unicodedata
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import Material
from arfx.errors import InputError
from arfx.media.model_files import ModelFolder, check_faces, check_parts
from arfx.media.model_parts import ModelFile
from arfx.media.mtl_files import MtlMaterials

_LIST = "materials made by arfx.mtl"  # the list that trimesh is given
_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_FILE = re.compile(r'"([^"]+)"|(\S.*?\.mtl(?=\s|$)|\S+)', re.IGNORECASE)
_VERTEX = re.compile(r"\nv ([^\n]*)")


@dataclass(frozen=True, eq=False)
class ObjFile:
    """text : for trimesh, all materials in one list, in the folder's memory;  materials : by name
    vertices : (n, 3) and colours : (n, 4) linear, where vertices have colours: then the first
        coordinate of trimesh's vertices is their number; else None"""

    text: bytes
    materials: dict[str, Material]
    vertices: np.ndarray | None = None
    colours: np.ndarray | None = None


def decoded(data: bytes) -> str:
    """Text in UTF-8 with or without a mark, UTF-16, or Latin-1: the first that it can be."""
    if data[:2] in _MARKS:
        return data.decode("utf-16", "replace")
    if b"\0" in data[:200]:  # no text in UTF-8 holds it
        return data.decode("utf-16-le" if data[1:2] == b"\0" else "utf-16-be", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_obj(file: ModelFile) -> ObjFile:
    """Raises InputError: more faces or parts than can be handled; see also MtlMaterials."""
    folder, notices = file.folder, file.notices
    text = "\n" + decoded(file.data).replace("\r\n", "\n").replace("\r", "\n")
    text = text.replace("\\\n", " ").replace("\t", " ")
    if "\n " in text:
        text = re.sub(r"\n +", "\n", text)
    check_faces(text.count("\nf "), folder.path)
    used = dict.fromkeys(map(_key, re.findall(r"\nusemtl +(.*)", text)))
    check_parts(len(used), folder.path)
    lists = re.findall(r"\nmtllib +(.*)", text)
    files = dict.fromkeys(name for line in lists for name in _files(line, folder))
    lines, missing = _lines_of_materials(used, files, folder)
    if missing and not folder.left_out:
        names = ", ".join(name[:60] for name in missing[:5]) + (
            ", …" if len(missing) > 5 else ""
        )
        notices.append(f"no MTL file describes {len(missing)} of its materials: {names}")
    made = MtlMaterials(folder, file.textures)
    materials = {name: made.material(name, rows) for name, rows in lines.items()}
    if made.lost:
        notices.append(f"left out of its materials: {', '.join(made.lost)}")
    folder.memory[_LIST] = "\n".join(f"newmtl {name}" for name in materials).encode()
    first, *others = text.split("\nusemtl ")
    parts = (other.partition("\n") for other in others)
    text = first + "".join(f"\nusemtl {_key(name)}\n{rest}" for name, _, rest in parts)
    text, vertices, colours = _with_colours(text, notices)
    return ObjFile(f"mtllib {_LIST}\n{text}".encode(), materials, vertices, colours)


def _with_colours(
    text: str,
    notices: list[str],
) -> tuple[str, np.ndarray | None, np.ndarray | None]:
    """The text, every vertex replaced by its number if they have colours; vertices and colours as
    of ObjFile."""
    first = _VERTEX.search(text)
    columns = len(first[1].split()) if first else 0
    if columns < 6:
        return text, None, None
    lines = _VERTEX.findall(text)
    with contextlib.suppress(ValueError):
        values = np.array(" ".join(lines).split(), float).reshape(len(lines), columns)
        shown = values[:, 3:6] / (255.0 if values[:, 3:6].max() > 1.0 else 1.0)
        shown = np.clip(np.where(np.isfinite(shown), shown, 1.0), 0.0, 1.0)
        colours = np.column_stack([SRGB.decode(shown), np.ones(len(lines))])
        number = itertools.count()
        text = _VERTEX.sub(lambda _: f"\nv {next(number)} 0 0", text)
        return text, values[:, :3], colours
    notices.append("colours of vertices left out: not all have them")
    return text, None, None


def _key(name: str) -> str:
    """Exporters write one name composed and decomposed, in quotation marks, with other blanks."""
    return " ".join(unicodedata.normalize("NFC", name).strip().strip("\"'").split())


def _lines_of_materials(
    used: Collection[str],
    files: Iterable[str],
    folder: ModelFolder,
) -> tuple[dict[str, list[str]], list[str]]:
    """Lines of the materials that are used, by name, and those of which there are none."""
    exact: dict[str, list[str]] = {}
    alike: dict[str, list[str]] = {}  # but for their case
    for file in files:
        with contextlib.suppress(InputError):  # it is in folder.left_out
            text = decoded(folder.read(file)).replace("\\\n", " ")
            for block in re.split(r"(?mi)^\s*newmtl\b", text)[1:]:
                name, *lines = block.splitlines()
                exact.setdefault(_key(name), lines)
                alike.setdefault(_key(name).casefold(), lines)
    known = {name: name.casefold() for name in used if name.casefold() in alike}
    lines_of = {name: exact.get(name, alike[folded]) for name, folded in known.items()}
    return lines_of, [name for name in used if name not in known]


def _files(names: str, folder: ModelFolder) -> list[str]:
    """Of a line of mtllib: one name with blanks, or several."""
    several = [quoted or plain for quoted, plain in _FILE.findall(names)]
    if len(several) > 1:
        with contextlib.suppress(InputError):
            folder.find(names)
            return [names]
    return several
