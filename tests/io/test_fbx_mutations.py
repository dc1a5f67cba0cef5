"""Damaged FBX files: whatever they do to the reader's process, here they are a character, a mesh, or one line."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fbx_maker import Picture, Shapes, document
from gltf_maker import PNG

from retarget.errors import RetargetError
from retarget.evaluate.damage import damaged
from retarget.io import gltf

HERE = Path(__file__).parent
MUTATIONS = int(os.environ.get("RETARGET_MUTATIONS", 2000))
SECONDS = 20.0
"""For one file."""


def convert_all(folder, count):
    """Every file through the reader; the numbers of those that took it down."""
    fatal, first = [], 0
    while first < count:
        command = [sys.executable, HERE / "fbx_many.py", folder, str(first), str(count)]
        run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=SECONDS + 0.5 * (count - first))
        done = run.stdout.split()
        first += len(done)
        if run.returncode != 0 and first < count:
            fatal.append(first)
            (folder / f"{first}.glb").unlink(missing_ok=True)
            first += 1
    return fatal


@pytest.mark.parametrize("kind", ["ascii", "binary"])
def test_damaged_files_are_read_or_refused(tmp_path, data_or_none, kind):
    if kind == "ascii":
        shown = {"picture": Picture(PNG), "shapes": Shapes((50.0, 100.0), rest=25.0, end=100.0)}
        seeds = [
            document(takes=(("one", 30.0), ("two", 60.0)), pre_rotation=(0, 90, 0)).encode(),
            document(takes=(("one", 30.0),), **shown).encode(),
            document(bones=False, **shown).encode(),
        ]
    else:
        path = data_or_none and data_or_none / "meshes" / "quaternius_posed" / "M_Male_Sitting.fbx"
        if not path or not path.exists():
            pytest.skip("no binary FBX file is at hand")
        seeds = [path.read_bytes()]
        shown = data_or_none / "characters" / "fbx" / "blender_293_barbarian_7400_binary.fbx"
        seeds += [shown.read_bytes()] if shown.exists() else []
    random, count = np.random.default_rng(3), MUTATIONS if kind == "ascii" else MUTATIONS // 4
    for number in range(count):
        (tmp_path / f"{number}.fbx").write_bytes(damaged(seeds[number % len(seeds)], random))
    fatal = convert_all(tmp_path, count)
    outcomes = {"read": 0, "refused": 0}
    for number in set(range(count)) - set(fatal):
        path = tmp_path / f"{number}.glb"
        if not path.exists():
            outcomes["refused"] += 1
            continue
        try:
            asset = gltf.load(path)
            if asset.clips:
                asset.motion(0)
            outcomes["read"] += 1
        except RetargetError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 0.02 * count, outcomes
    assert len(fatal) < 0.05 * count, "the reader goes down more often than it may"
