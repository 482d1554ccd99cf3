"""Clips: damaged containers of every kind, playlists and scripts under a video's name, odd
times, sizes and formats.
"""

from __future__ import annotations

import random
import shutil
import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from tests.clips import clip_camera, picture, pose_at
from tests.fuzz.case import REFUSED, Build, Case, mutated_bytes, process
from tests.fuzz.material import CLIPS

# Scripts that name other files; {} = a file. FFmpeg opens each of them as a video unless it
# is told not to.
SCRIPTS = {
    "ffconcat": "ffconcat version 1.0\nfile '{}'\n",
    "m3u8": (
        "#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{}\n#EXT-X-ENDLIST\n"
    ),
    "mpd": (
        '<MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static"'
        ' mediaPresentationDuration="PT1S"><Period>'
        '<AdaptationSet mimeType="video/mp4"><Representation id="1"'
        ' bandwidth="1"><BaseURL>{}</BaseURL></Representation>'
        "</AdaptationSet></Period></MPD>"
    ),
    "sdp": (
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=a\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP"
        " 96\na=rtpmap:96 H264/90000\n{}"
    ),
    "lavfi": "testsrc=size=160x120:rate=30:duration=0.1{}",
    "bluray": "concat:{}|{}",
    "asx": '<asx version="3.0"><entry><ref href="{}"/></entry></asx>',
    "edl": "# mpv EDL v0\n{}\n",
}
TARGETS = (
    "part.ts", "part.mp4", "../outside/secret.ts", "../outside/secret.mp4", "http://127.0.0.1:9/a.ts", "tcp://127.0.0.1:9",
    "/etc/hostname",
)  # fmt: skip
SUFFIXES = (
    ".mp4",
    ".mkv",
    ".mov",
    ".ts",
    ".avi",
    ".m3u8",
    ".ffconcat",
    ".txt",
    ".mpd",
    ".sdp",
    "",
)


def script(kind: str, target: str, suffix: str) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        shutil.copy(material / "clip.ts", folder / "part.ts")
        shutil.copy(material / "clip.mp4", folder / "part.mp4")
        name = (
            str(folder.parent / target[3:])
            if target.startswith("../") and rng.random() < 0.3
            else target
        )
        (folder / f"list{suffix}").write_text(SCRIPTS[kind].replace("{}", name))
        return Case(
            folder,
            process(folder, material, clip=f"list{suffix}"),
            codes=frozenset({3}),
            note=f"{kind} of {name}",
        )

    return build


def times(
    pts: list[int], base: Fraction = Fraction(1, 1000), suffix: str = ".mkv"
) -> Build:
    """A clip whose frames are shown at these times."""

    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        write(folder / f"clip{suffix}", pts=pts, base=base)
        return Case(
            folder,
            process(folder, material, clip=f"clip{suffix}"),
            note=f"times {pts} of {base}",
        )

    return build


def write(
    path: Path,
    pts: list[int],
    base: Fraction,
    size: tuple[int, int] = (160, 120),
    fmt: str = "yuv420p",
) -> None:
    camera = clip_camera(*size)
    with av.open(str(path), "w") as out:
        stream = out.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.time_base = (
            *size,
            fmt,
            base,
        )
        stream.codec_context.time_base = base
        for i, at in enumerate(pts):
            rgb = (
                np.full((size[1], size[0], 3), 90, np.uint8)
                if min(size) < 64
                else picture(pose_at(i, len(pts)), camera)
            )
            frame = av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(
                format=fmt
            )
            frame.pts, frame.time_base = at, base
            for packet in stream.encode(frame):
                out.mux(packet)
        for packet in stream.encode():
            out.mux(packet)


def as_suffix(source: str, name: str) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        shutil.copy(material / source, folder / name)
        return Case(
            folder, process(folder, material, clip=name), note=f"{source} as {name}"
        )

    return build


def huge_header(rng: random.Random, folder: Path, material: Path) -> Case:
    """The header says 65535 x 65535, or the sample tables hold four billion entries."""
    data = bytearray((material / "clip.mp4").read_bytes())
    for atom, offset in rng.sample(
        [
            (b"avc1", 28),
            (b"stsz", 12),
            (b"stts", 8),
            (b"stco", 8),
            (b"mdhd", 16),
            (b"elst", 8),
        ],
        2,
    ):
        at = data.find(atom) + offset
        data[at : at + 4] = struct.pack(
            ">I", rng.choice((0, 0xFFFFFFFF, 0x7FFFFFFF, 0x20002000))
        )
    (folder / "clip.mp4").write_bytes(data)
    return Case(folder, process(folder, material), note="numbers in the header")


def damaged(rng: random.Random, folder: Path, material: Path) -> Case:
    source = rng.choice([*CLIPS, "clip.tif", "clip.gif"])
    name = source if rng.random() < 0.8 else f"clip{rng.choice(SUFFIXES)}"
    (folder / name).write_bytes(mutated_bytes(rng, (material / source).read_bytes()))
    args = process(folder, material, clip=name)
    if rng.random() < 0.1:
        return Case(
            folder, ["inspect", name, "--json"], None, note=f"damaged {source}"
        )
    return Case(folder, args, note=f"damaged {source}")


