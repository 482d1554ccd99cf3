"""The media contract: what goes through arfx keeps its times, its untouched pixels, its
streams and its tags.
"""

from __future__ import annotations

import itertools
import os
import resource
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from arfx.core.rect import Rect
from arfx.errors import ConfigError, InputError, RenderError
from arfx.media.clip import ClipInfo, probe
from arfx.media.codecs import CODECS
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.media.join import join_chunks
from arfx.media.output import (
    MAX_TICKS,
    OutputPlan,
    OutputSettings,
    check_times,
    plan_output,
)
from arfx.media.planes import planes_of
from arfx.media.writer import ChunkWriter, chunk_suffix
from tests.clips import write_clip
from tests.unit.media.clips import make_clip, packets

STEADY = [512 * i for i in range(20)]
VARIABLE = list(
    itertools.accumulate(
        [512, 256, 1024, 513, 97, 5000, 512, 640, 300, 30000, 512, 512, 77, 512, 600],
        initial=127995,
    )
)


def read(
    info: ClipInfo, first_pts: int | None = None, most: int | None = None
) -> list[Frame]:
    with ClipReader(info) as r:
        return list(itertools.islice(r.frames(first_pts), most))


def through(
    source: Path,
    out: Path,
    cuts: list[int],
    *,
    edit: Rect | None = None,
    **settings: str,
) -> tuple[list[Frame], OutputPlan]:
    """The clip in chunks that begin at `cuts`, joined; `edit` halves the light in a rectangle."""
    info = probe(source)
    plan = plan_output(info, out, OutputSettings(**settings))  # type: ignore[arg-type]
    frames = read(info)
    chunks = []
    for a, b in itertools.pairwise([*cuts, len(frames)]):
        chunk = out.parent / f"chunk{a:06d}{chunk_suffix(plan)}"
        with ChunkWriter(plan, info, chunk) as w:
            for f in frames[a:b]:
                if edit is not None:
                    before = f.linear(edit)
                    f = f.edited(edit, before, before * np.float32(0.5))
                w.write(f)
        chunks.append(chunk)
    join_chunks(chunks, [f.pts for f in frames], plan, info, out)
    return frames, plan


def times(frames: list[Frame]) -> list[Fraction]:
    return [f.pts * f.clip.time_base for f in frames]


def stored(frame: Frame) -> list[np.ndarray]:
    lay, f = frame.clip.layout, frame.clip
    cw = -(-f.coded_width >> lay.sub_x)
    widths = [f.coded_width] + [cw if lay.kind == "yuv" else f.coded_width] * 2
    return [
        p[:, :w].copy()
        for p, w in zip(planes_of(frame.picture, lay), widths, strict=False)
    ]


@pytest.mark.parametrize("codec", ["h264", "h265", "av1"])
@pytest.mark.parametrize(
    "pts", [STEADY, VARIABLE], ids=["steady", "variable, late, with a gap"]
)
def test_every_time_survives_chunks_with_reordered_frames(
    tmp_path: Path, codec: str, pts: list[int]
) -> None:
    source = make_clip(tmp_path / "in.mp4", pts)
    before, _ = through(source, tmp_path / "out.mp4", [0, 1, 8], codec=codec)
    after = read(probe(tmp_path / "out.mp4"))
    assert times(before) == [Fraction(p, 15360) for p in pts]
    assert times(after) == times(before)
    for a, b in zip(
        before, after, strict=True
    ):  # and the pictures are in the right order
        assert np.abs(a.luma().astype(int) - b.luma()).mean() < 6


def keys(path: Path) -> list[int]:
    """Numbers of the key frames, in the order in which they are shown."""
    with av.open(str(path)) as container:
        return [i for i, f in enumerate(container.decode(video=0)) if f.key_frame]


def test_key_frames_are_the_chunks_own_not_the_sources(tmp_path: Path) -> None:
    source = make_clip(tmp_path / "in.mp4", STEADY, options={"g": "2", "mbtree": "0"})
    through(source, tmp_path / "out.mp4", [0, 8])
    assert len(keys(source)) == 10 and keys(tmp_path / "out.mp4") == [0, 8]


def test_one_frame(tmp_path: Path) -> None:
    source = make_clip(tmp_path / "in.mp4", [4000])
    for codec in ("h264", "h265"):
        through(source, tmp_path / f"{codec}.mp4", [0], codec=codec)
        assert times(read(probe(tmp_path / f"{codec}.mp4"))) == [
            Fraction(4000, 15360)
        ]


