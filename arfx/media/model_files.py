"""A model's file and those that it names: only from its own folder, of bounded size, every
picture of a known kind."""

import contextlib
import io
import os
import tomllib
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy import ndarray
from PIL import Image

from arfx.core.opener import read_bytes
from arfx.errors import InputError

# Of all instances together: 1.5 GB while the edges are looked for.
MAX_FACES = 5_000_000
# Mesh instances: each is a part with a transform of its own, a hundred parts take a second.
MAX_PARTS = 10_000
# Texels of a model together: 20 bytes each while it is drawn, 2 GB
MAX_TEXELS = 8192**2 + 2 * 4096**2
# An 8k texture takes seconds and a gigabyte in software OpenGL; beyond it drivers refuse.
MAX_TEXTURE_PX = 8192
TABLES = tomllib.loads(Path(__file__).with_name("models.toml").read_text("utf-8"))
DAMAGED = "the file is damaged or not what its name says"
NO_TRIANGLES = "points and lines left out"
# What Pillow may open: left to itself it also takes formats for which it starts other
# programs (EPS: Ghostscript).
PICTURES = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "TGA", "PPM", "DDS")


class ModelFile:
    """A file while it is read. Errors do not name it: who reads it does.

    data : all of it;  kind : its format, as "glb"
    files : all that was read;  notices : of what is left out or repaired"""

    def __init__(self, path: Path, data: bytes, kind: str) -> None:
        self.path, self.data, self.kind = path, data, kind
        self.files = [path]
        self.notices: list[str] = []
        self._folder = path.absolute().parent.resolve()
        self._pictures: dict[Any, ndarray | None] = {}
        self._texels = 0

    def check_counts(self, faces: int, parts: int = 0) -> None:
        """Raises InputError: there are more than can be handled."""
        if faces > MAX_FACES:
            raise InputError(
                f"it has more than {MAX_FACES} faces", "simplify it first"
            )
        if parts > MAX_PARTS:
            what = f"it has more than {MAX_PARTS} parts or materials"
            raise InputError(what, "join them first")

    def picture(
        self, name: Any, content: Callable[[], bytes] | None = None
    ) -> ndarray | None:
        """(h, w, 4) uint8, decoded once; None: it is not there or no picture, which is in
        `notices`.

        name : in the model, of a file beside it where no content is given
        Raises InputError: too large, damaged."""
        if name not in self._pictures:
            image = None
            with contextlib.suppress(InputError):
                image = self._opened(content() if content else self.read(name))
            self._pictures[name] = self.texels(image)
        return self._pictures[name]

    def texels(self, image: Any) -> ndarray | None:
        """(h, w, 4) uint8 of a picture of Pillow, which is closed; None for None.

        Raises InputError: too large, damaged."""
        if image is None:
            return None
        width, height = image.size
        if max(width, height) > MAX_TEXTURE_PX:
            hint = f"at most {MAX_TEXTURE_PX} px a side: scale it down"
            raise InputError(f"a texture is {width}x{height} px", hint)
        self._texels += width * height
        if self._texels > MAX_TEXELS:
            what = f"its textures hold more than {MAX_TEXELS / 1e6:.0f} megapixels"
            raise InputError(what, "scale them down")
        try:
            with image:
                # 16-bit greys, which Pillow cuts off at 255
                if image.mode.startswith("I"):
                    grey = np.clip(np.asarray(image) >> 8, 0, 255)
                    image = Image.fromarray(grey.astype(np.uint8))
                return np.asarray(image.convert("RGBA"))
        except (OSError, ValueError, SyntaxError) as e:  # Pillow decodes late
            what = "a texture is damaged or cut short"
            raise InputError(what, "export it again") from e

    def _opened(self, content: bytes) -> Any:
        """Pillow's picture of one of PICTURES; None: it is none of these, or damaged."""
        try:
            return Image.open(io.BytesIO(content), formats=PICTURES)
        except Image.UnidentifiedImageError:
            why = "not pictures of the kinds that are read: " + ", ".join(PICTURES)
        except Exception:  # whatever its header holds
            why = "a picture's header is damaged"
        self.notices.append(f"textures left out: {why}")
        return None

    def get(self, name: str) -> bytes:
        """A picture, for trimesh, which itself would open any kind. Raises InputError."""
        data = self.read(name)
        if self._opened(data) is None:
            raise InputError(f"it refers to {name}, which is no picture")
        return data

    __getitem__ = get

    def read(self, name: str) -> bytes:
        """The file that the model calls `name`.

        Raises InputError: not in the folder, not a regular file, too large; a notice tells."""
        try:
            found = self.find(name)
            data = read_bytes(found, "model part")
        except InputError as e:
            self.notices.append(f"left out {e.message}")
            raise InputError(f"it refers to {e.message}", e.hint) from None
        if found not in self.files:
            self.files.append(found)
        return data

    def find(self, name: str) -> Path:
        """Exporters write names with %20, in quotation marks, in other case, with umlauts
        composed or not, and paths of the machine that they ran on: the file may lie beside
        the model. Raises InputError."""
        plain = name.strip().strip("\"'")
        usual = unquote(plain).replace("\\", "/")
        outside = False
        for candidate in (plain, usual, usual.rpartition("/")[2]):
            with contextlib.suppress(OSError, ValueError):  # too long, a NUL in it
                place = Path(os.path.normpath(self._folder / candidate))
                if not place.is_relative_to(self._folder):
                    # not even looked for: the system may ask another machine (//host/x)
                    outside = True
                    continue
                found = self._alike(place).resolve()
                if found.exists() and found != self._folder:
                    if found.is_relative_to(self._folder):
                        return found
                    outside = True
        shown = name if len(name) < 200 else f"{name[:200]}…"
        if outside:
            what = f"{shown}, which lies outside its folder {self._folder}"
            raise InputError(what, "put it into the model's folder")
        what = f"{shown}, which is not in its folder {self._folder}"
        raise InputError(what, "put it there")

    def _alike(self, place: Path) -> Path:
        """The same path; under the names that are on the disk, where they differ in case or
        in how umlauts are written."""
        path = self._folder
        for name in place.relative_to(path).parts:
            inside = path.resolve().is_relative_to(self._folder) and path.is_dir()
            on_disk = os.listdir(path) if inside else []  # noqa: PTH208
            alike = sorted(n for n in on_disk if _folded(n) == _folded(name))
            path /= name if name in alike or not alike else alike[0]
        return path


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
