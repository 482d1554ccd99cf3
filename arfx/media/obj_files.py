"""OBJ and MTL as people have them, made into what trimesh reads: UTF-8, one list of materials, names that match.

trimesh takes one `mtllib`, no options of maps, and drops without a word what it does not find."""

from __future__ import annotations

import codecs
import contextlib
import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator

from arfx.errors import InputError
from arfx.media.model_files import ModelFolder
from arfx.media.model_limits import check_faces, check_parts

_MADE = "materials made by arfx.mtl"  # the list that trimesh is given
_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# Options of maps, how many values they take at most, and those that change nothing here.
_OPTIONS = dict.fromkeys(("-clamp", "-imfchan", "-cc", "-bm", "-boost", "-blendu", "-blendv", "-texres", "-type"), 1)
_OPTIONS |= {"-s": 3, "-o": 3, "-t": 3, "-mm": 2}
_IDLE = ("-bm", "-boost", "-blendu", "-blendv", "-texres", "-type")
_FILE = re.compile(r'"([^"]+)"|(\S.*?\.mtl(?=\s|$)|\S+)', re.IGNORECASE)
_OTHER_MAPS = ("map_", "bump", "disp", "decal", "refl", "norm")
_UNREAD = ("ke", "pr", "pm", "ps", "pc")  # emission and what later exporters add; told where they are not 0


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


def obj_for_trimesh(data: bytes, folder: ModelFolder, notices: list[str]) -> bytes:
    """The OBJ, its materials in `folder.memory`. Raises InputError: more faces or parts than can be handled.
    notices : gets what is left out"""
    text = "\n" + decoded(data).replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ").replace("\t", " ")
    if "\n " in text:
        text = re.sub(r"\n +", "\n", text)
    check_faces(text.count("\nf "), folder.path)
    used = dict.fromkeys(map(_key, re.findall(r"\nusemtl +(.*)", text)))
    check_parts(len(used), folder.path)
    names = re.findall(r"\nmtllib +(.*)", text)
    materials, missing = _materials(used, dict.fromkeys(file for line in names for file in _files(line, folder)), folder)
    about = f"model {folder.path.name}: "
    if missing and not folder.left_out:
        shown = ", ".join(name[:60] for name in missing[:5]) + (", …" if len(missing) > 5 else "")
        notices.append(f"{about}no MTL file describes {len(missing)} of its materials: {shown}")
    lost: dict[str, None] = {}
    lines = [line for name, rows in materials.items() for line in (f"newmtl {name}", *_statements(rows, lost))]
    if lost:
        notices.append(f"{about}left out of its materials: {', '.join(lost)}")
    at = text.find("\nv ") + 1
    if len(text[at : at + 500].partition("\n")[0].split()) >= 7:
        if materials:
            notices.append(f"{about}vertex colours left out where a material is used")
        else:  # beside texture coordinates trimesh drops them
            text = text.replace("\nvt ", "\n# ")
    folder.memory[_MADE] = "\n".join(lines).encode()
    first, *others = text.split("\nusemtl ")
    parts = (other.partition("\n") for other in others)
    text = first + "".join(f"\nusemtl {_key(name)}\n{rest}" for name, _, rest in parts)
    return f"mtllib {_MADE}\n{text}".encode()


def _key(name: str) -> str:
    """Exporters write one name composed and decomposed, in quotation marks, with other blanks."""
    return " ".join(unicodedata.normalize("NFC", name).strip().strip("\"'").split())


def _materials(used: Collection[str], files: Iterable[str], folder: ModelFolder) -> tuple[dict[str, list[str]], list[str]]:
    """Lines of the materials that are used, by name, and those of which there are none."""
    exact: dict[str, list[str]] = {}
    alike: dict[str, list[str]] = {}  # but for their case
    for file in files:
        with contextlib.suppress(InputError):  # it is in folder.left_out
            text = decoded(folder.get(file)).replace("\\\n", " ")
            for block in re.split(r"(?mi)^\s*newmtl\b", text)[1:]:
                name, *lines = block.splitlines()
                exact.setdefault(_key(name), lines)
                alike.setdefault(_key(name).casefold(), lines)
    known = {name: name.casefold() for name in used if name.casefold() in alike}
    return {name: exact.get(name, alike[folded]) for name, folded in known.items()}, [n for n in used if n not in known]


def _files(names: str, folder: ModelFolder) -> list[str]:
    """Of a line of mtllib: one name with blanks, or several."""
    several = [quoted or plain for quoted, plain in _FILE.findall(names)]
    if len(several) > 1:
        with contextlib.suppress(InputError):
            folder.find(names)
            return [names]
    return several


def _statements(lines: list[str], lost: dict[str, None]) -> Iterator[str]:
    """What trimesh and model_materials read of a material. lost : gets the rest, where it shows"""
    rows = [(row[0].lower(), row[0], row[1].strip()) for line in lines if len(row := line.split(None, 1)) == 2]
    maps = {value for key, _, value in rows if key == "map_kd"}
    for key, written, value in rows:
        number = value.split("#")[0].strip()
        if key == "map_kd":
            yield from _map(value, lost)
        elif key == "map_ka" and value in maps:
            continue
        elif key.startswith(_OTHER_MAPS) or (key in _UNREAD and re.search(r"[1-9]", number)):
            lost[written] = None
        elif key == "kd" and not _numbers(number.split()):
            lost[f"{written} {number[:40]}"] = None
        elif key == "kd":
            yield f"kd {number if ' ' in number else f'{number} {number} {number}'}"
        elif key in ("d", "ns"):
            yield f"{key} {number.removeprefix('-halo').strip()}"


def _map(value: str, lost: dict[str, None]) -> Iterator[str]:
    """`-s 2 2 -o .5 0 name of a file.png`"""
    place = {"-s": [1.0, 1.0], "-o": [0.0, 0.0]}
    while (option := value.split(None, 1)[0].lower()) in _OPTIONS:
        most = _OPTIONS[option]
        words = value.split(None, most + 1)
        count = next((k for k in range(most) if not _numbers(words[k + 1 : k + 2])), most) if most > 1 else 1
        if option in place:
            given = _numbers(words[1 : count + 1])[:2]
            place[option][: len(given)] = given
        elif option not in _IDLE and words[1:2] != ["off"]:
            lost[f"{option} of map_Kd"] = None
        value = " ".join(value.split(None, count + 1)[count + 1 :])
        if not value:
            return
    yield f"map_Kd {value}"
    yield "map_uv {} {} {} {}".format(*place["-s"], *place["-o"])


def _numbers(words: list[str]) -> list[float]:
    """Of all words, none where one is no number."""
    try:
        return [float(word) for word in words]
    except ValueError:
        return []
