"""Clips that are lists of other files, names that look like protocols, pictures that pose
as clips.
"""

from __future__ import annotations

import io
import socket
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image, ImageOps

from arfx.errors import InputError
from arfx.media.clip import probe
from arfx.media.codecs import CONTAINERS, check_size
from arfx.media.depth_maps import open_depth
from arfx.media.frames import ClipReader
from arfx.media.join import join_chunks
from arfx.media.output import plan_output
from arfx.media.writer import ChunkWriter, chunk_suffix
from tests.unit.media.clips import make_clip

PTS = [512 * i for i in range(6)]


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_clip(tmp_path_factory.mktemp("clips") / "a.mp4", PTS)


@pytest.fixture
def listener() -> socket.socket:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        s.listen()
        s.setblocking(False)
        yield s
        with pytest.raises(BlockingIOError):
            s.accept()  # nobody called


@pytest.mark.parametrize(
    "name",
    [
        "list.mp4",
        "list.mkv",
        "list.ffconcat",
        "list.m3u8",
        "list.mpd",
        "list.sdp",
        "list.txt",
    ],
)
def test_a_list_of_other_files_is_refused_whatever_its_name(
    clip: Path, tmp_path: Path, name: str, listener: socket.socket
) -> None:
    (tmp_path / "a.mp4").write_bytes(clip.read_bytes())
    url = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
    for other in ("a.mp4", url):
        for text in (
            f"ffconcat version 1.0\nfile '{other}'\n",
            f"\ufeffffconcat version 1.0\nfile '{other}'\n",
            f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:1,\n{other}\n#EXT-X-ENDLIST\n",
            (
                '<?xml version="1.0"?><MPD'
                f' xmlns="urn:mpeg:dash:schema:mpd:2011"><Period><BaseURL>{other}</BaseURL></Period></MPD>'
            ),
            (
                "v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP"
                " 96\na=rtpmap:96 H264/90000\n"
            ),
        ):
            (tmp_path / name).write_text(text)
            with pytest.raises(
                InputError, match="cannot be read as a video: it is text"
            ):
                probe(tmp_path / name)
            if name.endswith((".mp4", ".mkv")):
                with pytest.raises(
                    InputError, match="cannot be read as a video: it is text"
                ):
                    open_depth(tmp_path / name)


def test_formats_that_open_other_files_are_not_listed() -> None:
    assert not {
        "concat",
        "hls",
        "dash",
        "imf",
        "sdp",
        "rtsp",
        "image2",
        "lavfi",
        "vobsub",
        "tty",
        "webm_dash_manifest",
    } & set(CONTAINERS.split(","))


@pytest.mark.parametrize(
    "name",
    [
        "12:30.mp4",
        "http:x.mp4",
        "tcp:127.0.0.1.mp4",
        "concat:a|b.mp4",
        "a%03d.mp4",
        "pipe:0.mp4",
        "out 1:2.mp4",
    ],
)
def test_names_are_never_protocols(
    clip: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path(name)  # relative: a folder before it would hide the colon
    path.write_bytes(clip.read_bytes())
    info = probe(path)
    plan = plan_output(info, Path("o " + name))
    chunk = Path(name + chunk_suffix(plan))
    with ClipReader(info) as reader, ChunkWriter(plan, info, chunk) as writer:
        for frame in reader.frames():
            writer.write(frame)
    join_chunks([chunk], PTS, plan, info, Path("o " + name))
    assert probe(Path("o " + name)).frame_count_stated == len(PTS)


@pytest.mark.parametrize("kind", ["TIFF", "PNG", "JPEG", "WEBP"])
@pytest.mark.parametrize("name", ["a.mp4", "a.jpg"])
def test_a_photo_is_a_clip_of_one_frame(tmp_path: Path, kind: str, name: str) -> None:
    Image.fromarray(np.full((16, 24, 3), 90, np.uint8)).save(tmp_path / name, kind)
    info = probe(tmp_path / name)
    with ClipReader(info) as reader:
        (frame,) = reader.frames()
    assert (info.container, info.width, info.height) == ("photo", 24, 16)
    assert np.abs(frame.rgb8().astype(int) - 90).max() <= 1


@pytest.mark.parametrize("kind", ["BMP", "PPM"])
def test_pictures_of_other_kinds_are_named(tmp_path: Path, kind: str) -> None:
    Image.fromarray(np.full((16, 16, 3), 90, np.uint8)).save(tmp_path / "a.mp4", kind)
    with pytest.raises(InputError, match="it is a picture"):
        probe(tmp_path / "a.mp4")


def test_empty_files_devices_and_huge_pictures_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").touch()
    with pytest.raises(InputError, match="it is empty"):
        probe(tmp_path / "a.mp4")
    with pytest.raises(InputError, match="not a regular file"):
        probe("/dev/zero")
    with pytest.raises(InputError, match="at most 8192"):
        check_size(100_000, 16, tmp_path)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_pictures_with_exif_in_motion_jpeg_are_read_and_turned(
    tmp_path: Path, orientation: int
) -> None:
    """PyAV does not know EXIF among a picture's side data."""
    stored = Image.fromarray(
        np.repeat(
            np.arange(64 * 96, dtype=np.uint16).reshape(64, 96, 1) // 25, 3, 2
        ).astype(np.uint8)
    )
    exif = stored.getexif()
    exif[0x0112] = orientation
    coded = io.BytesIO()
    stored.save(coded, "jpeg", exif=exif.tobytes(), quality=95)
    with av.open(str(tmp_path / "a.avi"), "w") as c:
        stream = c.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuvj420p"
        for k in range(2):
            packet = av.Packet(coded.getvalue())
            packet.pts, packet.dts, packet.time_base, packet.stream = (
                k,
                k,
                Fraction(1, 25),
                stream,
            )
            c.mux(packet)
    info = probe(tmp_path / "a.avi")
    with ClipReader(info) as reader:
        shown = next(reader.frames()).rgb8()
    assert (
        np.abs(
            shown.astype(int) - np.asarray(ImageOps.exif_transpose(Image.open(coded)))
        ).mean()
        < 2
    )


@pytest.mark.parametrize("start_s", [0, 2, 500_000])
def test_a_matroska_clip_may_begin_at_any_time(tmp_path: Path, start_s: int) -> None:
    pts = [1000 * start_s + 40 * i for i in range(12)]
    path = make_clip(tmp_path / "a.mkv", pts, time_base=Fraction(1, 1000))
    info = probe(path)
    assert info.duration_s == pytest.approx(0.48, abs=0.05)
    with ClipReader(info) as reader:
        assert [frame.pts for frame in reader.frames()] == pts
    assert reader.truncated is None
