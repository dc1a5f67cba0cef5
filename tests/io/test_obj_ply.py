import os
import random
import struct

import numpy as np
import pytest
from file_faults import mutated
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from retarget.character import Mesh, PointCloud
from retarget.errors import FileError, RetargetError
from retarget.io import obj_ply
from retarget.io.ply import fan

OBJ = """# a square and a triangle
o thing
mtllib thing.mtl
v 0 0 0
v 1 0 0 1.0
v 1 1 0 0.5 0.5 0.5
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
usemtl red
f 1/1/1 2/2/1 3/3/1 4/4/1
g other
v 0 0 1
vt 0.5 0.25
f -1/-1 \\
  1/1 2/2
"""

PLY = """ply
format ascii 1.0
comment made by hand
element vertex 4
property float x
property float y
property uchar red
property double z
element face 2
property uchar flags
property list uchar int vertex_indices
element edge 1
property int a
end_header
0 0 9 0
1 0 9 0
1 1 9 0
0 1 9 0.5
1 3 0 1 2
2 4 0 1 2 3
7
"""


@pytest.fixture
def read(tmp_path):
    def read(text, suffix):
        path = tmp_path / f"file{suffix}"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return obj_ply.load(path)

    return read


def test_obj_with_polygons_groups_negative_indices_and_continued_lines(read):
    for text in (OBJ, OBJ.replace("\n", "\r\n"), "\ufeff" + OBJ.rstrip()):
        asset = read(text, ".obj")
        assert asset.kind == "mesh" and asset.convention.up is None
        assert asset.mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]]
        assert asset.mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 0, 1]]
        assert asset.mesh.uvs.tolist() == [[0, 1], [1, 1], [1, 0], [0, 0], [0.5, 0.75]]  # glTF: origin top left
        assert asset.notes == ("2 statements about materials were passed over",)


def test_obj_seams_keep_the_surface_closed_and_drop_the_texture(read):
    asset = read(OBJ.replace("1/1 2/2\n", "1/2 2/2\n"), ".obj")
    assert len(asset.mesh.vertices) == 5 and asset.mesh.uvs is None
    assert any("1 vertices on seams" in note for note in asset.notes)


def test_obj_corner_forms_and_faces_before_their_vertices(read):
    for face in ("f 1 2 3", "f 1// 2// 3//", "f 1//1 2//1 3//1", "f -3 -2 -1"):
        assert read(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\n{face}", ".obj").mesh.faces.tolist() == [[0, 1, 2]]
    assert read("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0", ".obj").mesh.faces.tolist() == [[0, 1, 2]]


def test_vertices_without_faces_are_a_cloud(read):
    assert read("v 1 2 3\nv 4 5 6\np 1 2\n", ".obj").points.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    asset = read(PLY.replace("face 2", "face 0").replace("1 3 0 1 2\n2 4 0 1 2 3\n", ""), ".ply")
    assert asset.kind == "points" and len(asset.points.points) == 4


@pytest.mark.parametrize("change", [str, lambda text: text.replace("\n", "\r\n"), str.rstrip])
def test_ply_text_with_properties_of_no_interest_and_mixed_polygons(read, change):
    mesh = read(change(PLY), ".ply").mesh
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]]
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]


def binary_ply(order, face_type="i", faces=((0, 1, 2), (0, 1, 2, 3)), count_type="B"):
    """The mesh of PLY in bytes, with a list per vertex that nobody wants."""
    names = {"B": "uchar", "H": "ushort", "i": "int", "h": "short", "b": "char", "I": "uint"}
    header = f"""ply
format binary_{"little" if order == "<" else "big"}_endian 1.0
element vertex 4
property float x
property list uchar short extra
property double y
property float z
property float s
property float t
element face {len(faces)}
property list {names[count_type]} {names[face_type]} vertex_index
property uchar flags
end_header
"""
    body = b""
    for i, (x, y, z) in enumerate([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.5)]):
        extra = [7] * (i % 2)
        body += struct.pack(f"{order}fB{len(extra)}hdfff", x, len(extra), *extra, y, z, 0.25, 0.75)
    for face in faces:
        body += struct.pack(f"{order}{count_type}{len(face)}{face_type}B", len(face), *face, 1)
    return header.encode() + body


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("face_type, count_type", [("i", "B"), ("h", "i"), ("b", "H"), ("I", "I")])
def test_ply_bytes_of_any_order_and_type(read, order, face_type, count_type):
    mesh = read(binary_ply(order, face_type, count_type=count_type), ".ply").mesh
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]]
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
    assert mesh.uvs.tolist() == [[0.25, 0.25]] * 4


