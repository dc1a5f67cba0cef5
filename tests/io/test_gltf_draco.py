"""Draco: primitives are read as their plain twins are, the compressed data are written back, and damage is one line."""

import random
import struct
import subprocess
import sys

import numpy as np
import pytest
from draco_maker import EXTENSION, compressed
from gltf_maker import worm

from retarget.body.kinematics import world_pose
from retarget.body.skinning import rest_vertices
from retarget.errors import FileError, RetargetError
from retarget.io import gltf, gltf_draco
from retarget.io.gltf_document import read_document

FILES = 40
"""Damaged ones, each with a child; `test_damaged_files.py` reads thousands."""


def both(tmp_path, **options):
    """The worm plain and compressed, as read."""
    m = worm(**options)
    packed = compressed(m, tmp_path / "plain.glb")
    return gltf.load(tmp_path / "plain.glb"), gltf.load(packed.glb(tmp_path / "draco.glb"))


@pytest.mark.parametrize(
    "options",
    [{}, {"joints_as": "u2"}, {"weights_as": "u2"}, {"weights_as": "u1"}, {"sets": 2}, {"texture": True, "prop": True}],
    ids=str,
)
def test_a_compressed_character_is_read_as_its_plain_twin(tmp_path, options):
    plain, asset = both(tmp_path, **options)
    assert asset.kind == "character" and not asset.notes
    assert np.array_equal(asset.character.mesh.faces, plain.character.mesh.faces)
    assert np.abs(rest_vertices(asset.character) - rest_vertices(plain.character)).max() < 1e-4
    assert np.abs(asset.character.skin.weights - plain.character.skin.weights).max() < 1e-6
    assert np.array_equal(asset.character.skin.columns, plain.character.skin.columns)
    assert np.abs(asset.character.mesh.uvs - plain.character.mesh.uvs).max() < 1e-4
    assert np.array_equal(world_pose(asset.motion())[1], world_pose(plain.motion())[1])


def test_plain_data_beside_the_compressed_are_read_without_a_child(tmp_path, monkeypatch):
    packed = compressed(worm(), tmp_path / "plain.glb", required=False, keep_plain=True)
    monkeypatch.setattr(gltf_draco, "run_child", None)
    asset = gltf.load(packed.glb(tmp_path / "draco.glb"))
    assert np.array_equal(rest_vertices(asset.character), rest_vertices(gltf.load(tmp_path / "plain.glb").character))


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_the_compressed_data_are_written_back_untouched(tmp_path, suffix):
    _, asset = both(tmp_path)
    gltf.save(tmp_path / f"out{suffix}", asset.character, [asset.motion()])
    old, new = read_document(tmp_path / "draco.glb"), read_document(tmp_path / f"out{suffix}")
    size = old.json["buffers"][0]["byteLength"]
    assert new.buffers[0][:size] == old.buffers[0][:size]
    assert new.json["meshes"] == old.json["meshes"] and new.json["extensionsRequired"] == [EXTENSION]
    assert new.json["accessors"][: len(old.json["accessors"])] == old.json["accessors"]
    again = gltf.load(tmp_path / f"out{suffix}")
    assert [clip.name for clip in again.clips] == ["clip0", "clip0_2"]
    assert np.array_equal(rest_vertices(again.character), rest_vertices(asset.character))
    assert np.abs(world_pose(again.motion(1))[1] - world_pose(asset.motion())[1]).max() < 1e-5


