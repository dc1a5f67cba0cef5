"""Clips that are left out take their data along, and nothing else."""

import numpy as np
import pytest
from gltf_maker import worm
from gltf_reference import Reference
from test_gltf_write import errors_found

from retarget.io import gltf


def seen(reference):
    """What a document's meshes, skins and images show, decoded."""
    json = reference.json
    for mesh in json["meshes"]:
        for primitive in mesh["primitives"]:
            groups = [primitive["attributes"], *primitive.get("targets", ())]
            yield from (reference.accessor(group[name]) for group in groups for name in sorted(group))
            if "indices" in primitive:
                yield reference.accessor(primitive["indices"])
    yield from (reference.accessor(skin["inverseBindMatrices"]) for skin in json.get("skins", ()))
    for image in json.get("images", ()):
        view = json["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        yield np.frombuffer(reference.buffers[view["buffer"]][start : start + view["byteLength"]], np.uint8)


def made(**features):
    m = worm(**features)
    m.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": m.accessor(np.ones((len_of(m), 3)))}]
    return m


def len_of(m):
    return m.json["accessors"][m.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["count"]


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("features", [{}, {"texture": True, "sparse": True, "prop": True, "skins": 2, "extra": 3}])
def test_what_is_shown_stays_and_the_clips_data_goes(features, suffix, tmp_path):
    path = made(clips=5, **features).glb(tmp_path / "a.glb")
    asset = gltf.load(path)
    gltf.save(tmp_path / f"b{suffix}", asset.character, [asset.motion(2)], keep_clips=False)
    gltf.save(tmp_path / f"c{suffix}", asset.character, [asset.motion(2)])
    old, new = Reference(path), Reference(tmp_path / f"b{suffix}")
    shown = list(seen(old)), list(seen(new))
    assert len(shown[0]) == len(shown[1]) and all(np.array_equal(a, b) for a, b in zip(*shown))
    again = gltf.load(tmp_path / f"b{suffix}")
    assert [clip.name for clip in again.clips] == ["clip2"]
    true = gltf.load(tmp_path / f"c{suffix}")
    assert np.array_equal(again.motion(0).rotations, true.motion(5).rotations)
    size = lambda name: sum(file.stat().st_size for file in tmp_path.glob(f"{name}.*"))  # noqa: E731
    assert size("b") < 0.85 * size("c")
    views = new.json["bufferViews"]
    sizes = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
    for accessor in new.json["accessors"]:
        if "bufferView" in accessor:
            start = views[accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
            assert start % sizes[accessor["componentType"]] == 0
    used = {accessor.get("bufferView") for accessor in new.json["accessors"]}
    used |= {
        accessor["sparse"][part]["bufferView"]
        for accessor in new.json["accessors"]
        if "sparse" in accessor
        for part in ("indices", "values")
    }
    used |= {image.get("bufferView") for image in new.json.get("images", ())}
    assert set(range(len(views))) <= used  # no view is left for nothing
    assert gltf.load(path).motion(2).rotations.tolist() == asset.motion(2).rotations.tolist()  # the source is as it was


def test_the_khronos_validator_finds_no_error(tmp_path):
    path = made(clips=5, texture=True, sparse=True, skins=2).glb(tmp_path / "a.glb")
    asset = gltf.load(path)
    gltf.save(tmp_path / "b.glb", asset.character, [asset.motion(0)], keep_clips=False)
    before, after = errors_found(path, tmp_path / "b.glb")
    assert after == before or not after.get("errors")


def test_unknown_extensions_keep_everything(tmp_path):
    m = made(clips=3)
    m.json["extensionsUsed"] = ["KHR_materials_unlit", "EXT_mesh_gpu_instancing"]
    asset = gltf.load(m.glb(tmp_path / "a.glb"))
    gltf.save(tmp_path / "b.glb", asset.character, [asset.motion(0)], keep_clips=False)
    new = Reference(tmp_path / "b.glb")
    assert new.json["accessors"][: len(m.json["accessors"])] == m.json["accessors"]
    m.json["extensionsUsed"] = ["KHR_materials_unlit"]
    asset = gltf.load(m.glb(tmp_path / "a.glb"))
    gltf.save(tmp_path / "b.glb", asset.character, [asset.motion(0)], keep_clips=False)
    assert len(Reference(tmp_path / "b.glb").json["accessors"]) < len(new.json["accessors"])


def test_faulty_data_that_was_mended_is_pruned_too(tmp_path):
    m = made(clips=3)
    weights = m.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    m.json["accessors"][weights] = m.json["accessors"][m.accessor(np.full((len_of(m), 4), 7.0))]
    asset = gltf.load(m.glb(tmp_path / "a.glb"))
    gltf.save(tmp_path / "b.glb", asset.character, [asset.motion(0)], keep_clips=False)
    gltf.save(tmp_path / "c.glb", asset.character, [asset.motion(0)])
    pruned, whole = gltf.load(tmp_path / "b.glb"), gltf.load(tmp_path / "c.glb")
    assert np.array_equal(pruned.character.skin.weights, whole.character.skin.weights) and pruned.notes == whole.notes
