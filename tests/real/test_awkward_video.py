"""The awkward real clips: each is probed, read from anywhere, and written with its times,
streams, turn and tags.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.media.join import join_chunks
from arfx.media.output import OutputSettings, plan_output
from arfx.media.writer import ChunkWriter, chunk_suffix

DATA = (
    Path(__file__).parents[2].parent
    / "shared"
    / "data"
    / "awkward_video"
    / "meta-pytorch-torchcodec"
)
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the real clips are not at {DATA}"),
]

# name: frames, upright size, rotation, matrix, full range, bits, first time (s), further streams
CLIPS = {
    "bt601_limited_range.mp4": (60, (320, 240), 0, "bt601", False, 8, 0, 0),
    "bt709_full_range.mp4": (30, (1280, 720), 0, "bt709", True, 8, 0, 0),
    "discard_first_keyframe.mp4": (25, (64, 64), 0, "bt601", False, 8, 0, 0),
    "h264_10bits.mp4": (30, (200, 200), 0, "bt601", False, 10, 0, 0),
    "nasa_13013.mp4": (325, (320, 180), 0, "bt709", False, 8, 0, 5),
    "nasa_13013_rotated.mp4": (17, (270, 480), 90, "bt709", False, 8, 0, 0),
    "sine_stereo_mp2.mpg": (100, (128, 128), 0, "bt601", False, 8, 0.54, 1),
    "test_non_zero_start.mp4": (12, (200, 112), 0, "bt601", False, 8, 8.3330, 0),
    "testsrc2_av1_10bit.mp4": (25, (320, 240), 0, "bt601", False, 10, 0, 0),
    "testsrc2_mpeg4.mp4": (1, (64, 64), 0, "bt601", False, 8, 0, 0),
    "testsrc2_odd_height_and_width_444_10bit.mp4": (
        25,
        (321, 241),
        0,
        "bt601",
        False,
        10,
        0,
        0,
    ),
    "testsrc2_odd_height_and_width_mpeg2.mp4": (
        10,
        (121, 81),
        0,
        "bt601",
        False,
        8,
        0,
        0,
    ),
    "testsrc2_odd_height_and_width_vp9.mp4": (
        25,
        (321, 241),
        0,
        "bt601",
        False,
        8,
        0,
        0,
    ),
    "testsrc2_vp8.webm": (30, (1280, 720), 0, "bt601", False, 8, 0, 0),
}


@pytest.mark.parametrize("name", CLIPS)
def test_what_is_in_the_clip(name: str) -> None:
    count, size, rotation, matrix, full, bits, start_s, further = CLIPS[name]
    info = probe(DATA / name)
    with ClipReader(info) as r:
        frames = list(r.frames())
        assert r.truncated is None
    assert (len(frames), (info.width, info.height), info.rotation_deg) == (
        count,
        size,
        rotation,
    )
    assert (info.matrix, info.full_range, info.bit_depth, len(info.streams) - 1) == (
        matrix,
        full,
        bits,
        further,
    )
    assert (
        frames[0].time_s == pytest.approx(start_s, abs=1e-3)
        and frames[0].pts == info.start_pts
    )
    assert (
        frames[0].luma().shape
        == frames[0].linear(frames[0].rect).shape[:2]
        == size[::-1]
    )


@pytest.mark.parametrize("name", ["bt2020_10bit.mp4", "nasa_13013_hdr.mp4"])
def test_hdr_is_read_in_its_own_light(name: str) -> None:
    info = probe(DATA / name)
    assert info.hdr and info.transfer.name == "pq" and info.bit_depth == 10


@pytest.mark.parametrize("name", CLIPS)
def test_reading_from_a_time_is_reading_from_the_start(name: str) -> None:
    info = probe(DATA / name)
    with ClipReader(info) as r:
        everything = list(r.frames())
    for k in {len(everything) // 3, len(everything) // 2, len(everything) - 1}:
        with ClipReader(info) as r:
            part = list(itertools.islice(r.frames(everything[k].pts), 5))
        with ClipReader(info) as r:
            assert (
                len(list(r.frames(first_pts=everything[k].pts)))
                == len(everything) - k
            )
            assert r.truncated is None
        assert [f.pts for f in part] == [f.pts for f in everything[k : k + 5]]
        assert all(
            np.array_equal(a.luma(), b.luma())
            for a, b in zip(part, everything[k:], strict=False)
        )


@pytest.mark.parametrize("name", CLIPS)
def test_written_and_joined(name: str, tmp_path: Path) -> None:
    import av

    info = probe(DATA / name)
    plan = plan_output(info, tmp_path / "out.mp4", OutputSettings())
    with ClipReader(info) as r:
        frames = (
            list(itertools.islice(r.frames(), 60))
            if info.width > 1000
            else list(r.frames())
        )
    cuts = sorted({0, 1, len(frames) // 2, len(frames)} & set(range(len(frames) + 1)))
    chunks = []
    for a, b in itertools.pairwise(cuts):
        chunks.append(tmp_path / f"{a:06d}{chunk_suffix(plan)}")
        with ChunkWriter(plan, info, chunks[-1]) as w:
            for f in frames[a:b]:
                w.write(f)
    join_chunks(chunks, [f.pts for f in frames], plan, info, plan.path)
    out = probe(plan.path)
    with ClipReader(out) as r:
        got = list(r.frames())
    assert [f.pts * f.clip.time_base for f in got] == [
        f.pts * f.clip.time_base for f in frames
    ]
    assert (out.rotation_deg, out.bit_depth, out.full_range, out.matrix) == (
        info.rotation_deg,
        info.bit_depth,
        info.full_range,
        info.matrix,
    )
    tags = ("matrix_tag", "transfer_tag", "primaries_tag")
    assert [getattr(out, t) for t in tags] == [getattr(info, t) for t in tags]

    def further(path: Path, used: int) -> list[tuple[int, bytes]]:
        with av.open(str(path)) as c:
            return sorted(
                (p.stream_index, bytes(p))
                for p in c.demux()
                if p.size and p.stream_index != used
            )

    source = [b for _, b in further(info.path, info.stream_index)]
    assert sorted(b for _, b in further(plan.path, out.stream_index)) == sorted(
        source
    )
