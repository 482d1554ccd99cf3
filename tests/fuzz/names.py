"""Names: colons, newlines, leading dashes, bytes that are no text, 255 bytes, numbering
patterns, links; outputs onto inputs.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
from pathlib import Path

from tests.fuzz.case import Build, Case, process

STEMS = (
    "12:30", "http:x", "file:x", "concat:a|b", "pipe:0", "crypto:x", "data:x", "subfile,,start,0,end,0,,:x", "a\nb", "-x",
    "a b", "ä€😀", "b\udcff", "%d", "%s", "50%", "a%04d", "%%", "'", '"', "$(true)", "`true`", "*", "?", "[1]", "a" * 200,
    "a" * 251, "é" * 120, " ", ".", "..a", "~", "con", "\u202egnp", "\\", "a\\b", "\x1b[31m", "x.part", "x.job", "\t",
)  # fmt: skip


def clip(name: str) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        shutil.copy(material / "clip.mp4", folder / name)
        return Case(
            folder, process(folder, material, clip=name), codes=frozenset({0, 2, 3})
        )

    return build


def output(name: str, *more: str, codes: tuple[int, ...] = (0, 2)) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        return Case(
            folder,
            [*process(folder, material, o=name), *more],
            name,
            codes=frozenset(codes),
        )

    return build


def onto(target: str, *more: str, what: str = "") -> Build:
    """The output named as an input, or as a link to one: exit 2, and everything as it was."""

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        args = process(folder, material, o=target)
        if "depth" in target or "depth" in what:
            shutil.copytree(material / "depth", folder / "depth")
            args += ["--depth", "depth"]
        if what == "textured":
            for name in ("model.obj", "model.mtl"):
                shutil.copy(material / name, folder / name)
            shutil.copy(material / "texture.png", folder / "000001.png")
            (folder / "model.mtl").write_text(
                (material / "model.mtl")
                .read_text()
                .replace("texture.png", "000001.png")
            )
            args[args.index("--model") + 1] = "model.obj"
        if what == "hard link":
            (folder / target).hardlink_to(folder / "clip.mp4")
        if what == "link":
            (folder / target).symlink_to("clip.mp4")
        if what == "dangling":
            (folder / target).symlink_to("none.mp4")
            return Case(folder, args, target, frozenset({2}))
        if what == "foreign part":
            (folder / f"{target}.part").write_text("precious")
            return Case(folder, [*args, *more], target, frozenset({0, 2}))
        codes = (
            {0, 2} if what == "hard link" else {2}
        )  # replaced by another file, it leaves the clip as it is
        return Case(folder, [*args, "--overwrite", *more], target, frozenset(codes))

    return build


def foreign_job(rng: random.Random, folder: Path, material: Path) -> Case:
    """--job names a folder that no job made, with the clip in its chunks/."""
    (folder / "mine" / "chunks").mkdir(parents=True)
    (folder / "mine" / "job.toml").write_text("[input]\n")
    shutil.copy(material / "clip.mp4", folder / "mine" / "chunks" / "clip.mp4")
    args = process(folder, material, clip="mine/chunks/clip.mp4", job="mine")
    return Case(folder, [*args, "--overwrite"], codes=frozenset({2}))


def foreign_report(rng: random.Random, folder: Path, material: Path) -> Case:
    (folder / "report").mkdir()
    (folder / "report" / "report.json").write_text("precious")
    return Case(
        folder, process(folder, material, report="report"), codes=frozenset({2})
    )


def at_once(*more: str) -> Build:
    """Two jobs with one output: one is refused, or both wait their turn; what there is in
    the end is whole.
    """

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        args = [*process(folder, material), *more]
        whole = json.loads((material / "long.json").read_text())["short"]
        return Case(
            folder, args, codes=frozenset({0, 2}), beside=list(args), expect=whole
        )

    return build


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    stem = rng.choice(STEMS)
    if rng.random() < 0.3:
        stem = (stem + rng.choice(STEMS))[:240]
    what = rng.randrange(5)
    if what == 0:
        name = f"{stem}{rng.choice(('.mp4', '.mkv', ''))}"
        return _made(
            folder,
            material,
            lambda: shutil.copy(material / "clip.mp4", folder / name),
            clip=name,
        )
    if what == 1:
        name = f"{stem}.yaml"
        return _made(
            folder,
            material,
            lambda: shutil.copy(material / "camera.yaml", folder / name),
            camera=name,
        )
    if what == 2:
        name = f"{stem}.glb"
        return _made(
            folder,
            material,
            lambda: shutil.copy(material / "model.glb", folder / name),
            model=name,
        )
    if what == 3:
        name = f"{stem}{rng.choice(('.mp4', '.mkv', '.webm', '.png', '%04d.png', '%d.exr', '%9999999999d.png', ''))}"
        return Case(folder, process(folder, material, o=name), name, note=repr(name))
    return Case(
        folder,
        process(folder, material, job=stem),
        note=f"job {stem!r}",
        leaves=(os.path.normpath(stem),),
    )


def _made(folder: Path, material: Path, make: object, **named: str) -> Case:
    assert callable(make)
    with contextlib.suppress(
        OSError
    ):  # a name that the file system does not take: then it is missing
        make()
    return Case(folder, process(folder, material, **named), note=repr(named))


SEEDS: dict[str, Build] = {
    "12:30.mp4": clip("12:30.mp4"),
    "http:x.mkv": clip("http:x.mkv"),
    "concat:a|b.mp4": clip("concat:a|b.mp4"),
    "a newline": clip("a\nb.mp4"),
    "a dash": clip("-x.mp4"),
    "no text": clip("b\udcff.mp4"),
    "output with a colon": output("12:30.mp4"),
    "output of no text": output("b\udcff.mp4"),
    "output of 255 bytes": output("a" * 251 + ".mp4"),
    "output of 256 bytes": output("a" * 252 + ".mp4", codes=(2,)),
    "output of 250 bytes": output("a" * 246 + ".mp4"),
    "output %9999999999d.png": output("%9999999999d.png", codes=(2,)),
    "output %d.png": output("%d.png"),
    "output is a folder": output(".", codes=(2,)),
    "job of 256 bytes": output("out.mp4", "--job", "j" * 256, codes=(2,)),
    "onto the clip": onto("./clip.mp4"),
    "onto a hard link to the clip": onto("hard.mp4", what="hard link"),
    "onto a link to the clip": onto("soft.mp4", what="link"),
    "onto a dangling link": onto("dangling.mp4", what="dangling"),
    "onto the depth maps": onto("depth/%04d.png"),
    "onto a texture": onto("%06d.png", what="textured"),
    "onto a foreign part": onto("out.mp4", what="foreign part"),
    "a job folder that is none": foreign_job,
    "a report that is there": foreign_report,
    "two at once": at_once(),
    "two at once, --overwrite": at_once("--overwrite"),
    "two at once, --resume": at_once("--resume"),
}
