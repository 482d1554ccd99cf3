"""A whole job where the system lacks what only some have: no `resource`, no `fcntl`, no
affinity, no /proc, no POSIX signals.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.conftest import Material, Run

pytestmark = pytest.mark.process
# Read by Python as it starts, in workers too. Other libraries are those of this system:
# they may import what they like.
LACKING = """
import builtins, io, os, signal
ordinary = builtins.__import__
def lacking(name, globals=None, *args, **named):
    if name in ("resource", "fcntl", "pwd", "grp", "termios") and (globals or {}).get("__name__", "").startswith("arfx"):
        raise ModuleNotFoundError(name)
    return ordinary(name, globals, *args, **named)
builtins.__import__ = lacking
for module, names in (
    (os, ("sched_getaffinity", "geteuid", "getuid", "getloadavg", "O_NOFOLLOW", "link")),
    (signal, ("SIGHUP", "SIGKILL", "pthread_sigmask", "setitimer")),
):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
def hiding(real):
    def call(path, *args, **named):
        if isinstance(path, (str, os.PathLike)) and os.fspath(path).startswith(("/proc", "/sys/")):
            raise FileNotFoundError(2, "hidden", os.fspath(path))
        return real(path, *args, **named)
    return call
builtins.open = io.open = hiding(open)
for name in ("open", "stat", "listdir", "scandir"):
    setattr(os, name, hiding(getattr(os, name)))
"""


@pytest.fixture
def lacking(tmp_path: Path) -> dict[str, str]:
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(LACKING)
    return {
        "PYTHONPATH": os.pathsep.join(
            [str(tmp_path / "site"), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
    }


def test_a_job_on_a_system_that_lacks_what_others_have(
    material: Material, arfx: Run, tmp_path: Path, lacking: dict[str, str]
) -> None:
    r = arfx(
        *material.arguments(
            "-o", "out.mp4", "--end", "1.1", "--workers", "2", "--json"
        ),
        env=lacking,
    )
    assert r.code == 0 and "Traceback" not in r.err, r.err
    assert (tmp_path / "out.mp4").exists() and r.json["timing"]["peak_rss_mb"] >= 0


def test_doctor_there(arfx: Run, lacking: dict[str, str]) -> None:
    r = arfx("doctor", "--json", env=lacking)
    assert "Traceback" not in r.err and "arfx failed" not in r.err and r.code == 0, (
        r.err + r.out
    )
    assert {"cores", "disk"} <= {c["name"] for c in r.json["checks"]}
