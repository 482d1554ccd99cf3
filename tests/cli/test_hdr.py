"""Clips in HLG and PQ: linear light with diffuse white at 203 cd/m2, and out as they came."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from arfx.core.colour import SRGB, Transfer, from_bt709, yuv_from_rgb
from arfx.media.clip import probe
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.media.planes import planes_of
from tests.cli.conftest import Material, Run
from tests.clips import clip_camera, picture, pose_at

FRAMES = 12
TAGS = {"hlg": (18, "arib-std-b67"), "pq": (16, "smpte2084")}
STATIC = (
    "master-display=G(13250,34500)B(7500,3000)R(34000,16000)WP(15635,16450)L(10000000,50)"
    ":max-cll=1000,400"
)
DISPLAY = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329, 0.005, 1000.0)


def write_hdr_clip(path: Path, kind: str) -> Path:
    """The marker as a phone records it: H.265 Main 10 in BT.2020, white paper at 203 cd/m2."""
    trc, name = TAGS[kind]
    transfer, to_yuv = Transfer(kind), yuv_from_rgb("bt2020")
    to_2020 = from_bt709(9)
    assert to_2020 is not None
    camera = clip_camera()
    params = f"log-level=none:transfer={name}:colorprim=bt2020:colormatrix=bt2020nc:{STATIC}"
    with av.open(str(path), "w") as out:
        options = {"crf": "8", "preset": "ultrafast", "x265-params": params}
        s = out.add_stream("libx265", rate=30, options=options)
        s.width, s.height, s.pix_fmt = camera.width, camera.height, "yuv420p10le"
        ctx = s.codec_context
        ctx.colorspace, ctx.color_range = 9, 1
        ctx.color_trc, ctx.color_primaries = trc, 9
        for i in range(FRAMES):
            rgb = picture(pose_at(i, FRAMES), camera).astype(np.float32) / 255
            yuv = transfer.encode(SRGB.decode(rgb) @ to_2020.T) @ to_yuv.T
            small = (camera.width // 2, camera.height // 2)
            chroma = cv2.resize(yuv[..., 1:], small, interpolation=cv2.INTER_AREA)
            planes = yuv[..., 0] * 876 + 64, *np.moveaxis(chroma * 896 + 512, -1, 0)
            frame = av.VideoFrame(camera.width, camera.height, "yuv420p10le")
            for plane, values in zip(frame.planes, planes, strict=True):
                rows = np.frombuffer(plane, np.dtype("<u2"))  # type: ignore[call-overload]
                rows = rows.reshape(-1, plane.line_size // 2)
                h, w = values.shape
                rows[:h, :w] = np.rint(values)
            frame.pts, frame.time_base = i, Fraction(1, 30)
            out.mux(s.encode(frame))
        out.mux(s.encode(None))
    return path


@pytest.fixture(scope="module")
def hlg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_hdr_clip(tmp_path_factory.mktemp("hdr") / "hlg.mp4", "hlg")


def frames(path: Path) -> list[Frame]:
    with ClipReader(probe(path)) as reader:
        return list(reader.frames())


@pytest.mark.parametrize("kind", ["hlg", "pq"])
def test_an_hdr_clip_comes_out_as_it_came(
    kind: str, material: Material, arfx: Run, tmp_path: Path
) -> None:
    clip = write_hdr_clip(tmp_path / "clip.mp4", kind)
    assert probe(clip).transfer == Transfer(kind)
    assert np.median(frames(clip)[0].linear(frames(clip)[0].rect)) < 1
    r = arfx(*material.arguments("-o", "out.mp4", "--json", clip=clip))
    assert r.code == 0, r.err
    info = probe(tmp_path / "out.mp4")
    assert (info.codec, info.pixel_format) == ("hevc", "yuv420p10le")
    assert (info.matrix_tag, info.transfer_tag, info.primaries_tag) == (
        9,
        TAGS[kind][0],
        9,
    )
    assert info.range_tag == 1
    assert info.mastering_display == pytest.approx(DISPLAY)
    assert info.content_light == (1000, 400)


def test_the_codecs_that_hold_ten_bits_keep_the_tags(
    hlg: Path, material: Material, arfx: Run, tmp_path: Path
) -> None:
    for name, codec, layout, static in (
        ("out.webm", "av1", "yuv420p10le", True),
        ("out.mov", "prores", "yuv444p10le", False),
    ):
        r = arfx(*material.arguments("-o", name, "--codec", codec, clip=hlg))
        assert r.code == 0, r.err
        info = probe(tmp_path / name)
        assert (info.pixel_format, info.transfer_tag, info.primaries_tag) == (
            layout,
            18,
            9,
        )
        assert (info.content_light == (1000, 400)) == static
        assert ("do not keep the clip's mastering display" in r.err) == (not static)
        if static:
            assert info.mastering_display == pytest.approx(DISPLAY, abs=2e-5)


def test_untouched_pixels_of_hlg_keep_their_bits_and_the_object_its_colour(
    hlg: Path, material: Material, arfx: Run, tmp_path: Path
) -> None:
    """The model's orange, in BT.2020, is what an ordinary clip of the same scene shows."""
    r = arfx(
        *material.arguments("-o", "out.mkv", "--codec", "ffv1", "--json", clip=hlg)
    )
    assert r.code == 0, r.err
    assert json.loads(r.out)["output"]["frames"] == FRAMES
    plain = arfx(*material.arguments("-o", "sdr.mkv", "--codec", "ffv1"))
    assert plain.code == 0, plain.err
    to_2020 = from_bt709(9)
    assert to_2020 is not None
    before, after = frames(hlg)[0], frames(tmp_path / "out.mkv")[0]
    ordinary = frames(tmp_path / "sdr.mkv")[0]
    seen = after.linear(after.rect) @ np.linalg.inv(to_2020).T
    shown = ordinary.linear(ordinary.rect)
    changed = np.zeros(seen.shape[:2], bool)
    for a, b in zip(
        *(planes_of(f.picture, f.clip.layout) for f in (before, after)), strict=True
    ):
        step = after.rect.height // a.shape[0]
        width = after.rect.width // step
        differs = (a[:, :width] != b[:, :width]).repeat(step, 0).repeat(step, 1)
        changed |= differs
    assert 0.01 < changed.mean() < 0.5
    assert not changed[:30].any() and not changed[-20:].any()
    orange = cv2.erode(
        ((shown[..., 0] > 3 * shown[..., 2]) & (shown[..., 0] > 0.1)).astype(
            np.uint8
        ),
        np.ones((5, 5), np.uint8),
    ).astype(bool)
    assert orange.sum() > 200
    np.testing.assert_allclose(
        seen[orange].mean(0), shown[orange].mean(0), atol=0.02, rtol=0.08
    )