@pytest.mark.parametrize("size", [(96, 64), (160, 96)])
@pytest.mark.parametrize("chunks", [[0], [0, 7]])
def test_same_frames_same_bytes(
    tmp_path: Path, chunks: list[int], size: tuple[int, int]
) -> None:
    source = make_clip(
        tmp_path / "in.mp4", STEADY, audio=True, width=size[0], height=size[1]
    )
    for suffix in (".mp4", ".mkv"):
        through(source, tmp_path / f"a{suffix}", chunks)
        through(source, tmp_path / f"b{suffix}", chunks)
        assert (tmp_path / f"a{suffix}").read_bytes() == (
            tmp_path / f"b{suffix}"
        ).read_bytes()


@pytest.mark.parametrize(
    ("pix_fmt", "size", "rotation"),
    [("yuv420p", (96, 64), None), ("yuv420p", (96, 64), 90), ("yuv420p", (97, 63), 270), ("yuv422p", (96, 64), 180),
     ("yuv444p10le", (97, 63), None), ("yuv420p10le", (96, 64), None), ("yuv420p12le", (96, 64), None), ("gray", (96, 64), None),
     ("bgr0", (96, 64), 90), ("yuv411p", (97, 63), None)],
)  # fmt: skip
def test_lossless_output_changes_only_the_rectangle(
    tmp_path: Path, pix_fmt: str, size: tuple[int, int], rotation: int | None
) -> None:
    source = make_clip(
        tmp_path / "in.mkv", [40, 80, 120], width=size[0], height=size[1], codec="ffv1", pix_fmt=pix_fmt, rotation=rotation,
        time_base=Fraction(1, 1000),
    )  # fmt: skip
    edit = Rect(11, 7, 30, 41)
    before, plan = through(
        source, tmp_path / "out.mkv", [0, 2], edit=edit, codec="ffv1"
    )
    assert plan.pixel_format == before[0].clip.layout.name
    after = read(probe(tmp_path / "out.mkv"))
    lay = before[0].clip.layout
    coded = before[0].clip.orientation.coded_rect(
        edit, before[0].rect.width, before[0].rect.height
    )
    grown = coded.align(1 << lay.sub_x, 1 << lay.sub_y)
    for a, b in zip(before, after, strict=True):
        assert b.clip.layout == lay
        for k, (p, q) in enumerate(zip(stored(a), stored(b), strict=True)):
            sx, sy = (lay.sub_x, lay.sub_y) if k and lay.kind == "yuv" else (0, 0)
            r = (
                Rect(
                    grown.x0 >> sx,
                    grown.y0 >> sy,
                    -(-grown.x1 >> sx),
                    -(-grown.y1 >> sy),
                )
                if k
                else coded
            )
            same = p == q
            assert not same[r.slices].all() or k  # luma did change inside
            same[r.slices] = True
            assert same.all()


