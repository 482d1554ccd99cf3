"""`--anchor plane`: no marker; the object stands on the main level plane of the depth input."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from arfx.analyse.job import PLANE, AnalysisJob
from arfx.config.load import load
from arfx.core.facts import read_facts, write_facts
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.run import analysis, stretches
from arfx.run.folder import JobFolder
from arfx.run.inputs import open_inputs
from arfx.run.parameters import parameters
from arfx.run.stretches import Span
from tests.cli.conftest import Material, Run
from tests.cli.test_process import frames
from tests.clips import SIZE, clip_camera, write_clip

DOWN_DEG, HEIGHT_M = 35.0, 0.5


def depth_map(floor: bool = True) -> np.ndarray:
    """(h, w) uint16 mm, half the clip's size: a floor 0.5 m under a camera that looks down,
    or a wall; a third not measured.
    """
    w, h = SIZE[0] // 2, SIZE[1] // 2
    d = clip_camera(w, h).directions(
        np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).astype(float)
    )
    a = np.radians(DOWN_DEG)
    up = np.array([0, -np.cos(a), -np.sin(a)])
    z = -HEIGHT_M / np.minimum(d @ up, -0.1) if floor else np.full(d.shape[:2], 1.0)
    gone = np.random.default_rng(0).random((12, 16)) < 0.32
    return np.where(
        np.kron(gone, np.ones((10, 10), bool)), 0, np.round(1000 * z)
    ).astype(np.uint16)


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip without a marker whose camera stands still."""
    return write_clip(
        tmp_path_factory.mktemp("still") / "still.mp4", 18, absent=range(18)
    )


def arguments(material: Material, clip: Path, *more: str) -> list[str]:
    return [
        "process", str(clip), "--camera", str(material.camera), "--model", str(material.model), "--fit", "8cm",
        "--anchor", "plane",
        "-o", "out.mkv", "--codec", "ffv1", *more,
    ]  # fmt: skip


def test_the_object_stands_on_the_plane(
    material: Material, still: Path, arfx: Run, tmp_path: Path
) -> None:
    cv2.imwrite(str(tmp_path / "one.png"), depth_map())
    r = arfx(
        *arguments(
            material,
            still,
            "--depth",
            "one.png",
            "--pipeline",
            "lightmap,gi",
            "--quality",
            "draft",
            "--json",
        )
    )
    assert r.code == 0, r.err
    told = r.json["pose"]
    assert (
        told["frames_measured"] == 18
        and told["anchor"]["poses"] == "a camera at rest"
    )
    assert told["anchor"]["residual_mm"] < 1 and told["anchor"]["area_m2"] > 0.1
    plane = Pose.from_json(
        told["anchor"]["world_from_plane"]
    )  # the given world is the camera's
    a = np.radians(DOWN_DEG)
    assert (
        np.degrees(np.arccos(plane.rotation[:, 2] @ [0, -np.cos(a), -np.sin(a)]))
        < 0.2
    )
    assert -plane.rotation[:, 2] @ plane.translation_m == pytest.approx(
        HEIGHT_M, abs=0.002
    )
    made, plain = (
        frames(tmp_path / "out.mkv")[9][1].astype(float),
        frames(still)[9][1].astype(float),
    )
    changed = np.abs(made - plain).max(-1) > 12
    x, y = clip_camera().project(plane.translation_m + 0.03 * plane.rotation[:, 2])
    assert changed[round(y), round(x)] and 0.002 < changed.mean() < 0.2


def test_given_poses_hold_it_in_place(
    material: Material, still: Path, arfx: Run, tmp_path: Path
) -> None:
    """The given camera goes to the right: the object goes to the left."""
    turn = rotation_from_euler_deg(-90 - DOWN_DEG, 0, 0)
    x, y, z, w = Rotation.from_matrix(turn).as_quat()
    lines = [f"{0.005 * k} 0 {HEIGHT_M} {x} {y} {z} {w}" for k in range(18)]
    (tmp_path / "poses.txt").write_text(
        "# camera in the world\n" + "\n".join(lines) + "\n"
    )
    cv2.imwrite(str(tmp_path / "one.png"), depth_map())
    more = (
        "--depth",
        "one.png",
        "--poses",
        "poses.txt",
        "--pipeline",
        "lightmap",
        "--end",
        "0.5",
    )
    assert arfx(*arguments(material, still, *more)).code == 0
    plain = frames(still)[0][1].astype(float)
    at = [
        np.argwhere(np.abs(f.astype(float) - plain).max(-1) > 40).mean(0)[1]
        for _, f in frames(tmp_path / "out.mkv")
    ]
    assert 12 < at[0] - at[15] < 30


