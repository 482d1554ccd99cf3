"""Names of files that are no text, and names that are text where the locale knows ASCII alone."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.errors import ConfigError
from arfx.media.images import load_image
from tests.cli.conftest import Material, Run

BAD = os.fsdecode(b"caf\xe9")  # Latin-1


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    folder = tmp_path / BAD
    try:
        folder.mkdir()
    except OSError:
        pytest.skip("this file system takes text alone")
    return folder


@pytest.mark.parametrize(
    "option",
    ["clip", "--camera", "--model", "-o", "--job", "--report", "--depth", "--set"],
)
def test_a_name_that_is_no_text_is_refused(
    material: Material, arfx: Run, bad: Path, option: str
) -> None:
    arguments = material.arguments("-o", "out.mp4")
    name = f"output.path={bad}/x.mp4" if option == "--set" else str(bad / "x.mp4")
    if option == "clip":
        arguments[1] = name
    else:
        arguments += [option, name]
    r = arfx(*arguments)
    assert (
        r.code == 2
        and "caf\\xe9" in r.err
        and "is not utf-8 text" in r.err
        and "arfx failed" not in r.err
    )
    assert not list(bad.iterdir())


def test_a_folder_that_is_no_text_is_refused(
    material: Material, arfx: Run, bad: Path
) -> None:
    r = arfx(*material.arguments("-o", "out.mp4"), cwd=bad)
    assert r.code == 2 and "caf\\xe9" in r.err and not list(bad.iterdir())
    assert arfx("--help", cwd=bad).code == 0


def test_a_picture_in_a_folder_that_was_named(bad: Path) -> None:
    cv2.imwrite(str(bad.parent / "fine.png"), np.zeros((4, 4), np.uint8))
    shutil.move(bad.parent / "fine.png", bad / "fine.png")
    with pytest.raises(ConfigError, match="is not utf-8 text"):  # OpenCV would crash
        load_image(bad / "fine.png")


@pytest.mark.process
def test_names_in_any_script_where_the_locale_is_plain(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    folder = tmp_path / "Prüfung 試験"
    folder.mkdir()
    for file, name in (
        (material.clip, "Übung.mp4"),
        (material.model, "Würfel.glb"),
        (material.camera, "Kamera ß.yaml"),
    ):
        shutil.copy(file, folder / name)
    arguments = [
        "process",
        "Übung.mp4",
        "--camera",
        "Kamera ß.yaml",
        "--marker",
        "36h11:3:10cm",
        "--model",
        "Würfel.glb",
    ]
    plain = {"LC_ALL": "C", "LANG": "C"}
    r = arfx(
        *arguments,
        "--fit",
        "8cm",
        "-o",
        "Ergebnis ±.mp4",
        "--end",
        "0.1",
        "--json",
        cwd=folder,
        env=plain,
    )
    assert r.code == 0 and "Traceback" not in r.err, r.err
    assert (folder / "Ergebnis ±.mp4").exists() and r.json["input"]["path"].endswith(
        "Übung.mp4"
    )


def test_a_job_folder_that_links_to_itself_is_one_message(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    (tmp_path / "o.mp4.job").symlink_to("o.mp4.job")
    r = arfx(*material.arguments("-o", "o.mp4"))
    assert r.code == 2 and "o.mp4.job" in r.err and "arfx failed" not in r.err


def test_names_cannot_steer_the_terminal(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    r = arfx(*material.arguments("-o", "o.mp4", clip=tmp_path / "\x1b[31mred\r.mp4"))
    assert r.code == 3 and "\x1b" not in r.err and "\\x1b[31mred\\r.mp4" in r.err
