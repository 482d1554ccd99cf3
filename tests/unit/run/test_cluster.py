"""What is said on the command line of a cluster, where its workers look for files, and who
gets which chunk.
"""

from __future__ import annotations

import functools
import http.server
import pickle
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import pytest

from arfx.core.machine import usable_cores
from arfx.errors import ConfigError, InputError, RenderError
from arfx.media.frames import FrameTimesError
from arfx.run import schedule
from arfx.run.cluster import remote
from arfx.run.cluster.files import Bundle, Part, find
from arfx.run.cluster.spec import ClusterSpec, PathMap, places
from arfx.run.cluster.start import open_cluster
from arfx.run.folder import _CHUNK, JobFolder, file_digest
from arfx.run.times import ANALYSIS, CHUNK, STRETCH, WorkLog
from arfx.run.worker import process_name


def test_clusters_by_name(tmp_path: Path) -> None:
    assert ClusterSpec.parse("local") == ClusterSpec("local", workers=usable_cores())
    assert ClusterSpec.parse("local:3").workers == 3
    assert ClusterSpec.parse("tls://[::1]:8786").address == "tls://[::1]:8786"
    (tmp_path / "slurm.toml").write_text(
        'jobs = 3\ncores = 8\nprocesses = 4\nmemory = "8GB"\nqueue = "q"\n'
    )
    slurm = ClusterSpec.parse(f"slurm:{tmp_path / 'slurm.toml'}")
    assert slurm.workers == 24 and slurm.settings["queue"] == "q"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "local:",
        "local:0",
        "local:-1",
        "tcp://host",
        "tcp://:1",
        "http://a:1",
        "slurm:",
        "tcp://a b:1",
    ],
)
def test_what_is_no_cluster(text: str) -> None:
    with pytest.raises(ConfigError, match="is no cluster"):
        ClusterSpec.parse(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cores = 1", "memory is not said"), ('cores = "1"\nmemory = "1GB"', "cores is '1'"), ("cores = true", "cores is True"),
        ("cores = 1\nprocesses = 0", "processes is 0"), ("cores = [", "not valid TOML"),
    ],
)  # fmt: skip
def test_settings_of_slurm_that_are_wrong(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "slurm.toml").write_text(text)
    with pytest.raises(ConfigError, match=message):
        ClusterSpec.parse(f"slurm:{tmp_path / 'slurm.toml'}")
    with pytest.raises(InputError):
        ClusterSpec.parse(f"slurm:{tmp_path}")


@pytest.mark.parametrize("missing", ["dask", "distributed"])
def test_without_the_extra_it_is_said_what_to_install(
    missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with (
        pytest.raises(ConfigError, match=f"needs {missing}") as said,
        open_cluster(ClusterSpec.parse("local:1"), (), print),
    ):
        pass
    assert (
        "pip install 'arfx[cluster]'" in said.value.hint and said.value.exit_code == 2
    )


def test_slurm_that_is_not_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "slurm.toml").write_text('cores = 1\nmemory = "1GB"')
    monkeypatch.setenv("PATH", str(tmp_path))
    with (
        pytest.raises(ConfigError, match="there is no sbatch here"),
        open_cluster(
            ClusterSpec.parse(f"slurm:{tmp_path / 'slurm.toml'}"), (), print
        ),
    ):
        pass


def test_paths_are_mapped() -> None:
    maps = [
        PathMap.parse(text)
        for text in (
            "/a=/x",
            "/a/b=s3://bucket/b",
            "/a/b=/y/",
            "/a/b/one file=http://h/f",
        )
    ]
    assert places(Path("/a/b/c/d.mp4"), maps) == (
        "/y/c/d.mp4",
        "/x/b/c/d.mp4",
        "/a/b/c/d.mp4",
        "s3://bucket/b/c/d.mp4",
    )
    assert places(Path("/a/b/one file"), maps)[-2:] == (
        "http://h/f",
        "s3://bucket/b/one file",
    )
    assert places(Path("/ab"), maps) == ("/ab",)
    assert (
        PathMap.parse("/a=http://h/x").of(Path("/a/100% #1.mp4"))
        == "http://h/x/100%25%20%231.mp4"
    )
    assert PathMap.parse("b=/x").here == Path.cwd() / "b"


@pytest.mark.parametrize("text", ["", "a", "=", "a=", "=/b", "a=b"])
def test_what_maps_nothing(text: str) -> None:
    with pytest.raises(ConfigError, match="--map-path"):
        PathMap.parse(text)


def of(*paths: Path, at: tuple[str, ...]) -> Bundle:
    parts = [
        Part(
            "" if p is paths[0] else p.relative_to(paths[0].parent).as_posix(),
            p.stat().st_size,
            file_digest(p),
        )
        for p in paths
    ]
    return Bundle("model", "file", at, False, tuple(parts))


@pytest.fixture
def model(tmp_path: Path) -> tuple[Path, Path]:
    (tmp_path / "here" / "textures").mkdir(parents=True)
    main, texture = (
        tmp_path / "here" / "a model.obj",
        tmp_path / "here" / "textures" / "wood #1.png",
    )
    main.write_bytes(b"model")
    texture.write_bytes(b"wood")
    return main, texture


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[str, list[str]]]:
    """Address of a web server of the folder `here`, and what it was asked for."""
    asked: list[str] = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            asked.append(self.path)

    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Handler, directory=str(tmp_path / "here"))
    ) as server:
        threading.Thread(
            target=server.serve_forever, args=(0.02,), daemon=True
        ).start()
        yield f"http://127.0.0.1:{server.server_port}", asked
        server.shutdown()


