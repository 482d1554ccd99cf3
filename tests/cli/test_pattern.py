"""--pattern: a print without code as marker, through the command line."""

from __future__ import annotations

import tomllib
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from arfx.core.facts import read_facts
from arfx.core.marker import PatternSpec
from arfx.core.pose import rotation_angle_rad
from tests.cli.conftest import Run
from tests.clips import clip_camera, pose_at, write_camera, write_model
from tests.unit.analyse.synthetic import background, hung, poster

FRAMES = 6
PRINT = PatternSpec(Path("poster.png"), 0.15, 0.1)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a clip of a print, its picture, a camera and a model."""
    folder, camera, picture = (
        tmp_path_factory.mktemp("pattern"),
        clip_camera(),
        poster(300, 200, seed=2),
    )
    coded = lambda linear: (255 * np.clip(linear, 0, 1) ** (1 / 2.2) + 0.5).astype(  # noqa: E731
        np.uint8
    )
    cv2.imwrite(str(folder / "poster.png"), coded(picture)[..., ::-1])
    card = np.where(np.arange(200)[:, None, None] < 100, picture, picture[::-1, ::-1])
    cv2.imwrite(str(folder / "card.png"), coded(card)[..., ::-1])
    cv2.imwrite(str(folder / "plain.png"), np.full((200, 300, 3), 220, np.uint8))
    back = np.repeat(background(camera.width, camera.height)[..., None], 3, 2)
    with av.open(str(folder / "clip.mkv"), "w") as out:
        stream = out.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = (
            camera.width,
            camera.height,
            "yuv444p",
        )
        stream.time_base = Fraction(1, 30)
        for i in range(FRAMES):
            view = 0.7 * hung(
                camera,
                0.05 + 0.83 * picture,
                PRINT.corners_m,
                pose_at(i, FRAMES),
                back,
            )
            frame = av.VideoFrame.from_ndarray(coded(view), format="rgb24").reformat(
                format="yuv444p"
            )
            frame.pts, frame.time_base = i, Fraction(1, 30)
            out.mux(stream.encode(frame))
        out.mux(stream.encode())
    write_camera(folder / "camera.yaml")
    write_model(folder / "model.glb")
    return folder


def arguments(*more: str) -> list[str]:
    return [
        "process",
        "clip.mkv",
        "--camera",
        "camera.yaml",
        "--model",
        "model.glb",
        "--fit",
        "5cm",
        *more,
    ]


def test_the_object_stands_on_the_print(place: Path, arfx: Run) -> None:
    job = place / "kept"
    r = arfx(
        *arguments(
            "--pattern", "poster.png:15cm", "-o", "out.mkv", "--job", str(job)
        ),
        cwd=place,
    )
    assert r.code == 0, r.err
    for fact in read_facts(job / "facts.jsonl"):
        true = pose_at(fact.index, FRAMES)
        assert fact.light is not None and [m.key for m in fact.markers] == [
            "poster.png"
        ]
        assert np.degrees(rotation_angle_rad(fact.pose, true)) < 0.5
        assert np.linalg.norm(fact.pose.translation_m - true.translation_m) < 1.5e-3
    written = tomllib.loads((job / "job.toml").read_text())
    assert (
        written["pattern"] == [{"spec": f"{place / 'poster.png'}:150mmx100mm"}]
        and not written["marker"]
    )


def test_a_job_file_names_it_beside_itself(
    place: Path, arfx: Run, tmp_path: Path
) -> None:
    text = (
        '[input]\nclip = "clip.mkv"\ncamera = "camera.yaml"\n[model]\nfile ='
        ' "model.glb"\nfit = "5cm"\n'
    )
    (place / "job.toml").write_text(text + '[[pattern]]\nspec = "poster.png:15cm"\n')
    r = arfx(
        "plan",
        "--config",
        str(place / "job.toml"),
        "--marker",
        "36h11:3:10cm",
        "-o",
        "x.mkv",
        cwd=tmp_path,
    )
    assert r.code == 0 and "marker 36h11:3 was never seen" in r.err, r.err


def test_another_picture_of_the_same_name_is_another_job(
    place: Path, arfx: Run, tmp_path: Path
) -> None:
    job, pattern = tmp_path / "job", tmp_path / "poster.png"
    pattern.write_bytes((place / "poster.png").read_bytes())
    options = [
        "--pattern",
        f"{pattern}:15cm",
        "-o",
        str(tmp_path / "out.mkv"),
        "--job",
        str(job),
    ]
    assert arfx(*arguments(*options), cwd=place).code == 0
    pattern.write_bytes((place / "plain.png").read_bytes())
    r = arfx(*arguments(*options, "--overwrite"), cwd=place)
    assert r.code != 0 and "too plain" in r.err, (
        "what was known of the other picture is not taken for this one's"
    )


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--pattern", "poster.png"], 2, "pattern 'poster.png' is not IMAGE:SIZE"),
        (["--pattern", "poster.png:20"], 2, "'20' is not a length"),
        (["--pattern", "poster.png:-2cm"], 2, "the size must be above 0"),
        (
            ["--pattern", "poster.png:15cm", "--pattern", "poster.png:20cm"],
            2,
            "pattern poster.png is named twice",
        ),
        (["--pattern", "none.png:15cm"], 3, "pattern none.png: no such file"),
        (
            ["--pattern", "camera.yaml:15cm"],
            3,
            "pattern camera.yaml is not a picture",
        ),
        (["--pattern", "plain.png:15cm"], 3, "pattern plain.png is too plain"),
        (
            ["--pattern", "card.png:15cm"],
            2,
            "pattern card.png looks the same when it is turned by 180 degrees",
        ),
    ],
)
def test_what_is_no_pattern_is_one_message(
    place: Path, arfx: Run, options: list[str], code: int, words: str
) -> None:
    r = arfx(*arguments(*options, "-o", "bad.mkv"), cwd=place)
    assert r.code == code and words in r.err and "Traceback" not in r.err, r.err


def test_the_picture_is_not_written_over(place: Path, arfx: Run) -> None:
    (place / "out.mkv.png").write_bytes((place / "poster.png").read_bytes())
    (place / "same.mkv").unlink(missing_ok=True)
    (place / "same.mkv").hardlink_to(place / "out.mkv.png")
    r = arfx(
        *arguments("--pattern", "out.mkv.png:15cm", "-o", "same.mkv", "--overwrite"),
        cwd=place,
    )
    assert r.code == 2 and "is also an input (pattern)" in r.err, r.err
