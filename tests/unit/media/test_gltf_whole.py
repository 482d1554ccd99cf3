"""glTF: what is read is whole, what is not is said."""

import base64
import copy
import io
import json

import numpy as np
import pytest
from PIL import Image

from arfx.errors import InputError
from arfx.media.models import load_model

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
CORNERS = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]])
KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


class Writer:
    """A glTF under construction: arrays in, accessors out."""

    def __init__(self):
        self.data = b""
        self.tree = {
            "asset": {"version": "2.0"},
            "accessors": [],
            "bufferViews": [],
            "scene": 0,
        }
        self.tree |= {
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": []}],
        }

    def view(self, data):
        self.data += bytes(-len(self.data) % 4)
        self.tree["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        )
        self.data += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array, **more):
        array = np.asarray(array)
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        row = {
            "bufferView": self.view(array.tobytes()),
            "count": len(array),
            "type": kind,
        }
        self.tree["accessors"].append(
            row | {"componentType": KINDS[array.dtype.str[1:]]} | more
        )
        return len(self.tree["accessors"]) - 1

    def primitive(self, indices=FACES, mode=4, **attributes):
        row = {"attributes": attributes, "mode": mode}
        if indices is not None:
            row["indices"] = self.accessor(indices)
        self.tree["meshes"][0]["primitives"].append(row)
        return row

    def texture(self, texels, **sampler):
        """Reference to a texture of (h, w, c) uint8."""
        file = io.BytesIO()
        Image.fromarray(np.asarray(texels, np.uint8)).save(file, "PNG")
        number = len(self.tree.setdefault("textures", []))
        self.tree["textures"].append({"source": number, "sampler": number})
        self.tree.setdefault("samplers", []).append(sampler)
        self.tree.setdefault("images", []).append(
            {"bufferView": self.view(file.getvalue()), "mimeType": "image/png"}
        )
        return {"index": number}

    def load(self, folder):
        uri = (
            "data:application/octet-stream;base64,"
            + base64.b64encode(self.data).decode()
        )
        tree = {"buffers": [{"byteLength": len(self.data), "uri": uri}]} | self.tree
        (folder / "m.gltf").write_text(json.dumps(tree))
        return load_model(folder / "m.gltf")


def square():
    w = Writer()
    w.primitive(POSITION=w.accessor(SQUARE))
    return w


@pytest.mark.parametrize(
    ("name", "way_out"),
    [
        ("KHR_texture_basisu", "ktxdecompress m.gltf"),
        ("KHR_draco_mesh_compression", "copy m.gltf"),
        ("XYZ_new", "without"),
    ],
)
def test_required_extension_that_is_not_read_is_an_error(tmp_path, name, way_out):
    w = square()
    w.tree["extensionsRequired"] = w.tree["extensionsUsed"] = [name]
    with pytest.raises(InputError, match=name) as e:
        w.load(tmp_path)
    assert way_out in e.value.hint


def test_used_extension_that_is_not_read_and_what_is_not_drawn_are_told(tmp_path):
    w = square()
    w.tree["extensionsUsed"] = [
        "KHR_materials_transmission",
        "KHR_materials_ior",
        "XYZ_new",
    ]
    bumps = w.texture(CORNERS)
    coat = {
        "KHR_materials_clearcoat": {
            "clearcoatFactor": 0.5,
            "clearcoatNormalTexture": bumps,
        }
    }
    w.tree["materials"] = [
        {
            "normalTexture": w.texture(CORNERS),
            "occlusionTexture": w.texture(CORNERS),
            "extensions": coat,
        }
    ]
    w.tree["meshes"][0]["primitives"][0]["material"] = 0
    text = " ".join(w.load(tmp_path).notices)
    assert all(t in text for t in ("transmission", "XYZ_new"))
    assert "bumps of clear coat" in text
    assert "occlusion" not in text and "normal maps" not in text
    assert "KHR_materials_ior" not in text


