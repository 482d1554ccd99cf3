"""Model files, written by the test: what is read, and what is refused with which words."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, MASK, OPAQUE, Material, Part
from arfx.errors import InputError
from arfx.media.model_parts import part_of
from arfx.media.models import load_model


def glb(
    path: Path,
    material: dict,
    uv: np.ndarray | None = None,
    colours: np.ndarray | None = None,
    matrix: list | None = None,
) -> Path:
    """One triangle (0,0,0) (1,0,0) (0,1,0) with a material, as a binary glTF file of our
    own making.
    """
    arrays = {"POSITION": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)}
    if uv is not None:
        arrays["TEXCOORD_0"] = uv.astype(np.float32)
    if colours is not None:
        arrays["COLOR_0"] = colours.astype(np.float32)
    blob, views, accessors, attributes = b"", [], [], {}
    for name, a in arrays.items():
        kind = {2: "VEC2", 3: "VEC3", 4: "VEC4"}[a.shape[1]]
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": a.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": len(a), "type": kind,
                          "min": a.min(0).tolist(), "max": a.max(0).tolist()})  # fmt: skip
        attributes[name] = len(accessors) - 1
        blob += a.tobytes()
    node: dict = {"mesh": 0}
    if matrix is not None:
        node["matrix"] = matrix
    header = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node],
        "meshes": [{"primitives": [{"attributes": attributes, "material": 0}]}], "materials": [material],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(blob)}],
    }  # fmt: skip
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(blob)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON") + text
                     + struct.pack("<I4s", len(blob), b"BIN\0") + blob)  # fmt: skip
    return path


def test_gltf_factors_are_exact_and_defaults_are_the_standards(
    tmp_path: Path,
) -> None:
    base = [0.0123, 0.4567, 1.0, 0.25]
    m = load_model(glb(tmp_path / "a.glb", {"name": "m", "alphaMode": "BLEND", "emissiveFactor": [0.5, 0.25, 0.125],
                                            "pbrMetallicRoughness": {"baseColorFactor": base}}))  # fmt: skip
    material = m.parts[0].material
    np.testing.assert_allclose(
        material.base_colour, base, atol=1e-6
    )  # trimesh alone rounds to 8 bits: .0118
    assert (material.metallic, material.roughness, material.alpha_mode) == (
        1.0,
        1.0,
        BLEND,
    )
    np.testing.assert_allclose(material.emissive, [0.5, 0.25, 0.125])
    assert m.up == "y" and not material.double_sided


@pytest.mark.parametrize(
    ("mode", "expected"), [("MASK", MASK), ("OPAQUE", OPAQUE), (None, OPAQUE)]
)
def test_alpha_modes(tmp_path: Path, mode: str | None, expected: str) -> None:
    material = {"name": "m", "alphaCutoff": 0.75} | (
        {"alphaMode": mode} if mode else {}
    )
    m = load_model(glb(tmp_path / "a.glb", material)).parts[0].material
    assert m.alpha_mode == expected and (mode != "MASK" or m.alpha_cutoff == 0.75)


def test_scene_graph_mirrors_and_stretches(tmp_path: Path) -> None:
    # column-major: x mirrored and doubled, z moved by 5
    matrix = [-2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]
    p = load_model(glb(tmp_path / "a.glb", {"name": "m"}, matrix=matrix)).parts[0]
    np.testing.assert_allclose(p.vertices.min(0), [-2, 0, 5])
    v = p.vertices[p.faces[0]]
    n = np.cross(v[1] - v[0], v[2] - v[0])
    assert n[2] > 0, "a mirrored node must not turn the triangle inside out"
    np.testing.assert_allclose(p.normals, [[0, 0, 1]] * 3, atol=1e-12)


def test_gltf_texture_coordinates_count_from_the_top(tmp_path: Path) -> None:
    uv = np.array([[0, 0.25], [1, 0.25], [0, 1]])
    p = load_model(glb(tmp_path / "a.glb", {"name": "m"}, uv=uv)).parts[0]
    np.testing.assert_allclose(p.uv, uv, atol=1e-6)


def test_obj_with_spaces_in_its_textures_name(tmp_path: Path) -> None:
    picture = np.zeros((2, 4, 3), np.uint8)
    picture[0, 0] = [255, 10, 20]  # top left
    Image.fromarray(picture).save(tmp_path / "my wood picture.png")
    (tmp_path / "a.mtl").write_text(
        "newmtl wood\nKd 0.5 1 1\nNs 30\nmap_Kd my wood picture.png\n"
    )
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nvt 1 1\nvt 0 0\nusemtl wood\nf"
        " 1/1 2/2 3/3\n"
    )
    p = load_model(tmp_path / "a.obj").parts[0]
    assert p.material.base_texture is not None and p.uv is not None
    at = p.uv_on(p.material.base_texture)[np.flatnonzero((p.vertices == 0).all(1))[0]]
    np.testing.assert_allclose(
        at, [0, 0], atol=1e-9
    )  # vt (0, 1) is the picture's top left
    assert p.material.base_texture.picture[0, 0, :3].tolist() == [255, 10, 20]
    assert p.material.base_colour[0] == pytest.approx(
        float(SRGB.decode(np.array(0.5))), abs=0.004
    )
    assert 0.4 < p.material.roughness < 0.6  # (2 / 32) ^ 1/4


def test_ply_vertex_colours_become_linear(tmp_path: Path) -> None:
    mesh = trimesh.creation.box()
    mesh.visual.vertex_colors = np.tile(
        np.array([188, 0, 255, 255], np.uint8), (8, 1)
    )
    mesh.export(tmp_path / "a.ply")
    m = load_model(tmp_path / "a.ply")
    assert m.up == "z" and m.parts[0].material.double_sided
    np.testing.assert_allclose(m.parts[0].colours[0], [0.503, 0, 1, 1], atol=1e-3)
    assert m.parts[0].material.base_colour == (
        1,
        1,
        1,
        1,
    ), "colours must not be darkened by a default factor"


def test_stl_cube_gets_sharp_edges_and_a_sphere_smooth_ones(tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "box.stl")
    box = load_model(tmp_path / "box.stl").parts[0]
    assert len(box.vertices) == 24
    np.testing.assert_allclose(np.abs(box.normals).max(1), 1, atol=1e-12)
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / "ball.stl")
    ball = load_model(tmp_path / "ball.stl").parts[0]
    assert len(ball.vertices) == 642, (
        "shared again after STL took every triangle apart"
    )
    r = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    assert (r * ball.normals).sum(1).min() > np.cos(np.radians(1.5))


def test_smoothing_keeps_apart_what_the_file_keeps_apart() -> None:
    v = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]])
    f = np.array([[0, 1, 2], [3, 4, 5]])

    def part(**rows: np.ndarray) -> Part:
        out = part_of(f, {"vertices": v, **rows}, np.eye(4), Material())
        assert out is not None and (out.vertices[out.faces] == v[f]).all()
        np.testing.assert_allclose(out.normals, [[0, 0, 1]] * len(out.vertices))
        return out

    uv = np.arange(12.0).reshape(6, 2)
    apart = part(uv=uv)
    assert apart.uv is not None and (apart.uv[apart.faces] == uv[f]).all()
    assert len(apart.vertices) == 6 and len(part().vertices) == 4


def test_faces_without_area_are_dropped_and_counted(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\nf 1 1 2\n"
    )
    m = load_model(tmp_path / "a.obj")
    assert m.face_count == 1 and "2 faces without area" in m.notices[0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "a.obj",
            "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n",
            "1 of 3 vertices are not finite",
        ),
        ("a.obj", "v 0 0 0\nv 1 0 0\n", "no faces|cannot read"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no faces"),
        ("a.obj", "v 0 0 0\nv 1e12 0 0\nv 0 1 0\nf 1 2 3\n", "spans|no faces"),
        ("a.glb", "this is no glTF", "cannot read"),
        (
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\n",
            "cannot read|no faces",
        ),
        ("a.stl", "", "is empty"),
        ("a.xyzw", "?", "cannot read"),
    ],
)
def test_refusals(tmp_path: Path, name: str, content: str, message: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as e:
        load_model(tmp_path / name)
    assert str(tmp_path / name) in e.value.message and "\n" not in e.value.message


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_model(tmp_path / "no.glb")
    with pytest.raises(InputError, match="is a folder"):
        load_model(tmp_path)


def test_a_texture_beyond_the_limit_is_refused(tmp_path: Path) -> None:
    Image.new("L", (8193, 1)).save(tmp_path / "t.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd t.png\n")
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1"
        " 2/2 3/3\n"
    )
    with pytest.raises(InputError, match="8193x1"):
        load_model(tmp_path / "a.obj")


def test_a_ply_may_have_an_empty_comment(tmp_path: Path) -> None:
    mesh = trimesh.creation.box()
    text = mesh.export(file_type="ply", encoding="ascii").decode()
    (tmp_path / "a.ply").write_text(
        text.replace("\nelement vertex", "\ncomment\nelement vertex")
    )
    assert load_model(tmp_path / "a.ply").face_count == 12
