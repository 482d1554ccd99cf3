"""Depth maps: which file belongs to which frame, what their values mean, what is refused,
and holes.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.errors import InputError
from arfx.media.depth_maps import fill_holes, open_depth
from arfx.media.images import write_exr, write_png

W, H = 32, 24


def maps(folder: Path, *names: str, value: int = 1500) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        cv2.imwrite(str(folder / name), np.full((H, W), value, np.uint16))
    return folder


def test_order_is_that_of_numbers_and_the_count_must_be_the_clips(
    tmp_path: Path,
) -> None:
    found = open_depth(maps(tmp_path / "d", "2.pgm", "10.pgm", "1.pgm"))
    assert [p.name for p in found.files] == ["1.pgm", "2.pgm", "10.pgm"]
    assert found.of_frames([0.0, 0.1, 0.2], 0, whole=True) == [0, 1, 2]
    assert found.of_frames([0.1], 1, whole=False) == [1]  # --start, --end
    with pytest.raises(InputError, match="holds 3 maps, the clip has 2 frames"):
        found.of_frames([0.0, 0.1], 0, whole=True)
    with pytest.raises(InputError, match="holds 3 maps, the clip has at least 4"):
        found.of_frames([0.1, 0.2, 0.3], 1, whole=False)


def test_times_in_the_names_pair_with_the_nearest_frame(tmp_path: Path) -> None:
    names = [f"{1305031102.16 + t:.6f}.png" for t in (0.0, 0.033, 0.066, 0.166)]
    found = open_depth(maps(tmp_path / "d", *names))
    assert found.of_frames(
        [0.0, 0.02, 0.04, 0.07, 0.12, 0.16, 1.0], 0, whole=True
    ) == [
        0,
        1,
        1,
        2,
        None,
        3,
        None,
    ]
    assert open_depth(tmp_path / "d", start_s=0.05).of_frames(
        [0.0, 0.05, 0.08], 0, whole=True
    ) == [None, 0, 1]
    assert found.of_frames([0.081, 0.086, 0.15], 0, whole=True) == [
        2,
        None,
        3,
    ]  # no farther than half of the spacing


def test_one_map_is_for_all_frames(tmp_path: Path) -> None:
    found = open_depth(maps(tmp_path / "d", "room.png") / "room.png")
    assert found.of_frames([0.0, 0.1], 7, whole=True) == [0, 0]


def test_values_are_millimetres_or_of_the_given_scale_and_exr_metres(
    tmp_path: Path,
) -> None:
    stored = np.full((H, W), 2500, np.uint16)
    stored[0, :2] = 0, 65535
    cv2.imwrite(str(tmp_path / "a.png"), stored)
    depth = open_depth(tmp_path / "a.png").load(0, W, H)
    assert (
        depth[5, 5] == pytest.approx(2.5)
        and not depth[0, :2].any()
        and depth.dtype == np.float32
    )
    assert open_depth(tmp_path / "a.png", 5000).load(0, W, H)[5, 5] == pytest.approx(
        0.5
    )
    metres = np.full((H, W), 1.25, np.float32)
    metres[0, :4] = np.nan, np.inf, -1, 0
    write_exr(tmp_path / "b.exr", metres)
    depth = open_depth(tmp_path / "b.exr").load(
        0, 2 * W, 2 * H
    )  # maps may be smaller than the picture
    assert depth[5, 5] == 1.25 and not depth[0, :4].any() and np.isfinite(depth).all()


def exr(channels: tuple[str, ...], display: tuple[int, int] = (W, H)) -> bytes:
    """An EXR whose k-th channel, by name, is k + 1 everywhere."""

    def attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value

    listed = (
        b"".join(
            c.encode() + b"\0" + struct.pack("<iBBBBii", 2, 0, 0, 0, 0, 1, 1)
            for c in channels
        )
        + b"\0"
    )
    head = (
        b"v/1\x01"
        + struct.pack("<i", 2)
        + attribute(b"comment", b"string", b"dataWindow\0box2i\0")
    )
    head += attribute(b"channels", b"chlist", listed) + attribute(
        b"compression", b"compression", b"\0"
    )
    head += attribute(b"dataWindow", b"box2i", struct.pack("<4i", 0, 0, W - 1, H - 1))
    head += attribute(
        b"displayWindow",
        b"box2i",
        struct.pack("<4i", 0, 0, display[0] - 1, display[1] - 1),
    )
    head += attribute(b"lineOrder", b"lineOrder", b"\0") + attribute(
        b"pixelAspectRatio", b"float", struct.pack("<f", 1)
    )
    head += attribute(b"screenWindowCenter", b"v2f", bytes(8)) + attribute(
        b"screenWindowWidth", b"float", struct.pack("<f", 1)
    )
    row = b"".join(
        np.full(W, k + 1, np.float32).tobytes() for k in range(len(channels))
    )
    start = len(head) + 1 + 8 * H
    offsets = b"".join(
        struct.pack("<Q", start + y * (8 + len(row))) for y in range(H)
    )
    return (
        head
        + b"\0"
        + offsets
        + b"".join(struct.pack("<ii", y, len(row)) + row for y in range(H))
    )


@pytest.mark.parametrize(
    ("channels", "value"),
    [("Y", 1), ("Z", 1), ("V", 1), ("R", 1), ("AZ", 2), ("BGR", 3), ("ABGRZ", 5)],
)
def test_depth_in_an_exr_is_the_channel_named_for_it(
    channels: str, value: float, tmp_path: Path
) -> None:
    (tmp_path / "z.exr").write_bytes(exr(tuple(channels)))
    assert (open_depth(tmp_path / "z.exr").load(0, W, H) == value).all()


def test_an_exr_without_depth_or_of_a_size_that_is_not_its_pixels_is_refused(
    tmp_path: Path,
) -> None:
    (tmp_path / "z.exr").write_bytes(exr(("depth.Z",)))
    with pytest.raises(
        InputError, match=r"holds the channels depth\.Z, none of which"
    ):
        open_depth(tmp_path / "z.exr").load(0, W, H)
    (tmp_path / "z.exr").write_bytes(
        exr(("Z",), (32000, 24000))
    )  # FFmpeg makes a picture of the display window
    with pytest.raises(InputError, match="is 32000x24000"):
        open_depth(tmp_path / "z.exr").load(0, W, H)
    for end in (8, 20, 60, 200, 330):
        (tmp_path / "z.exr").write_bytes(exr(("Z",))[:end])
        with pytest.raises(InputError):
            open_depth(tmp_path / "z.exr").load(0, W, H)


def test_pipes_and_folders_among_the_maps_are_named(tmp_path: Path) -> None:
    folder = maps(tmp_path / "d", "1.png", "3.png")
    (folder / "2.png").mkdir()
    with pytest.raises(InputError, match=r"2\.png is a folder"):
        open_depth(folder)
    (folder / "2.png").rmdir()
    os.mkfifo(folder / "2.png")
    with pytest.raises(InputError, match=r"2\.png is not a regular file"):
        open_depth(folder)


def test_what_is_wrong_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        open_depth(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no depth map"):
        open_depth(tmp_path / "empty")
    with pytest.raises(InputError, match=r"\.pgm and \.png files"):
        open_depth(maps(tmp_path / "mixed", "1.pgm", "2.png"))
    with pytest.raises(InputError, match="same time"):
        open_depth(maps(tmp_path / "twice", "1.50.png", "1.5.png"))
    (tmp_path / "t.txt").write_text("x")
    with pytest.raises(InputError, match="is not a depth map"):
        open_depth(tmp_path / "t.txt")
    write_png(tmp_path / "eight.png", np.zeros((H, W), np.uint8))
    with pytest.raises(InputError, match="uint8 with 1 channel, not depth"):
        open_depth(tmp_path / "eight.png").load(0, W, H)
    (tmp_path / "cut.png").write_bytes(
        (maps(tmp_path / "d", "1.png") / "1.png").read_bytes()[:40]
    )
    with pytest.raises(InputError, match=r"cut\.png is not a picture"):
        open_depth(tmp_path / "cut.png").load(0, W, H)
    with pytest.raises(InputError, match="is 32x24, the clip 64x36"):
        open_depth(tmp_path / "d").load(0, 64, 36)


def test_holes_fill_from_the_side_that_looks_alike() -> None:
    guide = np.full((60, 80), 60, np.uint8)
    guide[:, 40:] = 180  # the picture's edge: near on the left, far on the right
    depth = (
        np.where(np.arange(80) < 40, 1.0, 4.0)[None].repeat(60, 0).astype(np.float32)
    )
    holed = depth.copy()
    holed[20:40, 30:50] = 0  # over the edge
    holed[:, 74:] = 0
    out = fill_holes(holed, guide)
    known = holed > 0
    np.testing.assert_array_equal(out[known], depth[known])
    assert np.abs(1 / out - 1 / depth).max() < 0.05
    alone = np.zeros((60, 80), np.float32)
    alone[30, 40] = 2.0  # hardly anything known: everything takes it
    np.testing.assert_allclose(fill_holes(alone, guide), 2.0, rtol=1e-5)
    assert fill_holes(depth[::2, ::2], guide).shape == guide.shape


def test_a_tiff_that_holds_no_page_is_told_as_that(tmp_path: Path) -> None:
    (tmp_path / "depth.tiff").write_bytes(b"II*\0" + bytes(60))
    with pytest.raises(InputError, match="TIFF"):
        open_depth(tmp_path / "depth.tiff")
