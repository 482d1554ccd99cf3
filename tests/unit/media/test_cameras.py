"""Calibration files of other tools, and the one that arfx writes."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from arfx.core.camera import BROWN, FISHEYE, Camera
from arfx.errors import InputError
from arfx.media.cameras import (
    calibration_claims,
    camera_warnings,
    load_camera,
    save_camera,
)

K = np.array([[801.5, 0, 322.25], [0, 799.125, 239.75], [0, 0, 1]])
D5 = np.array([-0.2664, 0.0386, 0.00178, -0.00028, 0.2384])
D14 = np.array(
    [
        0.4,
        -2.5,
        -0.001,
        0.0017,
        5.6,
        0.046,
        0.118,
        -0.22,
        1e-4,
        -2e-4,
        3e-4,
        4e-5,
        0.01,
        -0.02,
    ]
)


def write(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def same(
    camera: Camera,
    k: np.ndarray,
    d: np.ndarray,
    size: tuple[int, int] = (640, 480),
    model: str = BROWN,
) -> None:
    assert (camera.width, camera.height, camera.model) == (*size, model)
    np.testing.assert_array_equal(camera.matrix, k)
    np.testing.assert_array_equal(camera.distortion, d)


@pytest.mark.parametrize(
    ("text", "centre", "distortion"),
    [
        ("fx: 801.5\nfy: 799.125\ncx: 322.25\ncy: 239.75\n", (322.25, 239.75), ()),
        ("fx: 801.5\nfy: 799.125\n", (319.5, 239.5), ()),
        (
            "fx: 801.5\nfy: 799.125\ndistortion: [-0.1, 0, 0, 0]\n",
            (319.5, 239.5),
            (-0.1, 0, 0, 0),
        ),
    ],
)
def test_a_file_by_hand(
    tmp_path: Path,
    text: str,
    centre: tuple[float, float],
    distortion: tuple[float, ...],
) -> None:
    k = K.copy()
    k[:2, 2] = centre
    read = load_camera(
        write(tmp_path, "camera.yaml", f"{text}width: 640\nheight: 480\n")
    )
    same(read, k, np.array(distortion))


def test_a_file_by_hand_states_numbers_and_a_size(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not state the picture size"):
        load_camera(write(tmp_path, "a.yaml", "fx: 800\nfy: 800\n"))
    text = "fx: wide\nfy: 800\nwidth: 640\nheight: 480\n"
    with pytest.raises(InputError, match="fx, fy, cx, cy is not a list of numbers"):
        load_camera(write(tmp_path, "b.yaml", text))


@pytest.mark.parametrize(
    ("d", "model"),
    [
        (D5, BROWN),
        (D14[:8], BROWN),
        (D14[:12], BROWN),
        (D14, BROWN),
        (np.array([0.1, -0.02, 0.003, 1e-5]), FISHEYE),
    ],
)
def test_round_trip_is_exact_and_readable_by_opencv_and_strict_yaml(
    tmp_path: Path, d: np.ndarray, model: str
) -> None:
    path = tmp_path / "camera.yaml"
    save_camera(
        path,
        Camera(640, 480, K, d, model),
        verdict="good",
        reasons=["a: b", "c 'd'"],
        std={"fx": 0.1},
        rms=0.3,
    )
    same(load_camera(path), K, d, model=model)
    fs = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(fs.getNode("camera_matrix").mat(), K)
    np.testing.assert_array_equal(
        fs.getNode("distortion_coefficients").mat().ravel(), d
    )
    assert fs.getNode("std").getNode("fx").real() == 0.1
    assert fs.getNode("reasons").at(0).string() == "a: b"
    fs.release()
    ros = yaml.safe_load(path.read_text())
    assert ros["distortion_model"] == (
        "equidistant"
        if model == FISHEYE
        else "plumb_bob"
        if d.size <= 5
        else "rational_polynomial"
    )
    assert np.reshape(ros["projection_matrix"]["data"], (3, 4))[1, 2] == K[1, 2]
    assert [p.name for p in tmp_path.iterdir()] == ["camera.yaml"], (
        "no temporary file is left"
    )


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_what_opencv_itself_writes(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"c.{suffix}"
    fs = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    fs.write("calibration_time", "Mon 02 Jan 2023 10:00:00")
    fs.write("image_width", 640)
    fs.write("image_height", 480)
    fs.write("camera_matrix", K)
    fs.write("distortion_coefficients", D5.reshape(-1, 1))
    fs.release()
    same(load_camera(path), K, D5)


def test_ros_camera_info_file_and_echoed_message(tmp_path: Path) -> None:
    file = f"""
image_width: 640
image_height: 480
camera_name: head
camera_matrix: {{rows: 3, cols: 3, data: {K.ravel().tolist()}}}
distortion_model: equidistant
distortion_coefficients: {{rows: 1, cols: 4, data: [1e-3, 0.2, 3E-05, 0]}}
"""
    same(
        load_camera(write(tmp_path, "a.yaml", file)),
        K,
        np.array([1e-3, 0.2, 3e-5, 0]),
        model=FISHEYE,
    )
    message = f"""
