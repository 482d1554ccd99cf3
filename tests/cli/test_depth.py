"""`--depth`: a clip with measured depth, end to end."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.conftest import FRAMES, Material, Run
from tests.cli.test_process import frames
from tests.clips import SIZE, clip_camera, pose_at


def depth_of(pose_index: int, near: bool) -> np.ndarray:
    """(h, w) uint16, half millimetres: the marker's plane, and a box before it on the left;
    holes.
    """
    camera, pose = clip_camera(), pose_at(pose_index, FRAMES)
    grid = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), -1).astype(
        float
    )
    normal = pose.rotation[:, 2]
    z = (normal @ pose.translation_m) / (camera.directions(grid) @ normal)
    if near:
        z[:, :60] = 0.2
    z[np.random.default_rng(pose_index).random(z.shape) < 0.2] = 0
    return np.clip(z * 2000, 0, 65534).astype(np.uint16)


@pytest.fixture(scope="module")
def depth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("depth")
    for k in range(FRAMES):
        cv2.imwrite(str(folder / f"{k}.png"), depth_of(k, near=True))
    return folder


def test_the_blur_follows_the_depth(
    material: Material, arfx: Run, depth: Path, tmp_path: Path
) -> None:
    lens = (
        "--pipeline",
        "dof",
        "--set",
        "dof.aperture_px=30",
        "--set",
        "dof.focus=marker",
        "--codec",
        "ffv1",
        "--end",
        "0.3",
    )
    r = arfx(
        *material.arguments("-o", "out.mkv", "--depth", str(depth), "--json", *lens)
    )
    assert r.code == 0, r.err
    told = r.json["depth"]
    assert (
        told["known"]
        and told["scale"] == pytest.approx(0.5, rel=0.01)
        and told["residual"] < 0.01
    )
    assert told["frames_with"] == 10 and 0.19 < told["holes"] < 0.21
    rows = {h["check"]: h for h in r.json["health"]}
    assert rows["real depth: miss of the markers' planes"]["verdict"] == "ok"
    assert arfx(*material.arguments("-o", "flat.mkv", *lens)).code == 0
    made, flat = (
        frames(tmp_path / n)[5][1].astype(float) for n in ("out.mkv", "flat.mkv")
    )
    sharp = frames(material.clip)[5][1].astype(float)
    rough = [np.abs(np.diff(a[:, 5:50], axis=1)).mean() for a in (sharp, flat, made)]
    assert rough[2] < 0.5 * rough[1] <= 0.5 * rough[0], (
        "the box on the left is far before the focus"
    )
    away = np.abs(made[80:160, 120:] - flat[80:160, 120:])
    assert away.mean() < 2.0, "the plane is where the marker says it is"


def test_what_is_nearer_hides_the_object(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    """A strip of the depth maps, 20 cm away, crosses the object: there the clip is seen,
    elsewhere the object.
    """
    (tmp_path / "maps").mkdir()
    sharp_lens = ("--pipeline", "dof", "--set", "dof.fnumber=1000")
    plain = arfx(
        *material.arguments(
            "-o",
            "plain.mkv",
            "--codec",
            "ffv1",
            "--end",
            "0.2",
            "--json",
            *sharp_lens,
        )
    )
    assert plain.code == 0, plain.err
    sharp, seen = (
        frames(p)[5][1].astype(float) for p in (material.clip, tmp_path / "plain.mkv")
    )
    drawn = (seen - sharp).max(
        -1
    ) > 40  # brighter: its shadow, which stays, is darker
    middle = int(np.median(np.nonzero(drawn)[1]))
    for k in range(FRAMES):
        z = depth_of(k, near=False)
        z[:, middle - 12 : middle + 12] = 400
        cv2.imwrite(str(tmp_path / "maps" / f"{k}.png"), z)
    r = arfx(
        *material.arguments(
            "-o",
            "out.mkv",
            "--codec",
            "ffv1",
            "--end",
            "0.2",
            "--json",
            "--depth",
            "maps",
            *sharp_lens,
        )
    )
    assert r.code == 0, r.err
    assert "hide" in [s["name"] for s in r.json["stages"]] and "hide" not in [
        s["name"] for s in plain.json["stages"]
    ]
    made = frames(tmp_path / "out.mkv")[5][1].astype(float)
    strip, away = np.zeros_like(drawn), np.ones_like(drawn)
    strip[:, middle - 5 : middle + 5] = True
    away[:, middle - 25 : middle + 25] = False
    assert (drawn & strip).sum() > 50 and (drawn & away).sum() > 50
    assert ((made - sharp).max(-1)[drawn & strip] > 40).mean() < 0.02
    assert np.abs(made - seen).max(-1)[drawn & away].max() <= 1


def test_refused_depth_is_said(material: Material, arfx: Run, tmp_path: Path) -> None:
    unknown = np.full((SIZE[1], SIZE[0]), 1000, np.uint16)
    unknown[40:-40, 40:-40] = 0  # nothing on the print
    cv2.imwrite(str(tmp_path / "one.png"), unknown)
    r = arfx(
        *material.arguments(
            "-o", "out.mkv", "--depth", "one.png", "--end", "0.3", "--json"
        )
    )
    assert r.code == 0 and not r.json["depth"]["known"]
    assert (
        "the real depth is not used: 0 frames have depth on a marker's print" in r.err
    )
    assert any(
        h["check"].startswith("real depth") and h["verdict"] == "warn"
        for h in r.json["health"]
    )
