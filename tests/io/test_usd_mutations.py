"""Damaged USD files: whatever they do to the reader's process, here they are a character, a mesh, or one line.

Most go through the reader's own code many in one process, for starting one costs half a second; some through `load`.
"""

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from file_faults import mutated
from usd_maker import LOOK, animation, skeleton, stage, tube_mesh

from retarget.errors import RetargetError
from retarget.io import gltf, load

pytest.importorskip("pxr")

HERE = Path(__file__).parent
MUTATIONS = int(os.environ.get("RETARGET_MUTATIONS", 2000))
THROUGH_A_CHILD_EACH = MUTATIONS // 100
WORDS = [b"skel:joints", b"1e400", b"[]", b"None", b"</Man>", b"int", b"elementSize", b"{", b"uniform", b"@./1.usda@"]


def seeds(tmp_path, suffix):
    from pxr import Sdf, UsdUtils

    plain = stage(LOOK, skeleton(inside=animation()), tube_mesh(extra="rel material:binding = </Man/Red>"), up="Z", unit="0.01")
    rich = stage(skeleton(inside=animation() + animation("other", joints=(0, 1, 2)), posed=20), tube_mesh(), tube_mesh("Twin", quads=True))
    cache = '#usda 1.0\n(\nmetersPerUnit = 1\n)\ndef Mesh "M" {\nint[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n'
    cache += "point3f[] points.timeSamples = {0: [(0,0,0), (1,0,0), (0,1,0)], 1: [(0,0,1), (1,0,0), (0,1,0)]}\n}\n"
    if suffix == "usda":
        return [plain.encode(), rich.encode(), cache.encode()]
    (tmp_path / "seed.usda").write_text(rich)
    Sdf.Layer.FindOrOpen(str(tmp_path / "seed.usda")).Export(str(tmp_path / "seed.usdc"))
    if suffix == "usdz":
        UsdUtils.CreateNewUsdzPackage(str(tmp_path / "seed.usdc"), str(tmp_path / "seed.usdz"))
    return [(tmp_path / f"seed.{suffix}").read_bytes()]


def convert_all(folder, count, suffix):
    """What became of every file: 'read', 'refused', 'hangs', or 'fatal' where it took the process down."""
    outcomes = []
    while len(outcomes) < count:
        command = [sys.executable, HERE / "usd_many.py", folder, str(len(outcomes)), str(count), suffix]
        run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=60 + 0.5 * (count - len(outcomes)), cwd=folder)
        outcomes += run.stdout.decode().split()
        if len(outcomes) < count:
            outcomes.append("fatal")
    return outcomes


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz"])
def test_damaged_files_are_read_or_refused(tmp_path, suffix):
    source, rng = seeds(tmp_path, suffix), random.Random(7)
    count = MUTATIONS if suffix == "usda" else MUTATIONS // 4
    for number in range(count):
        (tmp_path / f"{number}.{suffix}").write_bytes(mutated(source[number % len(source)], rng, WORDS))
    outcomes = convert_all(tmp_path, count, suffix)
    assert outcomes.count("hangs") == 0
    assert outcomes.count("fatal") < 0.05 * count, "the reader goes down more often than it may"
    assert outcomes.count("read") > 0.02 * count and outcomes.count("refused") > 0.02 * count
    for number in range(count):
        if outcomes[number] == "read":
            try:
                asset = gltf.load(tmp_path / f"{number}.glb")
                if asset.clips:
                    asset.motion(0)
            except RetargetError:
                continue


def test_some_go_all_the_way(tmp_path):
    outcomes, rng = {"read": 0, "refused": 0}, random.Random(11)
    for suffix in ("usda", "usdc", "usdz"):
        source = seeds(tmp_path, suffix)
        for number in range(THROUGH_A_CHILD_EACH):
            path = tmp_path / f"bad{number}.{suffix}"
            path.write_bytes(mutated(source[number % len(source)], rng, WORDS))
            try:
                asset = load(path)
                if asset.clips:
                    asset.motion(0)
                outcomes["read"] += 1
            except RetargetError as error:
                assert "\n" not in str(error)
                outcomes["refused"] += 1
    assert min(outcomes.values()) > 0