def test_a_file_is_fetched_once(
    model: tuple[Path, Path],
    served: tuple[str, list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With all that it refers to; what the cache holds is compared too."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    address, asked = served
    bundle = of(
        *model,
        at=(
            "/nowhere/a model.obj",
            PathMap(model[0].parent, address).of(model[0]) or "",
        ),
    )
    path = find(bundle)
    assert path.is_relative_to(tmp_path / "cache") and path.read_bytes() == b"model"
    assert (path.parent / "textures" / "wood #1.png").read_bytes() == b"wood"
    fetched = len(asked)
    assert fetched and find(bundle) == path and len(asked) == fetched
    path.write_bytes(b"MODEL")  # damaged
    assert find(bundle).read_bytes() == b"model" and len(asked) > fetched
    assert [p.name for p in (tmp_path / "cache" / "arfx" / "files").iterdir()] == [
        path.parent.name
    ]


def test_other_content_is_another_file(
    model: tuple[Path, Path],
    served: tuple[str, list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    bundle = of(
        *model,
        at=(
            str(model[0]),
            f"{served[0]}/a%20model.obj",
            f"{served[0]}/none",
            "nothing://x",
        ),
    )
    assert find(bundle) == model[0]
    model[1].write_bytes(b"iron")
    with pytest.raises(
        RenderError,
        match=(
            r"wood #1.png has other content; what lies at http.* is another file; .*none"
            r" cannot be fetched"
        ),
    ):
        find(bundle)
    model[1].write_bytes(b"wooden")
    with pytest.raises(RenderError, match="has another size"):
        find(bundle)
    assert not [*(tmp_path / "cache" / "arfx" / "files").iterdir()]


def test_names_of_unfinished_files_are_arfxs_own() -> None:
    import re

    assert re.fullmatch(
        _CHUNK, f"{process_name()}-140-000000-000029.0123456789abcdef.nut.part"
    )
    assert not re.fullmatch(
        _CHUNK, "my-notes-000000-000029.0123456789abcdef.nut.part"
    )


def test_the_time_of_each_worker(tmp_path: Path) -> None:
    log = WorkLog(tmp_path / "timings.jsonl")
    for key, name, first, last in (
        ("a", "1", 0, 29),
        ("b", "2", 30, 59),
        ("c", "1", 60, 65),
    ):
        log.note(
            CHUNK,
            key,
            {"decode": 1.0},
            stages={"raster": 2.0},
            worker=name,
            host="h",
            first=first,
            last=last,
        )
    log.note(
        CHUNK, "c", {"decode": 1.0}, worker=1, host="h", first=0, last=1
    )  # damaged
    for name in ("s", "made otherwise later"):
        log.note(
            STRETCH, name, {"analyse": 4.0}, worker="2", host="h", first=0, last=59
        )
    log.note(ANALYSIS, "facts", {"analyse": 0.5}, stretches=["s"])
    spent = log.spent("facts", "abc")
    assert spent.workers == [
        {
            "name": "2",
            "host": "h",
            "stretches": 1,
            "chunks": 1,
            "frames": 30,
            "seconds": 7.0,
        },
        {
            "name": "1",
            "host": "h",
            "stretches": 0,
            "chunks": 2,
            "frames": 36,
            "seconds": 6.0,
        },
    ]
    assert spent.seconds["analyse"] == 4.5
    log.note(ANALYSIS, "facts", {"analyse": 5.0}, stretches=[["s"]])  # damaged
    assert log.spent("facts", "abc").seconds["analyse"] == 4.5


def reference(work: str = CHUNK) -> remote.JobReference:
    return remote.JobReference("run", "key", work == CHUNK, (), ())


def test_a_full_disk_on_a_worker_ends_the_job_with_its_own_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask sends what an error was raised from too, and gives up the error where that
    cannot be sent, as FFmpeg's cannot.
    """
    from distributed.core import clean_exception, error_message

    def render_chunk(*arguments: Any, paths: Any) -> dict[str, Any]:
        try:
            raise av.error.OSError(28, "No space left on device", "file")
        except OSError as e:
            raise RenderError(
                f"cannot be written: {e.strerror}", "free space"
            ) from None

    monkeypatch.setattr("distributed.get_worker", lambda: SimpleNamespace(name="w"))
    monkeypatch.setattr(remote, "render_chunk", render_chunk)
    monkeypatch.setitem(
        remote._placed, "run", remote._Placed(reference(), JobFolder(tmp_path), ())
    )
    with pytest.raises(RenderError, match="No space left on device") as raised:
        remote.work("run", [schedule.FrameRange(0, 29)])
    sent = error_message(raised.value)
    arrived = clean_exception(pickle.loads(sent["exception"].data))[1]
    assert (
        isinstance(arrived, RenderError)
        and arrived.message == raised.value.message
        and arrived.hint == "free space"
    )


def test_what_ends_a_stretch_says_the_same_from_a_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where times of frames go back, the clip is analysed in one piece."""

    def analyse_stretch(*arguments: Any, paths: Any) -> dict[str, Any]:
        raise FrameTimesError("frame times go backwards")

    monkeypatch.setattr("distributed.get_worker", lambda: SimpleNamespace(name="w"))
    monkeypatch.setattr(remote, "analyse_stretch", analyse_stretch)
    monkeypatch.setitem(
        remote._placed,
        "run",
        remote._Placed(reference(STRETCH), JobFolder(tmp_path), ()),
    )
    with pytest.raises(FrameTimesError, match=r"backwards \(on worker w"):
        remote.work("run", [schedule.FrameRange(0, 29)])
