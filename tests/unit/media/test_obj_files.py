"""OBJ, MTL and PLY as people have them: encodings, names, options of maps; and what is lost
is told.
"""

from __future__ import annotations

import unicodedata
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from arfx.core.model import Model
from arfx.errors import InputError
from arfx.media.models import load_model

OBJ = (
    "# Würfel\nmtllib {}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl {}\nf"
    " 1/1 2/2 3/3\n"
)
PLY = """ply
format ascii 1.0
comment {comment}
element vertex 4
property float x
property float y
property float z
{uv}property uchar red
property uchar green
property uchar blue
element face 1
property list uchar int vertex_indices
end_header
0 0 0 {a}255 0 0
1 0 0 {b}0 255 0
1 1 0 {c}0 0 255
0 1 0 {d}255 255 255
4 0 1 2 3
"""


def obj(
    folder: Path,
    mtl: str = "newmtl Möbel\nmap_Kd Küche.png\n",
    line: str = "a.mtl",
    use: str = "Möbel",
    code: str = "utf-8",
) -> Model:
    for name in ("Küche.png", "t.png"):
        Image.new("RGB", (2, 2), (250, 120, 10)).save(folder / name)
    Image.new("L", (2, 2), 90).save(folder / "grey.png")
    (folder / "a.mtl").write_bytes(f"# Grün\n{mtl}".encode(code))
    (folder / "a.obj").write_bytes(OBJ.format(line, use).encode(code))
    return load_model(folder / "a.obj")


def is_whole(model: Model) -> bool:
    """White times the map."""
    (part,) = model.parts
    texture = part.material.base_texture
    white = part.material.base_colour == (1, 1, 1, 1)
    return (
        not model.notices
        and white
        and texture is not None
        and texture.picture[0, 0, 0] == 250
    )


@pytest.mark.parametrize(
    "code", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"]
)
def test_text_in_any_encoding(tmp_path: Path, code: str) -> None:
    assert is_whole(obj(tmp_path, code=code))


@pytest.mark.parametrize(
    ("line", "use", "map_kd"),
    [
        ("A.MTL", "möbel", "KÜCHE.PNG"),
        ('"a.mtl"', '"Möbel"', '"Küche.png"'),
        (
            unicodedata.normalize("NFD", "a.mtl"),
            unicodedata.normalize("NFD", "Möbel"),
            unicodedata.normalize("NFD", "Küche.png"),
        ),
        ("b.mtl a.mtl", "Möbel", "-s 1 1 1 -o 0 0 0 -bm 1 Küche.png"),
        ("b.mtl\nmtllib a.mtl", "Möbel", "-clamp off -bm .5 Küche.png"),
    ],
)
def test_names_as_exporters_write_them(
    tmp_path: Path, line: str, use: str, map_kd: str
) -> None:
    (tmp_path / "b.mtl").write_text("newmtl other\nKd 1 0 0\n")
    assert is_whole(obj(tmp_path, f"newmtl Möbel\nmap_Kd {map_kd}\n", line, use))


@pytest.mark.parametrize(
    "face",
    [
        "f 1/1/1 2/2/1 3/3/1 4/4/1 5/5/1",
        "f -5/-5/-1 -4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1",
        "\tf  1/1/1 2/2/1\t3/3/1 4/4/1 \\\n5/5/1 # five",
    ],
)
def test_faces_of_many_corners_are_fans(tmp_path: Path, face: str) -> None:
    places = [(0, 0), (2, 0), (3, 1), (1, 2), (-1, 1)]
    lines = [f"v {x} {y} 0" for x, y in places] + [f"vt {x} {y}" for x, y in places]
    (tmp_path / "a.obj").write_text("\n".join([*lines, "vn 0 0 2", face]))
    (part,) = load_model(tmp_path / "a.obj").parts
    corners = part.vertices[part.faces][..., :2]
    assert corners.tolist() == [
        [list(places[k]) for k in (0, k, k + 1)] for k in (1, 2, 3)
    ]
    assert (
        part.uv is not None
        and (part.uv == part.vertices[:, :2] * (1, -1) + (0, 1)).all()
    )
    assert (part.normals == [0, 0, 1]).all()


def test_a_corner_without_coordinates_leaves_the_others_theirs(
    tmp_path: Path,
) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt .5 .25\nf 1/1 2/1 3\n"
    (tmp_path / "a.obj").write_text(text)
    (part,) = load_model(tmp_path / "a.obj").parts
    assert part.uv is not None and sorted(map(tuple, part.uv)) == [
        (0, 0),
        (0.5, 0.75),
        (0.5, 0.75),
    ]


def test_a_name_with_blanks_is_one_name(tmp_path: Path) -> None:
    (tmp_path / "b c.mtl").write_text("newmtl m\nKd 1 0 0\n")
    assert obj(tmp_path, "", "b c.mtl", "m").parts[0].material.base_colour == (
        1,
        0,
        0,
        1,
    )


