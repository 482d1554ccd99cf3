"""Rates of Zhao et al. 2012, at their resolution, and the machine that they were taken on."""

from __future__ import annotations

import platform
from collections.abc import Iterator

from arfx.core.machine import usable_cores
from arfx.papers import CORRECTED, PAPER
from arfx.reproduce.rows import Bars, Item, Row, row
from arfx.reproduce.s2_scene import ball_model, moving_desk, moving_settings, room_model
from arfx.reproduce.work import Timed, Work, frames_of, median_s

PC_MB = 2048.0
HERE = (
    "another machine: here the method runs on the cores of a CPU and writes a file without"
    " loss"
)


def rows(work: Work) -> Iterator[Item]:
    clip = work.clip(moving_desk(work))
    models = {"augmented": ball_model(work), "all virtual": room_model(work)}
    timed: dict[tuple[str, str], Timed] = {}
    for mode, model in models.items():
        for formula in (PAPER, CORRECTED):
            timed[mode, formula] = work.timed(
                clip, settings=moving_settings(model, formula)
            )
    augmented = [timed["augmented", f].frames_per_s for f in (PAPER, CORRECTED)]
    # nothing is filmed and nothing is tracked: the stages alone
    virtual = [
        1 / sum(timed["all virtual", f].stage_s.values()) for f in (PAPER, CORRECTED)
    ]
    yield from _machine(
        [t.peak_mb for t in timed.values()],
        (clip.scene.clip.width, clip.scene.clip.height),
    )
    yield _rate(
        "section 4, all-virtual scene",
        48.0,
        virtual,
        f"{HERE}. The stages alone, all is a model; {_of_dof(timed, 'all virtual')}",
    )
    yield _rate(
        "section 4, augmented reality, GPU",
        21.0,
        augmented,
        f"{HERE}. With decoding, tracking and encoding; {_of_dof(timed, 'augmented')}",
    )
    yield _rate(
        "section 4, augmented reality, CPU",
        14.0,
        augmented,
        f"{HERE}; as in the row before",
    )
    decoding = len(clip.frames()) / median_s(
        lambda: frames_of(clip.file), work.scaled(3, 1)
    )
    for how, printed in (("DirectShow", 16.0), ("the board's own software", 25.0)):
        yield row(
            f"section 4, capture by {how}",
            printed,
            None,
            "fps",
            f"there is no camera: a clip of this size is decoded at {decoding:.0f} fps here",
        )
    yield _rate(
        "section 5, rate that is needed",
        25.0,
        augmented,
        f"not reached here, nor by the authors (21 fps): {HERE}",
    )
    labels = [
        "all virtual, their GPU",
        "augmented reality, their GPU",
        "augmented reality, their CPU",
    ]
    series = {"printed": [48.0, 21.0, 14.0]}
    series |= {
        name: [virtual[k], augmented[k], augmented[k]]
        for k, name in enumerate(("printed method", "corrected"))
    }
    yield Bars(
        "section 4, all-virtual scene",
        f"rates at {clip.scene.clip.width} x {clip.scene.clip.height}",
        "fps",
        labels,
        series,
    )


def _of_dof(timed: dict[tuple[str, str], Timed], mode: str) -> str:
    printed, corrected = (
        1e3 * timed[mode, formula].stage_s["dof"] for formula in (PAPER, CORRECTED)
    )
    return (
        f"depth of field takes {printed:.0f} ms of a frame as printed, {corrected:.0f} ms"
        " corrected"
    )


def _rate(item: str, printed: float, here: list[float], why: str) -> Row:
    return row(item, printed, here, "fps", why, min(here) >= printed)


def _machine(peaks_mb: list[float], size: tuple[int, int]) -> Iterator[Item]:
    here = f"{platform.machine()}, {usable_cores()} cores"
    yield row(
        "section 4, machine",
        "Intel Core Duo 2.80 GHz, 2 GB, GeForce 9600 GT",
        (here, here),
        "",
        "another machine, without a graphics processor",
    )
    printed, corrected = max(peaks_mb[::2]), max(peaks_mb[1::2])
    yield row(
        "section 4, memory of the machine",
        "2 GB",
        [f"at most {mb:.0f} MB used" for mb in (printed, corrected)],
        "",
        "the process with all its libraries needs more than the authors' machine had",
        max(printed, corrected) <= PC_MB,
    )
    used = f"{size[0]}*{size[1]}"
    yield row(
        "section 4, resolution",
        "1280*1024",
        (used, used),
        "",
        "the short form is smaller",
    )
