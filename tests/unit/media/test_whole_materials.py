"""Every texture slot and factor of a glTF material, tangents, and physical terms of MTL."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from arfx.core.model import CLAMP, MIRROR, REPEAT, TEXTURE_SLOTS, Material, Texture
from arfx.media.model_parts import corner_tangents, part_of
from arfx.media.models import load_model
from tests.unit.media.test_gltf_whole import CORNERS, SQUARE, Writer

UV = np.ascontiguousarray(SQUARE[:, :2])


def material_of(w, given, folder, **attributes):
    """The part of a square with this material."""
    w.tree["materials"] = [given]
    w.primitive(POSITION=w.accessor(SQUARE), TEXCOORD_0=w.accessor(UV), **attributes)[
        "material"
    ] = 0
    return w.load(folder).parts[0]


def test_every_slot_and_factor_is_read(tmp_path):
    w = Writer()
    number = iter(range(10))

    def slot(**more):
        return w.texture(np.full((1, 1, 3), next(number))) | more

    coat = {
        "clearcoatFactor": 0.9,
        "clearcoatTexture": slot(),
        "clearcoatRoughnessFactor": 0.2,
    }
    coat |= {"clearcoatRoughnessTexture": slot()}
    sheen = {"sheenColorFactor": [0.1, 0.2, 0.3], "sheenRoughnessFactor": 0.4}
    sheen |= {"sheenColorTexture": slot(), "sheenRoughnessTexture": slot()}
    given = {
        "pbrMetallicRoughness": {
            "baseColorTexture": slot(),
            "metallicRoughnessTexture": slot(),
        },
        "normalTexture": slot(scale=0.5),
        "occlusionTexture": slot(strength=0.7),
        "emissiveFactor": [0.5, 1, 0],
        "emissiveTexture": slot(),
        "doubleSided": True,
        "extensions": {
            "KHR_materials_clearcoat": coat,
            "KHR_materials_sheen": sheen,
            "KHR_materials_emissive_strength": {"emissiveStrength": 3},
            "KHR_materials_ior": {"ior": 2.0},
            "KHR_materials_specular": {"specularFactor": 0.5},
        },
    }
    m = material_of(w, given, tmp_path).material
    first_texels = {name: int(t.picture[0, 0, 0]) for name, t in m.textures.items()}
    assert list(first_texels) == list(TEXTURE_SLOTS)
    assert sorted(first_texels.values()) == list(range(9))
    written_in_this_order = (
        "clearcoat_texture", "clearcoat_roughness_texture", "sheen_colour_texture",
        "sheen_roughness_texture", "base_texture", "metallic_roughness_texture", "normal_texture", "occlusion_texture",
        "emissive_texture",
    )  # fmt: skip
    assert [first_texels[name] for name in written_in_this_order] == list(range(9))
    assert (m.normal_scale, m.occlusion_strength) == (0.5, 0.7)
    assert (m.clearcoat, m.clearcoat_roughness, m.sheen_roughness) == (0.9, 0.2, 0.4)
    assert m.sheen_colour == (0.1, 0.2, 0.3) and m.emissive == (1.5, 3, 0)
    assert m.specular == pytest.approx(0.5 / 9 / 0.08) and m.double_sided


def test_samplers_transforms_and_sets_are_each_textures_own(tmp_path):
    w = Writer()
    sampler = {"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}
    base = w.texture(CORNERS, **sampler) | {"texCoord": 1}
    glow = w.texture(CORNERS) | {
        "extensions": {"KHR_texture_transform": {"scale": [2, 3]}}
    }
    given = {
        "pbrMetallicRoughness": {"baseColorTexture": base},
        "emissiveTexture": glow,
        "emissiveFactor": [1, 1, 1],
    }
    part = material_of(w, given, tmp_path, TEXCOORD_1=w.accessor(1 - UV))
    base, glow = part.material.base_texture, part.material.emissive_texture
    assert (base.wrap, base.nearest, glow.wrap, glow.nearest) == (
        (CLAMP, MIRROR),
        True,
        (REPEAT, REPEAT),
        False,
    )
    where = part.vertices[:, :2]
    assert part.uv_on(base) == pytest.approx(1 - where)
    assert part.uv_on(glow) == pytest.approx(where * [2, 3])


def test_a_third_set_of_coordinates_is_told(tmp_path):
    w = Writer()
    slot = w.texture(CORNERS) | {"texCoord": 2}
    w.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": slot}}]
    w.primitive(POSITION=w.accessor(SQUARE), TEXCOORD_2=w.accessor(UV))[
        "material"
    ] = 0
    model = w.load(tmp_path)
    assert model.parts[0].material.base_texture is None and "third set" in " ".join(
        model.notices
    )


def test_greys_of_16_bits_are_scaled(tmp_path):
    picture = np.array([[0, 0x8000, 0xFFFF]], np.uint16)
    Image.fromarray(picture).save(tmp_path / "grey.png")
    w = Writer()
    slot = w.texture(CORNERS)
    w.tree["images"] = [{"uri": "grey.png"}]
    m = material_of(
        w, {"pbrMetallicRoughness": {"baseColorTexture": slot}}, tmp_path
    ).material
    assert m.base_texture.picture[0].tolist() == [
        [0, 0, 0, 255],
        [128, 128, 128, 255],
        [255] * 4,
    ]


@pytest.mark.parametrize(
    ("flip", "along", "sign"),
    [((1, 1), 1, 1), ((-1, 1), -1, -1), ((1, -1), 1, -1), ((-1, -1), -1, 1)],
)
def test_tangents_of_a_square_are_the_pictures_rows(flip, along, sign):
    """UV counts v downwards, so that a picture that stands upright on the square has flip
    (1, -1).
    """
    uv = UV * flip * [1, -1]
    tangents = corner_tangents(
        SQUARE, np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0.0, 0, 1]] * 4), uv
    )
    assert tangents == pytest.approx(np.array([[along, 0, 0, sign]] * 6), abs=1e-12)
    up = tangents[0, 3] * np.cross([0, 0, 1], tangents[0, :3])
    assert up @ [0, 1, 0] == flip[1]


FAN = np.array(
    [[0, 0, 0.5], [1, 0, 0], [0.3, 1.2, 0.1], [-1, 0.4, -0.2], [-0.2, -0.9, 0.3]]
)
FAN_FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]])
FAN_NORMALS = np.array(
    [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8], [0, -0.6, 0.8]]
)
# Of the fan, by the reference implementation (mikktspace.c, in float32): of a picture laid
# over it ...
EVEN = [[0.99774, -0.06716, 0], [0.76738, -0.28265, -0.57553], [0.99801, -0.05047, 0.03785],
        [0.99774, -0.06716, 0], [0.99801, -0.05047, 0.03785], [0.79056, 0.15313, 0.59292],
        [0.99774, -0.06716, 0], [0.79056, 0.15313, 0.59292], [0.99956, 0.02362, 0.01771],
        [0.99774, -0.06716, 0], [0.99956, 0.02362, 0.01771], [0.76738, -0.28265, -0.57553]]  # fmt: skip
# ... and of one that is mirrored on the last two faces.
FOLDED = [[0.99815, -0.06085, 0], [0.76496, -0.29271, -0.57372], [0.99801, -0.05047, 0.03785],
          [0.99815, -0.06085, 0], [0.99801, -0.05047, 0.03785], [0.78946, 0.16177, 0.5921],
          [0.96077, -0.27735, 0], [0.57488, -0.69542, 0.43116], [0.96356, -0.21399, -0.16049],
          [0.96077, -0.27735, 0], [0.96356, -0.21399, -0.16049], [0.77245, 0.26018, -0.57934]]  # fmt: skip


@pytest.mark.parametrize(
    ("last", "expected", "signs"),
    [((0.7, 0.8), EVEN, [1] * 12), ((0.5, 0.2), FOLDED, [1] * 6 + [-1] * 6)],
)
def test_tangents_are_mikktspaces(last, expected, signs):
    uv = np.array([[0.5, 0.5], [0.9, 0.4], [0.6, 0.1], [0.1, 0.3], last])
    tangents = corner_tangents(FAN, FAN_FACES, FAN_NORMALS, uv)
    assert tangents[:, :3] == pytest.approx(np.array(expected), abs=1e-5)
    assert tangents[:, 3].tolist() == signs


def test_vertices_are_split_where_tangents_differ_alone():
    uv = np.array([[0.5, 0.5], [0.9, 0.4], [0.6, 0.1], [0.1, 0.3], [0.5, 0.2]])
    rows = {"vertices": FAN, "normals": FAN_NORMALS, "uv": uv}

    def part(material):
        return part_of(FAN_FACES, rows, np.eye(4), material)

    bumpy = part(Material(normal_texture=Texture(np.zeros((1, 1, 4), np.uint8))))
    assert len(bumpy.vertices) == 8  # the middle, and both ends of the fold
    assert (bumpy.vertices[bumpy.faces] == FAN[FAN_FACES]).all()
    assert bumpy.tangents[bumpy.faces].reshape(-1, 4)[:, :3] == pytest.approx(
        np.array(FOLDED), abs=1e-5
    )
    assert part(Material()).tangents is None


def test_tangents_are_finite_where_the_picture_covers_nothing():
    tangents = corner_tangents(FAN, FAN_FACES, FAN_NORMALS, np.full((5, 2), 0.5))
    normals = FAN_NORMALS[FAN_FACES].reshape(-1, 3)
    assert np.linalg.norm(tangents[:, :3], axis=1) == pytest.approx(np.ones(12))
    assert (tangents[:, :3] * normals).sum(1) == pytest.approx(
        np.zeros(12), abs=1e-12
    )


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents_of_the_file_turn_with_its_node(tmp_path, mirrored):
    w = Writer()
    normals = w.accessor(np.array([[0, 0, 1]] * 4, np.float32))
    tangents = w.accessor(np.array([[0, 1, 0, 1]] * 4, np.float32))
    w.tree["nodes"] = [
        {
            "mesh": 0,
            "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)],
            "scale": [1, 1, -1 if mirrored else 1],
        }
    ]
    part = material_of(
        w,
        {"normalTexture": w.texture(CORNERS)},
        tmp_path,
        NORMAL=normals,
        TANGENT=tangents,
    )
    assert part.tangents == pytest.approx(
        np.array([[-1, 0, 0, -1 if mirrored else 1]] * 4), abs=1e-6
    )


def obj(folder, mtl, vertices="v 0 0 0\nv 1 0 0\nv 0 1 0\n"):
    """The part of a triangle with texture coordinates and this material."""
    normal, grey = (
        np.full((2, 2, 3), (128, 128, 255), np.uint8),
        np.full((4, 4), 51, np.uint8),
    )
    Image.fromarray(normal).save(folder / "n.png")
    Image.fromarray(grey).save(folder / "g.png")
    (folder / "a.mtl").write_text(f"newmtl m\n{mtl}\n")
    text = (
        f"mtllib a.mtl\n{vertices}vt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    )
    (folder / "a.obj").write_text(text)
    return load_model(folder / "a.obj").parts[0]


def test_physical_terms_of_mtl(tmp_path: Path) -> None:
    part = obj(
        tmp_path,
        "Kd 1 1 1\nPr .3\nPm .8\nPs .5\nPc .25\nPcr .1\nKe 0 2 .5\nmap_Bump -bm .4 n.png",
    )
    m = part.material
    assert (m.roughness, m.metallic, m.clearcoat, m.clearcoat_roughness) == (
        0.3,
        0.8,
        0.25,
        0.1,
    )
    assert m.emissive == (0, 2, 0.5) and m.sheen_colour == (0.5, 0.5, 0.5)
    assert m.normal_texture is not None and m.normal_scale == 0.4
    assert part.tangents is not None and part.tangents[:, 3].tolist() == [1, 1, 1]


def test_maps_of_roughness_and_metal_are_one_texture(tmp_path: Path) -> None:
    m = obj(tmp_path, "Pr .3\nmap_Pr g.png\nmap_Pm n.png\nmap_Ke n.png").material
    assert m.metallic_roughness_texture is not None
    assert m.metallic_roughness_texture.picture[0, 0, 1:3].tolist() == [51, 128]
    assert (m.roughness, m.metallic, m.emissive) == (1, 1, (1, 1, 1))


def test_colours_of_vertices_multiply_an_objs_material(tmp_path: Path) -> None:
    part = obj(tmp_path, "Kd 0 1 0", "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\n")
    assert (
        part.material.base_colour == (0, 1, 0, 1)
        and part.uv is not None
        and part.colours is not None
    )
    by_place = {
        tuple(v[:2]): tuple(c)
        for v, c in zip(part.vertices, part.colours, strict=True)
    }
    assert by_place == {
        (0, 0): (1, 0, 0, 1),
        (1, 0): (0, 1, 0, 1),
        (0, 1): (0, 0, 1, 1),
    }


def test_colours_that_some_vertices_lack_are_told(tmp_path: Path) -> None:
    part = obj(tmp_path, "Kd 0 1 0", "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\n")
    assert part.vertices.max() == 1 and part.colours is None
    assert "not all have them" in load_model(tmp_path / "a.obj").notices[0]
