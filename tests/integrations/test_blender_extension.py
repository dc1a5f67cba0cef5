"""The extension for Blender: registers, runs on two characters, and keys arrive on the target's own armature."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from made_motions import actor, body

from retarget.body.kinematics import world_pose
from retarget.character import MeshMotion
from retarget.io import load, save, save_sequence
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.retargeting import retarget

tomllib = pytest.importorskip("tomllib" if sys.version_info >= (3, 11) else "tomli")

HERE = Path(__file__).parent
FOLDER = HERE.parents[1] / "integrations" / "blender"


def test_the_manifest_says_what_blender_asks_for():
    manifest = tomllib.loads((FOLDER / "blender_manifest.toml").read_text())
    assert {"schema_version", "id", "version", "name", "tagline", "maintainer", "type", "license"} <= set(manifest)
    assert manifest["blender_version_min"] == "4.2.0" and len(manifest["tagline"]) <= 64


def test_an_action_goes_from_one_armature_onto_another(tmp_path):
    python = os.environ.get("RETARGET_BPY_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("bpy is not installed (RETARGET_BPY_PYTHON may name an interpreter that has it)")
    motion = cut(embedded_motion("wave"), 0.5, 1.2)
    save(tmp_path / "source.glb", actor().character, [motion])
    save(tmp_path / "target.glb", actor("heavy").character, [])
    bare = body("average").mesh
    save_sequence(tmp_path / "statue.glb", MeshMotion(bare, bare.vertices[None].astype(np.float32)))
    command = tmp_path / "retarget"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m retarget "$@"\n')
    command.chmod(0o755)
    told = subprocess.run(
        [python, str(HERE / "blender_runs_extension.py"), *(str(tmp_path / name) for name in ("source.glb", "target.glb", "out.npz", "statue.glb"))],
        capture_output=True, text=True, env=os.environ | {"RETARGET_COMMAND": str(command)},
    )  # fmt: skip
    assert told.returncode == 0, told.stderr[-2000:]
    with np.load(tmp_path / "out.npz") as found:
        assert found["done"].tolist() == ["FINISHED"]
        assert found["left"].tolist() == [], "nothing stays behind in the scene"
        assert "the character's own already" in str(found["said"])
        assert found["roll"] == 0.0, "the armature's rest pose is untouched"
        assert found["rigged"].tolist() == ["FINISHED"] and found["hidden"]
        assert found["faces"] == len(bare.faces) and found["moving"].shape[1] == 52
        assert np.abs(found["moving"][1] - found["moving"][0]).max() > 0.05, "the mesh that got bones moves"
        names, places = found["names"].tolist(), found["places"]
    result = retarget(load(tmp_path / "source.glb").path, tmp_path / "target.glb")
    _, expected = world_pose(result.motion)
    own = [result.target.skeleton.names.index(name) for name in names]
    assert places.shape[0] == len(motion)
    # Blender lays the mesh's vertices out anew, which moves the solver's contacts by millimetres and nothing else.
    off = np.abs(places - expected[:, own])
    assert off.max() < 0.01 and np.median(off) < 1e-4
