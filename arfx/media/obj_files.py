"""OBJ as people have it: any encoding, several lists of materials, faces of any number of
corners, colours of vertices behind their place; and MTL with the physical terms that later
exporters write.

Numbers of corners count from 1, negative ones from the last one of the file back.
Physical terms of MTL are Pr, Pm, Ps, Pc, Pcr, Ke and norm, and maps of Pr, Pm and Ke. Kd is a
display colour
(sRGB), Ke radiance. Ns is a Blinn-Phong exponent, turned into roughness = sqrt(2 / (Ns + 2)) to the
half (Karis 2013); Pr goes before it. d < 1 is BLEND. A map of Pr or Pm stands in their place.
map_Bump is a normal map where it has colours. Leaves out: `Tr`, of which exporters disagree whether
1 means clear or solid; grey heights; map_d."""

import contextlib
import io
import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import count, pairwise

import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, CLAMP, OPAQUE, REPEAT, Material, Texture
from arfx.errors import InputError
from arfx.media.model_files import TABLES, ModelFile
from arfx.media.model_parts import (
    Placed,
    checked,
    linear_colours,
    plain_material,
    resized,
)

_MTL = TABLES["mtl"]
_OTHER_MAPS = tuple(_MTL["other_maps"])
Words = dict[str, list[str]]  # by what they belong to
_GREY = 0.4  # display colour of a material that states neither Kd nor a map
_SHEEN_ROUGHNESS = 0.5  # MTL has none
_NUMBER = r"\s+[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?!\S)"
# Of a map, with its value: one word, or as many numbers as there may be.
_OPTION = re.compile(
    rf"-(?:halo|[sot](?:{_NUMBER}){{0,3}}|mm(?:{_NUMBER}){{0,2}}"
    r"|(?:clamp|imfchan|cc|bm|boost|blendu|blendv|texres|type)\s+\S+)(?:\s+|$)",
    re.IGNORECASE,
)
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
    rows: Words = {"v": [], "vt": [], "vn": [], "mtllib": []}
    faces_of: Words = {}
    faces = faces_of.setdefault("", [])
    text = io.StringIO(decoded(file.data), None).read()  # with line ends of one kind
    text = text.replace("\\\n", " ").replace("\t", " ")
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
        # as fans of corners; of these what the file counts by: place, texture coordinates,
        # normal, 0 = none
        polygons = [line.partition("#")[0].split() for line in lines]
        fans = [
            word
            for polygon in polygons
            for pair in pairwise(polygon[1:])
            for word in (polygon[0], *pair)
        ]
        number = dict(zip(dict.fromkeys(fans), count(), strict=False))
        filled = (word.rstrip("/").replace("//", "/0/") for word in number)
        stated = [(*word.split("/"), "0", "0")[:3] for word in filled]
        corners = np.array(stated, int).reshape(-1, 3)
        triangles = np.array([number[word] for word in fans], int).reshape(-1, 3)
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
    stated: Words = {}
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


def _table(rows: list[str], columns: int) -> ndarray:
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