def test_ply_faces_with_too_few_corners_are_left_out_and_noted(read):
    asset = read(binary_ply("<", faces=((0, 1), (0, 1, 2))), ".ply")
    assert asset.mesh.faces.tolist() == [[0, 1, 2]] and "fewer than three" in asset.notes[0]


def test_points_without_depth_are_left_out_of_a_cloud_and_noted(read):
    text = PLY[: PLY.index("element face")] + "end_header\n0 0 1 0\nnan nan 1 nan\n1 1 1 1\n2 2 1 inf\n"
    asset = read(text, ".ply")
    assert asset.points.points.tolist() == [[0, 0, 0], [1, 1, 1]]
    assert asset.notes == ("2 points that are not finite were left out",)


def test_fan_of_polygons_covers_their_area():
    angles = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    polygon = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    faces = fan(np.array([*range(7), 2, 1, 0, 5, 5]), np.array([7, 3, 2]))
    assert faces.shape == (6, 3) and faces[5].tolist() == [2, 1, 0]
    a, b, c = polygon[faces[:5]].swapaxes(0, 1)
    assert 0.5 * np.cross(b - a, c - a)[:, 2].sum() == pytest.approx(3.5 * np.sin(2 * np.pi / 7))


def swap(old, new):
    return lambda text: text.replace(old, new)


OBJ_REJECTED = {
    "empty": (lambda text: "", "holds no vertex"),
    "no vertex": (lambda text: "o nothing\n", "holds no vertex"),
    "binary": (lambda text: bytes(range(128, 256)) * 10, "line 1: .* is no word of an OBJ file"),
    "another format": (lambda text: "glTF" + text[1:], "line 1: 'glTF' is no word"),
    "short vertex": (swap("v 0 1 0", "v 0 1"), "line 7: a vertex takes three numbers, received '0 1'"),
    "nan vertex": (swap("v 0 1 0", "v 0 nan 0"), r"line 7: a vertex at \[0.0, nan, 0.0\]"),
    "huge vertex": (swap("v 0 1 0", "v 0 1e99 0"), "line 7: a vertex at .*no place"),
    "words": (swap("vt 0 1", "vt a b"), "line 11: a texture coordinate takes two numbers, received 'a b'"),
    "two corners": (swap("f 1/1/1 2/2/1 3/3/1 4/4/1", "f 1 2"), "line 14: a face needs three corners"),
    "no corner": (swap("4/4/1", "4,4"), "line 14: the corners of a face are .* received '1/1/1 2/2/1 3/3/1 4,4'"),
    "corner zero": (swap("4/4/1", "0"), "line 14: a corner has number 0, with 4 given"),
    "corner before the first": (swap("4/4/1", "-5"), "line 14: a corner has number -5, with 4 given"),
    "texture before the first": (swap("4/4/1", "4/-5"), "line 14: a corner has number -5, with 4 given"),
    "corner beyond all numbers": (swap("4/4/1", "9" * 30), "line 14: the corners of a face"),
    "missing vertex": (swap("4/4/1", "6/4/1"), "line 14: the face names vertex 6 of 5"),
    "missing vertex, continued line": (swap("  1/1 2/2", "  1/1 9/2"), "line 18: the face names vertex 9 of 5"),
    "missing texture": (swap("4/4/1", "4/7/1"), "line 14: the face names texture coordinate 7 of 5"),
}

