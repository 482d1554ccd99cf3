"""`arfx calibrate` as a user runs it, on rendered pictures and a clip of them."""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pytest
import yaml
from PIL import Image
from PIL.PngImagePlugin import PngImageFile

from arfx.media.cameras import load_camera
from tests.cli.conftest import Run
from tests.unit.calibrate.boards import CHESS, SIZE, TRUE, poses, render


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    d = tmp_path_factory.mktemp("board")
    for i, pose in enumerate(poses(9)):
        cv2.imwrite(str(d / f"p{i:02d}.png"), render(CHESS, pose, seed=i))
    return d


def test_pictures_to_a_camera_file(arfx: Run, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "camera.yaml"
    result = arfx(
        "calibrate",
        str(folder),
        "--board",
        "chessboard:9x6:25mm",
        "-o",
        str(out),
        "--json",
    )
    assert result.code == 0, result.err
    d = result.json
    assert np.shape(d["camera_matrix"]) == (3, 3)
    sd = d["standard_deviations"]
    for name, value, truth in (
        ("fx", d["camera_matrix"][0][0], TRUE.fx),
        ("cy", d["camera_matrix"][1][2], TRUE.cy),
    ):
        assert abs(value - truth) < 4 * sd[name] + 0.3, name
    assert d["pictures"]["searched"] == d["pictures"]["with_board"] == 9
    assert out.with_name(f"{out.stem}-residuals.png").is_file()
    camera = load_camera(out)
    assert (camera.width, camera.height) == SIZE
    assert camera.fx == pytest.approx(d["camera_matrix"][0][0])
    assert yaml.safe_load(out.read_text())["verdict"] == d["verdict"]
    assert f"verdict: {d['verdict']}" in result.err
    again = arfx(
        "calibrate", str(folder), "--board", "chessboard:9x6:25mm", "-o", str(out)
    )
    assert again.code == 2
    assert "--overwrite" in again.err


def test_a_rotated_clip_is_searched_upright(
    arfx: Run, folder: Path, tmp_path: Path
) -> None:
    clip = tmp_path / "clip.mp4"
    with av.open(str(clip), "w") as container:
        stream = container.add_stream("libx264", 10, options={"crf": "10"})
        stream.width, stream.height, stream.pix_fmt = SIZE[1], SIZE[0], "yuv420p"
        stream.set_display_rotation(90)  # stored standing, shown lying
        for path in sorted(folder.glob("*.png")):
            gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            assert gray is not None
            stored = np.ascontiguousarray(np.rot90(gray, -1))
            frame = av.VideoFrame.from_ndarray(stored, "gray").reformat(
                format="yuv420p"
            )
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    result = arfx(
        "calibrate",
        str(clip),
        "--board",
        "chessboard:9x6:25mm",
        "-o",
        str(tmp_path / "c.yaml"),
        "--json",
    )
    assert result.code == 0, result.err
    assert (result.json["image_width"], result.json["image_height"]) == SIZE
    assert result.json["camera_matrix"][0][0] == pytest.approx(TRUE.fx, rel=0.01)
    assert "clip.mp4@0.300s" in [v["name"] for v in result.json["views"]]


def test_pictures_turned_by_exif_are_one_camera(
    arfx: Run, folder: Path, tmp_path: Path
) -> None:
    """Stored lying, with the tag that turns them upright: the same pixels as upright ones."""
    turned = tmp_path / "turned"
    turned.mkdir()
    for i, path in enumerate(sorted(folder.glob("*.png"))[:5]):
        with Image.open(path) as image:
            if i % 2:
                exif = Image.Exif()
                exif[0x0112] = 6  # the viewer turns it by 90 degrees clockwise
                image.transpose(Image.Transpose.ROTATE_90).save(
                    turned / f"{i}.jpg", quality=97, exif=exif
                )
            else:
                image.save(turned / f"{i}.jpg", quality=97)
    result = arfx(
        "calibrate",
        str(turned),
        "--board",
        "chessboard:9x6:25mm",
        "-o",
        str(tmp_path / "c.yaml"),
        "--json",
    )
    assert result.code == 0, result.err
    assert (result.json["image_width"], result.json["image_height"]) == SIZE
    assert result.json["camera_matrix"][0][0] == pytest.approx(TRUE.fx, rel=0.02)


def test_a_rig_is_calibrated_camera_by_camera(
    arfx: Run, folder: Path, tmp_path: Path
) -> None:
    """One that fails does not stop the others; what a first run wrote into the rig's folder
    is no camera of the second.
    """
    rig = tmp_path / "rig"
    for name in ("left.1", "right ü"):
        (rig / name).mkdir(parents=True)
        for path in sorted(folder.glob("*.png"))[:3]:
            (rig / name / path.name).write_bytes(path.read_bytes())
    (rig / "broken.mp4").write_bytes(b"no video")
    (rig / "notes").mkdir()
    command = [
        "calibrate",
        "rig",
        "--board",
        "chessboard:9x6:25mm",
        "-o",
        "rig/out/{stem}.yaml",
    ]
    r = arfx(*command, "--json")
    assert r.code == 6 and r.json["failed"] == 1, r.err
    rows = {row["input"]: row for row in r.json["cameras"]}
    assert {name: row["exit_code"] for name, row in rows.items()} == {
        "rig/broken.mp4": 3,
        "rig/left.1": 0,
        "rig/right ü": 0,
    }
    assert rows["rig/left.1"]["calibration"]["camera_matrix"][0][0] == pytest.approx(
        TRUE.fx, rel=0.02
    )
    assert (
        rows["rig/broken.mp4"]["calibration"] is None
        and "1 of 3 rig/broken.mp4: error:" in r.err
    )
    made = sorted(p.name for p in (rig / "out").iterdir())
    assert made == [
        f"{name}{end}"
        for name in ("left.1", "right ü")
        for end in ("-residuals.png", ".yaml")
    ]
    assert arfx(*command).code == 2
    assert arfx(*command[:-1], "rig/out/x{parent}.yaml", "--overwrite").code == 2, (
        "all to one file"
    )
    (rig / "broken.mp4").unlink()
    shutil.rmtree(rig / "left.1")
    again = arfx(*command, "--overwrite", "-q")
    assert again.code == 0 and "1 camera, none failed" in again.out, again.err
    assert "no pictures" in arfx("calibrate", "rig/notes", *command[2:]).err


def test_no_board_is_exit_4_and_nothing_is_written(
    arfx: Run, folder: Path, tmp_path: Path
) -> None:
    result = arfx(
        "calibrate",
        str(folder / "p00.png"),
        "--board",
        "charuco:7x5:25mm:18mm:4X4_50",
        "-o",
        str(tmp_path / "c.yaml"),
    )
    assert result.code == 4
    assert "chessboard with 9x6 inner corners" in result.err
    assert not list(tmp_path.iterdir())


def test_wrong_input_is_one_message(arfx: Run, folder: Path, tmp_path: Path) -> None:
    out = ["--board", "chessboard:9x6:25mm", "-o", str(tmp_path / "c.yaml")]
    missing = arfx("calibrate", "none.png", *out)
    assert missing.code == 3
    assert "none.png does not exist" in missing.err
    (tmp_path / "bad.png").write_bytes(b"not a picture")
    bad = arfx("calibrate", str(tmp_path / "bad.png"), *out)
    assert bad.code == 3
    assert "bad.png is not a picture" in bad.err
    assert "Traceback" not in bad.err
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((100, 100), np.uint8))
    mixed = arfx("calibrate", str(folder / "p00.png"), str(small), *out)
    assert mixed.code == 3
    assert "640x480, small.png is 100x100" in mixed.err
    assert (
        arfx(
            "calibrate",
            str(folder),
            "--board",
            "chessboard:9x6",
            "-o",
            str(tmp_path / "c.yaml"),
        ).code
        == 2
    )


