"""The main job through the command line: what comes out, what is refused, and what survives
a kill.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
from pathlib import Path

import av
import numpy as np
import pytest

from tests.cli.conftest import FRAMES, Material, Run, at_a_moment
from tests.clips import write_camera, write_clip


def frames(path: Path) -> list[tuple[float, np.ndarray]]:
    with av.open(str(path)) as c:
        return [
            (float(f.pts * f.time_base), f.to_ndarray(format="rgb24"))
            for f in c.decode(video=0)
        ]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_object_stands_on_the_marker_and_the_rest_is_untouched(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    r = arfx(
        *material.arguments("-o", "out.mkv", "--set", "output.codec=ffv1", "--json"),
        apart=True,
    )
    assert r.code == 0, r.err
    report = r.json
    before, after = frames(material.clip), frames(tmp_path / "out.mkv")
    assert len(before) == len(after) == report["output"]["frames"] == FRAMES
    assert max(abs(a[0] - b[0]) for a, b in zip(before, after, strict=True)) < 2e-3
    changed = [
        (a[1].astype(int) != b[1]).any(-1) for a, b in zip(before, after, strict=True)
    ]
    assert all(0.01 < c.mean() < 0.5 for c in changed), (
        "every frame shows the object, none is rewritten whole"
    )
    assert not any(c[:30].any() or c[-20:].any() for c in changed), (
        "rows far from the object are bit-identical"
    )
    # the ball's centre stands half its size above the marker's centre
    from tests.clips import clip_camera, pose_at

    for i in (0, FRAMES // 2, FRAMES - 1):
        centre = clip_camera().project(
            pose_at(i, FRAMES).apply(np.array([0, 0, 0.04]))
        )
        rgb = after[i][1].astype(int)
        ys, xs = np.nonzero(
            (rgb[..., 0] - rgb[..., 2] > 70) & changed[i]
        )  # the ball is orange, its shadow is not
        assert np.hypot(*(np.median(np.stack([xs, ys]), axis=1) - centre)) < 6
    assert (
        report["pose"]["frames_measured"] == FRAMES
        and report["pose"]["reprojection_px"]["median"] < 0.5
    )
    assert {
        "input",
        "output",
        "pose",
        "light",
        "stages",
        "health",
        "timing",
    } <= report.keys()
    assert not list(tmp_path.glob("*.job")), (
        "the job folder goes when the job is done"
    )


def test_a_damaged_packet_of_sound_is_left_out_with_a_word(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    clip = write_clip(tmp_path / "clip.ts", 4, audio=True)
    data = bytearray(clip.read_bytes())
    data[data.rfind(b"\xff\xf1\x50") + 1] = (
        0  # the last packet has no header: mp4 cannot hold it
    )
    clip.write_bytes(data)
    r = arfx(*material.arguments("-o", "out.mp4", clip=clip))
    assert r.code == 0, r.err
    assert (
        "damaged packets of sound, subtitles or data that were left out: 1" in r.err
    )
    with av.open(str(tmp_path / "out.mp4")) as c:
        assert len(list(c.demux(c.streams.audio[0]))) > 2
    assert len(frames(tmp_path / "out.mp4")) == 4


def test_sound_that_cannot_be_played_is_left_out_with_a_word(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    clip = write_clip(tmp_path / "clip.ts", 4, audio=True)
    data = clip.read_bytes().replace(
        b"\xff\xf1\x50", b"\xff\x01\x50"
    )  # no packet has a header: the rate is not known
    clip.write_bytes(data)
    r = arfx(*material.arguments("-o", "out.mp4", clip=clip))
    assert r.code == 0 and "audio aac is left out: it is damaged" in r.err, r.err
    assert len(frames(tmp_path / "out.mp4")) == 4


def test_audio_is_copied_bit_for_bit(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    r = arfx(*material.arguments("-o", "out.mp4"))
    assert r.code == 0, r.err

    def packets(path: Path) -> list[tuple[int, bytes]]:
        with av.open(str(path)) as c:
            s = c.streams.audio[0]
            return [
                (round(float(p.pts * s.time_base) * 44100), bytes(p))
                for p in c.demux(s)
                if p.size
            ]

    assert packets(tmp_path / "out.mp4") == packets(material.clip)


def test_an_image_sequence_holds_every_frame_of_every_chunk(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    (tmp_path / "frames").mkdir()
    r = arfx(
        *material.arguments("-o", "%04d.png", "--end", "1.1", "--job", "../kept"),
        cwd=tmp_path / "frames",
    )
    assert r.code == 0, r.err
    assert sorted(p.name for p in (tmp_path / "frames").glob("*.png")) == [
        f"{i:04d}.png" for i in range(34)
    ]
    times = [
        line.split()
        for line in (tmp_path / "frames" / "times.txt").read_text().splitlines()
    ]
    assert [int(i) for i, _ in times] == list(range(34))
    assert np.allclose([float(t) for _, t in times], np.arange(34) / 30, atol=1e-3)


def test_an_input_is_never_replaced_by_the_output(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    clip = write_clip(tmp_path / "clip.mp4", 4)
    before = digest(clip)
    r = arfx(*material.arguments("-o", "./clip.mp4", "--overwrite", clip=clip))
    assert r.code == 2 and "also an input" in r.err and digest(clip) == before


def test_a_folder_that_no_job_made_is_left_alone(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    (tmp_path / "mine" / "chunks").mkdir(parents=True)
    (tmp_path / "mine" / "chunks" / "notes.txt").write_text("keep")
    r = arfx(*material.arguments("-o", "out.mp4", "--job", "mine"))
    assert r.code == 2 and "not a job folder" in r.err
    assert (tmp_path / "mine" / "chunks" / "notes.txt").read_text() == "keep"


def test_a_percent_sign_in_a_video_name_is_only_a_name(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    (tmp_path / "other.mp4").touch()
    r = arfx(*material.arguments("-o", "50%.mp4", "--end", "0.1", "--json"))
    assert r.code == 0, r.err
    assert r.json["output"]["bytes"] == (tmp_path / "50%.mp4").stat().st_size


@pytest.mark.parametrize("name", ["frame.png", "%04d_%04d.png", "100%_%04d.png"])
def test_a_name_that_numbers_no_images_is_refused(
    material: Material, arfx: Run, name: str
) -> None:
    r = arfx(*material.arguments("-o", name))
    assert r.code == 2 and "number in its name" in r.err and "Traceback" not in r.err


def test_workers_and_threads_give_the_same_bytes(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    for name, how in (
        ("one", ("--workers", "1")),
        ("two", ("--workers", "2")),
        ("threads", ()),
    ):
        own = tmp_path / name
        own.mkdir()
        r = arfx(
            *material.arguments(
                "-o",
                "../" + name + ".mp4",
                "--job",
                "../job-" + name,
                "--end",
                "1.2",
                *how,
            ),
            cwd=own,
        )
        assert r.code == 0, r.err
    assert (
        digest(tmp_path / "one.mp4")
        == digest(tmp_path / "two.mp4")
        == digest(tmp_path / "threads.mp4")
    )


@pytest.mark.process
def test_a_killed_job_resumes_and_gives_the_same_bytes(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    whole = arfx(*material.arguments("-o", "whole.mp4", "--workers", "1"))
    assert whole.code == 0, whole.err
    killed = at_a_moment(
        tmp_path,
        "render",
        20,
        signal.SIGKILL,
        material.arguments("-o", "out.mp4", "--workers", "1"),
    )
    assert killed.returncode == -signal.SIGKILL
    assert not (tmp_path / "out.mp4").exists(), "nothing under the final name"
    chunks = tmp_path / "out.mp4.job" / "chunks"
    assert [c.name[:6] for c in chunks.iterdir() if re.match(r"\d{6}-", c.name)] == [
        "000000"
    ]
    r = arfx(
        *material.arguments(
            "-o",
            "out.mp4",
            "--workers",
            "1",
            "--resume",
            "--job",
            "out.mp4.job",
            "--json",
        )
    )
    assert r.code == 0, r.err
    assert digest(tmp_path / "out.mp4") == digest(tmp_path / "whole.mp4")
    assert f"render: 15/{FRAMES}" in r.err, "kept chunks are not made again"
    rows = [
        json.loads(line)
        for line in (tmp_path / "out.mp4.job" / "timings.jsonl")
        .read_text()
        .splitlines()
    ]
    rendered = [row["first"] for row in rows if row["work"] == "chunk"]
    assert r.json["timing"]["resumed"] is True
    assert {15, 30} <= set(rendered) and len(rendered) == len(set(rendered))


def test_outputs_are_never_overwritten_unasked(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    (tmp_path / "out.mp4").write_bytes(b"precious")
    r = arfx(*material.arguments("-o", "out.mp4", "--end", "0.2"))
    assert (
        r.code == 2
        and "--overwrite" in r.err
        and (tmp_path / "out.mp4").read_bytes() == b"precious"
    )
    assert (
        arfx(*material.arguments("-o", "out.mp4", "--end", "0.2", "--overwrite")).code
        == 0
    )
    assert (tmp_path / "out.mp4").stat().st_size > 1000


def test_start_and_end_select_frames_and_keep_their_times(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    r = arfx(
        *material.arguments(
            "-o",
            "out.mkv",
            "--start",
            "0.5",
            "--end",
            "1.0",
            "--set",
            "output.codec=ffv1",
        )
    )
    assert r.code == 0, r.err
    t = [f[0] for f in frames(tmp_path / "out.mkv")]
    want = [f[0] for f in frames(material.clip) if 0.5 - 1e-6 <= f[0] <= 1.0 + 1e-6]
    np.testing.assert_allclose(t, want, atol=1e-3)


def test_no_marker_at_all_exits_4_and_says_what_was_tried(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    clip = write_clip(tmp_path / "bare.mp4", 12, absent=range(12))
    r = arfx(*material.arguments("-o", "out.mp4", clip=clip))
    assert r.code == 4 and "36h11" in r.err and not (tmp_path / "out.mp4").exists()
    other = material.arguments("-o", "out.mp4")
    other[other.index("--marker") + 1] = "4X4_50:7:10cm"
    r = arfx(*other)
    assert r.code == 4 and "4X4_50" in r.err and "36h11:3" in r.err, (
        "it says what it saw instead"
    )


def test_a_marker_that_leaves_takes_the_object_along(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    clip = write_clip(tmp_path / "leaves.mp4", 90, absent=range(20, 75))
    r = arfx(
        *material.arguments(
            "-o", "out.mkv", "--set", "output.codec=ffv1", "--json", clip=clip
        )
    )
    assert r.code == 0, r.err
    assert r.json["pose"]["frames_absent"] > 20
    before, after = frames(clip), frames(tmp_path / "out.mkv")
    assert np.array_equal(before[47][1], after[47][1]) and not np.array_equal(
        before[5][1], after[5][1]
    )
    raster = next(s for s in r.json["stages"] if s["name"] == "raster")
    assert (
        raster["reasons"].get("marker not visible", 0) > 20
        and raster["frames_run"] + raster["frames_skipped"] == 90
    )


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (("--camera", "nan.yaml"), 3, "not finite"),
        (("--camera", "square.yaml"), 3, "aspect"),
        (("--camera", "none.yaml"), 3, "none.yaml"),
        (("--model", "broken.glb"), 3, "broken.glb"),
        (("--model", "none.glb"), 3, "none.glb"),
        (("--marker", "36h11:3"), 2, "FAMILY:ID:SIZE"),
        (("--marker", "37h11:3:1cm"), 2, "36h11"),
        (("--fit", "8"), 2, "25mm"),
        (("--fit", "800m"), 3, "800 m large"),
        (("--set", "raster.bakend=rays"), 2, "backend"),
        (("--pipeline", "watercolour"), 2, "watercolour"),
        (("-o", "no/such/folder/out.mp4"), 2, "no/such/folder"),
        (("-o", "out.xyz"), 2, "xyz"),
        (("--start", "500s"), 4, "--start"),
    ],
)
def test_bad_input_gets_one_clear_message(
    material: Material,
    arfx: Run,
    tmp_path: Path,
    change: tuple[str, str],
    code: int,
    says: str,
) -> None:
    from arfx.core.camera import Camera

    (tmp_path / "broken.glb").write_bytes(b"glTF\x02\x00\x00\x00 nothing else")
    write_camera(tmp_path / "nan.yaml")
    (tmp_path / "nan.yaml").write_text(
        (tmp_path / "nan.yaml")
        .read_text()
        .replace("304.", ".Nan", 1)
        .replace("3.04", ".Nan", 1)
    )
    write_camera(
        tmp_path / "square.yaml",
        Camera(500, 500, np.array([[450.0, 0, 250], [0, 450, 250], [0, 0, 1]])),
    )
    args = material.arguments("-o", "out.mp4")
    if change[0] in args and change[0] != "--set":
        args[args.index(change[0]) + 1] = change[1]
    else:
        args += change
    r = arfx(*args)
    assert r.code == code, (r.code, r.err)
    assert says in r.err and "Traceback" not in r.err
    assert not (tmp_path / "out.mp4").exists()


def test_a_camera_of_another_size_is_scaled_with_a_notice(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    from tests.clips import clip_camera

    write_camera(tmp_path / "double.yaml", clip_camera(640, 480))
    args = material.arguments("-o", "out.mp4", "--end", "0.3", "--json")
    args[args.index("--camera") + 1] = "double.yaml"
    r = arfx(*args)
    assert r.code == 0 and "scaled from 640x480" in r.err
    assert r.json["pose"]["reprojection_px"]["median"] < 0.5


def test_a_poor_calibration_is_a_notice_in_plan_and_report(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    from arfx.media.cameras import load_camera, save_camera

    camera = load_camera(material.camera)
    save_camera(
        tmp_path / "poor.yaml", camera, verdict="poor", reasons=["only 3 views"]
    )
    args = material.arguments("-o", "out.mp4", "--end", "0.1", "--json")
    args[args.index("--camera") + 1] = "poor.yaml"
    said = "its own verdict is poor (only 3 views)"
    assert arfx("plan", *args[1:]).err.count(said) == 1
    r = arfx(*args)
    assert sum(said in n for n in r.json["notices"]) == r.err.count(said) == 1, r.err


def test_without_a_camera_the_guess_is_said(material: Material, arfx: Run) -> None:
    args = material.arguments("-o", "out.mp4", "--end", "0.3", "--json")
    at = args.index("--camera")
    del args[at : at + 2]
    r = arfx(*args)
    assert (
        r.code == 0 and "guess" in r.err and r.json["health"][0]["verdict"] == "warn"
    )


def test_plan_explains_without_rendering(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    r = arfx(
        "plan", *material.arguments("-o", "out.mp4", "--workers", "2", "--json")[1:]
    )
    assert r.code == 0, r.err
    rows = {s["name"]: s for s in r.json["stages"]}
    assert (
        rows["raster"]["frames_run"] == FRAMES
        and 0 < rows["raster"]["area_fraction"] < 0.6
        and r.json["predicted_s"] > 0
    )
    assert not list(tmp_path.iterdir())


def test_forced_equals_planned(material: Material, arfx: Run, tmp_path: Path) -> None:
    for name, more in (("planned", ()), ("forced", ("--no-skip",))):
        r = arfx(
            *material.arguments(
                "-o",
                f"{name}.mkv",
                "--end",
                "0.5",
                "--set",
                "output.codec=ffv1",
                *more,
            )
        )
        assert r.code == 0, r.err
    pairs = zip(
        frames(tmp_path / "planned.mkv"), frames(tmp_path / "forced.mkv"), strict=True
    )
    assert max(np.abs(a[1].astype(int) - b[1]).max() for a, b in pairs) <= 1


def test_read_only_output_and_full_disk_are_one_message(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    folder = tmp_path / "ro"
    folder.mkdir()
    if os.geteuid() == 0 and not Path("/proc/self").exists():
        pytest.skip("root, and no /proc: nothing here is read-only")
    if (
        os.geteuid() == 0
    ):  # root writes through permissions: a file in place of the folder stands in for read-only
        r = arfx(*material.arguments("-o", "/proc/out.mp4"))
    else:
        folder.chmod(0o500)
        r = arfx(*material.arguments("-o", str(folder / "out.mp4")))
    assert (
        r.code in (2, 5)
        and "Traceback" not in r.err
        and len(r.err.strip().splitlines()) <= 3
    )


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk needs root")
def test_a_full_disk_leaves_nothing_half_written(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(disk)],
        capture_output=True,
        check=False,
    ).returncode:
        pytest.skip("cannot mount a tmpfs here")
    try:
        r = arfx(
            *material.arguments(
                "-o", str(disk / "out.mkv"), "--set", "output.codec=ffv1"
            ),
            apart=True,
        )
        assert r.code == 5 and "space" in r.err and "Traceback" not in r.err, r.err
        assert not (disk / "out.mkv").exists()
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_job_left_behind_is_not_cleared_unasked(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    more = ("-o", "out.mp4", "--end", "0.2", "--job", "kept")
    assert arfx(*material.arguments(*more)).code == 0
    (tmp_path / "out.mp4").unlink()
    r = arfx(*material.arguments(*more))
    assert (
        r.code == 2
        and "--resume" in r.err
        and (tmp_path / "kept" / "facts.jsonl").exists()
    )
    assert arfx(*material.arguments(*more, "--overwrite")).code == 0
    r = arfx(
        *material.arguments(
            "-o", "kept/out.mp4", "--end", "0.2", "--job", "kept", "--overwrite"
        )
    )
    assert (
        r.code == 2
        and "job folder" in r.err
        and (tmp_path / "kept" / "facts.jsonl").exists()
    )


def test_a_marker_that_is_never_seen_is_said(material: Material, arfx: Run) -> None:
    r = arfx(
        *material.arguments(
            "-o", "out.mp4", "--end", "0.2", "--marker", "36h11:7:10cm"
        )
    )
    assert r.code == 0 and "36h11:7 was never seen" in r.err


@pytest.mark.parametrize(
    ("option", "setting"),
    [
        (("--quality", "high"), "pipeline.quality=draft"),
        (("--quality", "high"), "pipeline.quality=high"),
        (("--no-skip",), "pipeline.skip=true"),
        (("--rotate", "0,0,90"), "model.rotate=[0, 0, 91]"),
        (("--marker", "36h11:4:10cm"), "marker.spec=36h11:3:10cm"),
        (("--pipeline", "auto"), "pipeline.stages=[]"),
        (("--start", "0.1"), "input.start=0.2s"),
        (("-o", "out.mp4"), "output.path=other.mp4"),
    ],
)
def test_an_option_and_a_setting_of_one_key_are_an_error(
    material: Material,
    arfx: Run,
    tmp_path: Path,
    option: tuple[str, ...],
    setting: str,
) -> None:
    r = arfx(*material.arguments("-o", "out.mp4", *option, "--set", setting))
    assert (
        r.code == 2 and " ".join(option) in r.err and f"--set {setting}" in r.err
    ), r.err
    assert "Traceback" not in r.err and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "pair",
    [("output.crf=20", "output.crf.more=1"), ("output.crf.more=1", "output.crf=20")],
)
def test_a_setting_below_another_is_one_message(
    material: Material, arfx: Run, pair: tuple[str, str]
) -> None:
    r = arfx(*material.arguments("-o", "out.mp4", "--set", pair[0], "--set", pair[1]))
    assert r.code == 2 and f"--set {pair[1]}" in r.err and "Traceback" not in r.err
