"""The files that a job reads, as a worker finds them: at a path that it sees, or fetched
once into its cache.

What is found there is the same file by its size and content, whatever it is called."""

from __future__ import annotations

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
from arfx.run.cluster.paths import PathMap, is_url, places
from arfx.run.cluster.spec import library
from arfx.run.folder import digest, file_digest
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
    found = [_bundle("input", "clip", config.input.clip, (), maps)]
    if not rendering:
        return tuple(found)
    found.append(
        _bundle("model", "file", config.model.file, inputs.model.files, maps)
    )
    if inputs.depth is not None and config.input.depth is not None:
        found.append(
            _bundle("input", "depth", config.input.depth, inputs.depth.files, maps)
        )
    for name in pipeline(config):
        for key, path in vars(config.params[name]).items():
            if isinstance(path, Path):
                found.append(_bundle(name, key, path, (), maps))
    return tuple(found)


def _bundle(
    section: str, key: str, path: Path, more: Sequence[Path], maps: Sequence[PathMap]
) -> Bundle:
    path = path.absolute()
    folder = path.is_dir()
    root = path if folder else path.parent
    parts = (
        []
        if folder
        else [Part("", path.stat().st_size, file_digest(path, with_time=False))]
    )
    for file in sorted({p.absolute() for p in more} - {path}):
        # maps of depth are many: their content is compared where it is used, by the chunk's
        # own facts
        content = "" if folder else file_digest(file, with_time=False)
        parts.append(
            Part(
                Path(os.path.relpath(file, root)).as_posix(),
                file.stat().st_size,
                content,
            )
        )
    return Bundle(section, key, places(path, maps), folder, tuple(parts))


def find(bundle: Bundle) -> Path:
    """Its path here. Raises RenderError that says of every place why it is not there."""
    reasons = []
    for place in bundle.places:
        reason = (
            _fetch(bundle, place) if is_url(place) else _differs(bundle, Path(place))
        )
        if isinstance(reason, Path):
            return reason
        if reason is None:
            return Path(place)
        reasons.append(reason)
    raise RenderError(
        "; ".join(reasons), "--map-path HERE=THERE says where workers see it"
    )


def _differs(bundle: Bundle, path: Path) -> str | None:
    """Why the bundle is not at `path`; None where it is."""
    for part in bundle.parts:
        file = (
            (path if bundle.folder else path.parent) / part.name
            if part.name
            else path
        )
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
    it cannot be.
    """
    name = "." if bundle.folder else PurePosixPath(url).name
    try:
        kept = (
            cache_folder()
            / "files"
            / digest([dataclasses.astuple(p) for p in bundle.parts], name)
        )
    except RuntimeError as e:  # no home
        return f"{url} cannot be fetched: {e}"
    if _differs(bundle, kept / name) is None:
        return kept / name
    failure = _copy(bundle, url, kept, name)
    return kept / name if _differs(bundle, kept / name) is None else failure


def _copy(bundle: Bundle, url: str, kept: Path, name: str) -> str:
    """Fill the folder `kept`, which appears when it is whole.

    Returns what went wrong, if anything did.
    """
    aside = kept.with_name(f"{kept.name}-{process_name()}.part")
    try:
        for part, source in _sources(bundle, url):
            target = aside / (part.name or name)
            target.parent.mkdir(parents=True, exist_ok=True)
            fs, path = file_system(source)
            fs.get_file(path, str(target))
        if _differs(bundle, aside / name) is None:
            shutil.rmtree(kept, ignore_errors=True)  # where it is damaged
            aside.rename(kept)
        return f"what lies at {url} is another file"
    except FAILURES as e:
        return f"{url} cannot be fetched: {said(e)}"
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _sources(bundle: Bundle, url: str) -> Iterator[tuple[Part, str]]:
    folder = url.rstrip("/") if bundle.folder else url.rpartition("/")[0]
    for part in bundle.parts:
        name = quote(part.name) if url.startswith(("http:", "https:")) else part.name
        yield part, f"{folder}/{name}" if name else url


def file_system(url: str) -> tuple[Any, str]:
    """fsspec's file system of a URL, and the path in it. Raises what fsspec raises."""
    fs, path = library("fsspec").core.url_to_fs(url)
    return fs, path


def said(e: BaseException) -> str:
    """An error of fsspec in a line."""
    return (why(e) or type(e).__name__).splitlines()[0][:300]