def test_version_1_is_named(tmp_path):
    (tmp_path / "m.gltf").write_text(
        json.dumps({"asset": {"version": "1.0"}, "accessors": {}})
    )
    with pytest.raises(InputError, match=r"is glTF 1\.0"):
        load_model(tmp_path / "m.gltf")


@pytest.mark.parametrize(
    "broken",
    [
        {"scenes": [{"nodes": 3}]},
        {"meshes": [{}]},
        {"meshes": [{"primitives": [3]}]},
        {"nodes": [{"mesh": "a"}]},
    ],
)
def test_messages_hold_no_python(tmp_path, broken):
    w = square()
    w.tree |= broken
    with pytest.raises(InputError) as e:
        w.load(tmp_path)
    assert not any(
        t in str(e.value) for t in ("Error", "NoneType", "'int'", "object")
    )


def corners(model):
    return np.concatenate([p.vertices[p.faces] for p in model.parts])


def same_surface(model):
    got = corners(model)
    assert len(got) == 2
    assert np.cross(got[:, 1] - got[:, 0], got[:, 2] - got[:, 0])[
        :, 2
    ] == pytest.approx([1, 1])


@pytest.mark.parametrize(
    ("mode", "order", "given"),
    [(6, [0, 1, 2, 3], True), (5, [0, 1, 3, 2], True), (6, [0, 1, 2, 3], False)],
)
def test_fans_and_strips(tmp_path, mode, order, given):
    w = Writer()
    w.primitive(
        np.array(order, np.uint8) if given else None,
        mode,
        POSITION=w.accessor(SQUARE),
    )
    same_surface(w.load(tmp_path))


def test_sparse_positions_with_and_without_a_base(tmp_path):
    for base in (True, False):
        w = Writer()
        at = w.accessor(np.zeros((4, 3), np.float32))
        row = w.tree["accessors"][at]
        if not base:
            del row["bufferView"]
        rows, values = (
            w.view(np.arange(1, 4, dtype=np.uint16).tobytes()),
            w.view(SQUARE[1:].tobytes()),
        )
        row["sparse"] = {
            "count": 3,
            "indices": {"bufferView": rows, "componentType": 5123},
            "values": {"bufferView": values},
        }
        w.primitive(POSITION=at)
        same_surface(w.load(tmp_path))


def test_quantised_positions_and_coordinates(tmp_path):
    w = Writer()
    w.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    w.tree["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": w.texture(CORNERS)}}
    ]
    uv = w.accessor((SQUARE[:, :2] * 65535).astype(np.uint16), normalized=True)
    place = w.accessor((SQUARE * 127).astype(np.int8), normalized=True)
    w.primitive(POSITION=place, TEXCOORD_0=uv)["material"] = 0
    model = w.load(tmp_path)
    same_surface(model)
    assert model.parts[0].uv == pytest.approx(
        model.parts[0].vertices[:, :2], abs=1e-6
    )


def test_a_rotation_of_zeros_is_none(tmp_path):
    w = Writer()
    w.primitive(POSITION=w.accessor(SQUARE))
    w.tree["nodes"] = [{"mesh": 0, "rotation": [0, 0, 0, 0]}]
    same_surface(w.load(tmp_path))


def test_what_an_accessor_counts_is_told(tmp_path):
    w = Writer()
    w.primitive(POSITION=w.accessor(SQUARE))
    w.tree["accessors"][0]["count"] = 10**12
    with pytest.raises(InputError, match="accessor 0 counts"):
        w.load(tmp_path)


