"""A tin before the object, then behind it: whole jobs with depth in one file, against the
scene's exact masks.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.media.depth_maps import open_depth
from arfx.synth.clip import make_clip
from arfx.synth.description import load_scene
from tests.cli.conftest import Run
from tests.cli.test_process import frames

SCENE = (
    Path(__file__).parents[2]
    / "sample_scenes"
    / "0022-before-and-behind"
    / "scene.toml"
)
BEFORE, BEHIND = (1, 3, 4), (10, 11)
SHARP = ("--pipeline", "lightmap", "--codec", "ffv1", "--json")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clip, maps (video of 16-bit grey) and masks of the scene."""
    folder = tmp_path_factory.mktemp("occlusion") / "clip"
    make_clip(
        load_scene(SCENE).model_copy(update={"samples": 1, "truth": ("mask",)}),
        folder,
    )
    return folder


def pictures(path: Path) -> list[np.ndarray]:
    return [rgb.astype(int) for _, rgb in frames(path)]


def tin(made: Path, frame: int, grown_px: int) -> np.ndarray:
    """(h, w) bool, of the exact mask, larger or smaller by that."""
    number = [p.name for p in load_scene(SCENE).objects].index("tin") + 1
    mask = (
        cv2.imread(
            str(made / "truth" / "mask" / f"{frame:06d}.png"), cv2.IMREAD_UNCHANGED
        )
        == number
    ).astype(np.uint8)
    box = np.ones((2 * abs(grown_px) + 1,) * 2, np.uint8)
    return (cv2.dilate(mask, box) if grown_px > 0 else cv2.erode(mask, box)) > 0


def rough(picture: np.ndarray, where: np.ndarray) -> float:
    """Mean step from pixel to pixel."""
    return float(np.abs(np.diff(picture.mean(-1), axis=1))[where[:, 1:]].mean())


def test_depth_in_one_file_decides_what_hides_what(
    made: Path, arfx: Run, tmp_path: Path
) -> None:
    job = ("process", "--config", str(made / "job.toml"))
    deep = arfx(*job, "-o", str(tmp_path / "deep.mkv"), *SHARP)
    assert deep.code == 0, deep.err
    told = deep.json["depth"]
    assert told["known"] and told["paired_by"] == "time" and told["frames_with"] == 12
    assert told["scale"] == pytest.approx(1.0, rel=0.01)
    assert {"holdout", "hide"} <= {s["name"] for s in deep.json["stages"]}
    bare = made / "bare.toml"
    lines = (made / "job.toml").read_text(encoding="utf-8").splitlines()
    bare.write_text(
        "\n".join(x for x in lines if not x.startswith("depth")), encoding="utf-8"
    )
    flat = arfx(
        "process", "--config", str(bare), "-o", str(tmp_path / "flat.mkv"), *SHARP
    )
    assert flat.code == 0, flat.err
    assert not {"holdout", "hide"} & {s["name"] for s in flat.json["stages"]}
    source, with_depth, without = (
        pictures(p)
        for p in (made / "clip.mp4", tmp_path / "deep.mkv", tmp_path / "flat.mkv")
    )

    for n in (
        BEFORE
    ):  # nearer: neither the object nor its shadow on the plane is seen on the tin
        drawn = np.abs(without[n] - source[n]).max(-1)
        inside, away = tin(made, n, -2), ~tin(made, n, 4)
        left = np.abs(with_depth[n] - source[n]).max(-1)[inside & (drawn > 6)]
        assert len(left) > 100 and (left > 6).mean() < 0.02, (
            n,
            len(left),
            (left > 6).mean(),
        )
        lost = np.abs(with_depth[n] - without[n]).max(-1)[away & (drawn > 6)]
        assert len(lost) > 1000 and (lost > 6).mean() < 0.005, (
            n,
            len(lost),
            (lost > 6).mean(),
        )
    for n in BEHIND:  # farther: the object hides it, as if there were no depth
        covered = tin(made, n, -1) & (np.abs(without[n] - source[n]).max(-1) > 40)
        assert covered.sum() > 150, (n, covered.sum())
        assert np.abs(with_depth[n] - without[n]).max(-1)[covered].max() <= 2

    # the same maps as pages of a TIFF: the same picture, bit for bit
    maps = open_depth(made / "depth.mkv")
    pages = [maps.read(k) for k in range(maps.count)]
    assert cv2.imwritemulti(str(tmp_path / "depth.tiff"), pages)
    again = arfx(
        *job,
        "-o",
        str(tmp_path / "pages.mkv"),
        "--depth",
        str(tmp_path / "depth.tiff"),
        *SHARP,
    )
    assert again.code == 0, again.err
    assert again.json["depth"]["paired_by"] == "order"
    for a, b in zip(pictures(tmp_path / "pages.mkv"), with_depth, strict=True):
        np.testing.assert_array_equal(a, b)

    # with a lens focused on the object: the tin before it is out of focus, the object is not
    blurred = arfx(*job, "-o", str(tmp_path / "lens.mkv"), "--codec", "ffv1")
    assert blurred.code == 0, blurred.err
    lens = pictures(tmp_path / "lens.mkv")
    for n in BEFORE:
        within = tin(made, n, -5)
        object_only = (np.abs(without[n] - source[n]).max(-1) > 40) & ~tin(
            made, n, 12
        )
        assert rough(lens[n], within) < 0.6 * rough(with_depth[n], within)
        assert rough(lens[n], object_only) > 0.9 * rough(with_depth[n], object_only)
