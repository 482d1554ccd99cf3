"""Whole jobs on a Dask cluster: the same bytes, whoever dies; and nothing is left running."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import psutil
import pytest

from arfx.config.load import load
from arfx.config.sections import JobConfig
from arfx.errors import RenderError
from arfx.run import job as jobs
from arfx.run import stretches
from arfx.run.cluster import files, pool, start
from arfx.run.cluster.agreement import OPENGL, OPENS, differences, environment
from arfx.run.cluster.spec import ClusterSpec, PathMap
from arfx.run.cluster.start import Cluster
from arfx.run.executors import Task
from arfx.run.folder import JobFolder, content_digest
from arfx.run.inputs import open_inputs
from arfx.run.job import Options, plan_job
from arfx.run.lock import locked
from arfx.run.parameters import parameters
from arfx.run.planned import Job
from arfx.run.schedule import find_chunk
from arfx.run.times import Row
from arfx.stages.raster import gl_context
from tests.cli.conftest import FRAMES, Material, Run, at_a_moment
from tests.cli.farm import Farm, farm
from tests.clips import MARKER, print_of, write_clip

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def running() -> Iterator[Farm]:
    with farm(2) as f:
        yield f


def config_of(material: Material, output: Path, **more: Any) -> JobConfig:
    return load(None, {
        "input": {"clip": str(material.clip), "camera": str(material.camera)}, "marker": [{"spec": str(MARKER)}],
        "model": {"file": str(material.model), "fit": "8cm"}, "output": {"path": str(output), "codec": "ffv1"}, **more,
    }, parameters())  # fmt: skip


@pytest.fixture(scope="module")
def planned(
    material: Material, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Job]:
    """A job up to where rendering begins, in a folder that is locked."""
    d = tmp_path_factory.mktemp("planned")
    config, folder = config_of(material, d / "out.mkv"), JobFolder(d / "job")
    with locked(folder.path, "--job"):
        folder.open(resume=False)
        yield plan_job(open_inputs(config), folder, Options(notice=lambda _: None))


@pytest.fixture(scope="module")
def serial(planned: Job) -> dict[int, str]:
    """First frame -> digest of each chunk's content, as this process renders them."""
    return rendered(planned, None)


def rendered(
    job: Job, cluster: Cluster | None, at: Callable[[int], object] = lambda done: None
) -> dict[int, str]:
    """Render all chunks anew. at : called with the frames done"""
    job.folder.clear("chunks/")
    start = 0

    def progress(phase: str, done: int, total: int | None) -> None:
        at(done - start)

    files = jobs._render(job, Options(workers=1, progress=progress, cluster=cluster))
    return {int(f.name.split("-")[0]): content_digest(f) for f in files}


@contextlib.contextmanager
def connected(
    farm: Farm, *maps: str, notice: Callable[[str], None] = lambda _: None
) -> Iterator[tuple[Any, Cluster]]:
    from distributed import Client

    with start._silence(), Client(farm.address, set_as_default=False) as client:
        client.wait_for_workers(1)  # those that a test has killed are started again
        spec = ClusterSpec.parse(farm.address)
        yield client, Cluster(client, spec, tuple(map(PathMap.parse, maps)), notice)


def once(
    action: Callable[[], object], ready: Callable[[int], object] = bool
) -> Callable[[int], None]:
    """Does something, once. ready : whether now, by the frames that are done"""
    left = [action]

    def at(done: int) -> None:
        if left and ready(done):
            left.pop()()

    return at


def kill_at_work(
    job: Job, at_work: int, pids: Sequence[int]
) -> Callable[[int], None]:
    """Ends the processes as soon as one of them is rendering a chunk."""

    def kill() -> None:
        for pid in pids:
            os.kill(pid, signal.SIGKILL)

    return once(kill, lambda _: [*job.folder.chunks.glob(f"*-{at_work}-*")])


def test_a_running_cluster_gives_the_same_bytes(
    running: Farm, planned: Job, serial: dict[int, str]
) -> None:
    with connected(running) as (_, cluster):
        assert rendered(planned, cluster) == serial
    rows = [r for r in planned.log.rows() if r.work == "chunk"][-3:]
    assert all(r.worker and r.host for r in rows)