def mtl_material(
    file: ModelFile,
    name: str,
    lines: Iterable[str],
    left_out: dict[str, None],
) -> Material:
    """Of the lines below `newmtl`. left_out : gets what is, as keys

    Raises InputError: numbers out of range, a texture too large or damaged."""
    stated = _stated(lines)
    of_base = [*stated["map_kd"][1:]]
    for key, (written, *told) in stated.items():
        unread = key.startswith(_OTHER_MAPS) and key not in _MTL["maps"]
        if unread and not (key == "map_ka" and told == of_base):
            left_out[written] = None

    def listed(key: str) -> list[float]:
        written, _, value = stated[key]
        value = value.split("#")[0].strip()
        out = numbers(value.split())
        if value and not out:
            left_out[f"{written} {value[:40]}"] = None
        return out

    def number(key: str, default: float) -> float:
        return (listed(key) or [default])[0]

    def colour(key: str, default: float) -> tuple[float, float, float]:
        # one number stands for all
        red, green, blue = np.resize(listed(key)[:3] or [default], 3).tolist()
        return red, green, blue

    def texture(key: str) -> Texture | None:
        written, options, where = stated[key]
        for option, words in options.items():
            if option not in _MTL["read"] and words[:1] != ["off"]:
                left_out[f"{option} of {written}"] = None
        picture = file.picture(where) if where else None
        if picture is None:
            return None
        wide, high = (*numbers(options.get("-s", [])), 1.0, 1.0)[:2]
        x, y = (*numbers(options.get("-o", [])), 0.0, 0.0)[:2]
        # an MTL file counts v from the bottom
        matrix = np.array([[wide, 0, x], [0, high, 1 - high - y]], float)
        wrap = CLAMP if options.get("-clamp") == ["on"] else REPEAT
        return Texture(picture, 0, matrix, (wrap, wrap))

    base, glow = texture("map_kd"), texture("map_ke")
    rough, metal = texture("map_pr"), texture("map_pm")
    bumps = next((k for k in ("norm", "map_bump", "bump") if k in stated), "norm")
    normal = texture(bumps)
    if normal is not None and (np.ptp(normal.picture[..., :3], axis=-1) == 0).all():
        left_out[f"grey heights of {stated[bumps][0]}"] = None
        normal = None
    shares = np.clip(
        [
            *colour("kd", _GREY if base is None else 1.0),
            number("d", 1.0),
            number("ps", 0.0),
        ],
        0,
        1,
    )
    red, green, blue = SRGB.decode(shares[:3]).tolist()
    alpha, sheen = shares[3:].tolist()
    shine = 2.0 / (max(number("ns", 0.0), 0.0) + 2.0)
    material = Material(
        name=name,
        base_colour=(red, green, blue, alpha),
        base_texture=base,
        metallic=number("pm", 0.0) if metal is None else 1.0,
        roughness=max(number("pr", shine**0.25), 0.05) if rough is None else 1.0,
        metallic_roughness_texture=_joined(rough, metal),
        emissive=colour("ke", 0.0 if glow is None else 1.0),
        emissive_texture=glow,
        alpha_mode=BLEND if alpha < 1.0 else OPAQUE,
        double_sided=True,  # nobody promises an OBJ's winding
        normal_texture=normal,
        normal_scale=(numbers(stated[bumps][1].get("-bm", [])) or [1.0])[0],
        clearcoat=number("pc", 0.0),
        clearcoat_roughness=number("pcr", 0.0),
        sheen_colour=(sheen, sheen, sheen),
        sheen_roughness=_SHEEN_ROUGHNESS,
    )
    return checked(material)


def _stated(lines: Iterable[str]) -> dict[str, tuple[str, Words, str]]:
    """By its key in lower case, the last of each kind: how it is written, the options of a
    map (`map_Kd -s 2 2 -o .5 0 name of a file.png`), and its value."""
    stated = defaultdict[str, tuple[str, Words, str]](lambda: ("", {}, ""))
    for line in lines:
        written, _, value = line.strip().replace("\t", " ").partition(" ")
        options, value = Words(), value.strip()
        if not value:
            continue
        while found := _OPTION.match(value):
            option, *words = found[0].lower().split()
            options[option], value = words, value[found.end() :]
        stated[written.lower()] = written, options, value
    return stated


def _joined(rough: Texture | None, metal: Texture | None) -> Texture | None:
    """Roughness in green, metallic in blue; laid as the first."""
    first = rough or metal
    if first is None:
        return None
    picture = np.full_like(first.picture, 255)
    if rough is not None:
        picture[..., 1] = rough.picture[..., 0]
    if metal is not None:
        picture[..., 2] = resized(metal.picture, *picture.shape[1::-1])[..., 0]
    return replace(first, picture=picture)


def numbers(words: list[str]) -> list[float]:
    """Of all words, none where one is no finite number."""
    try:
        out = [float(word) for word in words]
    except ValueError:
        return []
    return out if np.isfinite(out).all() else []