@pytest.mark.parametrize("rotation", [90, 180, 270])
def test_rotation_is_honoured_and_kept(tmp_path: Path, rotation: int) -> None:
    source = make_clip(tmp_path / "in.mp4", STEADY[:3], rotation=rotation)
    plain = make_clip(tmp_path / "plain.mp4", STEADY[:3])
    frames, _ = through(source, tmp_path / "out.mp4", [0])
    info, flat = probe(tmp_path / "out.mp4"), read(probe(plain))
    assert info.rotation_deg == probe(source).rotation_deg == rotation
    assert (info.width, info.height) == ((64, 96) if rotation != 180 else (96, 64))
    assert np.array_equal(frames[1].luma(), np.rot90(flat[1].luma(), rotation // 90))
    assert frames[1].linear(frames[1].rect).shape == (info.height, info.width, 3)
    whole = np.rot90(flat[1].linear(flat[1].rect), rotation // 90)
    part = Rect(10, 20, 41, 50)
    assert np.array_equal(frames[1].linear(part), whole[part.slices])


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("matrix", [1, 6])
def test_colours_are_read_as_they_were_made(
    tmp_path: Path, full: bool, matrix: int
) -> None:
    source = make_clip(
        tmp_path / "in.mp4", [0], full_range=full, matrix=matrix, pix_fmt="yuv444p", options={"qp": "0"}
    )  # fmt: skip
    info = probe(source)
    assert (info.full_range, info.matrix) == (full, {1: "bt709", 6: "bt601"}[matrix])
    from tests.unit.media.clips import pattern

    frame = read(info)[0]
    shown = info.transfer.encode(frame.linear(frame.rect)) * 255
    assert (
        np.abs(shown - pattern(0, 96, 64)).mean() < 0.8
    )  # 8-bit rounding of Y, Cb and Cr; a wrong matrix or range gives > 4
    through(source, tmp_path / "out.mp4", [0])
    out = probe(tmp_path / "out.mp4")
    assert (
        (out.matrix_tag, out.range_tag)
        == (info.matrix_tag, info.range_tag)
        == (matrix, 2 if full else 1)
    )


@pytest.mark.parametrize(
    ("codec", "suffix", "depth"),
    [
        ("h264", ".mp4", 10),
        ("h265", ".mp4", 10),
        ("av1", ".mp4", 10),
        ("prores", ".mov", 10),
    ],
)
def test_ten_bits_stay_ten(
    tmp_path: Path, codec: str, suffix: str, depth: int
) -> None:
    source = make_clip(
        tmp_path / "in.mkv",
        [0, 40],
        codec="ffv1",
        pix_fmt="yuv420p10le",
        time_base=Fraction(1, 1000),
    )
    through(source, tmp_path / f"out{suffix}", [0], codec=codec)
    info = probe(tmp_path / f"out{suffix}")
    assert info.bit_depth == depth
    assert (info.layout.subsampling == "444") == (codec == "prores")


def test_odd_sizes_become_444_with_a_notice(tmp_path: Path) -> None:
    source = make_clip(
        tmp_path / "in.mkv",
        [0, 40],
        width=97,
        height=63,
        codec="ffv1",
        time_base=Fraction(1, 1000),
    )
    _, plan = through(source, tmp_path / "out.mp4", [0])
    assert plan.pixel_format == "yuv444p" and any("odd" in n for n in plan.notices)
    out = probe(tmp_path / "out.mp4")
    assert (out.width, out.height) == (97, 63)
    with pytest.raises(ConfigError, match="odd picture size 97x63"):
        plan_output(probe(source), tmp_path / "out.mp4", OutputSettings(codec="av1"))


def test_audio_is_copied_bit_for_bit_and_cut_at_packets(tmp_path: Path) -> None:
    source = make_clip(
        tmp_path / "in.mp4", [15360 + 512 * i for i in range(60)], audio=True
    )
    frames, plan = through(source, tmp_path / "out.mp4", [0, 20])
    assert packets(tmp_path / "out.mp4", "audio") == packets(source, "audio")
    info = probe(source)
    kept = [f for f in frames if 0.5 <= f.time_s - frames[0].time_s < 1.25]
    chunk = tmp_path / "cut.nut"
    with ChunkWriter(plan, info, chunk) as w:
        for f in kept:
            w.write(f)
    join_chunks(
        [chunk], [f.pts for f in kept], plan, info, tmp_path / "cut.mp4", 0.5, 1.25
    )
    cut = packets(tmp_path / "cut.mp4", "audio")
    long = Fraction(1024, 48000)
    assert cut == [
        p
        for p in packets(source, "audio")
        if p[1] + long > Fraction(3, 2) and p[1] < Fraction(9, 4)
    ]
    assert 30 < len(cut) < 40
    assert times(read(probe(tmp_path / "cut.mp4"))) == times(
        kept
    )  # absolute, as in the source


def test_a_container_that_cannot_hold_the_audio_is_refused_with_one_that_can(
    tmp_path: Path,
) -> None:
    info = probe(make_clip(tmp_path / "in.mp4", STEADY, audio=True))
    with pytest.raises(
        ConfigError, match=r"\.webm file cannot hold the clip's audio \(aac\)"
    ) as e:
        plan_output(info, tmp_path / "out.webm")
    assert ".mkv" in e.value.hint
    with pytest.raises(ConfigError, match="cannot hold h264"):
        plan_output(info, tmp_path / "out.webm", OutputSettings(codec="h264"))
    with pytest.raises(ConfigError, match="unknown codec"):
        plan_output(info, tmp_path / "out.mp4", OutputSettings(codec="h266"))
    with pytest.raises(ConfigError, match="unknown output format"):
        plan_output(info, tmp_path / "out.gif")


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_a_truncated_file_gives_its_good_frames_and_says_so(
    tmp_path: Path, suffix: str
) -> None:
    codec = "mpeg4" if suffix == ".avi" else "libx264"
    whole = make_clip(tmp_path / f"whole{suffix}", [i * 512 if suffix == ".mp4" else i for i in range(60)], codec=codec,
                      time_base=Fraction(1, 15360) if suffix == ".mp4" else Fraction(1, 30))  # fmt: skip
    cut = tmp_path / f"cut{suffix}"
    data = whole.read_bytes()
    cut.write_bytes(data[: len(data) * 6 // 10])
    with ClipReader(probe(whole)) as r:
        good = list(r.frames())
        assert r.truncated is None
    info = probe(cut)
    with ClipReader(info) as r:
        got = list(r.frames())
        assert r.truncated is not None and "last good" in r.truncated
    assert 10 < len(got) < len(good)
    same = {f.pts: f for f in good}
    for f in got:
        assert np.array_equal(f.luma(), same[f.pts].luma())


def test_reading_from_any_time_equals_reading_from_the_start(tmp_path: Path) -> None:
    info = probe(
        make_clip(
            tmp_path / "in.mp4",
            VARIABLE,
            options={"g": "5", "bf": "2", "x264-params": "open-gop=1"},
        )
    )
    everything = read(info)
    for k in range(len(everything)):
        part = read(info, everything[k].pts, 4)
        assert [f.pts for f in part] == [f.pts for f in everything[k : k + 4]]
        for a, b in zip(part, everything[k:], strict=False):
            assert np.array_equal(a.luma(), b.luma())


def test_images_hold_every_frame_upright_with_its_time(tmp_path: Path) -> None:
    source = make_clip(tmp_path / "in.mp4", VARIABLE[:4], rotation=90)
    for kind in ("png", "exr"):
        frames, _ = through(source, tmp_path / kind / f"%03d.{kind}", [0, 1])
        from arfx.media.images import load_image

        for f in frames:
            image = load_image(tmp_path / kind / f"{f.index:03d}.{kind}")
            shown = f.linear(f.rect)
            if kind == "exr":
                assert np.array_equal(image, shown)
            else:
                assert np.abs(image - np.clip(shown, 0, 1)).max() < 0.005
        lines = (tmp_path / kind / "times.txt").read_text().split()
        assert [float(t) for t in lines[1::2]] == pytest.approx(
            [f.time_s for f in frames], abs=1e-8
        )


def test_errors_name_the_file(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("not a video")
    for path, message in (
        (tmp_path / "none.mp4", "no such file"),
        (tmp_path / "text.mp4", "cannot be read"),
        (tmp_path, "folder"),
    ):
        with pytest.raises(InputError, match=message):
            probe(path)
    sound = tmp_path / "sound.wav"
    with av.open(str(sound), "w") as out:
        s = out.add_stream("pcm_s16le", rate=48000)
        f = av.AudioFrame.from_ndarray(
            np.zeros((1, 2048), np.int16), format="s16", layout="stereo"
        )
        f.sample_rate = 48000
        out.mux(s.encode(f))
    with pytest.raises(InputError, match="no video stream"):
        probe(sound)


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.media.join import join_chunks
from arfx.media.output import plan_output
from arfx.media.writer import ChunkWriter
from arfx.errors import RenderError
folder = Path(sys.argv[1])
info = probe(folder / "in.mp4")
plan = plan_output(info, folder / "out.mp4")
def write(path):
    with ClipReader(info) as r, ChunkWriter(plan, info, path) as w:
        pts = []
        for f in r.frames():
            w.write(f); pts.append(f.pts)
    return pts
pts = write(folder / "a.nut")
resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
for work in (lambda: write(folder / "b.nut"), lambda: join_chunks([folder / "a.nut"], pts, plan, info, folder / "out.mp4")):
    try:
        work()
    except RenderError as e:
        print("refused:", e.message)
"""


def test_a_full_disk_is_one_clear_error_and_leaves_nothing(tmp_path: Path) -> None:
    assert resource.getrlimit(
        resource.RLIMIT_FSIZE
    )  # the limit on a file's size stands in for a full disk
    make_clip(tmp_path / "in.mp4", STEADY, audio=True)
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("refused:") == 2 and "cannot be written" in done.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.nut", "in.mp4"]


def test_chunks_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    source = make_clip(tmp_path / "in.mp4", STEADY)
    frames, plan = through(source, tmp_path / "out.mp4", [0])
    info, pts = probe(source), [f.pts for f in frames]
    (tmp_path / "out.mp4").unlink()
    with pytest.raises(RenderError, match="hold 20 frames, the clip has 19"):
        join_chunks(
            [tmp_path / "chunk000000.nut"], pts[:-1], plan, info, tmp_path / "out.mp4"
        )
    other = plan_output(info, tmp_path / "out.mp4", OutputSettings(preset="medium"))
    with ChunkWriter(other, info, tmp_path / "b.nut") as w:
        w.write(frames[0])
    with pytest.raises(RenderError, match="other settings"):
        join_chunks(
            [tmp_path / "chunk000000.nut", tmp_path / "b.nut"],
            [*pts, pts[-1] + 9],
            plan,
            info,
            tmp_path / "out.mp4",
        )
    with (
        pytest.raises(ZeroDivisionError),
        ChunkWriter(plan, info, tmp_path / "c.nut") as w,
    ):
        w.write(frames[0])
        raise ZeroDivisionError
    assert not list(tmp_path.glob("c.nut*")) and not list(tmp_path.glob("out.mp4*"))


@pytest.mark.parametrize(
    ("codec", "name"), [("h264", "out.mp4"), ("h265", "out.mkv"), ("av1", "out.webm")]
)
def test_a_preset_is_tried_before_any_work(
    tmp_path: Path, codec: str, name: str
) -> None:
    info = probe(write_clip(tmp_path / "clip.mp4", 1))
    usual = CODECS[codec].preset
    assert (
        dict(
            plan_output(
                info, tmp_path / name, OutputSettings(codec, preset=usual)
            ).options
        )["preset"]
        == usual
    )
    with pytest.raises(ConfigError, match="does not take preset '--help'"):
        plan_output(info, tmp_path / name, OutputSettings(codec, preset="--help"))
    if hasattr(os, "sched_getscheduler"):
        assert os.sched_getscheduler(0) == os.SCHED_OTHER, (
            "as root, AV1 makes real-time processes"
        )


def test_a_frame_that_lasts_longer_than_mp4_can_say_is_told_before_rendering(
    tmp_path: Path,
) -> None:
    info = probe(write_clip(tmp_path / "clip.mp4", 1))
    mp4, mkv = (plan_output(info, tmp_path / name) for name in ("out.mp4", "out.mkv"))
    for plan, pts in (
        (mp4, [0, MAX_TICKS, 2 * MAX_TICKS]),
        (mp4, [0]),
        (mkv, [0, 10**12]),
    ):
        check_times(plan, pts, Fraction(1, 1000))
    with pytest.raises(ConfigError, match=r"24\.9 days.*\.mp4"):
        check_times(mp4, [0, MAX_TICKS + 1], Fraction(1, 1000))


@pytest.mark.parametrize("pts", [STEADY, VARIABLE], ids=["steady", "variable"])
@pytest.mark.parametrize(
    ("codec", "suffix"),
    [
        *itertools.product(("h264", "h265"), (".mp4", ".mov", ".mkv")),
        *itertools.product(("av1",), (".mp4", ".mkv")),
        ("prores", ".mov"),
        ("ffv1", ".mkv"),
    ],
)
def test_files_state_their_frames_rate_and_length(
    tmp_path: Path, codec: str, suffix: str, pts: list[int]
) -> None:
    """As players read them, frames that are shown in another order than they are decoded in
    included.
    """
    source = make_clip(tmp_path / "in.mp4", pts)
    through(source, tmp_path / f"out{suffix}", [0, 7], codec=codec)
    length_s = float((pts[-1] - pts[0] + pts[-1] - pts[-2]) * probe(source).time_base)
    with av.open(str(tmp_path / f"out{suffix}")) as out:
        stream = out.streams.video[0]
        if suffix == ".mkv":
            assert (
                out.duration / av.time_base - out.start_time / av.time_base
                == pytest.approx(length_s, abs=0.002)
            )
        else:
            assert stream.frames == len(pts)
            assert float(stream.duration * stream.time_base) == pytest.approx(
                length_s, abs=1e-3
            )
            assert float(stream.average_rate) == pytest.approx(
                len(pts) / length_s, rel=1e-3
            )