def test_materials_that_differ_in_case_alone_are_two(tmp_path: Path) -> None:
    model = obj(tmp_path, "newmtl Red\nKd 1 0 0\nnewmtl red\nKd 0 1 0\n", use="red")
    assert model.parts[0].material.base_colour == (0, 1, 0, 1)


def test_a_map_is_scaled_and_moved(tmp_path: Path) -> None:
    (part,) = obj(
        tmp_path, "newmtl m\nmap_Kd -s 2 3 -o .5 .25 t.png\n", use="m"
    ).parts
    assert part.material.base_texture is not None
    uv = part.uv_on(part.material.base_texture)
    assert uv is not None
    where = [tuple(v[:2]) for v in part.vertices]
    uv = uv[[where.index((0, 0)), where.index((1, 0)), where.index((0, 1))]]
    np.testing.assert_allclose(uv, [[0.5, 0.75], [2.5, 0.75], [0.5, -2.25]])


@pytest.mark.parametrize(
    ("mtl", "told"),
    [
        ("map_Ns t.png\nmap_d t.png", ["map_Ns", "map_d"]),
        ("map_Kd -imfchan r t.png", ["-imfchan of map_Kd"]),
        ("map_Bump grey.png", ["grey heights of map_Bump"]),
        ("map_Kd -clamp on t.png", []),
        ("Kd 0,5 0,5 0,5", ["Kd 0,5"]),
        ("Ke 1,5 1 1", ["Ke 1,5"]),
        ("Ke 1 1 1\nPr .5\nPm 1", []),
        ("Ke 0 0 0\nillum 2\nNi 1", []),
    ],
)
def test_what_a_material_loses_is_told(
    tmp_path: Path, mtl: str, told: list[str]
) -> None:
    notices = obj(tmp_path, f"newmtl m\n{mtl}\n", use="m").notices
    assert len(notices) == bool(told) and all(word in notices[0] for word in told)


def test_a_material_that_is_nowhere_is_told(tmp_path: Path) -> None:
    (notice,) = obj(tmp_path, use="Tisch").notices
    assert "no MTL file describes 1 of its materials: Tisch" in notice


def ply(folder: Path, comment: str = "none", uv: bool = True) -> Model:
    Image.new("RGB", (2, 2), (250, 120, 10)).save(folder / "t.png")
    rows = {
        k: v if uv else ""
        for k, v in zip("abcd", ("0 0 ", "1 0 ", "1 1 ", "0 1 "), strict=True)
    }
    properties = "property float s\nproperty float t\n" if uv else ""
    (folder / "a.ply").write_bytes(
        PLY.format(comment=comment, uv=properties, **rows).encode("latin-1")
    )
    return load_model(folder / "a.ply")


def test_the_texture_of_a_ply_is_not_darkened(tmp_path: Path) -> None:
    model = ply(tmp_path, "TextureFile t.png")
    (part,) = model.parts
    assert (
        part.material.base_colour == (1, 1, 1, 1)
        and part.material.base_texture is not None
        and part.colours is None
    )
    assert "colours by vertex are left out" in model.notices[0]


def test_colours_of_a_ply_are_kept_beside_coordinates(tmp_path: Path) -> None:
    (part,) = ply(tmp_path, "von Jürgen").parts
    assert part.colours is not None and part.material.base_colour == (1, 1, 1, 1)
    by_place = {
        tuple(v[:2]): tuple(c[:3])
        for v, c in zip(part.vertices, part.colours, strict=True)
    }
    assert by_place == {
        (0, 0): (1, 0, 0),
        (1, 0): (0, 1, 0),
        (1, 1): (0, 0, 1),
        (0, 1): (1, 1, 1),
    }


def test_colours_of_a_ply_show_where_its_texture_is_missing(tmp_path: Path) -> None:
    model = ply(tmp_path, "TextureFile none.png")
    assert model.parts[0].colours is not None
    assert "none.png" in model.notices[0] and len(model.notices) == 1


def test_textures_of_a_ply_that_are_not_shown_are_told(tmp_path: Path) -> None:
    assert (
        "1 of its textures left out"
        in ply(tmp_path, "TextureFile t.png\ncomment TextureFile t.png").notices[-1]
    )
    assert (
        "1 of its textures left out"
        in ply(tmp_path, "TextureFile t.png", uv=False).notices[-1]
    )


def test_limits_hold_before_the_work(tmp_path: Path) -> None:
    many = {
        "a.obj": "v 0 0 0\n"
        + "".join(f"usemtl m{i}\nf 1 1 1\n" for i in range(10_001)),
        "b.obj": "v 0 0 0\n" + "f 1 1 1\n" * 5_000_001,
        "a.ply": "ply\nformat ascii 1.0\nelement face 5000001\nend_header\n",
        "a.off": "OFF\n# made by hand\n3 5000001 0\n",
        "a.stl": "solid\n" + "endfacet\n" * 5_000_001,
    }
    for name, text in many.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(
            InputError, match=r"more than (10000 parts|5000000 faces)"
        ):
            load_model(tmp_path / name)
