"""Model files that are damaged, or made to do harm: one message, and no file of others is read."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from arfx.errors import InputError
from arfx.media.models import load_model

OBJ = (
    "mtllib {}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2"
    " 3/3\n"
)
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)


# of messages that Python, numpy and trimesh raise where a file is damaged
PYTHON = r"Error|could not|No module|NoneType|' object|invalid literal|unpack|shape|unexpected"


def header(**changes: Any) -> dict[str, Any]:
    """A glTF triangle, its buffer in triangle.bin."""
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"name": "m"}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "triangle.bin", "byteLength": 36}], **changes,
    }  # fmt: skip


def gltf(folder: Path, tree: dict[str, Any]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "triangle.bin").write_bytes(POINTS.tobytes())
    (folder / "a.gltf").write_text(json.dumps(tree))
    return folder / "a.gltf"


def obj(folder: Path, mtl: str, material: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "a.mtl").write_text(material)
    (folder / "a.obj").write_text(OBJ.format(mtl))
    return folder / "a.obj"


def test_a_model_names_all_files_that_it_was_read_from(tmp_path: Path) -> None:
    path = gltf(tmp_path, header(images=[{"uri": "t%20x.png"}], textures=[{"source": 0}],
                                 materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]))  # fmt: skip
    Image.new("RGB", (2, 2)).save(tmp_path / "t x.png")
    model = load_model(path)
    assert (
        sorted(f.name for f in model.files) == ["a.gltf", "t x.png", "triangle.bin"]
        and not model.notices
    )
    Image.new("RGB", (2, 2)).save(tmp_path / "t.png")
    model = load_model(
        obj(tmp_path, "a.mtl", "newmtl m\nmap_Kd C:\\work\\t.png\n")
    )  # an exporter's own path
    assert (
        sorted(f.name for f in model.files) == ["a.mtl", "a.obj", "t.png"]
        and not model.notices
    )


@pytest.mark.parametrize(
    "name",
    [
        "../secret.bin",
        "{root}/secret.bin",
        "link.bin",
        "..%2Fsecret.bin",
        "x/../../secret.bin",
    ],
)
def test_a_buffer_outside_the_models_folder_is_refused(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / "secret.bin").write_bytes(POINTS.tobytes())
    path = gltf(
        tmp_path / "m",
        header(buffers=[{"uri": name.format(root=tmp_path), "byteLength": 36}]),
    )
    (tmp_path / "m" / "link.bin").symlink_to(tmp_path / "secret.bin")
    with pytest.raises(InputError, match="not in its folder"):
        load_model(path)


@pytest.mark.parametrize(
    "name",
    [
        "file:///etc/passwd",
        "http://localhost:1/x.bin",
        "",
        ".",
        "pipe:0",
        "x" * 5000,
        "a\0b",
    ],
)
def test_an_address_is_no_file_of_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="not in its folder"):
        load_model(
            gltf(tmp_path / "m", header(buffers=[{"uri": name, "byteLength": 36}]))
        )


def test_a_name_outside_the_models_folder_is_not_even_looked_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[Path] = []
    given = Path.exists

    def exists(self: Path) -> bool:
        looked.append(self)
        return given(self)

    path = gltf(
        tmp_path / "m",
        header(buffers=[{"uri": "//host/share/x.bin", "byteLength": 36}]),
    )
    monkeypatch.setattr(Path, "exists", exists)
    with pytest.raises(InputError, match="not in its folder"):
        load_model(path)
    assert looked == [tmp_path / "m" / "x.bin"]


@pytest.mark.parametrize("mtl", ["../o.mtl", "none.mtl", "/dev/zero"])
def test_materials_that_are_missing_or_outside_are_told(
    tmp_path: Path, mtl: str
) -> None:
    (tmp_path / "o.mtl").write_text("newmtl m\nKd 1 0 0\n")
    (notice,) = load_model(obj(tmp_path / "m", mtl, "")).notices
    assert mtl in notice and "left out" in notice


def test_textures_that_are_missing_outside_or_no_pictures_are_told(
    tmp_path: Path,
) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / "out.png")
    for name, why in (
        ("../out.png", "not in its folder"),
        ("none.png", "not in its folder"),
    ):
        (notice,) = load_model(
            obj(tmp_path / "m", "a.mtl", f"newmtl m\nmap_Kd {name}\n")
        ).notices
        assert why in notice
    (tmp_path / "m" / "t.png").write_text("no picture")
    (notice,) = load_model(
        obj(tmp_path / "m", "a.mtl", "newmtl m\nmap_Kd t.png\n")
    ).notices
    assert "PNG" in notice


@pytest.mark.parametrize("embedded", [False, True])
def test_postscript_under_a_pictures_name_starts_no_program(
    tmp_path: Path, embedded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(*_: object, **__: object) -> None:
        raise AssertionError("a program was started")

    eps = (
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10"
        b" 10\n%%EndComments\nshowpage\n%%EOF\n"
    )
    tmp_path.joinpath("t.png").write_bytes(eps)
    import base64

    uri = (
        "data:image/png;base64," + base64.b64encode(eps).decode()
        if embedded
        else "t.png"
    )
    path = gltf(tmp_path, header(images=[{"uri": uri}], textures=[{"source": 0}],
                                 materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]))  # fmt: skip
    for name in ("subprocess.Popen", "subprocess.check_call", "os.system"):
        monkeypatch.setattr(name, started)
    model = load_model(path)
    assert (
        "textures left out" in model.notices[0]
        and model.parts[0].material.base_texture is None
    )


def damaged(change: Any) -> dict[str, Any]:
    tree = copy.deepcopy(header())
    change(tree)
    return tree


def put(*keys: Any) -> Any:
    """Sets the last of keys where the others lead to."""
    *way, last, value = keys

    def change(tree: Any) -> None:
        for key in way:
            tree = tree[key]
        tree[last] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        put("accessors", 0, "componentType", 9999),
        put("accessors", 0, "type", "VEC9"),
        put("accessors", 0, "type", "SCALAR"),
        put("accessors", 0, "count", -3),
        put("accessors", 0, "count", 10**12),
        put("accessors", 0, "count", "3"),
        put("accessors", 0, "bufferView", 7),
        put("accessors", "x"),
        put("accessors", [None]),
        put("bufferViews", 0, "byteOffset", 10**9),
        put("nodes", [{"mesh": 0, "children": [0]}]),
        put("nodes", [{"children": [1]}, {"mesh": 0, "children": [0]}]),
        put("nodes", [{"mesh": 5}]),
        put("nodes", [{"mesh": 0, "matrix": [1, 2]}]),
        put("nodes", [{"mesh": 0, "scale": [1e308, 1e308, 1e308]}]),
        put("nodes", [{"mesh": 0, "rotation": "x"}]),
        put("scenes", [{"nodes": [9]}]),
        put("meshes", 0, "primitives", 0, "material", 4),
        put("meshes", 0, "primitives", 0, "indices", 0),
        put("meshes", 0, "primitives", "x"),
        put(
            "materials",
            [{"pbrMetallicRoughness": {"baseColorFactor": [1e999, 0, 0, 1]}}],
        ),
        put(
            "materials", [{"pbrMetallicRoughness": {"metallicFactor": float("nan")}}]
        ),
        put("materials", [{"name": "m", "emissiveFactor": [1e999, 0, 0]}]),
        put("materials", [{"pbrMetallicRoughness": 5}]),
        put("asset", 5),
        put("asset", {"version": "1" * 5000}),
        put("extras", json.loads("[" * 500 + "]" * 500)),
        put("buffers", [{"uri": "data:;base64,====", "byteLength": 36}]),
        put("extensionsRequired", ["KHR_draco_mesh_compression"]),
    ],
)
def test_damaged_gltf_is_one_message(tmp_path: Path, change: Any) -> None:
    with pytest.raises(InputError) as e:
        load_model(gltf(tmp_path, damaged(change)))
    assert "a.gltf" in e.value.message and "\n" not in e.value.message
    assert not re.search(PYTHON, str(e.value))


@pytest.mark.parametrize(
    "factor",
    [
        '"metallicFactor": 1e999',
        '"baseColorFactor": [1e999, 0, 0, 1]',
        '"baseColorFactor": [NaN, 0, 0, 1]',
    ],
)
def test_material_numbers_that_are_not_finite_are_refused(
    tmp_path: Path, factor: str
) -> None:
    path = gltf(
        tmp_path, header(materials=[{"name": "m", "pbrMetallicRoughness": {"x": 0}}])
    )
    path.write_text(path.read_text().replace('"x": 0', factor))
    with pytest.raises(InputError, match=r"out of range|NaN is not"):
        load_model(path)


@pytest.mark.parametrize(
    "body",
    [
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0\nvt 1\nvt 0\nf 1/1 2/2 3/3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/0 2/0 3/0\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/2 3/3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 0 0\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n",
        "v 0 0 0\nv 1 0\nf 1 2 3\n",
        "v a b c\nf 1 2 3\n",
    ],
)
def test_odd_obj_is_read_or_one_message(tmp_path: Path, body: str) -> None:
    (tmp_path / "a.obj").write_text(body)
    try:
        model = load_model(tmp_path / "a.obj")
    except InputError as e:
        assert "a.obj" in e.message and "\n" not in e.message
        assert not re.search(PYTHON, str(e))
    else:
        assert all(
            np.isfinite(p.vertices).all()
            and (p.uv is None or np.isfinite(p.uv).all())
            for p in model.parts
        )


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\nx\n",
        ),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex x\nend_header\n"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0\n"),
        ("a.off", b"nothing of the kind\n"),
        ("a.stl", bytes(80) + b"\x0c\0\0\0" + bytes(range(200))),
    ],
)
def test_damage_is_told_in_words(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match="does not fit together") as e:
        load_model(tmp_path / name)
    assert not re.search(PYTHON, str(e.value))


def test_mtl_numbers_that_are_not_finite_or_huge_are_no_numbers(
    tmp_path: Path,
) -> None:
    for line in ("Kd nan 0 0", "d nan", "Ns nan", "Kd 1e999 0 0"):
        (notice,) = load_model(obj(tmp_path, "a.mtl", f"newmtl m\n{line}\n")).notices
        assert line in notice
    with pytest.raises(InputError, match="not finite"):
        load_model(obj(tmp_path, "a.mtl", "newmtl m\nKe 1e308 0 0\n"))


def test_instances_are_counted_before_anything_is_built(tmp_path: Path) -> None:
    many = header(
        nodes=[{"mesh": 0}] * 20_000, scenes=[{"nodes": list(range(20_000))}]
    )
    with pytest.raises(InputError, match="more than 10000 parts"):
        load_model(gltf(tmp_path, many))
    big = header(nodes=[{"mesh": 0}] * 5000, scenes=[{"nodes": list(range(5000))}])
    big["accessors"].append(
        {"componentType": 5125, "count": 30_000, "type": "SCALAR"}
    )
    big["meshes"][0]["primitives"][0]["indices"] = 1
    with pytest.raises(InputError, match="more than 5000000 faces"):
        load_model(gltf(tmp_path, big))


def test_what_moves_a_model_is_told_to_be_left_out(tmp_path: Path) -> None:
    moving = header(
        animations=[{"channels": [], "samplers": []}], skins=[{"joints": [0]}]
    )
    (notice,) = load_model(gltf(tmp_path, moving)).notices
    assert "animations and skins left out" in notice


def test_content_tells_the_format(tmp_path: Path) -> None:
    gltf(tmp_path, header()).rename(tmp_path / "b.glb")
    assert load_model(tmp_path / "b.glb").face_count == 1


@pytest.mark.parametrize(
    "name", ["a.dae", "a.zip", "a.tar.gz", "a.json", "a.3mf", "a.xyz", "a"]
)
def test_archives_and_formats_without_faces_are_refused(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04 whatever")
    with pytest.raises(InputError, match="not a format that is read"):
        load_model(tmp_path / name)


def test_a_picture_that_materials_share_is_decoded_once_and_all_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.new("RGB", (64, 64)).save(tmp_path / "t.png")
    Image.new("RGB", (64, 64)).save(tmp_path / "u.png")
    tree = header(
        images=[{"uri": "t.png"}, {"uri": "u.png"}],
        textures=[{"source": 0}, {"source": 0}, {"source": 1}],
    )
    tree["materials"] = [
        {"name": n, "pbrMetallicRoughness": {"baseColorTexture": {"index": k}}}
        for n, k in zip("abc", (0, 1, 2), strict=True)
    ]
    tree["meshes"] = [
        {
            "primitives": [
                {"attributes": {"POSITION": 0}, "material": k} for k in range(3)
            ]
        }
    ]
    a, b, c = (
        p.material.base_texture for p in load_model(gltf(tmp_path, tree)).parts
    )
    assert a.picture is b.picture and a.picture is not c.picture
    monkeypatch.setattr("arfx.media.model_files.MAX_TEXELS", 5000)
    with pytest.raises(InputError, match="textures hold more"):
        load_model(tmp_path / "a.gltf")


def test_nodes_in_a_long_chain_are_walked(tmp_path: Path) -> None:
    chain = [{"children": [k + 1], "translation": [1, 0, 0]} for k in range(40_000)]
    model = load_model(gltf(tmp_path, header(nodes=[*chain, {"mesh": 0}])))
    assert model.bounds[0].tolist() == [40_000, 0, 0]
