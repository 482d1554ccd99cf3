"""Pictures of every kind are read, and what would fill the memory is refused by its header."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from arfx.errors import InputError
from arfx.media.depth_maps import open_depth
from arfx.media.images import decode_picture, load_image, write_exr

RGB = np.kron(
    np.arange(3 * 4 * 6, dtype=np.uint8).reshape(4, 6, 3) * 3,
    np.ones((32, 32, 1), np.uint8),
)


@pytest.mark.parametrize(
    "suffix",
    [".png", ".jpg", ".bmp", ".webp", ".ppm", ".tiff", ".hdr", ".exr", ".jp2"],
)
def test_every_kind_is_read_whatever_its_name(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".exr":
        write_exr(path, RGB.astype(np.float32))
    else:
        cv2.imwrite(str(path), RGB.astype(np.float32) if suffix == ".hdr" else RGB)
        assert decode_picture(
            path.rename(tmp_path / "b.dat"), "picture", cv2.IMREAD_COLOR
        ).shape == (128, 192, 3)
        path = tmp_path / "b.dat"
    assert load_image(path).shape == (128, 192, 3)


def test_float_tiff_is_read(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", RGB.astype(np.float32), photometric="rgb")
    assert load_image(tmp_path / "a.tif").dtype == np.float32


def png(width: int, height: int) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data))
            + name
            + data
            + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(b"\0" * 1000))
        + chunk(b"IEND", b"")
    )


def exr(folder: Path, side: int) -> bytes:
    write_exr(folder / "small.exr", np.zeros((4, 4), np.float32))
    data = (folder / "small.exr").read_bytes()
    return data.replace(
        struct.pack("<4i", 0, 0, 3, 3), struct.pack("<4i", 0, 0, side - 1, side - 1)
    )


@pytest.mark.parametrize("kind", ["png", "hdr", "exr", "tiff", "ppm"])
def test_a_small_file_that_states_gigabytes_is_refused(
    tmp_path: Path, kind: str
) -> None:
    path = tmp_path / f"a.{kind}"
    if kind == "tiff":
        tifffile.imwrite(path, np.zeros((8000, 8000), np.uint16), compression="zlib")
    else:
        path.write_bytes(
            {
                "png": png(60_000, 60_000), "exr": exr(tmp_path, 60_000), "ppm": b"P5\n60000 60000\n65535\n" + b"\0" * 100,
                "hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n" + b"\x02\x02\xea\x60" * 100,
            }[kind]
        )  # fmt: skip
    for read in (
        load_image,
        *(
            []
            if kind in ("hdr", "ppm")
            else [lambda p: open_depth(p).load(0, 16, 16)]
        ),
    ):
        with pytest.raises(InputError, match=r"60000x60000|8000x8000"):
            read(path)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"%!PS-Adobe-3.0 EPSF-3.0\n",
        b"GIF89a",
        b"II*\0" + b"\xff" * 50,
        b"v/1\x01",
        b"\x89PNG\r\n\x1a\n",
    ],
)
def test_what_is_no_picture_is_one_message(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.png").write_bytes(data)
    for read in (load_image, lambda p: open_depth(p).load(0, 16, 16)):
        with pytest.raises(InputError, match=r"a\.png") as e:
            read(tmp_path / "a.png")
        assert "\n" not in e.value.message


def test_depth_that_is_a_device_or_a_pipe_is_refused(tmp_path: Path) -> None:
    import os

    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(InputError, match="not a regular file"):
        open_depth(tmp_path / "a.png").load(0, 16, 16)
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match="not a depth map"):
            open_depth(path)


@pytest.mark.parametrize("after", [[8], [122, 8]])
def test_pages_that_follow_each_other_in_a_circle_are_refused(
    tmp_path: Path, after: list[int]
) -> None:
    """after : where the page after each page is.

    Red without a look at it: tifffile goes round for ever.
    """
    tags = [
        (256, 4, 4),
        (257, 4, 4),
        (258, 3, 8),
        (259, 3, 1),
        (262, 3, 1),
        (273, 4, 8),
        (277, 3, 1),
        (278, 4, 4),
        (279, 4, 16),
    ]
    page = struct.pack("<H", len(tags)) + b"".join(
        struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags
    )
    assert len(page) + 4 == 114
    path = tmp_path / "a.tif"
    path.write_bytes(
        b"II*\0"
        + struct.pack("<I", 8)
        + b"".join(page + struct.pack("<I", at) for at in after)
    )
    with pytest.raises(InputError, match="cannot be read"):
        load_image(path)
