"""`arfx inspect` on clips made for it: what is there is found, what is not there is not."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from tests.cli.conftest import FRAMES, Material, Run
from tests.clips import MARKER, clip_camera, pose_at, write_clip


def test_the_marker_is_found_measured_and_suggested(
    material: Material, arfx: Run
) -> None:
    r = arfx(
        "inspect", str(material.clip), "--camera", str(material.camera), "--json"
    )
    assert r.code == 0, r.err
    d = r.json
    (m,) = d["markers"]
    assert (
        m["marker"] == MARKER.key
        and m["frames"] == m["looked"] == len(d["samples"]) == 24
    )
    assert d["marker_coverage"] == 1.0
    camera, pose = clip_camera(), pose_at(FRAMES // 2, FRAMES)
    corners = camera.project(pose.apply(MARKER.corners_m))
    side = float(
        sum(((corners[i] - corners[i - 1]) ** 2).sum() ** 0.5 for i in range(4)) / 4
    )
    assert m["side_px"]["median"] == pytest.approx(
        side, abs=3.5
    )  # the finder's corners, 1 px each
    assert m["tilt_deg"]["median"] == pytest.approx(35, abs=6)
    assert (
        f"--marker {MARKER.key}:SIZE" in d["suggestion"]
        and str(material.camera) in d["suggestion"]
    )
    clip = d["clip"]
    assert (
        clip["width"],
        clip["height"],
        clip["frames"],
        clip["vfr"],
        clip["gaps"],
    ) == (
        320,
        240,
        FRAMES,
        False,
        0,
    )
    assert clip["seconds"] == pytest.approx(FRAMES / 30, abs=1e-6)
    assert any(s["kind"] == "audio" for s in clip["streams"])
    assert d["cuts"] == []


def test_the_text_names_marker_and_next_command(
    material: Material, arfx: Run
) -> None:
    r = arfx("inspect", str(material.clip), "--samples", "4")
    assert r.code == 0, r.err
    assert (
        MARKER.key in r.out and "arfx process" in r.out and "arfx calibrate" in r.out
    )


def test_a_clip_without_marker_is_said_plainly(arfx: Run, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "none.mp4", 12, absent=range(12))
    r = arfx("inspect", str(clip))
    assert (
        r.code == 0
        and "No marker was found in 12 sampled frames" in r.out
        and "36h11" in r.out
    )
    d = arfx("inspect", str(clip), "--json").json
    assert d["markers"] == [] and d["suggestion"] == "" and d["marker_coverage"] == 0


def test_coverage_counts_the_frames_that_show_it(arfx: Run, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "half.mp4", 20, absent=range(5, 20))
    d = arfx("inspect", str(clip), "--samples", "20", "--json").json
    assert [m["frames"] for m in d["markers"]] == [5] and d["marker_coverage"] == 0.25


def test_variable_rate_and_a_gap_are_seen(arfx: Run, tmp_path: Path) -> None:
    pts = [i * 1000 + (7000 if i > 7 else 0) for i in range(16)]
    clip = write_clip(tmp_path / "gap.mp4", 16, pts=pts, time_base=Fraction(1, 30000))
    d = arfx("inspect", str(clip), "--json").json
    assert (
        d["clip"]["vfr"]
        and d["clip"]["gaps"] == 1
        and d["clip"]["longest_gap_s"] == pytest.approx(8 / 30, abs=1e-3)
    )


def test_a_long_clip_is_sampled_by_seeking(
    arfx: Run, material: Material, monkeypatch: pytest.MonkeyPatch
) -> None:
    from arfx.measure import inspection
    from arfx.media.clip import probe

    whole = inspection.inspect(probe(material.clip), samples=5)
    monkeypatch.setattr(inspection, "READ_WHOLE", 10)
    sampled = inspection.inspect(probe(material.clip), samples=5)
    assert sampled["samples"] == whole["samples"] == [0, 9, 18, 26, 35]
    assert (
        sampled["markers"] == whole["markers"] and sampled["light"] == whole["light"]
    )
    assert whole["cuts"] == [] and sampled["cuts"] is None


def test_what_cannot_be_read_is_one_message(arfx: Run, tmp_path: Path) -> None:
    (tmp_path / "notes.mp4").write_text("no video")
    for name in ("notes.mp4", "absent.mp4"):
        r = arfx("inspect", name)
        assert (
            r.code == 3
            and r.err.startswith("error:")
            and "help:" in r.err
            and not r.out
            and "Traceback" not in r.err
        )


def test_what_is_left_out_is_listed_and_not_suggested(
    arfx: Run, tmp_path: Path
) -> None:
    """One frame: a tag, and a code of few bits with one wrong."""
    page = np.full((240, 320), 230, np.uint8)
    for at, name, wrong in (
        (40, "DICT_APRILTAG_36h11", 0),
        (180, "DICT_APRILTAG_16h5", 1),
    ):
        cells = cv2.aruco.generateImageMarker(
            cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)),
            4,
            8 - 2 * wrong,
        )
        cells[1, 1 : 1 + wrong] = 255 - cells[1, 1 : 1 + wrong]
        block = np.kron(cells, np.ones((12, 12), np.uint8))
        page[60 : 60 + len(block), at : at + len(block)] = block
    with av.open(str(tmp_path / "one.mkv"), "w") as file:
        stream = file.add_stream("ffv1", 25, width=320, height=240, pix_fmt="gray")
        file.mux(
            [
                *stream.encode(av.VideoFrame.from_ndarray(page, "gray")),
                *stream.encode(),
            ]
        )
    out = arfx("inspect", "one.mkv").out
    assert (
        "left out: 16h5:4, in 1 of 1: not plain" in out
        and "--marker 36h11:4:SIZE --model" in out
    )
    d = arfx("inspect", "one.mkv", "--json").json
    assert [m["marker"] for m in d["markers"]] == ["36h11:4"] and [
        m["marker"] for m in d["left_out"]
    ] == ["16h5:4"]
