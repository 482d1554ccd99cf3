"""A Dask cluster of its own for tests, as somebody else's that runs already: `python
farm.py WORKERS ALLOWED_FAILURES` prints its address.

It ends when its standard input does."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass
class Farm:
    process: subprocess.Popen[str]
    address: str


@contextlib.contextmanager
def farm(workers: int, allowed_failures: int = 3) -> Iterator[Farm]:
    command = [
        sys.executable,
        str(Path(__file__)),
        str(workers),
        str(allowed_failures),
    ]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout
        try:
            yield Farm(process, process.stdout.readline().strip())
        finally:
            process.kill()


def main() -> None:
    import dask
    from distributed import LocalCluster
    from distributed.utils import get_mp_context

    # Tests kill workers: a new one is forked from a server that has imported what it needs,
    # which takes others seconds.
    dask.config.set(
        {
            "distributed.worker.multiprocessing-method": "forkserver",
            "distributed.scheduler.allowed-failures": int(sys.argv[2]),
        }
    )
    get_mp_context().set_forkserver_preload(
        ["arfx.run.preload", "arfx.run.cluster.remote", "distributed.nanny"]
    )
    with LocalCluster(
        n_workers=int(sys.argv[1]), threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", memory_limit=0,
        silence_logs=50,
    ) as cluster:  # fmt: skip
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
