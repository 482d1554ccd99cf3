"""The job folder: what is written where, whole or not at all, what in it is arfx's own, and
what is still good.

job.toml (frozen) · inputs.json · stretches.json · stretches/ · frames.json · facts.jsonl ·
environment.maps · plan.jsonl · plan_summary.json · seal.json · placed.json · chunks/ ·
timings.jsonl · previews/ · report.json"""

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy import ndarray

import arfx
from arfx.core.facts import FrameFacts
from arfx.core.guard import PART, TIMES, Fingerprint, atomic_write, fingerprint
from arfx.core.opener import why
from arfx.errors import ConfigError, RenderError
from arfx.media.frames import Frame
from arfx.run.lock import HOLDER, LOCK, MARKER

T = TypeVar("T")
MARK = (  # job.toml begins with it
    "# A job of arfx. Its folder is arfx's own: --overwrite clears it.\n"
)
_LOCKS = "|".join(map(re.escape, (LOCK, MARKER, HOLDER)))
_IMAGE = rf"[^/]+\.(?:png|exr)|{re.escape(TIMES)}"
_CHUNK = r"(?:(?:[0-9A-Za-z]+-)?\d+-\d+-)?\d{6,}-\d{6,}(?:\.[0-9a-f]{16}){1,2}(?:\.nut|\.mkv)?(?:\.part)?"
# What arfx writes, by its path in the folder: without a job.toml of its own, and with one
_FOLDERS = re.compile(rf"chunks|stretches|previews|joined\.part|chunks/{_CHUNK}")
_UNMARKED = re.compile(rf"(?:{_LOCKS})|{PART}|joined\.part(?:/(?:{_IMAGE}))?")
_MARKED = re.compile(
    rf"job\.toml|environment\.maps|(?:inputs|stretches|frames|plan_summary|seal|placed|report)\.json|(?:facts|plan|timings)\.jsonl"
    rf"|stretches/(?:\d{{6,}}-\d{{6,}}\.[0-9a-f]{{16}}|{PART})|chunks/{_CHUNK}(?:/(?:{_IMAGE}))?|previews/\d{{6,}}\.bmp"
)
_SEALED = (
    "frames.json",
    "facts.jsonl",
    "environment.maps",
    "plan.jsonl",
    "plan_summary.json",
)
_SOURCE = (".py", ".toml", ".vert", ".frag")


def _inside(name: str) -> Any:
    return property(lambda self: self.path / name)


