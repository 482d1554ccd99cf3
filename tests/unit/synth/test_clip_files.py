"""Written clips read with plain PyAV: times, rotation, colours, sound, sameness; and
folders that appear whole or not at all.
"""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import av
import numpy as np
import pytest

from arfx.errors import ConfigError
from arfx.media.cameras import load_camera
from arfx.media.depth_maps import open_depth
from arfx.synth import clip as clip_module
from arfx.synth.clip import make_clip
from arfx.synth.picture import expose
from arfx.synth.truth import read_truth
from tests.unit.synth.little_scenes import little_scene, picture_of

ORBIT = {
    "kind": "orbit",
    "radius_m": 0.35,
    "azimuth_deg": [-100, -85],
    "elevation_deg": [50, 50],
}
PARTS = {
    "plane": [
        {"size_m": [2, 2], "position_m": [0, 0, "-1mm"], "texture": {"kind": "wood"}}
    ],
    "marker": [{"spec": "36h11:3:100mm"}],
    "light": {"ambient_rgb": [0.5, 0.4, 0.3]},
}


def decoded(path: Path) -> tuple[list[float], list[list[np.ndarray]], int]:
    """Times, planes as coded (swscale's way to RGB is off by a grey level), rotation by
    PyAV's sign (counter-clockwise).
    """
    with av.open(str(path)) as c:
        frames = list(c.decode(video=0))
        times = [float(f.pts * f.time_base) for f in frames]
        return (
            times,
            [[planar(p) for p in f.planes] for f in frames],
            frames[0].rotation,
        )


def planar(plane: av.video.plane.VideoPlane) -> np.ndarray:
    return (
        np.frombuffer(plane, np.uint8)
        .reshape(plane.height, plane.line_size)[:, : plane.width]
        .astype(float)
    )


def bt709(coded: np.ndarray) -> list[np.ndarray]:
    """Y', Cb, Cr of ITU-R BT.709, limited range of 8 bits, from R'G'B' (h, w, 3) in 0..1."""
    r, g, b = np.moveaxis(coded.astype(float), -1, 0)
    y = 0.2126 * r + 0.7152 * g + 0.0722 * b
    return [16 + 219 * y, 128 + 224 * (b - y) / 1.8556, 128 + 224 * (r - y) / 1.5748]


