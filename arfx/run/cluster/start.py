"""A cluster for a job: connected to, or started and stopped with it."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import logging
import shutil
import tempfile
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from arfx.core import interrupt
from arfx.core.parallel import ONE_THREAD
from arfx.errors import ConfigError
from arfx.media.writer import chunk_suffix
from arfx.run.analysis import Run
from arfx.run.cluster.agreement import OPENGL, OPENS, environment
from arfx.run.cluster.files import Store, bundles
from arfx.run.cluster.pool import Pool
from arfx.run.cluster.remote import JobReference
from arfx.run.cluster.spec import (
    ADDRESS,
    LOCAL,
    ClusterSpec,
    PathMap,
    is_url,
    library,
    places,
)
from arfx.run.executors import Done, Results, Task
from arfx.run.folder import JobFolder
from arfx.run.inputs import Inputs
from arfx.run.parameters import pipeline
from arfx.run.planned import Job
from arfx.stages import STAGES

CONNECT_S, CLOSE_S = 7, 3
_SETTINGS = {
    "distributed.worker.multiprocessing-method": "spawn",
    "distributed.worker.profile.enabled": (
        False
    ),  # it looks at every thread a hundred times a second
}


class Cluster:
    """A cluster that is there. workers : how many stretches or chunks are done at once, as
    far as that is known

    own : as of `Pool`"""

    def __init__(
        self,
        client: Any,
        spec: ClusterSpec,
        maps: Sequence[PathMap],
        notice: Callable[[str], None],
        own: Callable[[], bool] | None = None,
    ) -> None:
        self._client, self._maps, self._notice, self._own = client, maps, notice, own
        self.workers = spec.workers
        if spec.kind == ADDRESS:
            pool = Pool(client, environment(), None, notice)
            pool.look()
            pool.check()  # before any work, if none of its workers can be used
            self.workers = pool.slots or 1

    def render(self, tasks: Sequence[Task], progress: Done, job: Job) -> Results:
        """Render the tasks of a job whose folder this process holds; see `Pool.results`."""
        suffix = chunk_suffix(job.inputs.output)
        with self._pool(job.inputs, job.folder, job.key, suffix) as pool:
            yield from pool.results(tasks, progress, self.workers)

    def analysing(
        self, inputs: Inputs, folder: JobFolder, key: str, here: Run
    ) -> Run:
        """Has the stretches of a job analysed.

        Workers with another processor may not: with one that libraries choose other code
        for, facts differ in their last digits.
        key : of the analysis;  here : how this machine does it where all are refused"""

        def run(tasks: Sequence[Task], frames: int, progress: Done) -> Results:
            if len(tasks) <= 1:
                yield from here(tasks, frames, progress)
                return
            with self._pool(inputs, folder, key, None) as pool:
                pool.look()
                if why := pool.refusal():
                    self._notice(f"this machine analyses the clip alone: {why}")
                    yield from here(tasks, frames, progress)
                else:
                    yield from pool.results(tasks, progress, self.workers)

        return run

    @contextlib.contextmanager
    def _pool(
        self, inputs: Inputs, folder: JobFolder, key: str, suffix: str | None
    ) -> Iterator[Pool]:
        """Of a job that is placed where workers find it. If that is a store, the job's
        files are put there, and it is emptied when the body is done.

        key, suffix : as of `JobReference`
        """
        folders = places(folder.path.absolute(), self._maps)
        seen = [there for there in folders if not is_url(there)]
        store, rendering = None, suffix is not None
        if len(seen) < len(folders):
            store = Store(f"{folders[len(seen)].rstrip('/')}/{key}")
            store.put_job(folder, rendering)
            seen.append(store.url)
        files = bundles(inputs, self._maps, rendering)
        job = JobReference(
            f"arfx-{uuid.uuid4().hex}", key, suffix, tuple(seen), files
        )
        plugins = [name for name in pipeline(inputs.config) if name in STAGES.plugins]
        here = environment(plugins, not rendering)
        if rendering and inputs.config.params["raster"].backend == "pyrender":
            here[OPENGL] = OPENS
        try:
            yield Pool(self._client, here, job, self._notice, store, self._own)
        finally:
            if store is not None:
                store.take_previews(folder.previews)
                store.remove()


@contextlib.contextmanager
def open_cluster(
    spec: ClusterSpec | None, maps: Sequence[PathMap], notice: Callable[[str], None]
) -> Iterator[Cluster | None]:
    """The cluster, until the body ends; None where there is none to be. notice : is told
    the dashboard's address

    Raises ConfigError where the extra is not installed, or the scheduler cannot be reached.
    """
    if spec is None:
        yield None
        return
    dask, distributed = library("dask"), library("distributed")
    with contextlib.ExitStack() as stack:
        stack.enter_context(_silence())
        stack.enter_context(dask.config.set(_SETTINGS))
        address = spec.address
        if spec.kind != ADDRESS:
            scratch = tempfile.mkdtemp(prefix="arfx-")
            stack.callback(shutil.rmtree, scratch, ignore_errors=True)
            start = _start_local if spec.kind == LOCAL else _start_slurm
            cluster = start(spec, scratch)
            stack.callback(_close, cluster)
            address = cluster.scheduler_address
            if importlib.util.find_spec("bokeh") is not None:
                notice(f"dashboard: {cluster.dashboard_link}")
        try:
            if spec.kind == ADDRESS:
                asyncio.run(asyncio.wait_for(_greet(address), CONNECT_S))
            client = distributed.Client(
                address, timeout=CONNECT_S, set_as_default=False, name="arfx"
            )
        except (
            Exception
        ) as e:  # what another's server says is taken for lengths of arrays, and more
            said = f"{type(e).__name__}: {e}".splitlines()[0][:200]
            raise ConfigError(
                f"no scheduler answers at {address}: {said}",
                "`dask scheduler` starts one and says its address; --executor local needs"
                " none",
            ) from None
        stack.callback(_close, client)
        if spec.kind == ADDRESS and client.dashboard_link:
            notice(f"dashboard: {client.dashboard_link}")
        own = (lambda: _is_running(cluster)) if spec.kind == LOCAL else None
        yield Cluster(client, spec, maps, notice, own)


async def _greet(address: str) -> None:
    """Raises what distributed raises where nobody answers; a client would wait for ever for
    one who is there and silent.
    """
    from distributed.comm import connect
    from distributed.security import Security

    comm = await connect(
        address, timeout=CONNECT_S, **Security().get_connection_args("client")
    )
    comm.abort()


def _start_local(spec: ClusterSpec, scratch: str) -> Any:
    """Processes of one thread each, which end with this one; reached from this machine alone."""
    from distributed import LocalCluster

    # the threads of the cluster, and what they start, never see Ctrl-C: that is this
    # process's affair
    with interrupt.starting_workers():
        cluster = LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
            local_directory=scratch,
            silence_logs=logging.CRITICAL,
            env=ONE_THREAD,
        )
        cluster.scale(spec.workers)
    return cluster


def _start_slurm(spec: ClusterSpec, scratch: str) -> Any:
    library("dask_jobqueue")
    from dask_jobqueue import SLURMCluster

    for command in ("sbatch", "scancel"):
        if shutil.which(command) is None:
            raise ConfigError(
                f"there is no {command} here",
                "run it on a machine of the Slurm cluster that may submit jobs",
            )
    settings = {k: v for k, v in spec.settings.items() if k != "jobs"}
    settings["job_script_prologue"] = [
        *(f"export {name}={value}" for name, value in ONE_THREAD.items()),
        *settings.get("job_script_prologue", ()),
    ]
    settings.setdefault("local_directory", scratch)
    with interrupt.starting_workers():
        try:
            cluster = SLURMCluster(
                **settings, scheduler_options={"dashboard_address": ":0"}
            )
        except (ValueError, TypeError, OSError) as e:
            raise ConfigError(
                f"Slurm's settings: {str(e)[:200]}", "docs/limits.md lists them"
            ) from None
        cluster.scale(jobs=spec.settings["jobs"])
    return cluster


def _is_running(cluster: Any) -> bool:
    """Whether not all processes of a local cluster ended before they were workers."""
    workers = cluster.workers.values()
    return not workers or any(w.status.name != "failed" for w in workers)


def _close(opened: Any) -> None:
    with contextlib.suppress(Exception), interrupt.deferred():
        opened.close(timeout=CLOSE_S)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """What goes wrong is said once, in arfx's own words."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logging.disable(before)


def planned_workers(spec: ClusterSpec | None) -> int | None:
    """How many chunks would be rendered at once; None without a cluster. Starts nothing."""
    if spec is not None and spec.workers:
        return spec.workers
    with open_cluster(spec, (), lambda _: None) as cluster:
        return None if cluster is None else cluster.workers
