"""Damage in the middle of a clip is not its end: what follows is read, what is missing is
counted, with its time.
"""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from arfx.config.load import load
from arfx.core.machine import preserve_scheduling
from arfx.media.clip import probe
from arfx.media.frames import ClipReader, late_frames, missing_frames
from arfx.run import stretches
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.run.source import job_frame, release
from tests.clips import MARKER, write_camera, write_clip, write_model
from tests.unit.media.clips import make_clip, packets
from tests.unit.run.test_stretches import analysed, shuffled, threads

N = 96
PACKET = 188


def damaged(path: Path, suffix: str, codec: str, how: str = "flip") -> Path:
    """A clip of N frames, key frames each 12, in whose middle 1500 bytes are wrong."""
    whole = path / f"whole{suffix}"
    with preserve_scheduling(), av.open(str(whole), "w") as out:
        s = out.add_stream(codec, rate=30)
        s.width, s.height, s.pix_fmt = (
            320,
            240,
            "yuvj420p" if codec == "mjpeg" else "yuv420p",
        )
        s.codec_context.gop_size = 1 if codec == "ffv1" else 12
        if codec == "libx265":
            s.options = {
                "preset": "ultrafast",
                "x265-params": "log-level=none:keyint=12:pools=1:frame-threads=1",
            }
        ground = (
            np.random.default_rng(1)
            .integers(0, 255, (60, 160, 3))
            .astype(np.uint8)
            .repeat(4, 0)
            .repeat(4, 1)
        )
        for i in range(N):
            frame = av.VideoFrame.from_ndarray(
                np.ascontiguousarray(ground[:, 2 * i :][:, :320]), format="rgb24"
            )
            frame = frame.reformat(format=s.pix_fmt)
            frame.pts = i
            out.mux(s.encode(frame))
        out.mux(s.encode())
    data = np.fromfile(whole, np.uint8)
    middle = slice(len(data) // 2, len(data) // 2 + 1500)
    data[middle] = (
        0
        if how == "zero"
        else data[middle]
        ^ np.random.default_rng(2).integers(1, 256, 1500).astype(np.uint8)
    )
    data.tofile(path / f"damaged{suffix}")
    return path / f"damaged{suffix}"


@pytest.mark.parametrize("how", ["flip", "zero"])
@pytest.mark.parametrize(
    ("suffix", "codec"),
    [(".mkv", "libx264"), (".mkv", "libx265"), (".mkv", "libsvtav1"), (".mkv", "mjpeg"), (".mkv", "ffv1"),
     (".mp4", "libx264"), (".mp4", "libx265"), (".mp4", "libsvtav1"), (".mp4", "mjpeg"),
     (".avi", "libx264"), (".avi", "mpeg4"), (".avi", "mjpeg"), (".avi", "ffv1"), (".ts", "libx264"), (".ts", "libx265")],
)  # fmt: skip
def test_what_follows_damage_is_read_and_what_is_missing_counted(
    tmp_path: Path, suffix: str, codec: str, how: str
) -> None:
    info = probe(damaged(tmp_path, suffix, codec, how))
    with ClipReader(info, careful=True) as reader:
        shown = [f.pts for f in reader.frames()]
        assert reader.truncated is None
        times = reader.times()
    missing = missing_frames(shown, [] if times is None else times.pts)
    assert (
        len(shown) + sum(count for _, count in missing) == N and len(shown) > N // 2
    )
    at = [
        float((t - shown[0]) * info.time_base * 30)
        for t in (shown[-1], *(t for t, _ in missing))
    ]
    assert at[0] == pytest.approx(N - 1, abs=0.1), "what follows has moved"
    assert all(0.2 * N < t < 0.8 * N for t in at[1:])


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("stream") / "a.ts", N, audio=True)