def test_pictures_that_are_no_use_are_left_out_with_a_note(
    arfx: Run, folder: Path, tmp_path: Path
) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for i, path in enumerate(sorted(folder.glob("*.png"))):
        with Image.open(path) as image:
            exif = Image.Exif()
            exif[0x0112] = 3 if i == 4 else 1
            image.resize((320, 240) if i == 3 else SIZE).save(
                photos / f"{i}.jpg", quality=95, exif=exif
            )
    (photos / "5.jpg").write_bytes((photos / "5.jpg").read_bytes()[:3000])
    (photos / "p.HEIC").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")
    command = [
        "calibrate",
        "photos",
        "--board",
        "chessboard:9x6:25mm",
        "-o",
        "c.yaml",
        "--overwrite",
    ]
    r = arfx(*command)
    assert r.code == 0, r.err
    assert (
        "5.jpg cannot be read" in r.err
        and "3.jpg is 320x240" in r.err
        and "4.jpg is 640x480 upside down by EXIF" in r.err
    )
    assert "p.HEIC" in r.err and load_camera(tmp_path / "c.yaml").fx == pytest.approx(
        TRUE.fx, rel=0.02
    )
    assert "note: left out" in arfx(*command, "-q").err


def test_heic_is_read_by_pillows_plug_in_or_names_it(
    arfx: Run, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By name and in a folder; a plug-in that stands in for it here knows PNG behind the
    first bytes.
    """
    (tmp_path / "photos").mkdir()
    for path in sorted(folder.glob("*.png"))[:4]:
        (tmp_path / "photos" / f"{path.stem}.HEIC").write_bytes(
            b"\0\0\0\x18ftypheic" + path.read_bytes()
        )
    command = ["--board", "chessboard:9x6:25mm", "-o", "c.yaml", "--overwrite"]
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    for inputs in (
        ["photos"],
        [f"photos/{p.name}" for p in (tmp_path / "photos").iterdir()],
    ):
        r = arfx("calibrate", *inputs, *command)
        assert (
            r.code == 3
            and "needs the package pillow-heif" in r.err
            and "pip install pillow-heif" in r.err
        )

    def register() -> None:
        Image.register_open(
            "HEIF",
            lambda file, name: PngImageFile(io.BytesIO(file.read()[12:])),
            lambda head: head[4:8] == b"ftyp",
        )

    monkeypatch.setattr(Image, "OPEN", Image.OPEN.copy())
    monkeypatch.setattr(Image, "ID", Image.ID.copy())
    monkeypatch.setitem(
        sys.modules, "pillow_heif", SimpleNamespace(register_heif_opener=register)
    )
    r = arfx("calibrate", "photos", *command)
    assert r.code == 0 and "4 views" in r.err, r.err