PLY_REJECTED = {
    "empty": (lambda text: "", "is empty"),
    "another format": (lambda text: "x" + text, "is not a PLY file: it begins with 'xply"),
    "no format": (swap("format ascii 1.0\n", ""), "line 13: the header names no format"),
    "odd format": (swap("ascii", "ebcdic"), "line 2: 'format ebcdic 1.0' is no valid line"),
    "odd type": (swap("double", "quad"), "line 8: 'property quad z' is no valid line"),
    "float list length": (swap("list uchar", "list float"), "line 11: .* is no valid line"),
    "property first": (swap("element vertex 4\n", ""), "line 4: .* is no valid line"),
    "negative count": (swap("vertex 4", "vertex -4"), "line 4: .* is no valid line"),
    "absurd count": (swap("vertex 4", "vertex " + "9" * 30), "line 4: .* is no valid line"),
    "element twice": (swap("element edge", "element face"), "line 12: a second element 'face'"),
    "property twice": (swap("double z", "double x"), "line 8: a second property 'x' of vertex"),
    "no end": (lambda text: text[: text.index("end_header")], "line 13: the header does not end"),
    "endless header": (swap("comment made", "comment" + " x" * 100_000), "the header does not end"),
    "no properties": (swap("property int a\n", ""), None),
    "nothing declared": (lambda text: "ply\nformat ascii 1.0\nelement vertex 3\nend_header\n", "without any property"),
    "no vertices": (swap("element vertex", "element point"), "no element 'vertex' with the properties x, y and z"),
    "no z": (swap("double z", "double w"), "no element 'vertex' with the properties x, y and z"),
    "list as z": (swap("property double z", "property list uchar int z"), "no element 'vertex'|cut off|announces"),
    "vertex 0": (swap("vertex 4", "vertex 0"), "holds no vertex|announces|cut off"),
    "no number": (swap("1 1 9 0", "1 one 9 0"), "line 17: 'one' is no number"),
    "nan": (swap("1 1 9 0", "1 nan 9 0"), r"vertex 2: holds \[1.0, nan, 0.0\]"),
    "a billion": (swap("vertex 4", "vertex 1000000000"), "declares 1000000000 of element 'vertex'.*cut off"),
    "cut off": (lambda text: text[: text.index("2 4 0 1")], "cut off"),
    "cut inside a list": (lambda text: text[: text.index(" 2 3\n")], "vertex_indices announces 4 values where 2"),
    "negative length": (swap("1 3 0 1 2", "1 -3 0 1 2"), "face 0: vertex_indices announces -3 values"),
    "lying length": (swap("2 4 0 1 2 3", "2 4000 0 1 2 3"), "face 1: vertex_indices announces 4000 values"),
    "half a length": (swap("1 3 0 1 2", "1 2.5 0 1 2"), "face 0: vertex_indices announces 2.5 values"),
    "missing vertex": (swap("4 0 1 2 3", "4 0 1 2 4"), "face 1: names vertex 4 of 4"),
    "half a vertex": (swap("4 0 1 2 3", "4 0 1 2 1.5"), "face 1: names vertex 1.5 of 4"),
    "negative vertex": (swap("4 0 1 2 3", "4 0 1 2 -1"), "face 1: names vertex -1 of 4"),
    "no indices": (swap("vertex_indices", "corners"), "not given as 'property list"),
    "strips": (lambda text: text.replace("element face", "element tristrips"), "not given as 'property list"),
    "indices no list": (swap("list uchar int vertex_ind", "int vertex_ind"), "must be a list"),
}


def expect_refused(read, text, suffix, message):
    with pytest.raises(FileError, match=f"file{suffix}.*{message}") as caught:
        read(text, suffix)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


@pytest.mark.parametrize("change, message", OBJ_REJECTED.values(), ids=OBJ_REJECTED.keys())
def test_faulty_obj_files_are_refused_in_one_line(read, change, message):
    expect_refused(read, change(OBJ), ".obj", message)


@pytest.mark.parametrize("change, message", PLY_REJECTED.values(), ids=PLY_REJECTED.keys())
def test_faulty_ply_files_are_refused_in_one_line(read, change, message):
    if message is None:  # an element behind those of interest is never looked at
        assert len(read(change(PLY), ".ply").mesh.faces) == 3
    else:
        expect_refused(read, change(PLY), ".ply", message)


@pytest.mark.parametrize("cut", range(1, 70, 3))
def test_binary_ply_cut_anywhere_is_refused(read, cut):
    expect_refused(read, binary_ply("<")[:-cut], ".ply", "cut off|announces")


def test_binary_ply_that_lies_about_its_size_is_refused_before_memory_is_taken(read):
    raw = binary_ply("<")
    expect_refused(read, raw.replace(b"vertex 4", b"vertex 99999999999999"), ".ply", "declares 99999999999999")
    expect_refused(read, binary_ply("<", count_type="I")[:-50] + b"\xff" * 50, ".ply", "announces|cut off")


def test_clouds_without_a_single_usable_point_are_refused(read):
    head = PLY[: PLY.index("element face")] + "end_header\n"
    expect_refused(read, head + "nan nan 1 nan\n" * 4, ".ply", "none of its 4 points is finite")
    expect_refused(read, head + "0 1e99 1 0\n" * 4, ".ply", "absurdly large")


