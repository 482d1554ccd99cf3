"""What runs on a worker of a cluster: it says who it is, finds what the job reads, analyses
stretches and renders chunks.

What it is sent are places, digests and numbers of frames; what it returns are names and
times. It tells how far it is by events, and leaves a chunk of which nobody wants the result
any more."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arfx.core.parallel import ONE_THREAD
from arfx.errors import ArfxError, RenderError
from arfx.media.writer import remove_output
from arfx.run.cluster.agreement import PROCESSOR, STAGE, differences, environment
from arfx.run.cluster.files import Bundle, find
from arfx.run.cluster.paths import is_url
from arfx.run.cluster.store import Store
from arfx.run.folder import JobFolder, content_digest
from arfx.run.lock import HOLDER
from arfx.run.stretches import analyse_stretch, listed
from arfx.run.times import CHUNK, STRETCH
from arfx.run.worker import Paths, render_chunk

TELL_S = 0.5  # between two events of a chunk or stretch


@dataclass(frozen=True)
class JobReference:
    """What a worker has to know of a run of a job.

    run : names it, and the topic of its events;  key : of the job, or of its analysis;
    work : CHUNK or STRETCH
    folders : places of the job folder (`paths.places`), and of a store, if there is one;
    holder : digest of its lock's file
    """

    run: str
    key: str
    work: str
    folders: tuple[str, ...]
    holder: str
    bundles: tuple[Bundle, ...]


@dataclass(frozen=True)
class _Placed:
    """A job as this worker sees it.

    store : where its chunks go; the folder is a copy then, to be removed
    """

    key: str
    folder: JobFolder
    paths: Paths
    work: str = CHUNK
    store: Store | None = None


_MOST = 8  # jobs that a worker keeps in mind
_placed: dict[str, _Placed] = {}  # by run


def examine(here: Mapping[str, str], job: JobReference | None) -> dict[str, str]:
    """{name, host, refused}.

    refused : why this worker can do nothing for a process with the environment `here`, "" =
    it can.
    """
    import cv2

    cv2.setNumThreads(1)
    for variable, one in ONE_THREAD.items():
        os.environ.setdefault(variable, one)
    plugins = tuple(name.removeprefix(STAGE) for name in here if name.startswith(STAGE))
    refused = ", ".join(differences(here, environment(plugins, PROCESSOR in here)))
    if job is not None and not refused:
        refused = _place(job)
    return {"name": str(_worker().name), "host": socket.gethostname(), "refused": refused}


def _place(job: JobReference) -> str:
    """Find all that the job reads. Returns why this worker cannot see it; "" where it can."""
    try:
        paths = tuple((b.section, b.key, str(find(b))) for b in job.bundles)
        _placed[job.run] = _folder(job, paths)
    except ArfxError as e:
        return e.message
    except OSError as e:
        return f"{e.filename or 'a file'}: {e.strerror or e}"
    for run in [*_placed][:-_MOST]:
        old = _placed.pop(run)
        if old.store is not None:
            shutil.rmtree(old.folder.path, ignore_errors=True)
    return ""


def _folder(job: JobReference, paths: Paths) -> _Placed:
    reasons = []
    for there in job.folders:
        if is_url(there):
            scratch = Path(tempfile.mkdtemp(prefix="arfx-", dir=_worker().local_directory))
            folder = Store(there).get_job(scratch, job.work)
            if _holds(folder, job):
                return _Placed(job.key, folder, paths, job.work, Store(there))
            reasons.append(f"{there} holds another job")
        else:
            folder = JobFolder(Path(there))
            if not folder.path.is_dir():
                reasons.append(f"job folder {there}: no such folder")
            elif not _holds(folder, job) or job.holder != holder(folder):
                reasons.append(f"{there} is not the job folder, but a copy or another one")
            else:
                return _Placed(job.key, folder, paths, job.work)
    raise RenderError("; ".join(reasons))


def _holds(folder: JobFolder, job: JobReference) -> bool:
    """Whether what the work needs is there, of this job."""
    return folder.sealed(job.key) if job.work == CHUNK else listed(folder, job.key)


def holder(folder: JobFolder) -> str:
    """Tells the folder that a job has locked from copies of it; "" where the disk was too
    full for that.
    """
    with contextlib.suppress(OSError):
        return content_digest(folder.path / HOLDER)
    return ""


class UnwantedError(Exception):
    """Raised to leave a chunk or stretch."""


def work(run: str, first: int, last: int, name: str) -> None:
    """Do a task of the job that was placed here, as `render_chunk` or `analyse_stretch`
    does; its file goes into the job folder.

    The result is an event too: the scheduler has it then, while what a call returns would
    have to be asked of this worker."""
    worker = _worker()
    token, placed = worker.get_current_task(), _placed[run]
    done, told = 0, time.monotonic()

    def tick() -> None:
        nonlocal done, told
        done += 1
        if time.monotonic() - told > TELL_S:
            told = time.monotonic()
            task = worker.state.tasks.get(token)
            if task is None or task.state == "cancelled" or worker.status.name != "running":
                raise UnwantedError
            worker.log_event(run, {"attempt": token, "frames": done})

    folder, failed = placed.folder, None
    try:
        do, files = (
            (analyse_stretch, folder.stretches)
            if placed.work == STRETCH
            else (render_chunk, folder.chunks)
        )
        result = do(
            str(folder.path),
            placed.key,
            first,
            last,
            str(files / name),
            tick,
            paths=placed.paths,
        )
        if placed.store is not None:
            _hand_over(placed.store, folder, files / result["file"], result)
    except ArfxError as e:
        failed = type(e)(
            f"{e.message} (on worker {worker.name}, {socket.gethostname()})", e.hint
        )
    finally:
        worker.log_event(run, {"attempt": token, "ended": True})
    if (
        failed is not None
        # raised here, it has no context: Dask would send that too, and FFmpeg's errors cannot
        # be sent
    ):
        raise failed
    worker.log_event(
        run, {"attempt": token, "result": {**result, "worker": str(worker.name)}}
    )


def _hand_over(store: Store, folder: JobFolder, file: Path, result: dict[str, Any]) -> None:
    """A chunk's previews, then the file, into the store; there the names of all end with
    the digest of the content.
    """
    for index in range(result["first"], result["last"] + 1):
        for path in folder.previews.glob(f"{index:06d}.*"):
            store.put(path, f"previews/{path.name}")
            path.unlink()
    more = f".{content_digest(file)}" if file.parent == folder.stretches else ""
    store.put(file, f"{file.parent.name}/{file.name}{more}")
    remove_output(file)


def _worker() -> Any:
    from distributed import get_worker

    return get_worker()
