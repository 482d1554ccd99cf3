"""What runs on a worker of a cluster: it says who it is, finds what the job reads, analyses
stretches and renders chunks.

What it is sent are places, digests and numbers of frames; what it returns are names and
times."""

import asyncio
import os
import shutil
import socket
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arfx.core.opener import why
from arfx.core.parallel import ONE_THREAD
from arfx.errors import ArfxError, RenderError
from arfx.media.writer import remove_output
from arfx.run.cluster.agreement import (
    OPENGL,
    PROCESSOR,
    STAGE,
    differences,
    environment,
)
from arfx.run.cluster.files import Bundle, Store, find
from arfx.run.cluster.spec import is_url
from arfx.run.executors import Work
from arfx.run.folder import JobFolder
from arfx.run.stretches import analyse_stretch, listed
from arfx.run.worker import Paths, render_chunk


@dataclass(frozen=True)
class JobReference:
    """What a worker has to know of a run of a job.

    run : names it, and is the resource of workers that may work
    key : of the job, or of its analysis;  rendering : else stretches are wanted
    folders : places of the job folder (`paths.places`), and of a store, if there is one
    """

    run: str
    key: str
    rendering: bool
    folders: tuple[str, ...]
    bundles: tuple[Bundle, ...]


@dataclass(frozen=True)
class _Placed:
    """A job as this worker sees it.

    store : where its files go; the folder is a copy then, to be removed
    """

    job: JobReference
    folder: JobFolder
    paths: Paths
    store: Store | None = None


_MOST = 8  # jobs that a worker keeps in mind
_placed: dict[str, _Placed] = {}  # by run


async def examine(
    here: Mapping[str, str], job: JobReference | None, dask_worker: Any
) -> tuple[str, str]:
    """(name and host of this worker, why it can do nothing for a process with the
    environment `here`, "" = it can: then it gets tasks of the job).
    """
    from distributed.core import Status

    refused = await asyncio.to_thread(
        _refusal, here, job, dask_worker.local_directory
    )
    if job is not None and not refused:
        await dask_worker.set_resources(**{job.run: dask_worker.state.nthreads})
        # Dask gives tasks that wait for a worker to one that it sees wake
        dask_worker.status = Status.paused
        dask_worker.status = Status.running
    return f"{dask_worker.name} ({socket.gethostname()})", refused


def _refusal(here: Mapping[str, str], job: JobReference | None, scratch: str) -> str:
    import cv2

    cv2.setNumThreads(1)
    for variable, one in ONE_THREAD.items():
        os.environ.setdefault(variable, one)
    plugins = tuple(
        name.removeprefix(STAGE) for name in here if name.startswith(STAGE)
    )
    there = environment(plugins, PROCESSOR in here, OPENGL in here)
    differing = ", ".join(differences(here, there))
    return differing or ("" if job is None else _place(job, scratch))


def _place(job: JobReference, scratch: str) -> str:
    """Find all that the job reads. Returns why this worker cannot see it; "" where it can."""
    try:
        paths = tuple((b.section, b.key, str(find(b))) for b in job.bundles)
        _placed[job.run] = _folder(job, paths, scratch)
    except ArfxError as e:
        return e.message
    except OSError as e:
        return f"{e.filename or 'a file'}: {why(e)}"
    for run in [*_placed][:-_MOST]:
        old = _placed.pop(run)
        if old.store is not None:
            shutil.rmtree(old.folder.path, ignore_errors=True)
    return ""


def _folder(job: JobReference, paths: Paths, scratch: str) -> _Placed:
    reasons = []
    for there in job.folders:
        store, folder = None, JobFolder(Path(there))
        if is_url(there):
            store = Store(there)
            copy = tempfile.mkdtemp(prefix="arfx-", dir=scratch)
            folder = store.get_job(Path(copy), job.rendering)
        if not folder.path.is_dir():
            reasons.append(f"job folder {there}: no such folder")
        elif folder.sealed(job.key) if job.rendering else listed(folder, job.key):
            return _Placed(job, folder, paths, store)
        else:
            reasons.append(f"{there} holds another job")
    raise RenderError("; ".join(reasons))


def work(run: str, tasks: Sequence[tuple[int, int, str]]) -> list[dict[str, Any]]:
    """Do tasks (first and last frame, name of the file) of the job that was placed here,
    as `render_chunk` or `analyse_stretch` does."""
    return [_work(_placed[run], *task) for task in tasks]


def _work(placed: _Placed, first: int, last: int, name: str) -> dict[str, Any]:
    from distributed import get_worker

    worker, job, folder, store = (
        get_worker().name,
        placed.job,
        placed.folder,
        placed.store,
    )
    do: Work = render_chunk
    target = folder.chunks / name
    if not job.rendering:
        do, target = analyse_stretch, folder.stretches / name
    try:
        result = do(
            str(folder.path),
            job.key,
            first,
            last,
            str(target),
            lambda: None,
            paths=placed.paths,
        )
        if store is not None:
            _hand_over(store, folder, target.with_name(result["file"]), result)
        return {**result, "worker": str(worker)}
    except ArfxError as e:
        failed = type(e)(
            f"{e.message} (on worker {worker}, {socket.gethostname()})", e.hint
        )
    # raised here, it has no context: Dask would send that too, and FFmpeg's errors cannot be
    raise failed


def _hand_over(
    store: Store, folder: JobFolder, file: Path, result: dict[str, Any]
) -> None:
    """A chunk's previews, then the file, into the store."""
    for index in range(result["first"], result["last"] + 1):
        for path in folder.previews.glob(f"{index:06d}.*"):
            store.put(path, f"previews/{path.name}")
            path.unlink()
    store.put(file, f"{file.parent.name}/{file.name}")
    remove_output(file)
