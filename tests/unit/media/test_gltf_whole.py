"""glTF: what is read is whole, what is not is said."""

import base64
import json

import numpy as np
import pytest

from arfx.errors import InputError
from arfx.media.models import load_model

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


class Writer:
    """A glTF under construction: arrays in, accessors out."""

    def __init__(self):
        self.data = b""
        self.tree = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "scene": 0}
        self.tree |= {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": []}]}

    def view(self, data):
        self.data += bytes(-len(self.data) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array, **more):
        array = np.asarray(array)
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        row = {"bufferView": self.view(array.tobytes()), "count": len(array), "type": kind}
        self.tree["accessors"].append(row | {"componentType": KINDS[array.dtype.str[1:]]} | more)
        return len(self.tree["accessors"]) - 1

    def primitive(self, indices=FACES, mode=4, **attributes):
        row = {"attributes": attributes, "mode": mode}
        if indices is not None:
            row["indices"] = self.accessor(indices)
        self.tree["meshes"][0]["primitives"].append(row)
        return row

    def load(self, folder):
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        tree = self.tree | {"buffers": [{"byteLength": len(self.data), "uri": uri}]}
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


def test_used_extension_and_map_are_told(tmp_path):
    w = square()
    w.tree["extensionsUsed"] = ["KHR_materials_clearcoat", "KHR_materials_ior", "XYZ_new"]
    w.tree["materials"] = [{"normalTexture": {"index": 0}, "occlusionTexture": {"index": 0}}]
    text = " ".join(w.load(tmp_path).notices)
    assert all(t in text for t in ("clear coat", "XYZ_new", "normal maps", "occlusion maps"))
    assert "KHR_materials_ior" not in text


def test_version_1_is_named(tmp_path):
    (tmp_path / "m.gltf").write_text(json.dumps({"asset": {"version": "1.0"}, "accessors": {}}))
    with pytest.raises(InputError, match=r"is glTF 1\.0"):
        load_model(tmp_path / "m.gltf")


@pytest.mark.parametrize(
    "broken", [{"scenes": [{"nodes": 3}]}, {"meshes": [{}]}, {"meshes": [{"primitives": [3]}]}, {"nodes": [{"mesh": "a"}]}]
)
def test_messages_hold_no_python(tmp_path, broken):
    w = square()
    w.tree |= broken
    with pytest.raises(InputError) as e:
        w.load(tmp_path)
    assert not any(t in str(e.value) for t in ("Error", "NoneType", "'int'", "object"))
