"""Draco-compressed characters: read as what they were, written back with their compressed data untouched."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.errors import FileError, RetargetError
from retarget.evaluate.damage import damaged
from retarget.io import gltf_draco, load, save
from retarget.io.child_process import ChildFailed
from retarget.io.gltf_document import read_document
from retarget.io.gltf_draft import Draft, write_files
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion

DracoPy = pytest.importorskip("DracoPy")
IDS = {"POSITION": 0, "NORMAL": 1, "JOINTS_0": 5, "WEIGHTS_0": 6}


def body():
    """A body of one material, all of whose vertices have faces."""
    character = actor("child").character
    return replace(character, mesh=replace(character.mesh, materials=(), face_materials=None, uvs=None))


def compressed(path, change=lambda text: None, blob=None):
    """The body as a GLB whose mesh is compressed with Draco only; `change` alters the JSON, `blob` the data."""
    plain = path.with_name("plain.glb")
    save(plain, body(), [cut(embedded_motion("wave"), 0.5, 1.0)])
    document = read_document(plain)
    draft = Draft.of(document)
    (primitive,) = draft.json["meshes"][0]["primitives"]
    arrays = {name: document.raw(accessor, ("VEC3", "VEC4")) for name, accessor in primitive["attributes"].items() if name in IDS}
    faces = document.integers(primitive["indices"], ("SCALAR",)).reshape(-1, 3)
    used, corners = np.unique(faces, return_inverse=True)
    data = blob or DracoPy.encode(
        arrays["POSITION"][used], corners.reshape(-1, 3).astype(np.uint32), quantization_bits=20, preserve_order=True,
        generic_attributes={IDS[name]: np.ascontiguousarray(arrays[name][used]) for name in ("NORMAL", "JOINTS_0", "WEIGHTS_0")},
    )  # fmt: skip
    ids = dict(IDS)
    if blob is None:  # the encoder numbers positions behind what was given
        ids["POSITION"] = next(each["unique_id"] for each in DracoPy.decode(data).attributes if each["attribute_type"] == 0)
    view = draft.add_view(bytes(data))
    kept = {name: accessor for name, accessor in primitive["attributes"].items() if name in IDS}
    own = {name: {k: v for k, v in draft.json["accessors"][a].items() if k not in ("bufferView", "byteOffset")} | {"count": len(used)} for name, a in kept.items()}
    own["indices"] = {"componentType": 5125, "type": "SCALAR", "count": faces.size}
    numbers = {name: draft.add("accessors", entry) for name, entry in own.items()}
    extension = {"bufferView": view, "attributes": {name: ids[name] for name in kept}}
    draft.json["meshes"] = [{"primitives": [{
        "attributes": {name: numbers[name] for name in kept}, "indices": numbers["indices"],
        "extensions": {gltf_draco.EXTENSION: extension},
    }]}]  # fmt: skip
    draft.json["extensionsUsed"] = draft.json["extensionsRequired"] = [gltf_draco.EXTENSION]
    change(draft.json)
    write_files(draft.glb(path))
    return path


def posed(path):
    asset = load(path)
    motion = asset.motion(0)
    return prepare_skinning(asset.character).vertices(*world_pose(motion))


def test_a_compressed_body_moves_as_the_plain_one(tmp_path):
    from scipy.spatial import cKDTree

    here, there = posed(compressed(tmp_path / "a.glb")), posed(tmp_path / "plain.glb")
    for frame in (0, 8):
        assert cKDTree(here[frame]).query(there[frame])[0].max() < 2e-4
    asset = load(tmp_path / "a.glb")
    assert len(asset.character.mesh.faces) == len(body().mesh.faces)
    assert np.abs(asset.character.skin.weights.sum(axis=1) - 1).max() < 1e-6


def test_it_is_written_back_with_its_data_untouched(tmp_path):
    asset = load(compressed(tmp_path / "a.glb"))
    save(tmp_path / "b.glb", asset.character, [replace(asset.motion(0), name="again")])
    before, after = read_document(tmp_path / "a.glb"), read_document(tmp_path / "b.glb")
    assert after.json["meshes"] == before.json["meshes"]
    view = before.json["meshes"][0]["primitives"][0]["extensions"][gltf_draco.EXTENSION]["bufferView"]
    assert bytes(after.view(view, "")) == bytes(before.view(view, ""))
    assert [clip.name for clip in load(tmp_path / "b.glb").clips] == [asset.clips[0].name, "again"]
    assert np.abs(posed(tmp_path / "b.glb") - posed(tmp_path / "a.glb")).max() < 1e-6


def primitive(text):
    return text["meshes"][0]["primitives"][0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: primitive(text)["extensions"].update({gltf_draco.EXTENSION: 3}), "must name a bufferView and attributes"),
        (lambda text: primitive(text)["extensions"][gltf_draco.EXTENSION].update(bufferView=999), "must name a bufferView"),
        (lambda text: primitive(text)["extensions"][gltf_draco.EXTENSION]["attributes"].update(POSITION="a"), "by whole numbers"),
        (lambda text: primitive(text)["extensions"][gltf_draco.EXTENSION]["attributes"].update(POSITION=77), "hold no POSITION"),
        (lambda text: text["accessors"][primitive(text)["indices"]].update(count=3), r"where \(3, 1\) are declared"),
        (lambda text: text["accessors"][primitive(text)["indices"]].update(count=10**9), "declares more than"),
        (lambda text: text["accessors"][primitive(text)["indices"]].update(componentType=5121), "beyond what is declared"),
    ],
)
def test_faulty_extensions_are_told(tmp_path, change, said):
    with pytest.raises(FileError, match=said):
        load(compressed(tmp_path / "a.glb", change))


def test_data_that_are_none_and_no_decoder_are_told(tmp_path, monkeypatch):
    with pytest.raises(FileError, match="its Draco data cannot be decoded"):
        load(compressed(tmp_path / "a.glb", blob=b"DRACO not really"))
    path = compressed(tmp_path / "b.glb")

    def without(*_):
        raise ChildFailed("ModuleNotFoundError: No module named 'DracoPy'")

    monkeypatch.setattr(gltf_draco, "run_child", without)
    with pytest.raises(FileError, match="needs DracoPy: pip install DracoPy"):
        load(path)


def test_plain_data_beside_compressed_ones_are_taken(tmp_path, monkeypatch):
    """Where the file also has the data uncompressed, nothing needs to be decoded."""

    def beside(text):
        for name in (*primitive(text)["attributes"].values(), primitive(text)["indices"]):
            text["accessors"][name]["bufferView"] = 0

    monkeypatch.setattr(gltf_draco, "run_child", lambda *_: pytest.fail("decoded"))
    with pytest.raises(RetargetError):  # view 0 is too short for them, but it was looked at
        load(compressed(tmp_path / "a.glb", beside))


def test_damaged_data_are_read_or_refused(tmp_path):
    """Native code meets damaged bytes in a process of its own: a result or one line, never more."""
    random, seen = np.random.default_rng(2), {"read": 0, "refused": 0}
    path = compressed(tmp_path / "a.glb")
    document = read_document(path)
    view = primitive(document.json)["extensions"][gltf_draco.EXTENSION]["bufferView"]
    data = bytes(document.view(view, ""))
    whole = path.read_bytes()
    for _ in range(int(os.environ.get("RETARGET_MUTATIONS", 25))):
        changed = damaged(data, random)
        changed = changed[: len(data)].ljust(len(data), b"\0")
        path.write_bytes(whole.replace(data, changed))
        try:
            load(path).motion(0)
            seen["read"] += 1
        except RetargetError:
            seen["refused"] += 1
    assert min(seen.values()) > 0, json.dumps(seen)
