"""A job folder under a URL, for workers that do not see the one of this machine: job files
go up, chunks and stretches come down.

It lies in a folder of its own under that URL, named by the job's key, and is removed when
the job is done."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from arfx.errors import RenderError
from arfx.run.cluster.files import FAILURES, file_system, said
from arfx.run.folder import JobFolder, content_digest
from arfx.run.worker import process_name


@dataclass(frozen=True)
class Store:
    """url : of the job's own folder there"""

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
            for file in sorted(path.iterdir()) if path.is_dir() else [path]:
                target = (
                    f"{root}/{name}/{file.name}"
                    if path.is_dir()
                    else f"{root}/{name}"
                )
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
            fs.get_file(f"{root}/{name}", str(target))
        except FAILURES as e:
            raise RenderError(f"cannot read {self.url}/{name}: {said(e)}") from None

    def take(self, name: str, suffix: str | None, folder: JobFolder) -> Path | None:
        """The file of a chunk (`Chunk.name`), or of a stretch where there is no suffix,
        moved into the job folder; None where there is none that is whole. Raises
        RenderError."""
        kind = (folder.stretches if suffix is None else folder.chunks).name
        try:
            fs, root = file_system(self.url)
            there = f"{root}/{kind}"
            listed = fs.ls(there, detail=False) if fs.exists(there) else []
            for file in sorted(PurePosixPath(path).name for path in listed):
                if not file.startswith(f"{name}."):
                    continue
                aside = folder.chunks / f"{process_name()}-0-{file}"
                fs.get(f"{there}/{file}", str(aside), recursive=True)
                fs.rm(f"{there}/{file}", recursive=True)
                if file == f"{name}.{content_digest(aside)}{suffix or ''}":
                    return aside.replace(
                        folder.path / kind / (name if suffix is None else file)
                    )
        except FAILURES as e:
            raise RenderError(f"cannot read {self.url}: {said(e)}") from None
        return None

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
