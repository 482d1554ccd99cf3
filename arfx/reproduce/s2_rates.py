"""Rates of Zhao et al. 2012, at their resolution, and the machine that they were taken on."""

from __future__ import annotations

import platform

from arfx.core.machine import usable_cores
from arfx.papers import CORRECTED, PAPER
from arfx.reproduce.rows import Bars, Items, Row, row
from arfx.reproduce.s2_scene import models, moving_desk, moving_settings
from arfx.reproduce.work import Timed, Work, median_s

PC_MB = 2048.0
HERE = (
    "another machine: here the method runs on the cores of a CPU and writes a file without"
    " loss"
)


def rows(work: Work) -> Items:
    clip = work.clip(moving_desk(work))
    size = f"{clip.scene.clip.width}{{}}{clip.scene.clip.height}"
    own, room = (
        [
            work.timed(clip, moving_settings(model, formula))
            for formula in (PAPER, CORRECTED)
        ]
        for model in models(work).values()
    )
    augmented = [timed.frames_per_s for timed in own]
    # nothing is filmed and nothing is tracked: the stages alone
    virtual = [1 / sum(timed.stage_s.values()) for timed in room]
    yield from _machine(own + room, size.format("*"))
    yield _rate(
        "section 4, all-virtual scene",
        48.0,
        virtual,
        f"{HERE}. The stages alone, all is a model; {_of_dof(room)}",
    )
    yield _rate(
        "section 4, augmented reality, GPU",
        21.0,
        augmented,
        f"{HERE}. With decoding, tracking and encoding; {_of_dof(own)}",
    )
    yield _rate(
        "section 4, augmented reality, CPU",
        14.0,
        augmented,
        f"{HERE}; as in the row before",
    )
    decoding = clip.scene.frames / median_s(clip.frames, work.scaled(3, 1))
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
    pairs = zip(virtual, augmented, augmented, strict=True)
    series |= dict(
        zip(("printed method", "corrected"), map(list, pairs), strict=True)
    )
    yield Bars(
        "section 4, all-virtual scene",
        f"rates at {size.format(' x ')}",
        "fps",
        labels,
        series,
    )


def _of_dof(timed: list[Timed]) -> str:
    printed, corrected = (1e3 * one.stage_s["dof"] for one in timed)
    return (
        f"depth of field takes {printed:.0f} ms of a frame as printed, {corrected:.0f} ms"
        " corrected"
    )


def _rate(item: str, printed: float, here: list[float], why: str) -> Row:
    return row(item, printed, here, "fps", why, min(here) >= printed)


def _machine(timed: list[Timed], size: str) -> Items:
    here = f"{platform.machine()}, {usable_cores()} cores"
    yield row(
        "section 4, machine",
        "Intel Core Duo 2.80 GHz, 2 GB, GeForce 9600 GT",
        (here, here),
        "",
        "another machine, without a graphics processor",
    )
    peaks_mb = [max(one.peak_mb for one in timed[k::2]) for k in (0, 1)]
    yield row(
        "section 4, memory of the machine",
        "2 GB",
        [f"at most {mb:.0f} MB used" for mb in peaks_mb],
        "",
        "the process with all its libraries needs more than the authors' machine had",
        max(peaks_mb) <= PC_MB,
    )
    yield row(
        "section 4, resolution",
        "1280*1024",
        (size, size),
        "",
        "the short form is smaller",
    )
