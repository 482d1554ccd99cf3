"""`kill -9` at any moment, then --resume: the same bytes. And SIGINT, SIGTERM: never lost,
and the exit code tells the truth.

A moment is the n-th file that is opened for writing, renamed or removed, or the n-th
import, which is the same in every run, or a time, which is not."""

from __future__ import annotations

import json
import random
import shutil
import signal
from pathlib import Path

from tests.fuzz.case import Build, Case


def long_job(folder: Path, material: Path, *more: str) -> Case:
    for name in ("long.mp4", "camera.yaml", "model.ply"):
        shutil.copy(material / name, folder / name)
    args = [
        "process",
        "long.mp4",
        "--camera",
        "camera.yaml",
        "--marker",
        "36h11:3:100mm",
        "--model",
        "model.ply",
        "--fit",
        "8cm",
    ]
    args += ["-o", "out.mp4", "--json"]
    known = material / "long.json"
    expect = json.loads(known.read_text())["digest"] if known.exists() else None
    return Case(folder, [*args, *more], expect=expect)


def killed(rng: random.Random, folder: Path, material: Path) -> Case:
    case = long_job(
        folder,
        material,
        *rng.choice(((), (), ("--workers", "1"), ("--workers", "2"))),
    )
    known = json.loads((material / "long.json").read_text())

    def moment() -> tuple[int, str, float]:
        if rng.random() < 0.5 or "2" in case.args:
            return signal.SIGKILL, "time", rng.uniform(0, 1.1) * known["seconds"]
        return signal.SIGKILL, "event", rng.randint(1, known["events"])

    case.stop = moment()
    if rng.random() < 0.7:
        case.start = _short_stretches  # of the analysis
    if rng.random() < 0.3:
        case.stop_again = moment()
    case.after, case.codes, case.note = (
        [*case.args, "--resume"],
        frozenset({0}),
        f"SIGKILL at {case.stop[1:]}",
    )
    return case


def _short_stretches() -> None:
    from arfx.run import stretches

    stretches.LEAST_FRAMES = 10


def signalled(rng: random.Random, folder: Path, material: Path) -> Case:
    """SIGINT or SIGTERM, half of them to a process that still imports."""
    case = long_job(folder, material, *rng.choice(((), (), ("--workers", "1"))))
    known = json.loads((material / "long.json").read_text())
    number = rng.choice((signal.SIGINT, signal.SIGTERM))
    if rng.random() < 0.5:
        case.cold = True
        case.stop = (
            number,
            "time",
            rng.uniform(0.05, 1.0) * (known["cold_seconds"] + known["seconds"]),
        )
    elif rng.random() < 0.5:
        case.stop = (number, "event", rng.randint(1, known["events"]))
    else:
        case.stop = (number, "time", rng.uniform(0, 1.0) * known["seconds"])
    case.after, case.codes, case.note = (
        [*case.args, "--resume"],
        frozenset({0}),
        f"{number.name} at {case.stop[1:]}",
    )
    return case


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    return rng.choices((killed, signalled), (3, 2))[0](rng, folder, material)


SEEDS: dict[str, Build] = {"a kill": killed, "a signal": signalled}