header:
  seq: 0
height: 480
width: 640
distortion_model: plumb_bob
D: {D5.tolist()}
K: {K.ravel().tolist()}
---
"""
    same(load_camera(write(tmp_path, "b.yaml", message)), K, D5)


def test_colmap_pixel_centres_are_half_a_pixel_off(tmp_path: Path) -> None:
    head = (
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH,"
        " HEIGHT, PARAMS[]\n"
    )
    k = np.array([[800.0, 0, 319.5], [0, 800, 239.5], [0, 0, 1]])
    path = write(
        tmp_path, "cameras.txt", head + "1 SIMPLE_RADIAL 640 480 800 320 240 -0.05\n"
    )
    same(load_camera(path), k, np.array([-0.05, 0, 0, 0]))
    path = write(
        tmp_path,
        "cameras.txt",
        head + "1 FULL_OPENCV 640 480 800 800 320 240 1 2 3 4 5 6 7 8\n",
    )
    same(load_camera(path), k, np.arange(1.0, 9.0))
    path = write(
        tmp_path,
        "cameras.txt",
        "1 PINHOLE 640 480 800 800 320 240\n2 RADIAL_FISHEYE 64 48 90 32 24 .1 .2\n",
    )
    with pytest.raises(InputError, match="2 cameras"):
        load_camera(path)
    same(load_camera(f"{path}#1"), k, np.zeros(0))
    assert load_camera(f"{path}#2").model == FISHEYE
    with pytest.raises(InputError, match="fov"):
        load_camera(
            write(tmp_path, "cameras.txt", "1 FOV 640 480 800 800 320 240 .9\n")
        )


def test_kalibr_camchain(tmp_path: Path) -> None:
    chain = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.7e-05]
  distortion_model: radtan
  intrinsics: [458.6, 457.2, 367.2, 248.3]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.1]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]
  distortion_model: equidistant
  intrinsics: [1, 2, 3, 4]
  resolution: [10, 10]
"""
    path = write(tmp_path, "camchain.yaml", chain)
    with pytest.raises(InputError, match="cam0, cam1"):
        load_camera(path)
    k = np.array([[458.6, 0, 367.2], [0, 457.2, 248.3], [0, 0, 1]])
    same(
        load_camera(f"{path}#cam0"),
        k,
        np.array([-0.28, 0.07, 0.0002, 1.7e-05]),
        (752, 480),
    )
    assert load_camera(f"{path}#cam1").model == FISHEYE
    with pytest.raises(InputError, match="omni"):
        load_camera(
            write(
                tmp_path, "o.yaml", chain.split("cam1:")[0].replace("pinhole", "omni")
            )
        )


@pytest.mark.parametrize(
    "document",
    [
        {
            "camera_matrix": K.ravel().tolist(),
            "distortion_coefficients": D5.tolist(),
            "image_width": 640,
            "image_height": 480,
        },
        {"image_size": [640, 480], "K": K.ravel().tolist(), "dist": D5.tolist()},
        {
            "img_size": [640, 480],
            "camera_matrix": K.tolist(),
            "distortion_coefficients": [D5.tolist()],
        },
        {
            "resolution": {"width": 640.0, "height": 480.0},
            "cameraIntrinsics": {
                "rows": 3,
                "cols": 3,
                "type": 6,
                "data": K.ravel().tolist(),
            },
            "distCoeffs": {"rows": 1, "cols": 5, "data": D5.tolist()},
        },
    ],
)
def test_json_of_wpilib_photonvision_and_others(
    tmp_path: Path, document: dict
) -> None:
    same(load_camera(write(tmp_path, "c.json", json.dumps(document))), K, D5)


