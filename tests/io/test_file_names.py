"""Names for many files: in the order people count, fit for every file system, no two alike."""

import numpy as np
import pytest

from retarget.io.file_names import LONGEST, distinct, natural_order, portable


def test_numbers_count_by_their_value():
    names = ["walk10", "Walk2", "walk1", "run", "walk2", "walk02b", "10", "9", ""]
    assert sorted(names, key=natural_order) == ["", "9", "10", "run", "walk1", "Walk2", "walk2", "walk02b", "walk10"]


@pytest.mark.parametrize(
    "name, fit",
    [
        ("Walk", "Walk"), ("Armature|Walk:1", "Armature_Walk_1"), ("a/b\\c", "a_b_c"), ("..", "_"), (".hidden", "_hidden"),
        ("tail. ", "tail"), ("", "_"), ("con", "_con"), ("Lpt1.old", "_Lpt1.old"), ("console", "console"),
        ("a\0b\n", "a_b_"), ("bad\udcff", "bad_"), ("e\u0301", "\u00e9"), ("走る", "走る"), ("   ", "_"),
    ],
)  # fmt: skip
def test_names_fit_every_file_system(name, fit):
    assert portable(name) == fit
    assert portable(fit) == fit  # nothing more to do


def test_long_names_are_cut_between_characters():
    assert len(portable("走" * 100).encode()) <= LONGEST and set(portable("走" * 100)) == {"走"}


def test_who_alone_wants_a_name_gets_it_and_others_are_told_apart():
    wanted = [["walk", "walk_bvh"], ["Walk", "Walk_fbx"], ["run", "run_bvh"], ["walk_bvh", "walk_bvh_glb"]]
    assert distinct(wanted, ".glb") == ["walk_2.glb", "Walk_fbx.glb", "run.glb", "walk_bvh.glb"]
    assert distinct([["a"], ["A"], ["a"]]) == ["a", "A_2", "a_3"]
    assert distinct([["x"], ["\u00e9"], ["e\u0301"]], ".glb") == ["x.glb", "\u00e9.glb", "e\u0301_2.glb"]


def test_names_that_are_taken_or_folders_are_left_alone():
    assert distinct([["manifest.jsonl", "other"]], taken=["Manifest.jsonl"]) == ["other"]
    names = distinct([["a/walk", "a/walk_x"], ["a/walk.glb/one"]], ".glb")
    assert names == ["a/walk_x.glb", "a/walk.glb/one.glb"]


def test_no_two_names_ever_meet():
    rng = np.random.default_rng(5)
    parts = ["a", "A", "a_2", "b", "a_bvh", "a.glb"]
    for _ in range(500):
        wanted = [
            ["/".join(rng.choice(parts, rng.integers(1, 4))) for _ in range(rng.integers(1, 3))]
            for _ in range(rng.integers(1, 9))
        ]
        names = distinct(wanted, ".glb")
        folded = [name.casefold() for name in names]
        folders = {"/".join(name.split("/")[:depth]) for name in folded for depth in range(1, name.count("/") + 1)}
        assert len(set(folded)) == len(names) and not folders & set(folded)
        assert distinct(wanted, ".glb") == names
