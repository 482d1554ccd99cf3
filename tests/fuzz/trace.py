"""What a case opens, starts and connects to: told by strace, under which the worker runs;
where there is none, by Python.

Compiled libraries (FFmpeg, OpenCV) hide from Python's audit events, so without strace what
they open is not seen."""

from __future__ import annotations

import codecs
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from tests.fuzz.case import Case

ROOT = Path(__file__).parents[2]
# Places of the system and of the libraries: what else lies outside a case's folder and its
# command line is none of its business.
SYSTEM = (
    *(str(p) for p in (ROOT, sys.prefix, sys.base_prefix)),
    *map(os.path.realpath, (sys.prefix, sys.base_prefix, *sysconfig.get_paths().values())),
    "/usr", "/lib", "/lib64", "/bin", "/proc", "/sys", "/var/cache/fontconfig",
    *(f"/dev/{name}" for name in ("null", "full", "urandom", "shm", "tty", "dri")),
    *(f"/etc/{name}" for name in ("ld.so.cache", "ld.so.preload", "localtime", "locale.alias", "ssl", "passwd", "group")),
    *(f"/etc/{name}" for name in ("nsswitch.conf", "mime.types", "apache2/mime.types", "httpd", "fonts", "glvnd", "drirc")),
    *(f"/etc/{name}" for name in ("machine-id", "OpenCL", "vulkan")),
    *map(os.path.expanduser, ("~/.cache", "~/.config", "~/.local", "~/.drirc")),
)  # fmt: skip
FINDERS = (
    "ldconfig",
    "ldconfig.real",
    "gcc",
    "cc",
    "ld",
    "objdump",
    "uname",
    "collect2",
)  # how ctypes finds a shared library
CALL = re.compile(
    rb"^\d+ +(?:(?P<open>openat2?|open)\((?:(?:AT_FDCWD|\d+)(?:<(?P<at>[^>]*)>)?,"
    rb' )?"(?P<path>(?:[^"\\]|\\.)*)"'
    rb'|(?P<exec>execve|execveat)\((?:[^"]*)"(?P<program>(?:[^"\\]|\\.)*)"'
    rb"|(?P<connect>connect|sendto)\(.*?sa_family=(?P<family>AF_INET6?).*?(?P<port>sin6?_port=htons\(\d+\)))"
)


@cache
def strace(log: Path | str = os.devnull) -> tuple[str, ...]:
    """The words that put a command under strace, () where that is not to be had."""
    if not shutil.which("strace"):
        return ()
    words = (
        "strace",
        "-f",
        "--seccomp-bpf",
        "-qq",
        "-y",
        "-e",
        "trace=open,openat,openat2,execve,execveat,connect,sendto",
        "-e",
        "signal=none",
    )
    works = (
        subprocess.run(
            [*words, "-o", os.devnull, sys.executable, "-c", ""],
            capture_output=True,
            check=False,
        ).returncode
        == 0
    )
    return (*words, "-A", "-o", str(log)) if works else ()


class Trace:
    def __init__(self, place: Path) -> None:
        self._log = place.with_name(f"{place.name}.strace")
        under = self._log.exists()
        self.how = (
            "strace"
            if under
            else (
                "Python alone: what FFmpeg and OpenCV open is not seen (strace is not to be"
                " had)"
            )
        )
        if not under:
            self._log.touch()
            self._log.chmod(0o666)
        self._place, self._listens = place, not under

    def clear(self) -> None:
        os.truncate(self._log, 0)

    def listen(self) -> None:
        """In a child, where there is no strace: note what Python opens, starts and connects to."""
        if not self._listens:
            return
        log = os.open(self._log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

        def hook(event: str, args: tuple[Any, ...]) -> None:
            if event == "open" and isinstance(args[0], (str, bytes)):
                told = ["open", os.path.realpath(os.fsdecode(args[0]))]
            elif event == "socket.connect" and isinstance(
                args[-1], (str, bytes)
            ):  # between processes of one machine
                return
            elif event in ("socket.connect", "socket.getaddrinfo"):
                told = [
                    "connect",
                    str(args[-1] if event == "socket.connect" else args[0]),
                ]
            elif event in (
                "subprocess.Popen",
                "os.exec",
                "os.posix_spawn",
                "os.system",
            ):
                told = ["exec", os.fsdecode(args[0])]
            else:
                return
            os.write(log, (json.dumps(told) + "\n").encode())

        sys.addaudithook(hook)

    def read(self, case: Case) -> list[tuple[str, str]]:
        """(what, which) of all that a case has no business with, each once."""
        lines = self._log.read_bytes().splitlines()
        calls = map(json.loads, lines) if self._listens else _calls(lines)
        return sorted(
            {
                (what, which)
                for what, which in calls
                if not self._may(what, which, case)
            }
        )

    def _may(self, what: str, which: str, case: Case) -> bool:
        if what == "connect":
            return False
        if what == "exec":
            python = os.path.realpath(which) == os.path.realpath(sys.executable)
            return Path(which).name in FINDERS or (
                python and (case.cold or "workers" in " ".join(case.args))
            )
        given = [
            os.path.realpath(case.folder / word.rpartition("=")[2][:4000])
            for word in case.args
            if "\0" not in word
        ]
        own = (
            str(case.folder),
            f"{case.folder}.job",
            f"{case.folder}.part",
            str(self._place / "tmp"),
            *SYSTEM,
        )
        if which.startswith(
            "/tmp/__opencv_temp."
        ):  # how OpenCV decodes a Radiance picture from memory
            return True
        return (
            which == "/dev"
            or which in given
            or any(which == p or which.startswith(p + "/") for p in own)
        )


def _calls(lines: list[bytes]) -> Iterator[tuple[str, str]]:
    own = f"{os.getpid()} ".encode()
    for line in lines:
        if line.startswith(own) or (m := CALL.match(line)) is None:
            continue
        if m["connect"]:
            yield "connect", f"{m['family'].decode()} {m['port'].decode()}"
        elif m["exec"]:
            yield "exec", _text(m["program"])
        else:
            yield (
                "open",
                os.path.realpath(Path(_text(m["at"] or b"/")) / _text(m["path"])),
            )


def _text(escaped: bytes) -> str:
    return os.fsdecode(codecs.escape_decode(escaped)[0])