def test_missing_file(tmp_path):
    for suffix in (".obj", ".ply"):
        with pytest.raises(FileError, match="cannot be read"):
            obj_ply.load(tmp_path / f"absent{suffix}")


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    vertices=st.integers(1, 20),
    faces=st.integers(0, 30),
    textured=st.booleans(),
    scale=st.sampled_from([1e-3, 1.0, 1e4]),
    seed=st.integers(0, 2**32 - 1),
    suffix=st.sampled_from([".obj", ".ply", ".PLY"]),
)
def test_surfaces_come_back_as_they_were_written(tmp_path, vertices, faces, textured, scale, seed, suffix):
    rng, path = np.random.default_rng(seed), tmp_path / f"out{suffix}"
    points = scale * rng.normal(size=(vertices, 3))
    near = 1e-8 * scale if suffix == ".obj" else 0.0
    if not faces:
        obj_ply.save(path, PointCloud(points))
        assert np.abs(obj_ply.load(path).points.points - points).max() <= near
        return
    corners = rng.integers(vertices, size=(faces, 3))
    obj_ply.save(path, Mesh(points, corners, uvs=rng.random((vertices, 2)) if textured else None))
    mesh = obj_ply.load(path).mesh
    assert np.abs(mesh.vertices - points).max() <= near and np.array_equal(mesh.faces, corners)
    assert (mesh.uvs is not None) == textured
    if textured:
        used = np.unique(corners)  # OBJ has texture coordinates of corners only
        wanted = np.random.default_rng(seed)
        wanted.normal(size=(vertices, 3))
        wanted.integers(vertices, size=(faces, 3))
        assert np.abs(mesh.uvs - wanted.random((vertices, 2)))[used].max() < 1e-8


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_trimesh_reads_what_we_write(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    rng = np.random.default_rng(0)
    points, corners = rng.normal(size=(50, 3)), rng.permutation(50)[:48].reshape(16, 3)
    obj_ply.save(tmp_path / f"out{suffix}", Mesh(points, corners))
    mesh = trimesh.load(tmp_path / f"out{suffix}", process=False, force="mesh", maintain_order=True)
    assert np.allclose(mesh.vertices[mesh.faces], points[corners], atol=1e-6)


def test_what_cannot_be_written_is_refused_and_nothing_written(tmp_path):
    cloud = PointCloud(np.zeros((1, 3)))
    with pytest.raises(FileError, match="written as .obj or .ply, not as '.stl'"):
        obj_ply.save(tmp_path / "out.stl", cloud)
    with pytest.raises(FileError, match="cannot be written"):
        obj_ply.save(tmp_path / "absent" / "out.ply", cloud)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("raw", [OBJ, PLY, binary_ply("<"), binary_ply(">")], ids=["obj", "ply", "little", "big"])
def test_mutated_files_are_read_or_refused_but_never_crash(read, raw):
    raw = raw if isinstance(raw, bytes) else raw.encode()
    rng, refused = random.Random(0), 0
    suffix, words = (".obj" if raw[:1] == b"#" else ".ply"), [b"element", b"list", b"end_header", b"f", b"v", b"\\"]
    for _ in range(400):
        try:
            asset = read(mutated(raw, rng, words), suffix)
            assert np.isfinite(asset.mesh.vertices if asset.mesh else asset.points.points).all()
        except RetargetError as error:
            refused += 1
            assert "\n" not in str(error)
    assert 50 < refused < 399


def test_mutated_real_file_is_read_or_refused_but_never_crashes(read, data):
    rng = random.Random(1)
    raw = (data / "characters/makehuman/base.obj").read_bytes()
    raw = raw[:60_000].rpartition(b"\n")[0] + b"\nf 1 2 3 4\nf -1/-1 -2 -3\n" * 500
    for _ in range(20):
        try:
            read(mutated(raw, rng, [b"f", b"v", b"\\"]), ".obj")
        except RetargetError as error:
            assert "\n" not in str(error)


def test_the_base_mesh_of_makehuman(data):
    asset = obj_ply.load(data / "characters/makehuman/base.obj")
    assert asset.mesh.vertices.shape == (19158, 3)
    assert asset.mesh.vertices[0].tolist() == [-0.3492, 7.3299, 1.4076]
