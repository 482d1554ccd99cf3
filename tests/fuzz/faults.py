"""Faults of the machine and of the user: a full disk, closed streams, folders that cannot
be written, a damaged job folder.
"""

from __future__ import annotations

import ctypes
import json
import os
import random
import resource
import signal
from collections.abc import Callable
from pathlib import Path

from tests.fuzz.case import (
    REFUSED,
    Build,
    Case,
    mutated_bytes,
    mutated_text,
    mutated_tree,
    process,
)
from tests.fuzz.kills import long_job

PIECES = (
    "job.toml",
    "inputs.json",
    "stretches",
    "seal.json",
    "placed.json",
    "frames.json",
    "facts.jsonl",
    "environment.maps",
    "plan.jsonl",
    "plan_summary.json",
    "timings.jsonl",
    "chunks",
)


def damaged_job(piece: str = "", how: str = "") -> Build:
    """A job that was killed while it rendered, and then damaged; --resume gives the same
    bytes, or refuses.
    """

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        case = long_job(folder, material)
        known = json.loads((material / "long.json").read_text())
        case.stop = (
            signal.SIGKILL,
            "event",
            rng.randint(known["placed"] // 3, known["placed"]),
        )
        name = piece or rng.choice(PIECES)
        case.between = lambda: _damage(rng, folder / "out.mp4.job" / name, how)
        case.after = [*case.args, "--resume"]
        case.codes, case.note = REFUSED, f"{name} {how}"
        return case

    return build


def _damage(rng: random.Random, path: Path, how: str) -> None:
    if path.is_dir():
        files = sorted(path.iterdir())
        if not files:
            return
        path = rng.choice(files)
    if not path.exists():
        return
    how = how or rng.choice(
        (
            "bytes",
            "bytes",
            "text",
            "tree",
            "empty",
            "gone",
            "folder",
            "pipe",
            "foreign",
        )
    )
    data = path.read_bytes()
    if how in ("gone", "folder", "pipe"):
        path.unlink()
    if how == "folder":
        path.mkdir()
    elif how == "pipe":
        os.mkfifo(path)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "foreign":
        path.write_bytes(b"[1, 2]\n")
    elif how == "text" and path.suffix in (".toml", ".json", ".jsonl"):
        path.write_text(mutated_text(rng, data.decode()), errors="replace")
    elif how == "tree" and path.suffix in (".json", ".jsonl"):
        lines = data.decode().splitlines()
        line = rng.randrange(len(lines)) if path.suffix == ".jsonl" else 0
        try:
            tree = mutated_tree(
                rng, json.loads(lines[line] if path.suffix == ".jsonl" else data)
            )
        except ValueError:  # cut off by the kill
            return
        lines = (
            [*lines[:line], json.dumps(tree), *lines[line + 1 :]]
            if path.suffix == ".jsonl"
            else [json.dumps(tree)]
        )
        path.write_text("\n".join(lines) + "\n", errors="replace")
    elif how not in ("gone", "folder", "pipe"):
        path.write_bytes(mutated_bytes(rng, data))


def closed(*descriptors: int, command: list[str] | None = None) -> Build:
    """Standard streams that are closed, as by 2>&-."""

    def start() -> None:
        for d in descriptors:
            os.close(d)

    return _started(start, command)


def full(descriptor: int, command: list[str] | None = None) -> Build:
    """A standard stream onto a full disk."""
    return _started(
        lambda: os.dup2(os.open("/dev/full", os.O_WRONLY), descriptor) and None,
        command,
    )


def broken(descriptor: int, command: list[str] | None = None) -> Build:
    """A standard stream into a pipe that nobody reads, as by | head -1."""

    def start() -> None:
        read, write = os.pipe()
        os.close(read)
        os.dup2(write, descriptor)

    return _started(start, command)


def _started(start: Callable[[], None], command: list[str] | None) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        if command is not None:
            return Case(
                folder,
                command,
                None,
                start=start,
                cold=True,
                codes=frozenset({0, 5}),
                silent=True,
            )
        args = process(folder, material)
        return Case(
            folder,
            args,
            start=start,
            cold=True,
            codes=frozenset({0, 5}),
            silent=True,
            keeps=True,
        )

    return build


def small_disk(rng: random.Random, folder: Path, material: Path) -> Case:
    """A file system that is full after so many bytes: as root a real one, else a limit on
    the size of a file.
    """
    size = rng.choice((0, 4096, 16384, 30000, 60000, 100000))
    named = {
        k: str(material / v)
        for k, v in (
            ("clip", "clip.mp4"),
            ("camera", "camera.yaml"),
            ("model", "model.glb"),
        )
    }
    args = process(folder, material, **named, o="disk/out.mp4")
    (folder / "disk").mkdir()

    def start() -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        if (
            libc.unshare(0x20000) == 0
        ):  # CLONE_NEWNS: the mount is this child's alone, and goes with it
            libc.mount(b"none", b"/", None, 0x44000, None)  # MS_REC | MS_PRIVATE
            if (
                libc.mount(
                    b"tmpfs",
                    os.fsencode(folder / "disk"),
                    b"tmpfs",
                    0,
                    f"size={max(size, 4096)}".encode(),
                )
                == 0
            ):
                return
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return Case(
        folder,
        args,
        None,
        frozenset({0, 2, 5}),
        start,
        keeps=True,
        note=f"{size} bytes",
        lost=True,
    )


def read_only(rng: random.Random, folder: Path, material: Path) -> Case:
    """A folder that this user may not write to."""
    args = process(folder, material, o="locked/out.mp4")
    (folder / "locked").mkdir(mode=0o555)

    def start() -> None:
        if os.getuid() == 0:
            os.setresuid(65534, 65534, 65534)

    folder.chmod(0o755)
    return Case(folder, args, "locked/out.mp4", frozenset({2, 5}), start)


def of_pieces(rng: random.Random, folder: Path, material: Path) -> Case:
    """A finished job's folder, kept with --job, damaged, then `report` or `plan` on it."""
    args = [*process(folder, material), "--job", "kept"]
    case = Case(
        folder,
        args,
        leaves=("kept", "report"),
        after=["report", "kept", "-o", "report", "--json"],
    )
    case.between = lambda: _damage(
        rng,
        folder
        / "kept"
        / rng.choice(("report.json", "timings.jsonl", "frames.json", "facts.jsonl")),
        "",
    )
    return case


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    return rng.choices((damaged_job(), small_disk, of_pieces), (6, 1, 2))[0](
        rng, folder, material
    )


SEEDS: dict[str, Build] = {
    **{
        f"{piece} {how}": damaged_job(piece, how)
        for piece in ("inputs.json", "plan.jsonl", "frames.json")
        for how in ("empty", "tree", "foreign", "folder")
    },
    "no standard input": closed(0),
    "no standard output": closed(1),
    "no standard error": closed(2),
    "no standard streams": closed(0, 1, 2),
    "full standard output": full(1),
    "full standard error": full(2),
    "nobody reads standard output": broken(1),
    "nobody reads standard error": broken(2),
    "doctor, no standard error": closed(2, command=["doctor"]),
    "doctor, nobody reads": broken(1, command=["doctor"]),
    "help, full": full(1, command=["--help"]),
    "a small disk": small_disk,
    "a locked folder": read_only,
    "report of a damaged job": of_pieces,
}  # fmt: skip