@dataclass(frozen=True)
class JobFolder:
    path: Path

    job = _inside("job.toml")
    inputs = _inside("inputs.json")
    frames = _inside("frames.json")
    facts = _inside("facts.jsonl")
    environment = _inside("environment.maps")  # those that the facts name
    plan = _inside("plan.jsonl")
    plan_summary = _inside("plan_summary.json")
    chunks = _inside("chunks")
    timings = _inside("timings.jsonl")
    previews = _inside("previews")
    report = _inside("report.json")
    stretch_list = _inside("stretches.json")  # where the analysis cuts the clip
    stretches = _inside("stretches")  # what each was found to hold
    joined = _inside("joined.part")  # the output, until it is whole
    # fingerprints of the output's files, from just before it is put in place
    placed = _inside("placed.json")
    _seal = _inside("seal.json")

    def files(self) -> Iterator[Path]:
        """All that arfx wrote into it."""
        return (self.path / name for name, ours in self._entries() if ours)

    def worker_files(self, analysed: bool) -> Iterator[Path]:
        """What workers read of it, and what says that it is whole.

        analysed : to render, else to analyse
        """
        yield from (self.job, self.inputs)
        yield from (
            (*(self.path / name for name in _SEALED), self._seal)
            if analysed
            else (self.stretch_list,)
        )

    def check_foreign_files(self) -> None:
        """Raises ConfigError where the folder holds anything that arfx did not write."""
        foreign = next((name for name, ours in self._entries() if not ours), None)
        if foreign is not None:
            raise ConfigError(
                f"{self.path} holds {foreign!r}, it is not a job folder",
                "name an empty one with --job",
            )

    def check(self, resume: bool, overwrite: bool) -> None:
        """Raises ConfigError where it holds a job that is neither to be resumed nor to be
        replaced.
        """
        if self.job.exists() and not resume and not overwrite:
            state = "a finished" if self.report.exists() else "an unfinished"
            raise ConfigError(
                f"{self.path} holds {state} job",
                "--resume goes on with it, --overwrite starts afresh",
            )

    def open(self, resume: bool) -> None:
        """Make the folder, or keep what an earlier job left in it (resume), else clear that.

        Raises RenderError.
        """
        if not resume:
            self.clear()
        try:
            self.chunks.mkdir(parents=True, exist_ok=True)
            self.stretches.mkdir(exist_ok=True)
            self.previews.mkdir(exist_ok=True)
        except OSError as e:
            raise RenderError(
                f"job folder {self.path} cannot be made: {e.strerror}",
                "name another with --job",
            ) from None

    def clear(self, under: str = "") -> None:
        """Remove what arfx wrote, but for a lock; what it did not write stays. under : only
        what lies in this folder
        """
        for name, ours in [*self._entries()]:
            if ours and name.startswith(under) and name not in (LOCK, MARKER, HOLDER):
                path = self.path / name
                with contextlib.suppress(OSError):
                    path.rmdir() if path.is_dir() else path.unlink()

    @property
    def resumable(self) -> bool:
        """Whether there is anything here that another process need not do again."""
        return self._seal.exists() or any(self.stretches.glob("*-*.*"))

    def seal(self, job_key: str) -> None:
        """The analysis and the plan of this job are written, whole."""
        write(self._seal, json.dumps({"job_key": job_key, "files": self._digests()}))

    def unseal(self) -> None:
        self._seal.unlink(missing_ok=True)

    def sealed(self, job_key: str) -> bool:
        """Whether they are this job's, as they were written."""
        try:
            return bool(
                json.loads(self._seal.read_bytes())
                == {
                    "job_key": job_key,
                    "files": self._digests(),
                }
            )
        except (OSError, ValueError, RecursionError):
            return False

    def sealed_key(self) -> str:
        """Of the job that is sealed here. Raises OSError, ValueError, KeyError where none is."""
        return str(json.loads(self._seal.read_bytes())["job_key"])

    def record_outputs(self, part: Path) -> None:
        """The files of `part` are about to become the output."""
        files = sorted(part.iterdir()) if part.is_dir() else [part]
        write(self.placed, json.dumps([fingerprint(f) for f in files]))

    def outputs(self) -> frozenset[Fingerprint]:
        """Files that were put in place, or were about to be, by a job that was killed
        before it had ended.
        """
        try:
            return frozenset(
                (int(a), int(b), int(c))
                for a, b, c in json.loads(self.placed.read_bytes())
            )
        except (OSError, ValueError, TypeError, OverflowError, RecursionError):
            return frozenset()

    def _digests(self) -> dict[str, str]:
        return {name: content_digest(self.path / name) for name in _SEALED}

    def _entries(self, inside: str = "") -> Iterator[tuple[str, bool]]:
        """(path in the folder, whether arfx wrote it) of all that is in it, from the inside
        out; links are not arfx's.
        """
        patterns = (_UNMARKED, *[_MARKED] * self._marked())
        try:
            with os.scandir(self.path / inside) as found:
                entries = sorted(found, key=lambda e: e.name)
        except (
            FileNotFoundError
        ):  # none yet, or none any more: a job that ends clears it
            return
        for e in entries:
            name = inside + e.name
            if e.is_dir(follow_symlinks=False):
                ours = _FOLDERS.fullmatch(name) is not None
                yield from self._entries(f"{name}/") if ours else ()
            else:
                ours = e.is_file(follow_symlinks=False) and any(
                    p.fullmatch(name) for p in patterns
                )
            yield name, ours

    def _marked(self) -> bool:
        with contextlib.suppress(OSError):
            if self.job.is_file():  # reading from a pipe would wait
                with self.job.open("rb") as f:
                    return f.read(len(MARK)) == MARK.encode()
        return False


def write(path: Path, data: str | bytes | Iterable[str]) -> None:
    """Write aside, then rename: the file is whole or absent. data : or its pieces. Raises
    RenderError.
    """
    try:
        with atomic_write(path) as part, part.open("wb") as f:
            for piece in [data] if isinstance(data, (str, bytes)) else data:
                f.write(piece.encode() if isinstance(piece, str) else piece)
    except OSError as e:
        raise disk_error(e, path) from None


def disk_error(e: OSError, path: Path) -> RenderError:
    """One clear message for a full disk, a read-only place and the like."""
    return RenderError(
        f"cannot write {path}: {why(e)}",
        "free space or name another place; --resume goes on from there",
    )


def append_line(path: Path, row: Any) -> None:
    """One more line of JSON, behind one that a kill or a full disk may have cut short.

    Raises OSError.
    """
    with path.open("ab+") as f:
        f.seek(max(f.seek(0, os.SEEK_END) - 1, 0))
        whole = f.read(1) in (b"", b"\n")
        f.write(f"{'' if whole else chr(10)}{json.dumps(row)}\n".encode())


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """The objects that the lines of a file hold, none where there is no file; a line that
    is cut short or damaged is skipped.
    """
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace") as f:
        for line in f:
            with contextlib.suppress(ValueError, RecursionError):
                if isinstance(row := json.loads(line), dict):
                    yield row


