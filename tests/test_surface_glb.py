"""A GLB file is read as it was written, and nothing that a file claims is believed before it was checked."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_hand import glb, made_hand

from handtrack.errors import InputError
from handtrack.formats.glb import read_glb

MESH = made_hand()
WHOLE = glb(MESH)


def read(tmp_path, data: bytes, name: str = "hand.glb"):
    (tmp_path / name).write_bytes(data)
    return read_glb(tmp_path / name)


def spoilt(*path, value):
    def change(content) -> None:
        for key in path[:-1]:
            content = content[key]
        content[path[-1]] = value

    return glb(MESH, change)


def test_a_written_hand_reads_back_in_millimetres(tmp_path):
    back = read(tmp_path, WHOLE)
    np.testing.assert_allclose(back.vertices, MESH.vertices, atol=1e-4)
    np.testing.assert_allclose(back.bind, MESH.bind, atol=1e-4)
    np.testing.assert_array_equal(back.triangles, MESH.triangles)
    np.testing.assert_allclose(back.weight.sum(axis=1), 1.0)
    assert back.joint_names == MESH.joint_names and back.parent.tolist() == MESH.parent.tolist()


def test_missing_normals_are_made_from_the_triangles(tmp_path):
    back = read(tmp_path, glb(MESH, normals=False))
    assert ((back.normals * MESH.normals).sum(axis=1) > 0.999).mean() > 0.99


def test_without_bind_matrices_the_nodes_say_where_the_joints_are(tmp_path):
    back = read(tmp_path, glb(MESH, lambda content: content["skins"][0].pop("inverseBindMatrices")))
    np.testing.assert_allclose(back.bind, MESH.bind, atol=1e-6)


def test_quaternions_and_a_parent_place_a_node_like_its_matrix(tmp_path):
    def change(content) -> None:
        del content["skins"][0]["inverseBindMatrices"]
        content["nodes"][1] = {"name": "wrist", "translation": [0, -0.075, 0], "rotation": [0.5, 0.5, 0.5, 0.5]}
        content["nodes"].append({"children": [1], "translation": [0.01, 0, 0], "scale": [1, 1, 1]})

    back = read(tmp_path, glb(MESH, change))
    np.testing.assert_allclose(back.bind[0, :3, 3], [10.0, -75.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(back.bind[0, :3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-9)


def test_text_with_a_buffer_beside_it_reads_like_the_binary_file(tmp_path):
    size = struct.unpack_from("<I", WHOLE, 12)[0]
    content = json.loads(WHOLE[20 : 20 + size])
    content["buffers"][0]["uri"] = "hand%20data.bin"
    (tmp_path / "hand data.bin").write_bytes(WHOLE[28 + size :])
    back = read(tmp_path, json.dumps(content).encode(), "hand.gltf")
    np.testing.assert_allclose(back.vertices, MESH.vertices, atol=1e-4)
    content["buffers"][0]["uri"] = "../hand.bin"
    with pytest.raises(InputError, match="buffers"):
        read(tmp_path, json.dumps(content).encode(), "hand.gltf")


NODES = len(MESH.joint_names) + 1
BAD = [
    (b"", "no glTF|cut short"),
    (b"glTF" + bytes(8), "cut short"),
    (b"glTF" + struct.pack("<II", 1, 20) + bytes(8), "version 1"),
    (WHOLE[:-8], "header: says"),
    (WHOLE[:12] + struct.pack("<I", 10**9) + WHOLE[16:], "leaves the file"),
    (WHOLE[:16] + b"ABCD" + WHOLE[20:], "no JSON"),
    (b"[1, 2]", "its JSON is no object"),
    (b"[" * 100_000, "no glTF"),
    (b'{"asset": {"version": NaN}}', "not finite"),
    (spoilt("asset", "version", value="1.0"), "glTF 2.0 is wanted"),
    (spoilt("skins", value=[]), "no mesh with a skin"),
    (spoilt("nodes", 1, "name", value="Hand_L"), "no joint of a W3C hand"),
    (spoilt("nodes", 1, "name", value="thumb-tip"), "given twice"),
    (spoilt("nodes", 1, "matrix", value=[1.0] * 15), "16 finite numbers"),
    (spoilt("nodes", 1, "matrix", value=[10**400] * 16), "16 finite numbers"),
    (spoilt("nodes", 1, value={"name": "wrist", "rotation": [9, 0, 0, 0]}), "unit quaternion"),
    (spoilt("nodes", 1, "children", value=[1]), "below itself"),
    (spoilt("nodes", 1, "children", value=[NODES]), "no other parent"),
    (spoilt("nodes", 0, "children", value=[2, 2]), "no other parent"),
    (spoilt("accessors", 0, "count", value=10**9), "count"),
    (spoilt("accessors", 0, "count", value=3000), "leave its view"),
    (spoilt("accessors", 0, "componentType", value=5120), "does not fit"),
    (spoilt("accessors", 0, "componentType", value=99), "does not fit"),
    (spoilt("accessors", 0, "sparse", value={"count": 1}), "sparse"),
    (spoilt("accessors", 3, "count", value=10), "different counts|positions"),
    (spoilt("accessors", 5, "count", value=3), "matrices for"),
    (spoilt("bufferViews", 0, "byteLength", value=10**9), "leave its buffer"),
    (spoilt("bufferViews", 0, "buffer", value=4), "there are 1 buffers"),
    (spoilt("bufferViews", 0, "byteOffset", value=True), "a whole number is wanted"),
    (spoilt("buffers", 0, "byteLength", value=10**8), "there are"),
    (spoilt("buffers", 0, "uri", value="data:text/plain,abc"), "base64 is wanted"),
    (spoilt("buffers", 0, "uri", value="data:;base64,a"), "no base64"),
    (spoilt("meshes", 0, "primitives", 0, "mode", value=1), "triangles"),
    (spoilt("meshes", 0, "primitives", 0, "extensions", value={}), "compressed"),
    (spoilt("meshes", 0, "primitives", 0, "attributes", value={"POSITION": 0}), "JOINTS_0 and WEIGHTS_0"),
    (spoilt("meshes", 0, "primitives", 0, "attributes", "WEIGHTS_0", value=0), "does not fit"),
    (spoilt("skins", 0, "joints", value=[1, 2]), "of 2"),
    (spoilt("skins", 0, "joints", value=[99]), "is missing"),
    (spoilt("meshes", value={}), "a list is wanted|is missing"),
]


@pytest.mark.parametrize(("data", "match"), BAD, ids=[str(i) for i in range(len(BAD))])
def test_a_broken_file_is_refused_in_one_line_that_names_the_place(tmp_path, data, match):
    with pytest.raises(InputError, match=match) as caught:
        read(tmp_path, data)
    assert "\n" not in str(caught.value) and "hand.glb" in str(caught.value)


def test_numbers_that_are_not_finite_or_of_another_size_are_refused(tmp_path):
    from dataclasses import replace

    vertices = MESH.vertices.copy()
    vertices[3, 1] = np.nan
    for change, match in (
        ({"vertices": vertices}, "not finite"),
        ({"vertices": 1e3 * MESH.vertices}, "mm large"),
        ({"weight": np.zeros_like(MESH.weight)}, "a sum above 0"),
        ({"triangles": MESH.triangles + 5000}, "indices up to"),
        ({"bind": MESH.bind * np.array([[0.0, 1, 1, 1]] * 3 + [[1, 1, 1, 1]]) + 1e-9}, "inverted|sheared|Singular"),
    ):
        with pytest.raises((InputError, np.linalg.LinAlgError), match=match):
            read(tmp_path, glb(replace(MESH, **change)))
    with pytest.raises(InputError, match="no such file"):
        read_glb(tmp_path / "none.glb")


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 40_000), flips=st.lists(st.tuples(st.integers(0, 12_000), st.integers(1, 255)), max_size=4))
def test_whatever_is_flipped_or_cut_a_file_is_read_or_refused(tmp_path_factory, cut, flips):
    data = bytearray(WHOLE[: len(WHOLE) - cut])
    for at, mask in flips:
        if at < len(data):
            data[at] ^= mask
    try:
        back = read(tmp_path_factory.getbasetemp(), bytes(data), "flipped.glb")
    except InputError:
        return
    assert np.isfinite(back.vertices).all() and back.triangles.max() < back.vertices.shape[0]
