"""Depth maps that lie in one file: video of 16-bit grey, TIFF of several pages."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from arfx.errors import InputError
from arfx.media.depth_maps import open_depth

W, H, COUNT = 48, 36, 70


def depth(k: int) -> np.ndarray:
    """(h, w) uint16, mm, another in every map; some of it not measured."""
    out = np.full((H, W), 1000 + 10 * k, np.uint16)
    out[:, : k % 7 + 1] = 0
    return out


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """15 maps a second."""
    path = tmp_path_factory.mktemp("depth") / "depth.mkv"
    with av.open(str(path), "w") as out:
        stream = out.add_stream("ffv1", rate=15)
        stream.width, stream.height, stream.pix_fmt, stream.time_base = (
            W,
            H,
            "gray16le",
            Fraction(1, 15),
        )
        for k in range(COUNT):
            frame = av.VideoFrame.from_ndarray(depth(k), format="gray16le")
            frame.pts = k
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    return path


def test_a_video_gives_every_map_in_any_order_and_from_any_thread(
    video: Path,
) -> None:
    found = open_depth(video)
    assert found.count == COUNT and not found.still
    order = [3, 4, 5, 60, 61, 2, 2, 69, 0, 40]

    def right(k: int) -> bool:
        return np.array_equal(found.load(k, W, H), depth(k).astype(np.float32) / 1000)

    assert all(right(k) for k in order)
    with ThreadPoolExecutor(3) as pool:
        assert all(pool.map(right, range(COUNT)))


def test_its_frames_belong_to_the_clips_by_time(video: Path) -> None:
    found = open_depth(video)
    assert found.of_frames([0.0, 0.03, 0.07, 0.1, 0.13, 0.16], 0, whole=False) == [
        0,
        0,
        1,
        1,
        2,
        2,
    ]
    assert open_depth(video, start_s=1.0).of_frames(
        [0.5, 1.0, 1.14], 0, whole=False
    ) == [
        None,
        0,
        2,
    ]


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_pages_of_a_tiff_are_maps_in_order(tmp_path: Path, kind: type) -> None:
    maps = [
        depth(k).astype(kind) / kind(1 if kind is np.uint16 else 1000)
        for k in range(4)
    ]
    path = tmp_path / "maps.tiff"
    assert cv2.imwritemulti(str(path), [m.astype(kind) for m in maps])
    found = open_depth(path)
    assert found.count == 4 and found.of_frames(
        [0.0, 0.1, 0.2, 0.3], 0, whole=True
    ) == [
        0,
        1,
        2,
        3,
    ]
    np.testing.assert_allclose(
        found.load(2, W, H), depth(2) / np.float32(1000), rtol=1e-6
    )
    with pytest.raises(InputError, match="holds 4 maps, the clip has 3 frames"):
        found.of_frames([0.0, 0.1, 0.2], 0, whole=True)
    cv2.imwrite(str(tmp_path / "one.tif"), maps[1].astype(kind))
    assert open_depth(tmp_path / "one.tif").still


def test_what_holds_no_depth_is_refused(tmp_path: Path, video: Path) -> None:
    colour = tmp_path / "colour.mkv"
    with av.open(str(colour), "w") as out:
        stream = out.add_stream("ffv1", rate=15)
        stream.width, stream.height, stream.pix_fmt = W, H, "yuv420p"
        out.mux(
            stream.encode(
                av.VideoFrame.from_ndarray(
                    np.zeros((H, W, 3), np.uint8), format="rgb24"
                )
            )
        )
        out.mux(stream.encode(None))
    with pytest.raises(InputError, match="holds yuv420p pictures, not depth"):
        open_depth(colour)
    (tmp_path / "broken.mkv").write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="cannot be read as a video"):
        open_depth(tmp_path / "broken.mkv")
    (tmp_path / "broken.tif").write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="its header is damaged"):
        open_depth(tmp_path / "broken.tif")
    with pytest.raises(InputError, match=r"48x36, the clip 100x50: another shape"):
        open_depth(video).load(3, 100, 50)
