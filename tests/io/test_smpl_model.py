"""Body models of the SMPL family as characters, and what is no such model."""

import numpy as np
import pytest
from smpl_maker import model_arrays

from retarget.body.skinning import rest_vertices
from retarget.casting import cast
from retarget.correspond.joints import match_humanoid
from retarget.errors import FileError
from retarget.io import load
from retarget.io.npz_arrays import open_archive
from retarget.io.smpl_joints import CANONICAL, FAMILIES
from retarget.io.smpl_model import open_model, read_model


def tiny(joints=24, vertices=8, shapes=3, seed=2):
    """A model without any sense but with every array a model has."""
    random = np.random.default_rng(seed)
    weights = random.random((vertices, joints)) * (random.random((vertices, joints)) < 0.2)
    weights[:, 0] += 0.1
    regressor = random.random((joints, vertices))
    table = np.array([FAMILIES[joints].parents, range(joints)], dtype=np.int64)
    return {
        "v_template": random.normal(size=(vertices, 3)),
        "f": random.integers(0, vertices, (5, 3)).astype(np.uint32),
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "kintree_table": np.where(table < 0, 2**32 - 1, table),
        "shapedirs": random.normal(size=(vertices, 3, shapes)),
    }


@pytest.mark.parametrize("joints", [24, 52, 55])
def test_a_model_is_a_character(tmp_path, joints):
    arrays = model_arrays(joints)
    np.savez(tmp_path / "BODY.npz", **arrays, posedirs=np.zeros((2, 3, 4)))
    asset = load(tmp_path / "BODY.npz")
    character = asset.character
    assert (asset.kind, asset.clips, character.name) == ("character", (), "BODY")
    assert (asset.convention.metres_per_unit, asset.convention.up) == (1.0, "+y")
    assert any("posedirs" in note for note in asset.notes)
    assert np.array_equal(character.mesh.vertices, arrays["v_template"]) and np.array_equal(
        character.mesh.faces, arrays["f"]
    )
    assert np.allclose(rest_vertices(character), arrays["v_template"], atol=1e-6)
    places = arrays["J_regressor"] @ arrays["v_template"]
    assert np.allclose(character.skin.inverse_binds[:, :3, 3], -places)
    dense = np.zeros_like(arrays["weights"])
    np.add.at(dense, (np.arange(len(dense))[:, None], character.skin.columns), character.skin.weights)
    assert np.allclose(dense, arrays["weights"])
    humanoid = match_humanoid(character.skeleton)
    body = [name for name in FAMILIES[22].names]
    assert all(humanoid.joints[CANONICAL[name]] == character.skeleton.index(name) for name in body)
    assert ("leftIndexProximal" in humanoid.joints) == (joints > 24)
    assert cast(asset).height == pytest.approx(1.66, abs=0.02)


@pytest.mark.parametrize("root", [-1, 2**32 - 1, 2**64 - 1])
def test_the_root_has_no_parent_however_it_is_written(tmp_path, root):
    arrays = tiny()
    table = np.array([FAMILIES[24].parents, range(24)])
    kind = np.uint64 if root > 2**33 else np.int64
    arrays["kintree_table"] = np.where(table < 0, np.array(root, dtype=kind), table.astype(kind))
    np.savez(tmp_path / "a.npz", **arrays)
    assert load(tmp_path / "a.npz").character.skeleton.parents[0] == -1


@pytest.mark.parametrize(
    ("joints", "count", "usable"), [(24, 16, 16), (24, 0, 0), (55, 20, 10), (55, 400, 300), (55, 16, 16)]
)
def test_expressions_are_no_shapes(tmp_path, joints, count, usable):
    arrays = tiny(joints, shapes=max(count, 1))
    if not count:
        del arrays["shapedirs"]
    np.savez(tmp_path / "a.npz", **arrays)
    model = read_model(open_archive(tmp_path / "a.npz"))
    assert model.shapes == usable
    all_of_it = np.ones(500)
    moved = model.character(all_of_it).mesh.vertices - arrays["v_template"]
    assert np.allclose(moved, arrays["shapedirs"][:, :, :usable].sum(axis=2) if count else 0.0)


