"""Opens and checks every external file: a regular file of a bounded size, taken by its path alone.

A name is never an address, a protocol or a pattern. Devices, pipes, sockets and folders are
refused before they are opened. Files that libraries read themselves (FFmpeg, OpenCV) pass
`regular` first; what the formats may hold is checked by their readers."""

import json
import math
import os
import re
import stat
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from arfx.errors import ConfigError, InputError

MIB = 1 << 20
# kind of file, as messages call it -> largest size in MiB
LIMITS: dict[str, float] = tomllib.loads(
    Path(__file__).with_name("limits.toml").read_text("utf-8")
)
# nesting of tables and lists in text: people write five; parsers and printers recurse
MAX_NESTING = 64
MAX_INTEGER = (
    1 << 63
)  # TOML's range; beyond it numbers overflow wherever they are used
_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
_DOTTED = re.compile(
    r"(?<![^\s.=])(?:[^\s.=]++[ \t]*+\.[ \t]*+){64}"
)  # tomllib takes the square of a dotted key's parts


def check_name(name: str | Path) -> None:
    """Raises ConfigError for a name that is not text in the system's encoding: job files
    cannot hold it, and OpenCV crashes.
    """
    try:
        str(name).encode()
    except UnicodeEncodeError:
        encoding = sys.getfilesystemencoding()
        raise ConfigError(
            f"the name {str(os.fsencode(name))[1:]} is not {encoding} text",
            "rename it",
        ) from None


def printable(text: str) -> str:
    """Text with what is no character, and what terminals obey, written as numbers; line
    ends and tabs stay.
    """
    return _UNPRINTABLE.sub(
        lambda found: found[0].encode("unicode_escape").decode(), text
    )


def regular(path: Path | str, kind: str) -> Path:
    """The path, if it names a regular file no larger than LIMITS[kind].
    Raises InputError: missing, a folder, a device or pipe, too large, not permitted;
    ConfigError: its name is no text."""
    path = Path(path)
    check_name(path)
    try:
        _check_status(path.stat(), path, kind)
    except (OSError, ValueError) as e:  # ValueError: a NUL in the name
        raise _unreadable(path, kind, e) from None
    return path


def is_folder(path: Path, kind: str) -> bool:
    """Raises InputError where nothing is there, or it cannot be examined."""
    try:
        return stat.S_ISDIR(path.stat().st_mode)
    except (OSError, ValueError) as e:
        raise _unreadable(path, kind, e) from None


def folder_entries(folder: Path, kind: str = "folder") -> list[Path]:
    """What is in a folder, by name, without what is hidden.

    Raises InputError where it cannot be listed.
    """
    try:
        return sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    except OSError as e:
        raise _unreadable(folder, kind, e) from None


def read_bytes(path: Path | str, kind: str) -> bytes:
    """The whole file. Raises InputError as `regular` does."""
    path = regular(path, kind)
    limit = LIMITS[kind] * MIB
    try:
        with path.open("rb") as f:
            data = f.read(path.stat().st_size + 1)
            while len(data) <= limit and (more := f.read(MIB)):
                data += more  # it grows, or is one of /proc, which say that they are empty
    except OSError as e:
        raise _unreadable(path, kind, e) from None
    if len(data) > limit:
        raise _too_large(path, kind, len(data))
    return data


def read_text(path: Path | str, kind: str) -> str:
    """The whole file as UTF-8, without a byte order mark.

    Raises InputError also where it is not text.
    """
    return as_text(read_bytes(path, kind), path, kind)


def as_text(data: bytes, path: Path | str, kind: str) -> str:
    """The bytes of a file as `read_text` gives them. Raises InputError."""
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as e:
        raise InputError(
            f"{kind} {path} is not text (byte {e.start} is not UTF-8)",
            "save it as UTF-8",
        ) from None


def ffmpeg_url(path: Path | str) -> str:
    """A file as a URL for FFmpeg: `12:30.mp4` and `http:x.mkv` are names."""
    return f"file:{os.fspath(path)}"


def parse_toml(text: str) -> dict[str, Any]:
    """Raises ValueError that says what is wrong: no TOML, nested too deep, a number out of
    range.
    """
    if _DOTTED.search(text):
        raise ValueError("a key of more than 64 parts")
    return _parse(lambda: tomllib.loads(text))


def parse_json(text: str | bytes) -> Any:
    """Raises ValueError that says what is wrong: no JSON, nested too deep, a number out of
    range, NaN.
    """
    return _parse(
        lambda: json.loads(text, parse_constant=_finite, parse_float=_finite)
    )


def _parse(parse: Callable[[], Any]) -> Any:
    try:
        return bounded(parse())
    except RecursionError:
        raise ValueError(f"nested deeper than {MAX_NESTING}") from None
    except ValueError as e:
        if "integer string conversion" in str(e):  # Python's own limit of digits
            raise ValueError("an integer of more than 64 bits") from None
        raise


def bounded(tree: Any) -> Any:
    """The same tree, if it is at most MAX_NESTING deep and its integers are at most
    MAX_INTEGER. Raises ValueError.
    """
    level = [tree]
    for _ in range(MAX_NESTING + 1):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner += value.values()
            elif isinstance(value, list):
                inner += value
            elif isinstance(value, int) and abs(value) > MAX_INTEGER:
                raise ValueError("an integer of more than 64 bits")
        level = inner
        if not level:
            return tree
    raise ValueError(f"nested deeper than {MAX_NESTING}")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is out of range")
    return value


def _check_status(status: os.stat_result, path: Path, kind: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        is_folder = stat.S_ISDIR(status.st_mode)
        what = (
            "is a folder"
            if is_folder
            else "is not a regular file (a device, pipe or socket)"
        )
        raise InputError(f"{kind} {path} {what}", "give a file")
    if status.st_size > LIMITS[kind] * MIB:
        raise _too_large(path, kind, status.st_size)


def _too_large(path: Path, kind: str, size: int) -> InputError:
    limit = LIMITS[kind]
    return InputError(
        f"{kind} {path} holds more than {limit:g} MiB ({size / MIB:.3g} MiB)",
        f"at most {limit:g} MiB",
    )


def _unreadable(path: Path, kind: str, e: OSError | ValueError) -> InputError:
    if isinstance(e, FileNotFoundError):
        return InputError(f"{kind} {path}: no such file", "check the path")
    return InputError(
        f"{kind} {path} cannot be read: {why(e)}",
        "check the path and its permissions",
    )


def why(e: BaseException) -> str:
    """What the system or FFmpeg says of an error."""
    return getattr(e, "strerror", None) or str(e)
