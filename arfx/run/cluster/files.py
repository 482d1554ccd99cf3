"""The files that a job reads, as a worker finds them: at a path that it sees, or fetched
once into its cache.

What is found there is the same file by its size and content, whatever it is called. Of a job
folder under a URL, for workers that do not see the one of this machine, job files go up, and
chunks and stretches come down (`Store`)."""

import contextlib
import dataclasses
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from arfx.core.machine import cache_folder
from arfx.core.opener import why
from arfx.errors import ArfxError, RenderError
from arfx.run.cluster.spec import PathMap, is_url, library, places
from arfx.run.folder import JobFolder, digest, file_digest
from arfx.run.inputs import Inputs
from arfx.run.parameters import pipeline
from arfx.run.worker import process_name

FAILURES = (
    OSError,
    ValueError,
    ImportError,
    NotImplementedError,
    ArfxError,
)  # of fsspec and its file systems


@dataclass(frozen=True)
class Part:
    """A file: name : from the folder of the bundle, "" = the bundle's own path;  digest :
    of its content, "" = not compared
    """

    name: str
    size: int
    digest: str


@dataclass(frozen=True)
class Bundle:
    """What one path of a job stands for: a clip; a model with its textures; a folder of depth maps.

    section, key : of the setting;  places : where a worker is to look (`paths.places`);
    folder : whether the path is one
    """

    section: str
    key: str
    places: tuple[str, ...]
    folder: bool
    parts: tuple[Part, ...]


def bundles(
    inputs: Inputs, maps: Sequence[PathMap], rendering: bool = True
) -> tuple[Bundle, ...]:
    """Of all files that a worker reads beside the job folder. Raises OSError."""
    config = inputs.config
    assert config.input.clip is not None and config.model.file is not None
    paths: list[tuple[str, str, Path, Sequence[Path]]] = []
    paths.append(("input", "clip", config.input.clip, ()))
    if rendering:
        paths.append(("model", "file", config.model.file, inputs.model.files))
        if inputs.depth is not None and config.input.depth is not None:
            paths.append(("input", "depth", config.input.depth, inputs.depth.files))
        for name in pipeline(config):
            settings = vars(config.params[name]).items()
            paths += [
                (name, key, p, ()) for key, p in settings if isinstance(p, Path)
            ]
    return tuple(_bundle(*path, maps) for path in paths)


def _bundle(
    section: str, key: str, path: Path, more: Sequence[Path], maps: Sequence[PathMap]
) -> Bundle:
    path = path.absolute()
    folder = path.is_dir()
    parts = []
    for file in sorted({p.absolute() for p in more} | (set() if folder else {path})):
        name = Path(os.path.relpath(file, path if folder else path.parent)).as_posix()
        # maps of depth are many: their content is compared where it is used, by the chunk's
        # own facts
        content = "" if folder else file_digest(file, with_time=False)
        size = file.stat().st_size
        parts.append(Part("" if file == path else name, size, content))
    return Bundle(section, key, places(path, maps), folder, tuple(parts))


def find(bundle: Bundle) -> Path:
    """Its path here. Raises RenderError that says of every place why it is not there."""
    reasons = []
    for place in bundle.places:
        found = (
            _fetch(bundle, place)
            if is_url(place)
            else _differs(bundle, Path(place)) or Path(place)
        )
        if isinstance(found, Path):
            return found
        reasons.append(found)
    raise RenderError(
        "; ".join(reasons), "--map-path HERE=THERE says where workers see it"
    )


def _files(bundle: Bundle, path: Path) -> Iterator[tuple[Part, Path]]:
    """Its parts, and where they lie if it lies at `path`."""
    root = path if bundle.folder else path.parent
    for part in bundle.parts:
        yield part, root / (part.name or path.name)


def _differs(bundle: Bundle, path: Path) -> str | None:
    """Why the bundle is not at `path`; None where it is."""
    for part, file in _files(bundle, path):
        try:
            if file.stat().st_size != part.size:
                return f"{file} has another size"
            if part.digest and file_digest(file, with_time=False) != part.digest:
                return f"{file} has other content"
        except OSError as e:
            return f"{file}: {e.strerror}"
    return None