@pytest.mark.parametrize(
    ("change", "place", "problem"),
    [
        ({"weights": None}, "", "the array weights is missing"),
        ({"f": None, "J_regressor": None}, "", "the array f, J_regressor is missing"),
        ({"v_template": np.zeros((8, 2))}, "v_template", "shape (any, 3)"),
        ({"v_template": np.full((8, 3), np.nan)}, "v_template", "not finite"),
        ({"v_template": np.zeros((0, 3))}, "v_template", "shape (any, 3)"),
        ({"v_template": np.array(None)}, "v_template", "run code"),
        ({"kintree_table": np.zeros((2, 16), dtype=int)}, "kintree_table", "has 16 joints"),
        ({"kintree_table": np.zeros((2, 22), dtype=int)}, "kintree_table", "has 22 joints"),
        ({"kintree_table": np.zeros((2, 24), dtype=int)}, "kintree_table", "do not hang"),
        ({"kintree_table": np.zeros((2, 24))}, "kintree_table", "must hold integers"),
        ({"kintree_table": np.zeros(24, dtype=int)}, "kintree_table", "shape (2, any)"),
        ({"J_regressor": np.zeros((24, 9))}, "J_regressor", "shape (24, 8)"),
        ({"J_regressor": np.array(None)}, "J_regressor", "run code"),
        ({"J_regressor": np.array(1.0)}, "J_regressor", "toarray"),
        ({"weights": np.zeros((8, 23))}, "weights", "shape (8, 24)"),
        ({"weights": np.zeros((8, 24))}, "", "must sum to one"),
        ({"weights": np.full((8, 24), -1.0)}, "", "must not be negative"),
        ({"f": np.full((5, 3), 8)}, "", "names vertex 8 of 8"),
        ({"f": np.zeros((5, 4), dtype=int)}, "f", "shape (any, 3)"),
        ({"f": np.zeros((5, 3))}, "f", "must hold integers"),
        ({"shapedirs": np.zeros((8, 3))}, "shapedirs", "shape (8, 3, any)"),
    ],
)
def test_what_is_no_model(tmp_path, change, place, problem):
    arrays = {name: array for name, array in (tiny() | change).items() if array is not None}
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(FileError) as told:
        load(tmp_path / "bad.npz")
    assert told.value.place == place and problem in told.value.problem
    assert "bad.npz" in str(told.value) and "\n" not in str(told.value)


def test_shape_directions_are_read_when_a_shape_is_asked_for(tmp_path):
    arrays = tiny() | {"shapedirs": np.full((8, 3, 2), np.nan)}
    np.savez(tmp_path / "a.npz", **arrays)
    model = open_model(tmp_path / "a.npz")
    model.character()
    with pytest.raises(FileError, match="shapedirs: holds numbers that are not finite"):
        model.character(np.ones(2))


def test_pickles_are_never_opened(tmp_path):
    class Trap:
        def __reduce__(self):
            return (print, ("the pickle ran",))

    import pickle

    for suffix in (".pkl", ".pickle"):
        path = tmp_path / f"SMPL{suffix}"
        path.write_bytes(pickle.dumps(Trap()))
        for read in (open_model, load):
            with pytest.raises(FileError, match="since they run code.*npz"):
                read(path)


def test_other_files_are_no_models(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        open_model(tmp_path / "none.npz")
    with pytest.raises(FileError, match="is not a file"):
        open_model(tmp_path)
    (tmp_path / "a.glb").write_bytes(b"")
    with pytest.raises(FileError, match="given as .npz"):
        open_model(tmp_path / "a.glb")
    np.savez(tmp_path / "a.npz", poses=np.zeros((1, 66)))
    with pytest.raises(FileError, match="is no SMPL-family model"):
        open_model(tmp_path / "a.npz")


def test_a_model_is_for_motions_in_npz(tmp_path):
    np.savez(tmp_path / "a.npz", **tiny())
    with pytest.raises(FileError, match="for motions only"):
        load(tmp_path / "a.npz", smpl_model=tmp_path / "a.npz")
    (tmp_path / "a.bvh").write_text("")
    for path in (tmp_path / "a.bvh", tmp_path):
        with pytest.raises(FileError, match="for motions in .npz only"):
            load(path, smpl_model=tmp_path / "a.npz")
