"""What the attacks are made from: a small clip in many containers, a model in many formats,
calibrations, a killed job.

In `outside` lie files that a hostile input may name, and that nobody may open; a copy lies
beside every case."""

from __future__ import annotations

import fcntl
import hashlib
import json
import shutil
from pathlib import Path

import av
import cv2
import numpy as np
from PIL import Image

from tests.clips import clip_camera, write_camera, write_clip

SIZE = (160, 120)
CLIPS = {  # file -> codec, pixel format
    "clip.mp4": ("libx264", "yuv420p"), "clip.mkv": ("ffv1", "yuv444p"), "clip.mov": ("mpeg4", "yuv420p"),
    "clip.avi": ("mjpeg", "yuvj420p"), "clip.ts": ("libx264", "yuv420p"), "clip.webm": ("libvpx-vp9", "yuv420p"),
    "clip.nut": ("ffv1", "yuv420p"), "clip.flv": ("flv", "yuv420p"), "clip.mpg": ("mpeg2video", "yuv420p"),
    "clip.y4m": ("wrapped_avframe", "yuv420p"),
}  # fmt: skip
MODELS = (
    "model.glb",
    "model.gltf",
    "model.obj",
    "model.ply",
    "text.ply",
    "model.stl",
    "text.stl",
    "model.off",
)
LONG = 64  # frames of the clip of killed jobs: three chunks
CAMERAS = {
    "ros.yaml": "image_width: 160\nimage_height: 120\ncamera_name: c\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [152.0, 0.0, 79.5, 0.0, 152.0, 59.5, 0.0, 0.0, 1.0]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n"
    "  rows: 1\n  cols: 5\n  data: [0.01, 0.0, 0.0, 0.0, 0.0]\n",
    "cameras.txt": "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 OPENCV 160 120 152 152 80 60 0.01 0 0 0\n",
    "kalibr.yaml": "cam0:\n  camera_model: pinhole\n  intrinsics: [152.0, 152.0, 79.5, 59.5]\n  distortion_model: radtan\n"
    "  distortion_coeffs: [0.01, 0.0, 0.0, 0.0]\n  resolution: [160, 120]\n",
    "wpilib.json": json.dumps(
        {
            "camera_matrix": {"rows": 3, "cols": 3, "data": [152.0, 0, 79.5, 0, 152.0, 59.5, 0, 0, 1]},
            "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.01, 0, 0, 0, 0]},
            "image_width": 160, "image_height": 120, "avg_reprojection_error": 0.2,
        }
    ),
    "fisheye.yaml": "image_width: 160\nimage_height: 120\ndistortion_model: equidistant\n"
    "camera_matrix: [152, 0, 79.5, 0, 152, 59.5, 0, 0, 1]\ndistortion_coefficients: [0.01, 0, 0, 0]\n",
}  # fmt: skip
OTHERS = {
    "map.toml": '[[marker]]\nspec = "36h11:3"\nposition = ["0m", "0m", "0m"]\nrotate_deg = [0, 0, 0]\n',
    "map.json": json.dumps(
        {
            "tags": [
                {
                    "ID": 3,
                    "pose": {
                        "translation": {"x": 0, "y": 0, "z": 1.5},
                        "rotation": {"quaternion": {"W": 1, "X": 0, "Y": 0, "Z": 0}},
                    },
                }
            ],
            "field": {"length": 16.5, "width": 8.2},
        }
    ),
    "poses.txt": "# tx ty tz qx qy qz qw\n" + "".join(f"0.0{i} 0 -0.5 0 0 0 1\n" for i in range(4)),
    "job.toml": '[input]\nclip = "clip.mp4"\ncamera = "camera.yaml"\ntransfer = "srgb"\nstart = "0s"\n\n[[marker]]\n'
    'spec = "36h11:3:100mm"\n\n[model]\nfile = "model.glb"\nfit = "8cm"\nrotate = [0, 0, 90]\noffset = ["0cm", "0cm", "1cm"]\n\n'
    '[pipeline]\nstages = ["lightmap"]\nquality = "draft"\nseed = 1\n\n[output]\npath = "out.mp4"\ncodec = "h264"\ncrf = 20\n\n'
    '[analyse]\nsmoothing = 1.0\nmax_gap_s = 0.5\n\n[light]\nsize_deg = 5.0\n\n[lightmap]\nshadow_strength = 1.0\n\n'
    '[raster]\nbackend = "rays"\nsamples = 4\n',
}  # fmt: skip


