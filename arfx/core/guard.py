"""What a command may write: never a file that it reads, nothing over an existing file
unasked, and all of a file or none.
"""

import contextlib
import errno
import os
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from arfx.errors import ConfigError

PART = r"\.arfx-\d+-[0-9a-f]{8}\.part"  # what `part_name` makes
Fingerprint = tuple[int, int, int]
TIMES = "times.txt"  # beside the images of a sequence


class Guard:
    """Checks on paths that a command is going to write to. Each raises ConfigError and
    touches nothing.
    reads : (what it is, path) of every file and folder that the command reads;  overwrite :
    outputs may be replaced
    own : fingerprints of outputs that the same job wrote before it was killed: they may be
    replaced unasked
    """

    def __init__(
        self, reads: Iterable[tuple[str, Path]], overwrite: bool = False
    ) -> None:
        self.overwrite = overwrite
        self.own: frozenset[Fingerprint] = frozenset()
        self._reads = {_real(path): what for what, path in reads}
        self._by_identity = {
            _identity(Path(path)): what for path, what in self._reads.items()
        }
        self._by_identity.pop(None, None)

    def file(
        self,
        path: Path,
        start: bytes = b"",
        option: str = "-o",
        folder_made: bool = False,
    ) -> None:
        """A file to write. start : how those of arfx begin; one that begins otherwise is
        not replaced at all.
        """
        self.check_not_read(path, option)
        if not folder_made:
            _check_parent(path, option)
        if not os.path.lexists(path):
            return
        _check_file(path, option)
        # a report that was begun behind the output is the job's too
        if not (start and self.own):
            self._check_replaceable(path, option)
        if start and not _begins_with(path, start):
            raise ConfigError(
                f"{path} was not written by arfx: it is not replaced",
                f"name another place with {option}",
            )

    def files(
        self, folder: Path, starts: Mapping[str, bytes], option: str = "-o"
    ) -> None:
        """Files of these names in a folder that is made where there is none.

        starts : as in `file`
        """
        _check_folder(folder, option)
        for name, start in starts.items():
            self.file(folder / name, start, option, folder_made=True)

    def images(self, folder: Path, suffix: str, named: Callable[[str], bool]) -> None:
        """A folder of images to write. named : whether a file name is one of theirs"""
        _check_folder(folder, "-o")
        if not folder.is_dir():
            _check_parent(folder, "-o")
            return
        self._refuse_if_read(folder, "-o")
        for name in sorted(os.listdir(folder)):  # noqa: PTH208 - names alone
            path, mine = folder / name, named(name) or name == TIMES
            if mine:
                self._refuse_if_read(path, "-o")
                _check_file(path, "-o")
            if mine or path.suffix.lower() == suffix.lower():
                self._check_replaceable(path, "-o")

    def folder(self, path: Path, option: str) -> None:
        """A folder that the command keeps for itself: no input is in it."""
        check_file_name(path / ("0" * 60) / ("0" * 120), option)
        _check_folder(path, option)
        inside = _real(path) + os.sep
        for real, what in self._reads.items():
            if (real + os.sep).startswith(inside):
                raise ConfigError(
                    f"{what} {real} lies in {path}: it could be lost",
                    f"name another with {option}",
                )

    def check_not_read(self, path: Path, option: str = "-o") -> None:
        """A file that is no input, under whatever name, and whose own name can be written."""
        check_file_name(path, option)
        self._refuse_if_read(path, option)

    def _check_replaceable(self, path: Path, option: str) -> None:
        if not (self.overwrite or fingerprint(path) in self.own):
            raise ConfigError(
                f"output {path} exists",
                f"--overwrite replaces it; or name another with {option}",
            )

    def _refuse_if_read(self, path: Path, option: str) -> None:
        if what := self._reads.get(_real(path)) or self._by_identity.get(
            _identity(path)
        ):
            raise ConfigError(
                f"output {path} is also an input ({what}): it would be lost",
                f"name another with {option}",
            )


def _check_parent(path: Path, option: str) -> None:
    if not path.absolute().parent.is_dir():
        raise ConfigError(
            f"output folder {path.parent} does not exist",
            f"make it first, or name another with {option}",
        )


def _check_folder(path: Path, option: str) -> None:
    if os.path.lexists(path) and not path.is_dir():
        raise ConfigError(
            f"{path} is a file, not a folder", f"name another with {option}"
        )


def _check_file(path: Path, option: str) -> None:
    if path.is_dir() or not (path.is_file() or path.is_symlink()):
        raise ConfigError(
            f"output {path} is not a file", f"name another with {option}"
        )


def check_file_name(path: Path, option: str = "-o") -> None:
    """Raises ConfigError where the system takes no such name: too long, or with a character
    that names cannot hold.
    """
    try:
        os.lstat(path.absolute())
    except OSError as e:
        if e.errno in (errno.ENAMETOOLONG, errno.EINVAL):
            name = str(path)
            name = name if len(name) <= 100 else f"{name[:60]}…{name[-30:]}"
            raise ConfigError(
                f"the name {name} is too long for this disk",
                f"a shorter one with {option}",
            ) from None
    except ValueError as e:
        raise ConfigError(
            f"{str(path)!r} cannot be a file's name: {e}",
            f"name another with {option}",
        ) from None


def part_name(path: Path) -> Path:
    """A name beside `path`, in use by nobody, for what is not whole yet."""
    return path.with_name(f".arfx-{os.getpid()}-{secrets.token_hex(4)}.part")


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A name to write to instead of `path`: renamed to it after the body, removed after an
    error.
    """
    part = part_name(path)
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def fingerprint(path: Path) -> Fingerprint:
    """What a file keeps when it is renamed, and loses when anyone writes to it or replaces it.

    (0, 0, 0) : no such file
    """
    try:
        s = path.lstat()
    except OSError:
        return 0, 0, 0
    return s.st_ino, s.st_size, s.st_mtime_ns


def _real(path: Path) -> str:
    return os.path.normcase(os.path.realpath(path))


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and number of a file: the same under every name of it, hard links and other
    spellings included.
    """
    try:
        s = path.stat()
    except (OSError, ValueError):
        return None
    return (s.st_dev, s.st_ino) if s.st_ino else None


def _begins_with(path: Path, start: bytes) -> bool:
    try:
        with path.open("rb") as f:
            return f.read(len(start)) == start
    except OSError:
        return False