def test_a_killed_worker_costs_its_chunk_only(
    running: Farm, planned: Job, serial: dict[int, str]
) -> None:
    with connected(running) as (client, cluster):
        pids = list(client.run(os.getpid).values())
        kill = kill_at_work(planned, pids[0], pids[:1])
        assert rendered(planned, cluster, kill) == serial


def test_a_chunk_that_is_lost_with_too_many_workers_is_named(planned: Job) -> None:
    """As many as Dask allows: this one was started to allow none."""
    with farm(2, allowed_failures=0) as own, connected(own) as (client, cluster):
        client.wait_for_workers(2)
        pids = list(client.run(os.getpid).values())
        with pytest.raises(
            RenderError, match=r"frames \d+–\d+: too many workers were lost"
        ):
            rendered(planned, cluster, kill_at_work(planned, pids[0], pids))


def test_a_worker_that_differs_gets_no_work(
    running: Farm, planned: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = start.environment()
    monkeypatch.setattr(
        start,
        "environment",
        lambda: {**here, "numpy": "0.1", "arfx's code": "another"},
    )
    with pytest.raises(RenderError) as refused, connected(running):
        pass
    for name, other in (("numpy", "0.1"), ("arfx's code", "another")):
        assert f"{name} is {here[name]}, here {other}" in refused.value.message


def test_a_worker_without_opengl_gets_no_work_of_a_job_that_needs_it(
    running: Farm, planned: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = planned.inputs.config.params
    by_opengl = params["raster"].model_copy(update={"backend": "pyrender"})
    config = planned.inputs.config.model_copy(update={"raster": by_opengl})
    job = replace(planned, inputs=replace(planned.inputs, config=config))
    monkeypatch.setattr(
        start, "OPENS", "opens on a graphics card"
    )  # as no worker says
    with (
        connected(running) as (_, cluster),
        pytest.raises(
            RenderError, match=r"OpenGL is .*, here opens on a graphics card"
        ),
    ):
        rendered(job, cluster)


def test_why_opengl_does_not_open(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise RenderError(
            "no OpenGL context opens here (egl: libEGL.so.1 is not installed)"
        )

    monkeypatch.setattr(gl_context, "open_context", fails)
    here = environment() | {OPENGL: OPENS}
    (why,) = differences(here, environment(opengl=True))
    assert why.startswith("OpenGL is no OpenGL context opens here (egl:")


@pytest.fixture
def mapped_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on another machine: what is mapped is not seen at its path here."""

    def elsewhere(path: Path, maps: Sequence[PathMap]) -> tuple[str, ...]:
        return tuple(there for m in maps if (there := m.of(path)) is not None) or (
            str(path),
        )

    for module in (start, files):
        monkeypatch.setattr(module, "places", elsewhere)


@pytest.mark.usefixtures("mapped_only")
def test_a_worker_that_sees_another_clip_gets_no_work(
    running: Farm, planned: Job, material: Material, tmp_path: Path
) -> None:
    """Of the same size: the content counts."""
    clip = tmp_path / material.clip.name
    clip.write_bytes(bytes(material.clip.stat().st_size))
    told: list[str] = []
    maps = f"{material.clip}={clip}"
    with (
        connected(running, maps, notice=told.append) as (_, cluster),
        pytest.raises(RenderError, match="has other content"),
    ):
        rendered(planned, cluster)
    assert any("gets no work: " in message for message in told)


@pytest.mark.usefixtures("mapped_only")
def test_other_mount_points_are_mapped(
    running: Farm,
    planned: Job,
    serial: dict[int, str],
    material: Material,
    tmp_path: Path,
) -> None:
    for name, path in (("job", planned.folder.path), ("clips", material.folder)):
        (tmp_path / name).symlink_to(path)
    maps = (
        f"{planned.folder.path}={tmp_path / 'job'}",
        f"{material.folder}={tmp_path / 'clips'}",
    )
    with connected(running, *maps) as (_, cluster):
        assert rendered(planned, cluster) == serial


@pytest.mark.usefixtures("mapped_only")
def test_a_copy_of_the_job_folder_is_not_the_job_folder(
    running: Farm, planned: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "ARRIVE_S", 0.5)
    planned.folder.clear("chunks/")
    maps = f"{planned.folder.path}={shutil.copytree(planned.folder.path, tmp_path / 'job')}"
    with (
        connected(running, maps) as (_, cluster),
        pytest.raises(
            RenderError, match=r"a worker has written .*, and it is not in"
        ),
    ):
        rendered(planned, cluster)


@pytest.mark.usefixtures("mapped_only")
def test_workers_that_do_not_see_the_job_folder_use_a_store(
    running: Farm, planned: Job, serial: dict[int, str], tmp_path: Path
) -> None:
    store, seen = tmp_path / "store", set[str]()
    planned.folder.clear("previews/")
    with connected(running, f"{planned.folder.path}=file://{store}") as (_, cluster):
        assert (
            rendered(
                planned,
                cluster,
                once(lambda: seen.update(p.name for p in store.rglob("*"))),
            )
            == serial
        )
    assert "facts.jsonl" in seen and not [*store.rglob("*")], (
        "what was put there is gone"
    )
    previews = [*planned.folder.previews.iterdir()]
    assert len(previews) == len(planned.analysed.previews)


FACTS = "facts.jsonl", "frames.json", "environment.maps"


@pytest.fixture(scope="module")
def cut_clip(
    material: Material, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[JobConfig]:
    """A job whose clip has six stretches.

    Its marker is a print to it as well, which only the analysis reads.
    """
    d = tmp_path_factory.mktemp("cut")
    clip = write_clip(d / "clip.mov", 48, codec="mjpeg", pixel_format="yuvj420p")
    cv2.imwrite(str(d / "print.png"), print_of(160, 24))
    config = config_of(
        Material(d, clip, material.camera, material.model),
        d / "out.mkv",
        pattern=[{"spec": f"{d}/print.png:13cm"}],
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stretches, "LEAST_FRAMES", 8)
        yield config


@contextlib.contextmanager
def analysed(
    config: JobConfig, folder: Path, cluster: Any = None
) -> Iterator[tuple[Job, list[bytes], list[Row]]]:
    """(the job, what was found, rows of its stretches in timings.jsonl), in a folder that
    is locked.
    """
    job = JobFolder(folder)
    with locked(job.path, "--job"):
        job.open(resume=False)
        options = Options(notice=lambda _: None, cluster=cluster)
        done = plan_job(open_inputs(config), job, options)
        rows = [r for r in done.log.rows() if r.work == "stretch"]
        assert len([*job.stretches.glob("*-*.*")]) == len(rows) == 6
        yield done, [(job.path / name).read_bytes() for name in FACTS], rows


@pytest.fixture(scope="module")
def found(
    cut_clip: JobConfig, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Job, list[bytes]]]:
    """As this process analyses it."""
    with analysed(cut_clip, tmp_path_factory.mktemp("found") / "job") as (
        job,
        facts,
        _,
    ):
        assert b'"print.png"' in facts[1]
        yield job, facts


def test_the_analysis_is_done_by_the_workers_too(
    running: Farm, cut_clip: JobConfig, found: tuple[Job, list[bytes]], tmp_path: Path
) -> None:
    with (
        connected(running) as (client, cluster),
        analysed(cut_clip, tmp_path / "job", cluster) as (job, facts, rows),
    ):
        assert facts == found[1] and rendered(job, cluster) == rendered(
            found[0], None
        )
        pids = client.run(os.getpid).values()
        assert all(row.pid in pids and row.worker for row in rows)
        workers = job.log.spent(job.analysis_key, ()).workers
        assert sum(w["stretches"] for w in workers) == 6 and {
            w["name"] for w in workers
        } == {row.worker for row in rows}


def test_a_worker_that_is_killed_with_a_stretch_costs_that_only(
    running: Farm,
    cut_clip: JobConfig,
    found: tuple[Job, list[bytes]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = list[str]()
    with connected(running, notice=told.append) as (client, cluster):
        pids = list(client.run(os.getpid).values())
        submit_run = pool.Pool._submit

        def submit(self: pool.Pool, run: Sequence[Task]) -> Any:
            if pids:
                os.kill(pids.pop(), signal.SIGKILL)
                pids.clear()
            return submit_run(self, run)

        monkeypatch.setattr(pool.Pool, "_submit", submit)
        with analysed(cut_clip, tmp_path / "job", cluster) as (_, facts, rows):
            assert facts == found[1] and os.getpid() not in {row.pid for row in rows}


@pytest.mark.usefixtures("mapped_only")
def test_stretches_go_through_a_store_with_all_that_they_need(
    running: Farm, cut_clip: JobConfig, found: tuple[Job, list[bytes]], tmp_path: Path
) -> None:
    """Workers see neither the job folder, nor the clip's folder with the print in it, but a
    folder that holds the clip alone.
    """
    clip, job, store = (
        Path(str(cut_clip.input.clip)),
        tmp_path / "job",
        tmp_path / "store",
    )
    (tmp_path / "clips").mkdir()
    shutil.copy(clip, tmp_path / "clips")
    seen, hidden = set[str](), clip.with_name("hidden.png")
    with connected(
        running, f"{job}=file://{store}", f"{clip.parent}={tmp_path / 'clips'}"
    ) as (_, cluster):

        def analysing(*about: Any) -> Any:
            (clip.parent / "print.png").rename(hidden)
            run = cluster.run(*about)
            return lambda *task: (
                seen.update(p.name for p in store.rglob("*")) or result
                for result in run(*task)
            )

        try:
            with analysed(
                cut_clip, job, SimpleNamespace(run=analysing, workers=2)
            ) as (
                _,
                facts,
                rows,
            ):
                assert facts == found[1] and os.getpid() not in {
                    row.pid for row in rows
                }
        finally:
            hidden.rename(clip.parent / "print.png")
    assert "inputs.json" in seen and not [*store.rglob("*")], (
        "what was put there is gone"
    )


def test_workers_with_another_processor_analyse_nothing(
    running: Farm,
    cut_clip: JobConfig,
    found: tuple[Job, list[bytes]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Libraries choose their code by it: facts might differ in their last digits. This
    machine does it then.
    """
    monkeypatch.setattr(
        "arfx.run.cluster.agreement.processor_name", lambda: "another"
    )
    told = list[str]()
    with (
        connected(running, notice=told.append) as (_, cluster),
        analysed(cut_clip, tmp_path / "job", cluster) as (_, facts, rows),
    ):
        assert facts == found[1] and {row.pid for row in rows} == {os.getpid()}
    assert (
        len(told) == 1
        and "this machine analyses the clip alone" in told[0]
        and "here another" in told[0]
    )


def test_a_lost_scheduler_ends_in_one_message(
    planned: Job, serial: dict[int, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """And what is done stays: the next run renders the rest."""
    capfd.readouterr()
    with farm(1) as own, connected(own) as (client, cluster):
        assert not logging.getLogger("distributed.client").isEnabledFor(logging.ERROR)
        pids = list(client.run(os.getpid).values())
        with pytest.raises(
            RenderError, match=r"connection to the scheduler at tcp://.* is lost"
        ):
            rendered(planned, cluster, once(own.process.kill))
    assert not capfd.readouterr().err, "Dask has nothing to add"
    assert any(
        find_chunk(planned.folder.chunks, chunk.name(planned.key), ".mkv")
        for chunk in planned.chunks
    )
    chunks = jobs._render(planned, Options(workers=1))
    assert {int(f.name.split("-")[0]): content_digest(f) for f in chunks} == serial
    ended(pids)


def ended(pids: Sequence[int]) -> None:
    """Waits until none of these processes is there."""
    for pid in pids:
        with contextlib.suppress(psutil.NoSuchProcess):
            psutil.Process(pid).wait(60)


@pytest.fixture(scope="module")
def whole(material: Material, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The output of a job without a cluster."""
    d = tmp_path_factory.mktemp("whole")
    jobs.process(config_of(material, d / "out.mkv"), Options(notice=lambda _: None))
    return (d / "out.mkv").read_bytes()


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_a_job_that_is_stopped_with_its_cluster_is_resumed(
    arfx: Run,
    material: Material,
    whole: bytes,
    tmp_path: Path,
    number: int,
    code: int,
) -> None:
    """As Ctrl-C at a terminal, which all processes see; and when there is no time for anything."""
    arguments = material.arguments("-o", "out.mkv", "--codec", "ffv1", "--job", "job")
    # two chunks of 15 frames are at work, and a third of 6 when one of them is done
    stopped = at_a_moment(
        tmp_path,
        "render",
        "+15",
        number,
        [*arguments, "--executor", "local:2"],
        number == signal.SIGINT,
    )
    assert stopped.returncode == code, stopped.stderr
    assert (tmp_path / "job").is_dir() and not (tmp_path / "out.mkv").exists()
    if number == signal.SIGINT:
        *_, error, hint = stopped.stderr.splitlines()
        assert (
            error.startswith("error: interrupted; what is done is kept in")
            and "--resume" in hint
        )
        assert "Traceback" not in stopped.stderr
    resumed = arfx(*arguments, "--resume", "--json")
    assert resumed.code == 0, resumed.err
    assert (tmp_path / "out.mkv").read_bytes() == whole


FAKE_SBATCH = """#!/bin/sh
# a Slurm that runs each job at once, here, and leaves it alone when asked to end it
echo "$@" >> {folder}/calls
cp "$1" {folder}/job.sh
setsid sh {folder}/job.sh > {folder}/log 2>&1 < /dev/null &
echo $! >> {folder}/pids
echo "Submitted batch job 42"
"""


def test_workers_are_started_by_slurm(
    arfx: Run,
    material: Material,
    whole: bytes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And end when the job does, even where Slurm itself does not end them."""
    bin = tmp_path / "bin"
    bin.mkdir()
    for name, text in (
        ("sbatch", FAKE_SBATCH.format(folder=tmp_path)),
        ("scancel", f'#!/bin/sh\necho cancel "$@" >> {tmp_path}/calls\n'),
    ):
        (bin / name).write_text(text)
        (bin / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{bin}:{os.environ['PATH']}")
    (tmp_path / "slurm.toml").write_text(
        'cores = 1\nmemory = "4GB"\ninterface = "lo"\nwalltime = "00:10:00"\n'
    )
    result = arfx(
        *material.arguments(
            "-o",
            "out.mkv",
            "--codec",
            "ffv1",
            "--executor",
            "slurm:slurm.toml",
            "--json",
        )
    )
    assert result.code == 0, result.err + (tmp_path / "log").read_text()
    us, worker = result.json["workers"]
    assert us["stretches"] == 1 and not us["chunks"], (
        "a clip of one stretch is analysed here"
    )
    assert (
        worker["frames"] == FRAMES
        and worker["chunks"] == 3
        and worker["name"].startswith("SLURMCluster-0")
    )
    assert "cancel 42" in (tmp_path / "calls").read_text()
    ended([int(pid) for pid in (tmp_path / "pids").read_text().split()])
    assert (tmp_path / "out.mkv").read_bytes() == whole


def test_workers_that_exit_at_start_are_told(
    arfx: Run, material: Material, tmp_path: Path
) -> None:
    """Red without a look at the processes: the job waits for two minutes."""
    (tmp_path / "end.py").write_text("import os\nos._exit(3)\n")
    env = {"DASK_DISTRIBUTED__WORKER__PRELOAD": repr([str(tmp_path / "end.py")])}
    done = arfx(
        *material.arguments("-o", "out.mp4", "--executor", "local:1"), env=env
    )
    assert done.code == 5 and "no worker of the local cluster starts" in done.err