def test_second_set_of_coordinates_and_transform(tmp_path):
    w = Writer()
    change = {
        "offset": [0.25, 0.5],
        "rotation": np.pi / 2,
        "scale": [0.5, 2.0],
        "texCoord": 1,
    }
    slot = w.texture(CORNERS) | {
        "texCoord": 0,
        "extensions": {"KHR_texture_transform": change},
    }
    w.tree["extensionsRequired"] = ["KHR_texture_transform"]
    w.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": slot}}]
    zero, one = (
        w.accessor(np.zeros((4, 2), np.float32)),
        w.accessor(np.ascontiguousarray(SQUARE[:, :2])),
    )
    w.primitive(POSITION=w.accessor(SQUARE), TEXCOORD_0=zero, TEXCOORD_1=one)[
        "material"
    ] = 0
    part = w.load(tmp_path).parts[0]
    u, v = part.vertices[:, 0] * 0.5, part.vertices[:, 1] * 2.0
    on_picture = part.uv_on(part.material.base_texture)
    assert on_picture == pytest.approx(
        np.stack([0.25 + v, 0.5 - u], 1), abs=1e-6
    )  # the extension's own matrices


def test_hidden_node_and_instances(tmp_path):
    w = square()
    hidden = {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}}
    places = w.accessor(np.array([[0, 0, 0], [5, 0, 0], [0, 7, 0]], np.float32))
    copies = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}
    w.tree["nodes"] = [
        {"children": [1, 2]},
        hidden,
        {"mesh": 0, "extensions": copies},
    ]
    model = w.load(tmp_path)
    assert model.face_count == 6
    assert model.bounds[1] == pytest.approx([6, 8, 0])


def test_unlit_is_emission_and_glossy_is_converted(tmp_path):
    w = square()
    colour = {"baseColorFactor": [0.2, 0.4, 0.6, 1.0]}
    glossy = {
        "diffuseFactor": [0.0, 0.0, 0.0, 1.0],
        "specularFactor": [0.9, 0.6, 0.3],
        "glossinessFactor": 0.75,
    }
    w.tree["materials"] = [
        {"pbrMetallicRoughness": colour, "extensions": {"KHR_materials_unlit": {}}},
        {"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}},
    ]
    w.tree["meshes"][0]["primitives"][0]["material"] = 0
    w.primitive(POSITION=0)["material"] = 1
    unlit, metal = (p.material for p in w.load(tmp_path).parts)
    assert unlit.emissive == pytest.approx((0.2, 0.4, 0.6))
    assert unlit.base_colour == (0, 0, 0, 1)
    assert unlit.specular == 0
    assert (metal.metallic, metal.roughness) == pytest.approx((1.0, 0.25))
    assert metal.base_colour[:3] == pytest.approx((0.9, 0.6, 0.3))


def test_shine_textures_are_converted_by_texel(tmp_path):
    w = Writer()
    shine = [
        [[0, 0, 0, 255], [255, 255, 255, 51]]
    ]  # matt white and glossy; a dull mirror
    glossy = {
        "diffuseTexture": w.texture(np.full((1, 1, 3), 255)),
        "specularGlossinessTexture": w.texture(shine),
    }
    w.tree["materials"] = [
        {"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}
    ]
    w.primitive(
        POSITION=w.accessor(SQUARE), TEXCOORD_0=w.accessor(SQUARE[:, :2].copy())
    )["material"] = 0
    got = w.load(tmp_path).parts[0].material
    assert got.metallic_roughness_texture.picture[..., 1:3].tolist() == [
        [[0, 0], [204, 255]]
    ]
    assert got.base_texture.picture.tolist() == [[[255] * 4] * 2]
    assert (got.metallic, got.roughness) == (1, 1)


def test_unlit_with_colours_by_vertex_keeps_them(tmp_path):
    w = Writer()
    w.tree["materials"] = [{"extensions": {"KHR_materials_unlit": {}}}]
    w.primitive(POSITION=w.accessor(SQUARE), COLOR_0=w.accessor(SQUARE * 0.5))[
        "material"
    ] = 0
    model = w.load(tmp_path)
    assert model.parts[0].material.base_colour == (1, 1, 1, 1)
    assert "shown lit" in " ".join(model.notices)


def test_lines_are_told_and_what_is_below_an_empty_mesh_keeps_its_place(tmp_path):
    w = square()
    w.primitive(mode=3, POSITION=0)
    w.tree["meshes"].append({"primitives": [{"attributes": {}}]})
    w.tree["nodes"] = [
        {"mesh": 1, "camera": 0, "translation": [5, 0, 0], "children": [1]},
        {"mesh": 0},
    ]
    model = w.load(tmp_path)
    assert model.bounds[0] == pytest.approx([5, 0, 0])
    assert "points and lines left out" in " ".join(model.notices)


def test_scenes(tmp_path):
    w = square()
    w.tree |= {
        "nodes": [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}],
        "scene": 1,
    }
    w.tree["scenes"] = [{"nodes": [0]}, {"nodes": [1]}]
    model = w.load(tmp_path)
    assert model.bounds[0] == pytest.approx([5, 0, 0])
    assert "2 scenes" in " ".join(model.notices)
    del w.tree["scenes"], w.tree["scene"]  # all roots
    assert w.load(tmp_path).face_count == 4


def test_a_buffer_that_is_cut_short_is_named(tmp_path):
    w = square()
    w.tree["buffers"] = [{"byteLength": 900, "uri": "data:;base64,AAAA"}]
    with pytest.raises(InputError, match="holds 3 of 900 bytes"):
        w.load(tmp_path)


def places(tree, path=()):
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*path, key))


