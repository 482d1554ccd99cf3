"""An interlaced clip stays one, with the order of its fields, or is refused with the
command that makes it progressive.
"""

from __future__ import annotations

import shlex
from pathlib import Path

import av
import av.filter
import pytest
from av.codec.context import Flags

from arfx.errors import InputError
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.media.join import join_chunks
from arfx.media.output import OutputSettings, plan_output
from arfx.media.writer import ChunkWriter, chunk_suffix
from tests.unit.media.clips import make_clip, pattern

ORDERS = {"tff": 2, "bff": 3}


def interlaced(path: Path, order: str) -> Path:
    graph = av.filter.Graph()
    source = graph.add_buffer(width=96, height=64, format="yuv420p", time_base="1/25")
    graph.link_nodes(
        source, graph.add("setfield", order), graph.add("buffersink")
    ).configure()
    with av.open(str(path), "w") as out:
        s = out.add_stream("mpeg2video", rate=25)
        s.width, s.height, s.pix_fmt = 96, 64, "yuv420p"
        s.codec_context.flags |= Flags.interlaced_dct | Flags.interlaced_me
        s.codec_context.field_order = ORDERS[order]
        for i in range(8):
            frame = av.VideoFrame.from_ndarray(
                pattern(i, 96, 64), format="rgb24"
            ).reformat(format="yuv420p")
            frame.pts = i
            graph.vpush(frame)
            out.mux(s.encode(graph.vpull()))
        out.mux(s.encode())
    return path


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("a.mp4", "h264"),
        ("a.mkv", "h264"),
        ("a.mov", "h264"),
        ("a.mkv", "ffv1"),
        ("a.mov", "prores"),
    ],
)
def test_the_output_has_the_fields_of_the_clip(
    tmp_path: Path, order: str, name: str, codec: str
) -> None:
    info = probe(interlaced(tmp_path / "in.mpg", order))
    assert info.fields == order and any("interlaced" in n for n in info.notices)
    plan = plan_output(info, tmp_path / name, OutputSettings(codec=codec))
    chunk = tmp_path / f"chunk{chunk_suffix(plan)}"
    with ClipReader(info) as reader, ChunkWriter(plan, info, chunk) as writer:
        frames = list(reader.frames())
        for frame in frames:
            writer.write(frame)
    join_chunks([chunk], [f.pts for f in frames], plan, info, tmp_path / name)
    with av.open(str(tmp_path / name)) as c:
        shown = list(c.decode(video=0))
        assert c.streams.video[0].codec_context.field_order == ORDERS[order]
    assert len(shown) == 8 and all(f.interlaced_frame for f in shown)


def test_a_codec_without_fields_is_refused_with_the_command(tmp_path: Path) -> None:
    info = probe(interlaced(tmp_path / "my clip.mpg", "tff"))
    for codec in ("h265", "av1"):
        with pytest.raises(InputError, match="is interlaced") as e:
            plan_output(info, tmp_path / "a.mkv", OutputSettings(codec=codec))
        command = shlex.split(e.value.hint[e.value.hint.index("ffmpeg") :])
        assert command[:5] == ["ffmpeg", "-i", str(info.path), "-vf", "bwdif"]
        assert command[-1] == str(tmp_path / "my clip-progressive.mkv")


def test_a_progressive_clip_has_no_fields(tmp_path: Path) -> None:
    assert probe(make_clip(tmp_path / "a.mp4", [0, 512])).fields == ""
