"""Damaged files of every kind: read, or refused in one line, whatever becomes of native parsers in their processes."""

import json
import os
import subprocess
import sys

import damage_seeds
import pytest
import said_of_files
from said_of_files import said_of

from retarget.evaluate.damage import damage
from retarget.evaluate.damage_run import outcomes, read
from retarget.io import READERS

MUTATIONS = int(os.environ.get("RETARGET_MUTATIONS", 1000))
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
    paths = []
    for number, seed in enumerate(2 * seeds(made, kind)):
        paths.append(tmp_path / f"{number}{seed.suffix}")
        paths[-1].write_bytes(damage(seed.read_bytes(), "few", number, seed.suffix))
    forks = subprocess.run([sys.executable, said_of_files.__file__, *paths], stdout=subprocess.PIPE, check=True)
    assert json.loads(forks.stdout) == [said_of(path) for path in paths]