class Lines(Generic[T]):
    """Lines of a file, a slice at a time: what is not asked for is neither read nor held.

    parse : what a line becomes;  header : lines at the top that do not count"""

    def __init__(
        self, path: Path, parse: Callable[[str], T], header: int = 0
    ) -> None:
        self._path, self._parse = path, parse
        with path.open("rb") as f:
            self._starts = np.cumsum([0, *map(len, f)])[header:]

    def __getitem__(self, part: slice) -> list[T]:
        wanted = range(len(self._starts) - 1)[part]
        start, end = self._starts[
            [wanted.start, max(wanted.start, wanted.stop)]
        ].tolist()
        with self._path.open("rb") as f:
            f.seek(start)
            return [
                self._parse(line)
                for line in f.read(end - start).decode().splitlines()
            ]


def digest(*parts: Any) -> str:
    """16 hex digits over JSON-able parts."""
    h = hashlib.blake2b(digest_size=8)
    for part in parts:
        h.update(json.dumps(part, sort_keys=True, default=str).encode())
        h.update(b"\0")
    return h.hexdigest()


def file_digest(
    path: Path, whole_up_to: int = 256 << 20, with_time: bool = True
) -> str:
    """Content digest of a file; of a larger one its size, time and three samples, so that
    an hour of 4K costs nothing.

    with_time : a copy of a large file, which has another time, is another file"""
    stat = path.stat()
    h = hashlib.blake2b(digest_size=16)
    h.update(str(stat.st_size).encode())
    with path.open("rb") as f:
        if stat.st_size <= whole_up_to:
            hashlib.file_digest(f, lambda: h)
        else:
            if with_time:
                h.update(str(stat.st_mtime_ns).encode())
            for at in (0, stat.st_size // 2, stat.st_size - (4 << 20)):
                f.seek(at)
                h.update(f.read(4 << 20))
    return h.hexdigest()


def content_digest(path: Path) -> str:
    """16 hex digits over a whole file, or over a folder's files and their names. Raises OSError."""
    h = hashlib.blake2b(digest_size=8)
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        h.update(b"" if file == path else file.name.encode() + b"\0")
        with file.open("rb") as f:
            hashlib.file_digest(f, lambda: h)
    return h.hexdigest()


@cache
def code_digest(
    root: Path = Path(arfx.__file__).parent, version: str = arfx.__version__
) -> str:
    """Digest of the source of a package (arfx's own) or module: a chunk made by other code
    is made again.
    """
    h = hashlib.blake2b(version.encode(), digest_size=8)
    for path in (
        [root]
        if root.is_file()
        else sorted(p for p in root.rglob("*") if p.suffix in _SOURCE)
    ):
        h.update(str(path.relative_to(root)).encode())
        h.update(path.read_bytes())
    return h.hexdigest()


PREVIEWS, WIDEST_PX = 8, 960


def pick_previews(facts: Sequence[FrameFacts]) -> list[int]:
    """Frames spread evenly over those that show the object; over all where none does."""
    shown = [f.index for f in facts if f.visible] or [f.index for f in facts]
    at = np.unique(
        np.linspace(0, len(shown) - 1, min(PREVIEWS, len(shown))).round().astype(int)
    )
    return [shown[i] for i in at]


def save_preview(folder: Path, index: int, before: Frame, after: Frame) -> None:
    """One picture: before, and after to its right."""
    import cv2

    pair = np.hstack([before.rgb8(), after.rgb8()])
    height, width = pair.shape[:2]
    if width > 2 * WIDEST_PX:
        size = (2 * WIDEST_PX, max(round(2 * height * WIDEST_PX / width), 1))
        pair = cv2.resize(pair, size, interpolation=cv2.INTER_AREA)
    # as it is: a PNG would take as long as a frame's rendering, for a file that lives as long
    # as the job folder
    cv2.imwrite(str(folder / f"{index:06d}.bmp"), pair[..., ::-1])


def load_previews(folder: Path) -> list[tuple[int, ndarray, ndarray]]:
    """(frame number, before, after), RGB uint8, in order."""
    import cv2

    out = []
    for path in sorted(folder.glob("*.bmp")):
        if (pair := cv2.imread(str(path))) is not None:
            before, after = np.array_split(pair[..., ::-1], 2, axis=1)
            out.append((int(path.stem), before, after))
    return out
