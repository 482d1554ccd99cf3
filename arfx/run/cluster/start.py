"""A cluster for a job: connected to, or started and stopped with it."""

import asyncio
import contextlib
import importlib.util
import logging
import shutil
import tempfile
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from arfx.core import interrupt
from arfx.core.parallel import ONE_THREAD
from arfx.errors import ConfigError, RenderError
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
from arfx.stages import STAGES

CONNECT_S, CLOSE_S = 7, 3
_SETTINGS = {
    "distributed.worker.multiprocessing-method": "spawn",
    "distributed.worker.profile.enabled": (
        False
    ),  # it looks at every thread a hundred times a second
}


@dataclass
class Cluster:
    """A cluster that is there.

    workers : how many stretches or chunks are done at once, as far as that is known"""

    client: Any
    spec: ClusterSpec
    maps: Sequence[PathMap]
    notice: Callable[[str], None]

    def __post_init__(self) -> None:
        self.workers = self.spec.workers
        if self.spec.kind == ADDRESS:
            pool = Pool(self.client, environment(), None, self.notice)
            pool.look()
            pool.check()  # before any work, if none of its workers can be used
            self.workers = pool.slots or 1

    def run(
        self,
        inputs: Inputs,
        folder: JobFolder,
        key: str,
        rendering: bool,
        here: Run,
    ) -> Run:
        """Has chunks of a job rendered whose folder this process holds, or its stretches
        analysed; see `Pool.results`.

        Workers with another processor may not analyse: with one that libraries choose other
        code for, facts differ in their last digits.
        key, rendering : as of `JobReference`;  here : how this machine analyses, where all are
        refused"""

        def run(tasks: Sequence[Task], frames: int, progress: Done) -> Results:
            if not rendering and len(tasks) <= 1:
                yield from here(tasks, frames, progress)
                return
            with self._pool(inputs, folder, key, rendering) as pool:
                pool.look()
                if not rendering and (why := pool.refusal()):
                    self.notice(f"this machine analyses the clip alone: {why}")
                    yield from here(tasks, frames, progress)
                else:
                    yield from pool.results(tasks, progress, self.workers)

        return run

    @contextlib.contextmanager
    def _pool(
        self, inputs: Inputs, folder: JobFolder, key: str, rendering: bool
    ) -> Iterator[Pool]:
        """Of a job that is placed where workers find it. If that is a store, the job's
        files are put there, and it is emptied when the body is done.

        key, rendering : as of `JobReference`
        """
        folders = places(folder.path.absolute(), self.maps)
        seen = [there for there in folders if not is_url(there)]
        store = None
        if len(seen) < len(folders):
            store = Store(f"{folders[len(seen)].rstrip('/')}/{key}")
            store.put_job(folder, rendering)
            seen.append(store.url)
        files = bundles(inputs, self.maps, rendering)
        job = JobReference(
            f"arfx-{uuid.uuid4().hex}", key, rendering, tuple(seen), files
        )
        plugins = [name for name in pipeline(inputs.config) if name in STAGES.plugins]
        here = environment(plugins, not rendering)
        if rendering and inputs.config.params["raster"].backend == "pyrender":
            here[OPENGL] = OPENS
        try:
            yield Pool(self.client, here, job, self.notice, store)
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
        yield Cluster(client, spec, maps, notice)


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
        try:
            return LocalCluster(
                n_workers=spec.workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                local_directory=scratch,
                silence_logs=logging.CRITICAL,
                env=ONE_THREAD,
            )
        except RuntimeError:
            raise RenderError(
                "no worker of the local cluster starts",
                "--workers N renders without a cluster",
            ) from None


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