def make(work: Path) -> Path:
    """work/material, made once, whoever comes first."""
    folder = work / "material"
    with (work / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.is_dir():
            new = work / "material.new"
            shutil.rmtree(new, ignore_errors=True)
            new.mkdir()
            _clips(new)
            _models(new)
            _texts(new)
            _outside(new / "outside", new)
            new.rename(folder)
    return folder


def _clips(folder: Path) -> None:
    camera = clip_camera(*SIZE)
    write_camera(folder / "camera.yaml", camera)
    write_clip(folder / "long.mp4", LONG, camera)
    for name, (codec, pixel_format) in CLIPS.items():
        write_clip(
            folder / name,
            4,
            camera,
            codec=codec,
            pixel_format=pixel_format,
            audio=name in ("clip.mp4", "clip.ts"),
        )
    with av.open(str(folder / "clip.mkv")) as c:
        pages = [f.to_image() for f in c.decode(video=0)]
    pages[0].save(folder / "clip.tif", save_all=True, append_images=pages[1:])
    pages[0].save(folder / "clip.gif", save_all=True, append_images=pages[1:])
    pages[0].save(folder / "picture.png")
    (folder / "depth").mkdir()
    for i in range(4):
        cv2.imwrite(
            str(folder / "depth" / f"{i:04d}.png"),
            np.full((120, 160), 400 + i, np.uint16),
        )
    Image.fromarray(np.full((16, 32, 3), 128, np.uint8)).save(
        folder / "environment.png"
    )
    cv2.imwrite(
        str(folder / "environment.hdr"), np.full((16, 32, 3), 0.5, np.float32)
    )


def _models(folder: Path) -> None:
    import trimesh

    mesh = trimesh.creation.box((1, 1, 1))
    uv = np.random.default_rng(0).random((len(mesh.vertices), 2))
    image = Image.fromarray(
        np.random.default_rng(1).integers(0, 255, (8, 8, 3)).astype(np.uint8)
    )
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=image, metallicFactor=0.1, roughnessFactor=0.8
    )
    textured = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    textured.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    textured.export(folder / "model.glb")
    for name, data in trimesh.exchange.gltf.export_gltf(
        trimesh.Scene(textured)
    ).items():
        (folder / name).write_bytes(data)
    gltf = json.loads((folder / "model.gltf").read_text())
    image.save(folder / "texture.png")
    gltf["images"] = [{"uri": "texture.png"}]
    (folder / "model.gltf").write_text(json.dumps(gltf))
    faces = "".join(
        f"f {a + 1}/{a + 1} {b + 1}/{b + 1} {c + 1}/{c + 1}\n"
        for a, b, c in mesh.faces
    )
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices) + "".join(
        f"vt {u:.4f} {v:.4f}\n" for u, v in uv
    )
    (folder / "model.obj").write_text(
        f"mtllib model.mtl\no box\n{points}usemtl paint\n{faces}"
    )
    (folder / "model.mtl").write_text(
        "newmtl paint\nKd 0.8 0.4 0.2\nKs 0.1 0.1 0.1\nNs 20\nd 1.0\nillum 2\nmap_Kd"
        " texture.png\n"
    )
    mesh.visual.vertex_colors = [200, 80, 40, 255]
    mesh.export(folder / "model.ply")
    mesh.export(folder / "text.ply", encoding="ascii")
    mesh.export(folder / "model.stl")
    mesh.export(folder / "text.stl", file_type="stl_ascii")
    mesh.export(folder / "model.off")


def _texts(folder: Path) -> None:
    for name, text in {**CAMERAS, **OTHERS}.items():
        (folder / name).write_text(text)


def _outside(folder: Path, material: Path) -> None:
    folder.mkdir()
    shutil.copy(material / "clip.mp4", folder / "secret.mp4")
    shutil.copy(material / "clip.ts", folder / "secret.ts")
    shutil.copy(material / "texture.png", folder / "secret.png")
    shutil.copy(material / "model.mtl", folder / "secret.mtl")
    (folder / "secret.bin").write_bytes(bytes(4096))


def digest(path: Path) -> str:
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()