def _fetch(bundle: Bundle, url: str) -> Path | str:
    """Its path in the cache of this machine, to which it is copied if it is not there; why
    it cannot be. The folder in the cache appears when it is whole.
    """
    name = "." if bundle.folder else PurePosixPath(url).name
    about = digest([dataclasses.astuple(p) for p in bundle.parts], name)
    try:
        kept = cache_folder() / "files" / about
    except RuntimeError as e:  # no home
        return f"{url} cannot be fetched: {e}"
    if _differs(bundle, kept / name) is None:
        return kept / name
    aside = kept.with_name(f"{about}-{process_name()}.part")
    try:
        for part, file in _files(bundle, aside / name):
            file.parent.mkdir(parents=True, exist_ok=True)
            fs, path = file_system(_source(bundle, url, part))
            fs.get_file(path, str(file))
        if _differs(bundle, aside / name) is not None:
            return f"what lies at {url} is another file"
        shutil.rmtree(kept, ignore_errors=True)  # where it is damaged
        aside.rename(kept)
        return kept / name
    except FAILURES as e:
        # another process may have been quicker
        failure = f"{url} cannot be fetched: {said(e)}"
        return failure if _differs(bundle, kept / name) else kept / name
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _source(bundle: Bundle, url: str, part: Part) -> str:
    if not part.name:
        return url
    folder = url.rstrip("/") if bundle.folder else url.rpartition("/")[0]
    name = quote(part.name) if url.startswith(("http:", "https:")) else part.name
    return f"{folder}/{name}"


def file_system(url: str) -> tuple[Any, str]:
    """fsspec's file system of a URL, and the path in it. Raises what fsspec raises."""
    fs, path = library("fsspec").core.url_to_fs(url)
    return fs, path


def said(e: BaseException) -> str:
    """An error of fsspec in a line."""
    return (why(e) or type(e).__name__).splitlines()[0][:300]


@dataclass(frozen=True)
class Store:
    """A job folder under a URL. It lies in a folder of its own there, named by the job's
    key, and is removed when the job is done. url : of that"""

    url: str

    def put_job(self, folder: JobFolder, rendering: bool) -> None:
        """What workers read of a job folder to render, else to analyse. Raises RenderError."""
        for path in folder.worker_files(rendering):
            self.put(path, path.name)

    def get_job(self, folder: Path, rendering: bool) -> JobFolder:
        """The same in `folder`, which exists. Raises RenderError."""
        job = JobFolder(folder)
        for path in job.worker_files(rendering):
            self._get(path.name, path)
        job.open(resume=True)
        return job

    def put(self, path: Path, name: str) -> None:
        """A file or folder. Raises RenderError."""
        try:
            fs, root = file_system(self.url)
            # one by one: `put` would read a path as a pattern
            for file in sorted(path.iterdir()) if path.is_dir() else [path]:
                inner = f"/{file.name}" if path.is_dir() else ""
                target = f"{root}/{name}{inner}"
                fs.makedirs(target.rpartition("/")[0], exist_ok=True)
                fs.put_file(str(file), target)
        except FAILURES as e:
            raise RenderError(
                f"cannot write {self.url}/{name}: {said(e)}",
                "the job folder's URL has to take files",
            ) from None

    def _get(self, name: str, target: Path) -> None:
        try:
            fs, root = file_system(self.url)
            fs.get(f"{root}/{name}", str(target), recursive=True)
        except FAILURES as e:
            raise RenderError(f"cannot read {self.url}/{name}: {said(e)}") from None

    def take(self, file: Path) -> None:
        """The file of a chunk or stretch, to its place in the job folder. Raises RenderError."""
        chunks = JobFolder(file.parents[1]).chunks
        aside: Path = chunks / f"{process_name()}-0-{file.name}"
        self._get(f"{file.parent.name}/{file.name}", aside)
        aside.replace(file)

    def take_previews(self, previews: Path) -> None:
        """All that are there."""
        with contextlib.suppress(*FAILURES):
            fs, root = file_system(self.url)
            fs.get(f"{root}/previews/", f"{previews}/", recursive=True)

    def remove(self) -> None:
        """As far as that is possible."""
        with contextlib.suppress(*FAILURES):
            fs, root = file_system(self.url)
            fs.rm(root, recursive=True)