@pytest.mark.parametrize("wrong", [None, "x", -1, 1e9, [], {}, [[]], True])
def test_any_value_of_a_wrong_kind_loads_or_is_refused_in_words(tmp_path, wrong):
    w = Writer()
    unlit = {
        "pbrMetallicRoughness": {
            "baseColorTexture": w.texture(CORNERS, wrapS=33071) | {"texCoord": 1}
        }
    }
    glossy = {
        "diffuseTexture": {
            "index": 0,
            "extensions": {"KHR_texture_transform": {"scale": [2, 2]}},
        }
    }
    unlit["extensions"] = {"KHR_materials_unlit": {}}
    more = {
        "KHR_materials_pbrSpecularGlossiness": glossy,
        "KHR_materials_ior": {"ior": 1.4},
    }
    more["KHR_materials_clearcoat"] = {
        "clearcoatFactor": 1,
        "clearcoatNormalTexture": {"index": 0, "scale": 2},
    }
    more["KHR_materials_sheen"] = {
        "sheenColorFactor": [1, 0, 0],
        "sheenRoughnessTexture": {"index": 0},
    }
    bumpy = {
        "name": "b",
        "normalTexture": {"index": 0, "scale": 0.5},
        "occlusionTexture": {"index": 0, "strength": 0.5},
    }
    w.tree["materials"] = [unlit, bumpy | {"extensions": more}]
    tangent = w.accessor(np.ones((4, 4), np.float32))
    uv = w.accessor((SQUARE[:, :2] * 200).astype(np.uint8))
    place = w.accessor(SQUARE)
    w.primitive(mode=6, POSITION=place, TEXCOORD_1=uv)["material"] = 0
    w.primitive(POSITION=place, TEXCOORD_0=uv, NORMAL=place, TANGENT=tangent)[
        "material"
    ] = 1
    where = {
        "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": w.accessor(SQUARE)}}
    }
    w.tree["nodes"] = [
        {"children": [1]},
        {
            "mesh": 0,
            "extensions": where,
            "rotation": [0, 0, 0, 1],
            "scale": [1, 1, 1],
        },
    ]
    w.tree |= {
        "extensionsUsed": ["KHR_materials_unlit"],
        "scenes": [{"nodes": [0]}],
        "extensionsRequired": [],
    }
    assert w.load(tmp_path).face_count == 16
    whole = w.tree
    for path in list(places(whole)):
        w.tree = copy.deepcopy(whole)
        owner = w.tree
        for key in path[:-1]:
            owner = owner[key]
        owner[path[-1]] = wrong
        try:
            text = " ".join(w.load(tmp_path).notices)
        except InputError as e:
            text = str(e)
        python = (
            "Error:",
            "None",
            "object is",
            "object has",
            "'int'",
            "'str'",
            "dict",
            "list index",
            "ndarray",
            "shape",
        )
        assert not [word for word in python if word in text], (path, text)