def lost(stream: Path, folder: Path) -> Path:
    """The transport stream without one packet of its video."""
    data = stream.read_bytes()
    number = {
        int.from_bytes(data[k + 1 : k + 3]) & 0x1FFF: k
        for k in range(0, len(data), PACKET)
    }
    video = next(pid for pid in sorted(number) if pid >= 0x100)
    at = next(k for k in range(len(data) // PACKET // 2 * PACKET, len(data), PACKET)
              if int.from_bytes(data[k + 1 : k + 3]) & 0x1FFF == video)  # fmt: skip
    (folder / "lost.ts").write_bytes(data[:at] + data[at + PACKET :])
    return folder / "lost.ts"


def finished(
    clip: Path, out: Path, workers: int = 1
) -> tuple[dict[str, object], list[str]]:
    folder = out.parent
    document = {
        "input": {"clip": str(clip), "camera": str(write_camera(folder / "camera.yaml"))},
        "marker": [{"spec": str(MARKER)}], "model": {"file": str(write_model(folder / "model.glb")), "fit": "5cm"},
        "output": {"path": str(out)}, "pipeline": {"stages": ["lightmap"]},
    }  # fmt: skip
    said: list[str] = []
    report = process(
        load(None, document, parameters()),
        Options(workers=workers, overwrite=True, notice=said.append),
    )
    return json.loads(json.dumps(report)), said


def test_a_lost_packet_is_told_and_both_passes_give_the_same_frames(
    stream: Path, tmp_path: Path
) -> None:
    clip = lost(stream, tmp_path)
    report, said = finished(clip, tmp_path / "out.mkv")
    health = {h["check"]: h for h in report["health"]}
    missing = health["frames missing in the source"]["value"]
    assert (
        len(packets(tmp_path / "out.mkv", "video")) == N - missing and missing <= 12
    )
    assert (
        health["source file"]["value"] == "damaged"
        and report["input"]["truncated"] is None
    )
    assert sum(count for _, count in report["input"]["missing"]) == missing
    told = [s for s in said if "missing" in s or "guess" in s]
    assert len(told) == 1 and ("missing" in told[0]) == (missing > 0)


def test_joined_streams_go_on_with_their_sound(stream: Path, tmp_path: Path) -> None:
    clip = tmp_path / "twice.ts"
    clip.write_bytes(stream.read_bytes() * 2)
    report, _ = finished(clip, tmp_path / "out.mp4")
    assert report["input"]["frames"] == 2 * N and report["input"][
        "seconds"
    ] == pytest.approx(2 * N / 30, abs=1e-3)
    once, sound = packets(stream, "audio"), packets(tmp_path / "out.mp4", "audio")
    assert len(sound) > 2 * len(once) - 3
    assert sound[-1][1] - sound[0][1] == pytest.approx(
        once[-1][1] - once[0][1] + Fraction(N, 30), abs=1e-3
    )


def test_pictures_with_guessed_parts_are_the_same_for_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H.264 hides damage, and what it makes up depends on where decoding began, and on threads."""
    monkeypatch.setattr(stretches, "LEAST_FRAMES", 20)
    clip = write_clip(tmp_path / "a.mp4", N)
    with av.open(str(clip)) as c:
        middle = [p for p in c.demux(video=0) if p.size][N // 2]
    data = bytearray(clip.read_bytes())
    data[middle.pos + 40 : middle.pos + middle.size] = bytes(middle.size - 40)
    clip.write_bytes(data)
    for k, run in enumerate((shuffled, threads(2))):
        _, found = analysed(clip, tmp_path / f"{k}", run)
        assert found.damaged and found.careful and not found.truncated
    info = probe(clip)
    with ClipReader(info, careful=True) as reader:
        every = {f.pts: f.luma().copy() for f in reader.frames()}
    for index, pts in enumerate(found.pts[40:60], 40):
        frame = job_frame(info, found, index, True)
        assert frame.pts == pts and np.array_equal(frame.luma(), every[pts])
    release()


def test_a_clip_that_ends_in_damage_is_still_said_to_be_cut(
    tmp_path: Path, stream: Path
) -> None:
    data = stream.read_bytes()
    (tmp_path / "cut.ts").write_bytes(
        data[: len(data) * 6 // 10 // PACKET * PACKET + 100]
    )
    _, found = analysed(tmp_path / "cut.ts", tmp_path / "job")
    assert found.careful and 40 < len(found.pts) < 70 and found.missing == []
    clip = make_clip(
        tmp_path / "a.mp4", [512 * i for i in range(30)], options={"g": "1"}
    )
    with av.open(str(clip)) as c:
        last = [p for p in c.demux(video=0) if p.size][-2:]
    whole = bytearray(clip.read_bytes())
    for p in last:
        whole[p.pos : p.pos + p.size] = bytes(p.size)
    clip.write_bytes(whole)
    info = probe(clip)
    with ClipReader(info) as reader:
        shown, times = [f.pts for f in reader.frames()], reader.times()
    assert times is not None and late_frames(shown, times.pts) == 2 == 30 - len(shown)


def test_what_is_missing_is_told_from_what_was_never_there() -> None:
    every = list(range(0, 100, 2))
    assert missing_frames(every, every) == []
    assert missing_frames([t for t in every if t not in (20, 22, 60)], []) == [
        (20, 2),
        (60, 1),
    ]
    assert (
        missing_frames(
            [t for t in every if t != 20], [t for t in every if t != 20], gaps=False
        )
        == []
    ), "an index is complete"
    fields = [t / 2 for t in range(200)]
    assert missing_frames(every, [round(10 * t) for t in fields]) == [], (
        "a packet for each field, and one picture of both"
    )
    uneven = [0, 1, 5, 6, 14, 15, 30, 31, 33, 47]
    assert missing_frames(uneven, uneven) == [], "a clip of variable rate has no gaps"
    assert missing_frames([t for t in uneven if t != 33], uneven) == [(33, 1)]


def test_a_picture_of_another_size_is_damage_unless_it_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = probe(make_clip(tmp_path / "a.mp4", [512 * i for i in range(20)]))
    raw = ClipReader._raw

    def with_a_stranger(self: ClipReader, stream: object):  # type: ignore[no-untyped-def]
        for i, picture in enumerate(raw(self, stream)):
            yield av.VideoFrame(64, 64, "yuv420p") if i == 5 else picture

    monkeypatch.setattr(ClipReader, "_raw", with_a_stranger)
    with ClipReader(info) as reader:
        assert len(list(reader.frames())) == 19 and reader.damaged