def test_poses_sparser_than_frames_are_bridged(
    material: Material, still: Path, arfx: Run, tmp_path: Path
) -> None:
    """A pose each sixth frame: the camera moves on evenly between them, and those frames
    are not called measured.
    """
    x, y, z, w = Rotation.from_euler("x", -90 - DOWN_DEG, degrees=True).as_quat()
    (tmp_path / "poses.txt").write_text(
        "".join(
            f"{k / 30} {0.005 * k} 0 {HEIGHT_M} {x} {y} {z} {w}\n"
            for k in (0, 6, 12, 18)
        )
    )
    cv2.imwrite(str(tmp_path / "one.png"), depth_map())
    more = (
        "--depth",
        "one.png",
        "--poses",
        "poses.txt",
        "--pipeline",
        "lightmap",
        "--job",
        "job",
        "--json",
    )
    r = arfx(*arguments(material, still, *more))
    assert r.code == 0 and "bridged" in r.err, r.err
    assert (
        r.json["pose"]["frames_measured"],
        r.json["pose"]["frames_interpolated"],
    ) == (
        3,
        15,
    )
    moved = np.diff(
        [f.pose.translation_m for f in read_facts(tmp_path / "job" / "facts.jsonl")],
        axis=0,
    )
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 0.005, atol=2e-4)


def test_an_interrupted_analysis_leaves_the_same_bytes(
    material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    still = write_clip(
        tmp_path / "keys.mov",
        18,
        absent=range(18),
        codec="mjpeg",
        pixel_format="yuvj420p",
    )
    monkeypatch.setattr(stretches, "LEAST_FRAMES", 5)
    cv2.imwrite(str(tmp_path / "one.png"), depth_map())
    document = {
        "input": {"clip": str(still), "camera": str(material.camera), "depth": str(tmp_path / "one.png")},
        "model": {"file": str(material.model), "fit": "8cm", "anchor": "plane"}, "output": {"path": str(tmp_path / "out.mp4")},
    }  # fmt: skip
    inputs = open_inputs(load(None, document, parameters()))
    of_plane = AnalysisJob((), inputs.camera, anchor=PLANE, depth=inputs.depth)

    def analysed(job: Path, stop: int | None) -> tuple[bytes, list[int]]:
        def progress(phase: str, done: int, total: int | None) -> None:
            if done == stop:
                raise KeyboardInterrupt

        found, frames = analysis.analyse_clip(
            Span(inputs.info),
            replace(of_plane, progress=progress),
            {"environment"},
            JobFolder(job),
            "key",
        )
        write_facts(tmp_path / "facts.jsonl", found.facts)
        return (tmp_path / "facts.jsonl").read_bytes(), frames.pts

    whole = analysed(tmp_path, None)
    shutil.rmtree(tmp_path / "stretches")
    for stop, kept in ((2, 0), (9, 1), (17, 3)):
        with pytest.raises(KeyboardInterrupt):
            analysed(tmp_path, stop)
        assert len([*(tmp_path / "stretches").iterdir()]) == kept
    assert analysed(tmp_path, None) == whole


@pytest.mark.parametrize(
    ("case", "code", "words"),
    [
        ("no depth", 2, "needs the depth"),
        ("a wall", 4, "none of which faces up"),
        ("moving", 4, "the camera moves"),
    ],
)
def test_refusals(
    case: str,
    code: int,
    words: str,
    material: Material,
    still: Path,
    arfx: Run,
    tmp_path: Path,
) -> None:
    cv2.imwrite(str(tmp_path / "one.png"), depth_map(case != "a wall"))
    more = () if case == "no depth" else ("--depth", "one.png")
    r = arfx(
        *arguments(material, material.clip if case == "moving" else still, *more)
    )
    assert r.code == code and words in r.err, r.err
    assert not (tmp_path / "out.mkv").exists()
