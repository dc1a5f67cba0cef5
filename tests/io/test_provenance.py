"""What a result's file says of its source: it comes back as it was written, and nonsense under its name is no record."""

import json
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_motions import body, fingerless, walk

from retarget.character import Provenance
from retarget.errors import RetargetError
from retarget.io import load, save
from retarget.io.provenance import KEY, LONGEST, provenance_record, recorded_provenance
from retarget.motion.filter import cut, resample

MADE = Provenance("dance.bvh", "dance", 2.0, 5.0, 120.0)


def test_the_record_comes_back():
    assert recorded_provenance({KEY: json.loads(json.dumps(provenance_record(MADE)))}) == MADE
    assert provenance_record(replace(MADE, start=1 / 3))["start"] == 0.333333
    assert str(MADE) == "'dance.bvh' ['dance'], 2 to 5 s"


def test_a_cut_is_a_part_of_what_it_was_cut_from():
    motion = replace(walk(), name="walk")  # 90 frames, 30 a second
    motion = replace(motion, made_from=Provenance.whole("/far/away/walk.bvh", motion))
    assert motion.made_from == Provenance("walk.bvh", "walk", 0.0, 89 / 30, 30.0)
    part = cut(cut(motion, 1.0, 2.0), 0.5, None)
    assert (part.made_from.start, part.made_from.end) == pytest.approx((1.5, 2.0)) and len(part) == 16
    assert resample(part, 60.0).made_from == part.made_from


def test_a_file_is_known_by_its_name_wherever_it_lies():
    assert MADE.is_of("dance.bvh") and MADE.is_of(Path("/elsewhere/dance.bvh")) and not MADE.is_of("dance.glb")
    odd = b"d\xff.bvh".decode("utf-8", "surrogateescape")
    made = Provenance.whole(odd, walk())
    assert made.is_of(f"/x/{odd}") and made.file == "d?.bvh", "what is no text cannot be written"


@pytest.mark.parametrize(
    "changed, said",
    [
        ({"fps": 0.0}, "fps must be positive"),
        ({"fps": np.nan}, "fps must be positive"),
        ({"start": 6.0}, "received 6.0 to 5.0 s"),
        ({"start": -1.0}, "received -1.0 to 5.0 s"),
        ({"end": np.inf}, "received 2.0 to inf s"),
        ({"start": np.nan}, "received nan to 5.0 s"),
    ],
)
def test_no_part_of_a_clip(changed, said):
    with pytest.raises(RetargetError, match=said):
        replace(MADE, **changed)


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".usda", ".usdz"])
def test_files_keep_it_and_hold_no_folder(tmp_path, suffix):
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr")
    file = tmp_path / f"hidden_folder{suffix}"
    told = replace(fingerless(walk()), made_from=replace(MADE, file="dänce [1].bvh"))
    save(file, fingerless(body()), [told, replace(fingerless(walk()), name="plain")])
    asset = load(file)
    assert [clip.made_from for clip in asset.clips] == [told.made_from, None]
    assert [asset.motion(number).made_from for number in (0, 1)] == [told.made_from, None]
    assert str(tmp_path).encode() not in file.read_bytes()
    save(tmp_path / f"again{suffix}", asset.character, [])  # kept with the file
    assert load(tmp_path / f"again{suffix}").clips[0].made_from == told.made_from


def test_one_glb_of_a_usd_and_back(tmp_path):
    pytest.importorskip("pxr")
    save(tmp_path / "a.usdc", fingerless(body()), [replace(fingerless(walk()), made_from=MADE)])
    asset = load(tmp_path / "a.usdc")
    save(tmp_path / "b.glb", asset.character, [asset.motion()], keep_clips=False)
    assert load(tmp_path / "b.glb").clips[0].made_from == MADE


def test_bvh_has_no_place_for_it(tmp_path):
    save(tmp_path / "a.bvh", body(), [replace(walk(), made_from=MADE)])
    assert load(tmp_path / "a.bvh").clips[0].made_from is None


def nonsense(rng):
    """Any JSON value."""
    kind = rng.randrange(8)
    if kind == 0:
        return {rng.choice(["source", "clip", "start", "end", "fps", KEY]): nonsense(rng) for _ in range(rng.randrange(4))}
    if kind == 1:
        return [nonsense(rng) for _ in range(rng.randrange(3))]
    return [None, True, -1, 1e300, "x" * rng.choice([1, LONGEST + 1]), 10**400][kind - 2]


def test_extras_of_others_are_no_record_and_no_fault():
    rng = random.Random(5)
    good = provenance_record(MADE)
    for _ in range(3000):
        record = good | {rng.choice(list(good)): nonsense(rng)}
        found = recorded_provenance(rng.choice([{KEY: record}, {KEY: nonsense(rng)}, nonsense(rng)]))
        assert found is None or found.start <= found.end < 1e9
    assert recorded_provenance({KEY: good | {"start": True}}) is None
    assert recorded_provenance({KEY: good | {"source": "x" * (LONGEST + 1)}}) is None
    assert recorded_provenance({KEY: good | {"start": 6}}) is None


def test_a_file_with_nonsense_in_its_extras_is_read(tmp_path):
    save(tmp_path / "a.gltf", fingerless(body()), [fingerless(walk())])
    said = json.loads((tmp_path / "a.gltf").read_text())
    for extras in (7, [], {KEY: 7}, {KEY: {"source": 7}}, {KEY: provenance_record(MADE) | {"end": 1e308}}):
        said["animations"][0]["extras"] = extras
        (tmp_path / "a.gltf").write_text(json.dumps(said))
        assert load(tmp_path / "a.gltf").clips[0].made_from is None


def test_a_prim_with_nonsense_in_its_custom_data_is_read(tmp_path):
    pytest.importorskip("pxr")
    save(tmp_path / "a.usda", fingerless(body()), [replace(fingerless(walk()), made_from=MADE)])
    text = (tmp_path / "a.usda").read_text()
    for old, new in (('string source = "dance.bvh"', "float3 source = (1, 2, 3)"), ("double fps = 120", "double fps = inf")):
        assert text.count(old) == 1
        (tmp_path / "b.usda").write_text(text.replace(old, new))
        assert load(tmp_path / "b.usda").clips[0].made_from is None