@pytest.mark.parametrize(
    "clip",
    [
        {"file": "clip.mkv"},
        {"file": "clip.mp4", "crf": 4},
        {
            "file": "clip.mp4",
            "crf": 4,
            "frame_times": "variable",
            "start_s": 1.4,
            "rotation_deg": 90,
        },
        {"file": "clip.mp4", "crf": 4, "rotation_deg": 270},
    ],
    ids=["lossless", "h264", "variable, late, turned", "turned the other way"],
)
def test_what_is_written_is_what_was_seen(tmp_path: Path, clip: dict) -> None:
    scene = little_scene(128, 96, frames=5, path=ORBIT, clip=clip, **PARTS)
    truth = make_clip(scene, tmp_path / "out")
    times, pictures, rotation = decoded(tmp_path / "out" / clip["file"])
    assert np.allclose(
        times,
        [f.time_s for f in truth.frames],
        atol=1e-3 if clip["file"].endswith("mkv") else 1.2e-5,
    )
    assert times[0] == pytest.approx(clip.get("start_s", 0), abs=1e-3)
    assert (len(set(np.round(np.diff(times), 4))) > 1) == (
        clip.get("frame_times") == "variable"
    )
    assert rotation % 360 == clip.get("rotation_deg", 0)
    world, picture = picture_of(scene)
    for n, shown in enumerate(pictures):
        exact = bt709(
            expose(scene, picture.radiance(n), n, float(world.frame_times_s[n]))
        )
        upright = np.rot90(shown[0], rotation // 90)
        assert upright.shape == exact[0].shape
        assert np.abs(upright - exact[0]).mean() < 0.8
        for plane, whole in zip(shown, exact, strict=True):
            assert abs(plane.mean() - whole.mean()) < 0.3


def test_the_same_scene_gives_the_same_bytes_and_another_seed_others(
    tmp_path: Path,
) -> None:
    noisy = {**PARTS, "noise": {"read": 0.01}}
    digests = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        make_clip(
            little_scene(64, 48, frames=3, path=ORBIT, seed=seed, **noisy),
            tmp_path / name,
        )
        digests.append(
            {
                p.name: hashlib.sha256(p.read_bytes()).hexdigest()
                for p in (tmp_path / name).iterdir()
            }
        )
    assert digests[0] == digests[1]
    assert (
        digests[0]["clip.mp4"] != digests[2]["clip.mp4"]
        and digests[0]["camera.yaml"] == digests[2]["camera.yaml"]
    )


def test_a_tone_of_the_stated_pitch_and_length(tmp_path: Path) -> None:
    make_clip(
        little_scene(64, 48, frames=8, path=ORBIT, clip={"tone_hz": 440}, **PARTS),
        tmp_path / "out",
    )
    with av.open(str(tmp_path / "out" / "clip.mp4")) as c:
        sound = np.concatenate([f.to_ndarray()[0] for f in c.decode(audio=0)])
    assert len(sound) == pytest.approx(0.8 * 48_000, abs=2048)
    spectrum = np.abs(np.fft.rfft(sound))
    assert np.fft.rfftfreq(len(sound), 1 / 48_000)[
        spectrum.argmax()
    ] == pytest.approx(440, abs=3)


def test_the_stated_camera_is_the_true_one(tmp_path: Path) -> None:
    make_clip(little_scene(64, 48, frames=1, path=ORBIT, **PARTS), tmp_path / "out")
    stated, header = (
        load_camera(tmp_path / "out" / "camera.yaml"),
        read_truth(tmp_path / "out" / "truth.jsonl").header,
    )
    true_f = 32 / np.tan(np.radians(30))
    assert stated.matrix[0, 0] == pytest.approx(true_f)
    assert stated.matrix[0, 2] == pytest.approx(31.5)
    assert header["markers"] == {"36h11:3": pytest.approx(0.1)}


def test_truth_pictures_are_there_when_asked_for(tmp_path: Path) -> None:
    scene = little_scene(64, 48, frames=2, path=ORBIT, **PARTS).model_copy(
        update={"truth": ("depth", "mask", "flow")}
    )
    make_clip(scene, tmp_path / "with")
    make_clip(scene, tmp_path / "without", truth_pictures=False)
    assert sorted(
        p.relative_to(tmp_path / "with" / "truth").as_posix()
        for p in (tmp_path / "with" / "truth").rglob("*.png")
    ) == [f"{kind}/{n:06d}.png" for kind in ("depth", "flow", "mask") for n in (0, 1)]
    assert not (tmp_path / "without" / "truth").exists()


def test_nothing_is_left_of_a_clip_that_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(clip_module, "save_camera", broken)
    with pytest.raises(KeyboardInterrupt):
        make_clip(
            little_scene(64, 48, frames=1, path=ORBIT, **PARTS), tmp_path / "out"
        )
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_replaced_only_on_request(tmp_path: Path) -> None:
    scene = little_scene(64, 48, frames=1, path=ORBIT, **PARTS)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="exists"):
        make_clip(scene, tmp_path / "out")
    with pytest.raises(ConfigError, match=r"mine\.txt"):
        make_clip(scene, tmp_path / "out", overwrite=True)
    (tmp_path / "out" / "mine.txt").unlink()
    make_clip(scene, tmp_path / "out", overwrite=True)
    assert (tmp_path / "out" / "clip.mp4").exists()


def test_a_depth_input_is_the_true_depth_as_a_camera_measures_it(
    tmp_path: Path,
) -> None:
    name = "depth.mkv"
    parts = {
        **PARTS,
        "box": [{"size_m": ["6cm", "6cm", "9cm"], "position_m": [0.12, 0, 0]}],
    }
    exact = little_scene(128, 96, frames=3, path=ORBIT, depth={"file": name}, **parts)
    rough = little_scene(
        128,
        96,
        frames=3,
        path=ORBIT,
        depth={"file": name, "noise": 0.01, "holes": 0.1, "edge_px": 2},
        **parts,
    )
    make_clip(exact, tmp_path / "exact")
    make_clip(rough, tmp_path / "rough")
    job = tomllib.loads(
        (tmp_path / "exact" / "job.toml").read_text(encoding="utf-8")
    )["input"]
    maps = open_depth(tmp_path / "exact" / job["depth"], job["depth_scale"])
    noisy = open_depth(tmp_path / "rough" / job["depth"], job["depth_scale"])
    assert maps.of_frames([0.0, 0.1, 0.2], 0, whole=True) == [0, 1, 2]
    picture = picture_of(exact)[1]
    for n in range(3):
        depth = picture.surfaces(n)[0]
        assert np.abs(maps.load(n, 128, 96) - depth).max() < 1.1e-4, "half a step"
        seen = noisy.load(n, 128, 96)
        good = seen > 0
        off = seen[good] / depth[good] - 1
        assert off.std() == pytest.approx(0.01, rel=0.1) and abs(off.mean()) < 0.001
        edges = np.abs(np.diff(depth, axis=1)) > 0.06 * depth[:, 1:]
        assert (
            edges.sum() > 20
            and not good[:, 1:][edges].any()
            and not good[:, :-1][edges].any()
        )
        assert 0.1 < (~good).mean() < 0.3


def test_a_folder_that_appears_meanwhile_is_not_replaced_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = tmp_path / "out"

    def fill(*_: object) -> None:
        first.mkdir()  # another process was quicker

    monkeypatch.setattr("arfx.synth.clip._fill", fill)
    with pytest.raises(ConfigError, match="exists"):
        make_clip(little_scene(64, 48, frames=1, path=ORBIT, **PARTS), first)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
