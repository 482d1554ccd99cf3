"""The files that a model is made of: only from its own folder, of bounded size, every picture of
a known kind.

trimesh is given bytes and asks here for whatever they name: buffers, MTL files, textures.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import unicodedata
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from arfx.core.opener import read_bytes
from arfx.errors import InputError

# Of all instances together: 1.5 GB while the edges are looked for.
MAX_FACES = 5_000_000
# Mesh instances: each is a part with a transform of its own, a hundred parts take a second.
MAX_PARTS = 10_000
_FACES_OF = {
    "ply": rb"\belement\s+face\s+(\d+)",
    "off": rb"OFF\s+(?:#[^\n]*\s+)*\d+\s+(\d+)",
}
# What Pillow may open: left to itself it also takes formats for which it starts other
# programs (EPS: Ghostscript).
PICTURES = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "TGA", "PPM", "DDS")


class ModelFolder:
    """Answers trimesh as one of its resolvers.

    files : all that was read;  left_out : by name, why it was not;  refused : why pictures
    could not be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file_name = path.name  # OBJ: the name of a mesh that has none
        self.folder = path.absolute().parent.resolve()
        self.files: list[Path] = [path]
        self.left_out: dict[str, str] = {}
        self.refused: list[str] = []
        self.memory: dict[
            str, bytes
        ] = {}  # by name, what was made from the file and is in none
        self._names: dict[Path, dict[str, str]] = {}

    def get(self, name: str) -> bytes:
        """A picture, for trimesh, which itself would open any kind; or what is in the memory.

        Raises InputError.
        """
        if name in self.memory:
            return self.memory[name]
        data = self.read(name)
        if self.picture(data) is None:
            raise InputError(f"model {self.path} refers to {name}, which is no picture")
        return data

    __getitem__ = get

    def picture(self, content: bytes) -> Any:
        """Pillow's picture of one of PICTURES; None: it is none of these, or damaged."""
        from PIL import Image

        try:
            return Image.open(io.BytesIO(content), formats=PICTURES)
        except Exception as e:  # whatever its header holds
            unknown = isinstance(e, Image.UnidentifiedImageError)
            kinds = "not a picture of the kinds that are read: " + ", ".join(PICTURES)
            self.refused.append(kinds if unknown else "a picture's header is damaged")
            return None

    def read(self, name: str) -> bytes:
        """The file that a model calls `name`.

        Raises InputError: not in the folder, not a regular file, too large.
        """
        try:
            found = self.find(name)
            data = read_bytes(found, "model part")
        except InputError as e:
            self.left_out[name] = e.message
            raise InputError(f"model {self.path} refers to {e.message}", e.hint) from None
        if found not in self.files:
            self.files.append(found)
        return data

    def find(self, name: str) -> Path:
        """Exporters write names with %20, in quotation marks, in other case, with umlauts
        composed or not, and paths of the machine that they ran on: the file may lie beside
        the model. Raises InputError."""
        name = name.strip()
        plain = name.strip("\"'")
        bare = re.split(r"[/\\]", unquote(plain))[-1]
        candidates = dict.fromkeys(
            (name, plain, unquote(plain), plain.replace("\\", "/"), bare)
        )
        outside = False
        for candidate in candidates:
            with contextlib.suppress(OSError, ValueError):  # too long, a NUL in it
                place = Path(os.path.normpath(self.folder / candidate))
                if not place.is_relative_to(
                    self.folder
                ):  # not even looked for: the system may ask another machine (//host/x)
                    outside = True
                elif (
                    real := self._alike(place).resolve()
                ).exists() and real != self.folder:
                    if real.is_relative_to(self.folder):
                        return real
                    outside = True
        shown = name if len(name) < 200 else f"{name[:200]}…"
        if outside:
            raise InputError(
                f"{shown}, which lies outside its folder {self.folder}",
                "put it into the model's folder",
            )
        raise InputError(
            f"{shown}, which is not in its folder {self.folder}", "put it there"
        )

    def _alike(self, place: Path) -> Path:
        """The same path; under the names that are on the disk, where they differ in case or
        in how umlauts are written.
        """
        at = self.folder
        for part in place.relative_to(self.folder).parts:
            if at not in self._names:
                on_disk = (
                    sorted(os.listdir(at))  # noqa: PTH208
                    if at.resolve().is_relative_to(self.folder) and at.is_dir()
                    else []
                )
                self._names[at] = {_folded(n): n for n in on_disk} | {n: n for n in on_disk}
            at /= self._names[at].get(part) or self._names[at].get(_folded(part), part)
        return at


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def check_faces(count: int, path: Path) -> None:
    """Raises InputError."""
    if count > MAX_FACES:
        raise InputError(
            f"model {path} has {count} faces", f"at most {MAX_FACES}: simplify it first"
        )


def check_parts(count: int, path: Path) -> None:
    """Raises InputError."""
    if count > MAX_PARTS:
        raise InputError(
            f"model {path} has {count} parts or materials",
            f"at most {MAX_PARTS}: join them first",
        )


def stated_faces(data: bytes, kind: str) -> int:
    """As the file's beginning says; counted where it says nothing."""
    if kind == "stl":
        declared = int.from_bytes(data[80:84], "little")
        return declared if len(data) >= 84 + 50 * declared else data.count(b"endfacet")
    found = re.search(_FACES_OF[kind], data[:65536]) if kind in _FACES_OF else None
    return int(found[1][:18]) if found else 0