def damaged_sound(rng: random.Random, folder: Path, material: Path) -> Case:
    """The last packet of sound has no header: mp4 cannot hold it, and the rest of the clip
    is whole.
    """
    data = bytearray((material / "clip.ts").read_bytes())
    data[data.rfind(b"\xff\xf1\x50") + 1] = 0
    (folder / "clip.ts").write_bytes(data)
    return Case(
        folder, process(folder, material, clip="clip.ts"), codes=frozenset({0})
    )


def stream(rng: random.Random, folder: Path, material: Path) -> Case:
    """A transport stream without some packets, joined with itself or with a part of itself."""
    data = (material / "clip.ts").read_bytes()
    packets = [data[k : k + 188] for k in range(0, len(data), 188)]
    first = packets[
        : rng.choice((len(packets), len(packets), rng.randrange(3, len(packets))))
    ]
    whole = [*first, *packets] if rng.random() < 0.7 else packets
    lost = set(
        rng.sample(
            range(3, len(whole)), min(rng.choice((0, 1, 1, 3, 20)), len(whole) - 3)
        )
    )
    (folder / "clip.ts").write_bytes(
        b"".join(p for k, p in enumerate(whole) if k not in lost)
    )
    codes = REFUSED if lost else frozenset({0})
    note = f"{len(whole)} packets, without {sorted(lost)}"
    return Case(
        folder, process(folder, material, clip="clip.ts"), codes=codes, note=note
    )


def odd(rng: random.Random, folder: Path, material: Path) -> Case:
    """Odd sizes, pixel formats, rates, and gaps of hours."""
    n, at = rng.choice((1, 2, 3, 5)), 0
    pts = []
    for _ in range(n):
        pts.append(at)
        at += rng.choice((1, 1, 2, 33, 1000, 10**6, 2**31, 2**40))
    size = rng.choice(
        (
            (160, 120),
            (160, 120),
            (160, 120),
            (161, 121),
            (16, 16),
            (2, 2),
            (1, 1),
            (640, 64),
            (64, 640),
            (4096, 66),
        )
    )
    fmt = rng.choice(
        (
            "yuv420p",
            "yuv444p",
            "yuv422p10le",
            "gray",
            "gray16le",
            "bgr0",
            "yuva420p",
            "yuv410p",
            "gbrp16le",
        )
    )
    base = rng.choice(
        (
            Fraction(1, 30),
            Fraction(1, 1000),
            Fraction(1, 90000),
            Fraction(1001, 30000),
            Fraction(1, 1),
            Fraction(1, 10**6),
        )
    )
    try:
        write(folder / "clip.nut", pts, base, size, fmt)
    except av.FFmpegError:  # no encoder for that
        write(folder / "clip.nut", pts, base)
    extra = (
        {"start": rng.choice(("0", "1s", "1e9", "-1"))} if rng.random() < 0.2 else {}
    )
    args = process(
        folder,
        material,
        clip="clip.nut",
        o=rng.choice(("out.mkv", "out.mp4")),
        **extra,
    )
    return Case(
        folder, args, args[args.index("-o") + 1], note=f"{size} {fmt} {pts} of {base}"
    )


def listed(rng: random.Random, folder: Path, material: Path) -> Case:
    return script(
        rng.choice(list(SCRIPTS)), rng.choice(TARGETS), rng.choice(SUFFIXES)
    )(rng, folder, material)


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    return rng.choices((damaged, odd, listed, huge_header, stream), (6, 2, 2, 1, 2))[
        0
    ](rng, folder, material)


SEEDS: dict[str, Build] = {
    "ffconcat named mp4": script("ffconcat", "part.mp4", ".mp4"),
    "ffconcat of a file outside": script(
        "ffconcat", "../outside/secret.mp4", ".ffconcat"
    ),
    "m3u8 over a ts": script("m3u8", "part.ts", ".m3u8"),
    "m3u8 named mp4 of a file outside": script(
        "m3u8", "../outside/secret.ts", ".mp4"
    ),
    "m3u8 of an address": script("m3u8", "http://127.0.0.1:9/a.ts", ".m3u8"),
    "dash manifest": script("mpd", "part.mp4", ".mpd"),
    "sdp": script("sdp", "", ".sdp"),
    "edl": script("edl", "part.mp4", ".mp4"),
    "ts with a damaged packet of sound": damaged_sound,
    "ts without some packets, joined": stream,
    "tiff as a clip": as_suffix("clip.tif", "clip.tif"),
    "tiff named mp4": as_suffix("clip.tif", "clip.mp4"),
    "png as a clip": as_suffix("picture.png", "clip.png"),
    "gif": as_suffix("clip.gif", "clip.gif"),
    "text as a clip": as_suffix("job.toml", "clip.mp4"),
    "gaps of days": times([0, 1, 90_000_000, 90_000_001, 10**12]),
    "gaps of hours, coarse times": times(
        [0, 7200, 7201, 14400], Fraction(1, 1), ".nut"
    ),
    "one frame": times([0]),
    "a late first frame": times([10**9, 10**9 + 33, 10**9 + 66]),
    "numbers in the header": huge_header,
}