def test_quantised_weights_are_scaled_to_one_and_not_written_anew(tmp_path):
    m = worm()
    weights = m.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    view = m.json["bufferViews"][m.json["accessors"][weights]["bufferView"]]
    values = np.frombuffer(m.binary, "<f4", view["byteLength"] // 4, view["byteOffset"]) * np.float32(1.003)
    m.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] = values.tobytes()
    asset = gltf.load(compressed(m, tmp_path / "plain.glb").glb(tmp_path / "draco.glb"))
    assert np.allclose(asset.character.skin.weights.sum(axis=1), 1)
    gltf.save(tmp_path / "out.glb", asset.character, [asset.motion()])
    assert read_document(tmp_path / "out.glb").json["meshes"] == read_document(tmp_path / "draco.glb").json["meshes"]
    plain = gltf.load(tmp_path / "plain.glb")  # plain weights that are off are mended, which this test relies on
    gltf.save(tmp_path / "mended.glb", plain.character, [])
    assert read_document(tmp_path / "mended.glb").json["meshes"] != read_document(tmp_path / "plain.glb").json["meshes"]


def test_a_wrong_count_is_told_and_the_data_are_believed(tmp_path):
    packed = compressed(worm(), tmp_path / "plain.glb")
    packed.json["accessors"][packed.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["count"] += 5
    asset = gltf.load(packed.glb(tmp_path / "draco.glb"))
    assert len(asset.character.mesh.vertices) == 54
    assert any("declares 59 elements, its Draco data hold 54" in note for note in asset.notes)


def primitive(document):
    return document["meshes"][0]["primitives"][0]


def accessor_of(document, name):
    return document["accessors"][primitive(document)["attributes"][name]]


def missing_attribute(document):
    primitive(document)["extensions"][EXTENSION]["attributes"]["POSITION"] = 77


def attribute_beside(document):
    primitive(document)["extensions"][EXTENSION]["attributes"]["NORMAL"] = 1


def other_type(document):
    accessor_of(document, "TEXCOORD_0")["type"] = "VEC4"


def other_component(document):
    accessor_of(document, "WEIGHTS_0")["componentType"] = 5121


def no_view(document):
    del primitive(document)["extensions"][EXTENSION]["bufferView"]


def picture_of_it(document):
    primitive(document)["extensions"][EXTENSION]["bufferView"] = 0


def shared(document):
    """Two primitives whose data differ, and one accessor."""
    first = primitive(document)
    attributes = {**first["extensions"][EXTENSION]["attributes"]}
    second = {**first, "extensions": {EXTENSION: {**first["extensions"][EXTENSION], "attributes": attributes}}}
    attributes["JOINTS_0"], attributes["WEIGHTS_0"] = attributes["WEIGHTS_0"], attributes["JOINTS_0"]
    for name in ("JOINTS_0", "WEIGHTS_0"):
        accessor_of(document, name)["componentType"] = 5126
    document["meshes"][0]["primitives"].append(second)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (missing_attribute, "have no attribute 77"),
        (attribute_beside, "compresses 'NORMAL', which the primitive does not have"),
        (other_type, "is of type VEC4, its Draco data have 2 components"),
        (other_component, "do not fit into its component type"),
        (no_view, "lacks 'bufferView'"),
        (picture_of_it, r"cannot be decoded \(piece 0"),
        (shared, "is filled with different data by two Draco primitives"),
    ],
)
def test_faults_are_told_with_their_place(tmp_path, change, problem):
    packed = compressed(worm(), tmp_path / "plain.glb")
    change(packed.json)
    with pytest.raises(FileError, match=problem) as caught:
        gltf.load(packed.glb(tmp_path / "draco.glb"))
    assert "\n" not in str(caught.value) and str(tmp_path / "draco.glb") in str(caught.value)


ATTRIBUTES = ", ".join(f'"{number}": [12, "<f4", 54, {width}]' for number, width in enumerate((3, 2, 4, 4), start=20))
ANSWER = f'{{"points": 54, "faces": [0, "<u4", 1, 3], "attributes": {{{ATTRIBUTES}}}}}'


