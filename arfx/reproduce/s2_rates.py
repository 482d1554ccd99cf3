"""Rates of Zhao et al. 2012, at their resolution, and the machine that they were taken on."""

from __future__ import annotations

import platform

from arfx.core.machine import usable_cores
from arfx.papers import CORRECTED, PAPER
from arfx.reproduce.rows import Items, row
from arfx.reproduce.s2_scene import models, moving_desk, moving_settings
from arfx.reproduce.work import Timed, Work, median_s

PC_MB = 2048.0
HERE = (
    "another machine: here the method runs on the cores of a CPU and writes a file without"
    " loss"
)


def rows(work: Work) -> Items:
    clip = work.clip(moving_desk(work))
    own, room = (
        [
            work.timed(clip, moving_settings(model, formula))
            for formula in (PAPER, CORRECTED)
        ]
        for model in models(work).values()
    )
    size = f"{clip.scene.clip.width}*{clip.scene.clip.height}"
    here = f"{platform.machine()}, {usable_cores()} cores"
    yield row(
        "section 4, machine",
        "Intel Core Duo 2.80 GHz, 2 GB, GeForce 9600 GT",
        (here, here),
        "",
        "another machine, without a graphics processor",
    )
    pairs = zip(own, room, strict=True)
    peaks_mb = [max(one.peak_mb for one in pair) for pair in pairs]
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
    augmented = [timed.frames_per_s for timed in own]
    # nothing is filmed and nothing is tracked: the stages alone
    virtual = [1 / sum(timed.stage_s.values()) for timed in room]
    alone = f"The stages alone, all is a model; {_of_dof(room)}"
    whole = f"With decoding, tracking and encoding; {_of_dof(own)}"
    for item, printed, rates, why in (
        ("section 4, all-virtual scene", 48.0, virtual, alone),
        ("section 4, augmented reality, GPU", 21.0, augmented, whole),
        ("section 4, augmented reality, CPU", 14.0, augmented, whole),
        ("section 5, rate that is needed", 25.0, augmented, whole),
    ):
        holds = min(rates) >= printed
        yield row(item, printed, rates, "fps", f"{HERE}. {why}", holds)
    decoding = clip.scene.frames / median_s(clip.frames, work.scaled(3, 1))
    for how, printed in (("DirectShow", 16.0), ("the board's own software", 25.0)):
        yield row(
            f"section 4, capture by {how}",
            printed,
            None,
            "fps",
            f"there is no camera: a clip of this size is decoded at {decoding:.0f} fps here",
        )


def _of_dof(timed: list[Timed]) -> str:
    printed, corrected = (1e3 * one.stage_s["dof"] for one in timed)
    return (
        f"depth of field takes {printed:.0f} ms of a frame as printed, {corrected:.0f} ms"
        " corrected"
    )
