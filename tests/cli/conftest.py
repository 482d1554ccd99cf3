from __future__ import annotations

import contextlib
import gc
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from arfx.run import schedule
from arfx_cli.main import main
from tests.clips import MARKER, write_camera, write_clip, write_model

FRAMES = 36
SHORTEST_CHUNK = (
    15  # so there are three: of jobs in this process and of `at_a_moment`
)


@dataclass
class Material:
    folder: Path
    clip: Path
    camera: Path
    model: Path

    def arguments(self, *more: str, clip: Path | None = None) -> list[str]:
        return [
            "process", str(clip or self.clip), "--camera", str(self.camera), "--marker", str(MARKER),
            "--model", str(self.model), "--fit", "8cm", *more,
        ]  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def short_chunks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule, "SHORTEST", SHORTEST_CHUNK)
        yield


@pytest.fixture(scope="session")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    d = tmp_path_factory.mktemp("material")
    return Material(
        d,
        write_clip(d / "clip.mp4", FRAMES, audio=True),
        write_camera(d / "camera.yaml"),
        write_model(d / "model.glb"),
    )


@dataclass
class Result:
    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


Run = Callable[..., Result]


def at_a_moment(
    folder: Path,
    phase: str,
    call: int | str,
    number: int,
    arguments: list[str],
    group: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Runs the command in `folder` and a session of its own; at the call of the progress of
    `phase` with this number, from 1, it sends the signal to itself, or to all of its
    processes. Returns when none of them is left that holds standard error."""
    command = [
        sys.executable,
        str(Path(__file__).with_name("at_a_moment.py")),
        phase,
        str(call),
        str(int(number)),
    ]
    return subprocess.run(
        [*command, "group" if group else "self", *arguments], cwd=folder, capture_output=True, text=True, check=False,
        timeout=300, start_new_session=True,
    )  # fmt: skip


@pytest.fixture
def arfx(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Run:
    """Runs the command in this process, or, with `apart` or an environment of its own, in
    one that it has to itself.

    A process of its own takes seconds to import everything: for what is about processes,
    and once for each kind of job."""

    def run(
        *args: str,
        cwd: Path | None = None,
        env: dict[str, str] | None = None,
        apart: bool = False,
    ) -> Result:
        if not (apart or env):
            return here(list(args), cwd or tmp_path)
        p = subprocess.run(
            [sys.executable, "-m", "arfx_cli", *args], cwd=cwd or tmp_path, capture_output=True, text=True,
            env={**os.environ, **(env or {})}, check=False, timeout=300,
        )  # fmt: skip
        return Result(p.returncode, p.stdout, p.stderr)

    def here(args: list[str], cwd: Path) -> Result:
        collections = gc.get_threshold()
        capfd.readouterr()
        try:
            with contextlib.chdir(cwd), pytest.raises(SystemExit) as done:
                main(args)
        finally:
            gc.set_threshold(*collections)
        code = done.value.code
        return Result(
            code if isinstance(code, int) else int(code is not None),
            *capfd.readouterr(),
        )

    return run