@pytest.mark.parametrize(
    ("script", "problem"),
    [
        ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)", r"cannot be decoded \(the process stopped without a word"),
        ("import time\ntime.sleep(60)", "take longer than 0.5 s to decode"),
        ("import DracoPyNot", "No module named 'DracoPyNot'"),
        ("raise ImportError(\"No module named 'DracoPy'\")", "which the package DracoPy decodes: pip install DracoPy"),
        ("import os, sys\nopen(sys.argv[2], 'w').write('{'); os._exit(0)", "stopped in the middle of its answer"),
        ("def work(source, output):\n    return [{'points': 3}]", "gave no usable answer"),
        ("def work(source, output):\n    open(output, 'w')\n    return []", "gave no usable answer"),
        ("def work(source, output):\n    open(output, 'w')\n    return [{'points': 3}]", "gave no usable answer"),
        (f"import json\ndef work(source, output):\n    open(output, 'w')\n    return [json.loads('{ANSWER}')]",
         "gave no usable answer"),
        (f"import json\ndef work(source, output):\n    open(output, 'wb').write(bytes([255]) * 12 + bytes(4000))\n"
         f"    return [json.loads('{ANSWER}')]", "a Draco triangle names vertex 4294967295 of 54"),
    ],
)  # fmt: skip
def test_a_decoder_that_crashes_hangs_or_lies_is_one_line(tmp_path, monkeypatch, own_child, script, problem):
    packed = compressed(worm(), tmp_path / "plain.glb")
    attributes = primitive(packed.json)["extensions"][EXTENSION]["attributes"]
    attributes |= {"POSITION": 20, "TEXCOORD_0": 21, "JOINTS_0": 22, "WEIGHTS_0": 23}
    own_child("draco_child", script)
    if "sleep" in script:
        monkeypatch.setattr(gltf_draco, "SECONDS", 0.5)
    with pytest.raises(FileError, match=problem) as caught:
        gltf.load(packed.glb(tmp_path / "draco.glb"))
    assert "\n" not in str(caught.value)


def test_values_that_are_not_one_a_vertex_are_refused(tmp_path, own_child):
    packed = compressed(worm(), tmp_path / "plain.glb")
    primitive(packed.json)["extensions"][EXTENSION]["attributes"] = {"POSITION": 20}
    answer = {"points": 54, "faces": [0, "<u4", 0, 3], "attributes": {20: [0, "<f4", 53, 3]}}
    script = f"def work(source, output):\n    open(output, 'wb').write(bytes(4000))\n    return [{answer!r}]\n"
    own_child("draco_child", script)
    with pytest.raises(FileError, match="have 53 values for 54 vertices"):
        gltf.load(packed.glb(tmp_path / "draco.glb"))


def test_this_process_never_loads_the_decoder(tmp_path):
    path = compressed(worm(), tmp_path / "plain.glb").glb(tmp_path / "draco.glb")
    code = f"import sys; from retarget import load; load({str(path)!r}); assert 'DracoPy' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def faulty(piece, rng):
    """The bytes with a few changed, or cut off."""
    piece = bytearray(piece)
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(len(piece)) if rng.random() < 0.5 else rng.randrange(min(60, len(piece)))
        piece[at] = rng.randrange(256)
    return bytes(piece[: rng.randrange(1, len(piece))] if rng.random() < 0.1 else piece)


def test_damaged_files_are_read_or_refused(tmp_path):
    packed, rng = compressed(worm(), tmp_path / "plain.glb"), random.Random(5)
    raw = packed.glb(tmp_path / "draco.glb").read_bytes()
    view = packed.json["bufferViews"][primitive(packed.json)["extensions"][EXTENSION]["bufferView"]]
    start = 28 + struct.unpack_from("<I", raw, 12)[0] + view["byteOffset"]
    outcomes = {"read": 0, "refused": 0}
    for _ in range(FILES):
        path = tmp_path / "bad.glb"
        piece = faulty(raw[start : start + view["byteLength"]], rng)
        path.write_bytes(raw[:start] + piece.ljust(view["byteLength"], b"\0") + raw[start + view["byteLength"] :])
        try:
            gltf.load(path)
            outcomes["read"] += 1
        except RetargetError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 2, outcomes