def test_a_file_without_a_size_needs_one(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "c.json",
        json.dumps(
            {
                "camera_matrix": K.ravel().tolist(),
                "distortion_coefficients": D5.tolist(),
            }
        ),
    )
    with pytest.raises(InputError, match="picture size"):
        load_camera(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "holds no camera"),
        ("hello", "holds no camera"),
        ("{]", "neither valid"),
        ("a: [1", "neither valid"),
        ("a: 1\nb: 2", "its keys: a, b"),
        ('{"K": [1,2,3], "image_size": [4, 4]}', "3 numbers"),
        ('{"K": "x", "image_size": [4, 4]}', "not a list of numbers"),
        ('{"K": [9,0,1,0,9,1,0,0,1], "image_size": [4.5, 4]}', "picture size"),
        ('{"K": [9,3,1,0,9,1,0,0,1], "image_size": [4, 4]}', "skew"),
        ('{"K": [-9,0,1,0,9,1,0,0,1], "image_size": [4, 4]}', "focal length"),
        (
            '{"K": [9,0,1,0,9,1,0,0,1], "image_size": [4, 4], "distortion_model": "ucm"}',
            "'ucm'",
        ),
        (
            '{"K": [9,0,1,0,9,1,0,0,1], "image_size": [4, 4], "dist": [1,2,3,4,5,6,7]}',
            "7 distortion",
        ),
        ("K: [9,0,.Nan,0,9,1,0,0,1]\nimage_size: [4, 4]", "not finite"),
        (
            "K: [9,0,1,0,9,1,0,0,1]\nimage_size: [4, 4]\nD: [-.Inf,0,0,0]",
            "not finite",
        ),
        ("K: !!python/object:os.system [1]", "neither valid"),
    ],
)
def test_wrong_files_get_one_clear_error(
    tmp_path: Path, text: str, says: str
) -> None:
    with pytest.raises(InputError, match=says) as e:
        load_camera(write(tmp_path, "c.yaml", text))
    assert "c.yaml" in str(e.value)


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_camera(tmp_path / "none.yaml")
    (tmp_path / "b.yaml").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InputError, match="not text"):
        load_camera(tmp_path / "b.yaml")


def test_a_failed_save_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(OSError):
        save_camera(tmp_path / "missing" / "c.yaml", Camera(640, 480, K, D5))
    assert not list(tmp_path.iterdir())


def test_what_a_calibration_says_of_itself_is_read(tmp_path: Path) -> None:
    a = write(
        tmp_path,
        "a.yaml",
        "%YAML:1.0\n---\nverdict: usable\ncondition: 3.5e+04\nimage_width: 640\n",
    )
    assert calibration_claims(a) == {"verdict": "usable", "condition": 3.5e4}
    assert calibration_claims(write(tmp_path, "c.yaml", "condition: e.e\n")) == {}
    assert calibration_claims(write(tmp_path, "d.yaml", "condition: .nan\n")) == {}
    assert calibration_claims(write(tmp_path, "b.yaml", "image_width: 640\n")) == {}
    assert calibration_claims(tmp_path / "none") == {}


@pytest.mark.parametrize(
    ("claims", "said"),
    [
        (
            {"verdict": "poor", "reasons": ["only 3 views"]},
            ["verdict is poor (only 3 views)"],
        ),
        ({"verdict": "poor"}, ["verdict is poor:"]),
        ({"verdict": "usable", "reasons": ["only 9 views"]}, []),
    ],
)
def test_a_calibration_that_calls_itself_poor_is_one_notice(
    tmp_path: Path, claims: dict[str, object], said: list[str]
) -> None:
    path = tmp_path / "camera.yaml"
    save_camera(path, Camera(640, 480, K, D5), **claims)
    notices = camera_warnings(load_camera(path), calibration_claims(path))
    assert len(notices) == bool(said) and all(words in notices[0] for words in said)


def test_what_opencv_writes_as_xml(tmp_path: Path) -> None:
    name = "c.xml"
    fs = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
    fs.write("calibration_time", "Mon 02 Jan 2023 10:00:00")
    fs.write("image_width", 640)
    fs.write("image_height", 480)
    fs.write("camera_matrix", K)
    fs.write("distortion_coefficients", D5[None])
    fs.release()
    same(load_camera(tmp_path / name), K, D5)


def test_numpy_archives(tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    np.savez(
        path,
        mtx=K,
        dist=D5[None],
        image_width=640,
        image_height=480,
        rvecs=np.array([{}], object),
    )
    same(load_camera(path), K, D5)
    np.savez_compressed(path, mtx=K, dist=D5, imageSize=(640, 480))
    same(load_camera(path), K, D5)
    np.savez(path, mtx=K, dist=D5)
    with pytest.raises(InputError, match="does not state the picture size") as e:
        load_camera(path)
    assert "np.savez" in str(e.value.hint)


def test_colmaps_binary_model_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cameras.bin"
    path.write_bytes(bytes(8))
    with pytest.raises(InputError, match="binary model") as e:
        load_camera(path)
    assert "cameras.txt" in str(e.value.hint)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (pickle.dumps({"mtx": 1}), "a Python pickle"), (b"MATLAB 5.0 MAT-file", "a MATLAB file"),
        (b"\x93NUMPY\1\0", "a single NumPy array"), (b"PK\3\4nothing", "not a NumPy archive"),
        (b"\x1f\x8bnothing", "packed by gzip"), (b"<calibration><f>3</f></calibration>", "XML of another program"),
        (b"<opencv_storage><K>", "neither valid"), (b"<!DOCTYPE a><opencv_storage/>", "a DOCTYPE is not read"),
    ],
)  # fmt: skip
def test_files_that_are_not_read_are_named(
    tmp_path: Path, data: bytes, said: str
) -> None:
    path = tmp_path / "camera"
    path.write_bytes(data)
    with pytest.raises(InputError, match=said):
        load_camera(path)
