"""Damaged files of every kind: read, or refused in one line, whatever becomes of native parsers in their processes."""

import os
import re

import damage_seeds
import pytest

from retarget.errors import RetargetError
from retarget.evaluate.damage import damage
from retarget.evaluate.damage_run import outcomes, read
from retarget.io import READERS, load
from retarget.io.child_fork import forking

MUTATIONS = int(os.environ.get("RETARGET_MUTATIONS", 2000))
KINDS = "amass bvh clouds draco fbx glb gltf meshopt morph obj pcd ply sequence smpl usda usdc usdz vrm".split()


@pytest.fixture(scope="session")
def made(tmp_path_factory, data_or_none):
    folder = tmp_path_factory.mktemp("damage") / "seeds"
    binary = data_or_none and data_or_none / "meshes" / "quaternius_posed" / "M_Male_Sitting.fbx"
    assert set(damage_seeds.main(folder, [binary] if binary and binary.exists() else [])) <= set(KINDS)
    return folder


def seeds(made, kind):
    if not (made / kind).is_dir():
        pytest.skip(f"this installation reads no {kind}")
    return sorted(path for path in (made / kind).iterdir() if path.suffix in READERS)


@pytest.mark.parametrize("kind", KINDS)
def test_seeds_are_valid(made, kind):
    for path in seeds(made, kind):
        assert read(path) == "read", path


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_read_or_refused(made, kind):
    found = outcomes(seeds(made, kind), MUTATIONS)
    assert not found.faults and found.crashes == found.hangs == 0
    assert found.count == MUTATIONS and min(found.read, found.refused) > 0.02 * MUTATIONS, found
    assert found.contained < 0.05 * MUTATIONS, "the parser goes down more often than it may"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize("kind", ["draco", "fbx", "usda", "usdc"])
def test_a_fork_says_what_a_child_says(made, kind, tmp_path):
    told = []
    for number, seed in enumerate(2 * seeds(made, kind) + 2 * seeds(made, kind)):
        path = tmp_path / f"{number}{seed.suffix}"
        path.write_bytes(damage(seed.read_bytes(), "few", number, seed.suffix))
        told.append((path, said_of(path)))
    with forking():
        assert told == [(path, said_of(path)) for path, _ in told]


def said_of(path):
    """Notes, or the refusal; of a parser's failure that it failed, for its words depend on the memory that was left to it."""
    try:
        return load(path).notes
    except RetargetError as error:
        return re.sub(r"(cannot be read as \w+) \(.*\)", r"\1", str(error), flags=re.DOTALL)
