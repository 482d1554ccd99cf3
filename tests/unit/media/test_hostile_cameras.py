"""Camera files that are made to hang, or that no camera can have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.errors import InputError
from arfx.media.cameras import camera_warnings, load_camera

K = [[800.0, 0, 640], [0, 800, 360], [0, 0, 1]]


def camera(
    folder: Path, matrix: object = K, distortion: object = (0, 0, 0, 0)
) -> Path:
    path = folder / "camera.yaml"
    rows = np.array(matrix, object).ravel().tolist()
    path.write_text(
        "image_width: 1280\nimage_height: 720\ncamera_matrix:"
        f" [{', '.join(map(str, rows))}]\n"
        f"distortion_coefficients: [{', '.join(map(str, distortion))}]\n"  # type: ignore[call-overload]
    )
    return path


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n"
    for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
MERGES = "a: &a {x: 1}\n" + "".join(
    f"{b}: &{b} {{<<: [{', '.join(['*' + a] * 9)}]}}\n"
    for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "aliases"),
        (MERGES, "aliases"),
        ("a: &a [*a]", "aliases"),
        ("[" * 50_000, "nested deeper|expected"),
        ("a: {b: " + "{a: " * 20_000, "nested deeper|expected"),
        ("- " * 20_000 + "1", "nested deeper"),
        ('{"a":' * 30_000, "nested deeper"),
        ('{"camera_matrix": ' + "9" * 5000 + "}", "64 bits"),
        ("camera_matrix: [" + "9" * 5000 + "]", "digits|64 bits"),
        ("camera_matrix: [" + "9" * 400 + ",0,0,0,1,0,0,0,1]", "64 bits"),
        ('{"camera_matrix": [1e999,0,0,0,1,0,0,0,1]}', "out of range"),
        ("? [1, 2]\n: 3\n", "neither|no camera"),
        ("!!python/object/apply:os.system ['true']", "neither"),
        ("a: 2024-99-99", "neither|no camera"),
        ("x" * 300_000, r"0\.25 MiB"),
    ],
)
def test_a_camera_file_that_unfolds_is_refused_at_once(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "camera.yaml").write_text(text)
    with pytest.raises(InputError, match=message) as e:
        load_camera(tmp_path / "camera.yaml")
    assert "camera.yaml" in e.value.message and len(str(e.value)) < 1000


def test_a_device_is_no_camera_file() -> None:
    with pytest.raises(InputError, match="not a regular file"):
        load_camera("/dev/zero")


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.transpose(K), "transposed"),
        (
            [[800, 0, 640], [0, 800, 360], [0, 0, 2]],
            "row of the camera matrix is 0 0 2",
        ),
        (
            [[800, 0, 640], [0, 800, 360], [0, 0, 0]],
            "row of the camera matrix is 0 0 0",
        ),
        (
            [[800, 0, 640], [0, 800, 360], [5, 0, 1]],
            "row of the camera matrix is 5 0 1",
        ),
        ([[800, 5, 640], [0, 800, 360], [0, 0, 1]], "skew"),
        (
            [[800, 0, 640], [5, 800, 360], [0, 0, 1]],
            "row of the camera matrix is 5 800 360",
        ),
        ([[800, 0, 640], [0, 0.08, 360], [0, 0, 1]], "fy is 0.08"),
        ([[40_000, 0, 640], [0, 400, 360], [0, 0, 1]], "far apart"),
        ([[1e-6, 0, 640], [0, 1e-6, 360], [0, 0, 1]], "fx is 1e-06"),
        ([[1e308, 0, 640], [0, 1e308, 360], [0, 0, 1]], r"fx is 1e\+308"),
        ([[800, 0, 1e5], [0, 800, 360], [0, 0, 1]], "100000, 360 lies far outside"),
        ([[800, 0, 640], [0, 800, -1e9], [0, 0, 1]], "640, -1e.09 lies far outside"),
    ],
)
def test_a_matrix_that_is_surely_wrong_is_refused_with_what_would_be_right(
    tmp_path: Path, matrix: object, message: str
) -> None:
    with pytest.raises(InputError, match=message) as e:
        load_camera(camera(tmp_path, matrix))
    assert e.value.hint


@pytest.mark.parametrize(
    "distortion",
    [(1e9, 0, 0, 0), (0, 0, 1e9, 0), (-1e5, 0, 0, 0), (1e300, 1e300, 0, 0)],
)
def test_a_distortion_that_no_lens_has_is_refused(
    tmp_path: Path, distortion: tuple[float, ...]
) -> None:
    with pytest.raises(InputError, match="distortion"):
        load_camera(camera(tmp_path, distortion=distortion))


@pytest.mark.parametrize(
    ("matrix", "distortion", "message"),
    [
        ([[800, 0, 640], [0, 1400, 360], [0, 0, 1]], (0, 0, 0, 0), "oblong"),
        ([[100, 0, 640], [0, 100, 360], [0, 0, 1]], (0, 0, 0, 0), "unusual"),
        (
            [[800, 0, 1500], [0, 800, 360], [0, 0, 1]],
            (0, 0, 0, 0),
            "outside the picture",
        ),
        (K, (-2.0, 0, 0, 0), "of the picture only"),
    ],
)
def test_what_is_odd_is_told(
    tmp_path: Path, matrix: object, distortion: tuple[float, ...], message: str
) -> None:
    (doubt,) = camera_warnings(load_camera(camera(tmp_path, matrix, distortion)), {})
    assert message in doubt


def test_usual_cameras_raise_no_doubt(tmp_path: Path) -> None:
    assert (
        camera_warnings(
            load_camera(camera(tmp_path, distortion=(-0.28, 0.07, 0, 0))), {}
        )
        == []
    )
    assert camera_warnings(Camera.guess(1920, 1080), {}) == []
    fisheye = Camera(
        1280,
        720,
        np.array([[400.0, 0, 640], [0, 400, 360], [0, 0, 1]]),
        np.array([0.01, 0, 0, 0]),
        "fisheye",
    )
    assert camera_warnings(fisheye, {}) == []


@pytest.mark.parametrize("width", ["nan", "inf", "640.5"])
def test_a_colmap_size_is_two_whole_numbers(tmp_path: Path, width: str) -> None:
    (tmp_path / "cameras.txt").write_text(f"1 PINHOLE {width} 480 800 800 320 240\n")
    with pytest.raises(InputError, match="two whole numbers"):
        load_camera(tmp_path / "cameras.txt")
