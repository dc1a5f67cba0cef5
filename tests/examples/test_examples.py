"""Every example and every snippet of the README runs as it stands."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from retarget.body.human import human
from retarget.body.skinning import skin_motion
from retarget.character import PointMotion
from retarget.geometry.sampling import sample_surface
from retarget.io import load, save, save_sequence
from retarget.motion.align import Similarity
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion

REPOSITORY = Path(__file__).resolve().parents[2]
# The demo takes most of a minute and draws pictures; `make demo` runs it.
EXAMPLES = sorted(path for path in (REPOSITORY / "examples").glob("*.py") if path.stem != "demo")
WRITTEN = {
    "retarget_files": {"walk.bvh", "heavy.glb", "heavy_walk.glb"},
    "human_shapes": {"child.glb", "muscular.glb", "tall_and_thin.glb", "wide_hips.glb"},
    "joint_map": {"mapped_by_hand.glb"},
    "own_method": set(),
}


def run(folder: Path, *command: str) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, env=os.environ)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_writes_what_it_says(path, tmp_path):
    assert run(tmp_path, sys.executable, str(path), "out").strip(), "an example says what it did"
    written = {each.name for each in (tmp_path / "out").iterdir()} if (tmp_path / "out").exists() else set()
    assert written == WRITTEN[path.stem]
    for name in written:
        asset = load(tmp_path / "out" / name)
        assert asset.kind == ("motion" if name.endswith(".bvh") else "character")
        assert all(np.isfinite(asset.motion(number).rotations).all() for number in range(len(asset.clips)))


def test_examples_are_short():
    assert all(len(path.read_text().splitlines()) < 40 for path in EXAMPLES)


@pytest.fixture(scope="module")
def a_users_folder(tmp_path_factory) -> Path:
    """What the README's user has: a motion, a character in centimetres, a bare mesh, and scans."""
    folder = tmp_path_factory.mktemp("user")
    save(folder / "dance.bvh", human(), [cut(embedded_motion("walk"), 1.0, 2.5)])
    knight = human(weight=1.0, height=1.8)
    names = tuple(f"knight_{name}" for name in knight.skeleton.names)
    knight = replace(knight, skeleton=replace(knight.skeleton, names=names))
    save(folder / "knight.glb", Similarity(np.array([0.0, 0.0, 0.0, 1.0]), 100.0).character(knight), [])
    statue = human(weight=0.7).mesh
    (folder / "statue.obj").write_text(
        "".join(f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in statue.vertices.tolist())
        + "".join(f"f {a} {b} {c}\n" for a, b, c in (statue.faces + 1).tolist())
    )
    for name, file in (("captures", "dance.bvh"), ("characters", "knight.glb")):
        (folder / name).mkdir()
        (folder / name / file).write_bytes((folder / file).read_bytes())
    walk = skin_motion(human(), cut(embedded_motion("walk"), 0.0, 0.3))
    scans = tuple(sample_surface(frame.astype(float), human().mesh.faces, 3000, number) for number, frame in enumerate(walk))
    save_sequence(folder / "scans", PointMotion(scans))
    return folder


def readme_blocks(language: str) -> list[str]:
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def hips_range(path: Path) -> np.ndarray:
    asset = load(path)
    return np.ptp(asset.motion(len(asset.clips) - 1).translations[:, 0], axis=0)


def test_the_snippet_of_the_readme_runs(a_users_folder):
    (snippet,) = readme_blocks("python")
    run(a_users_folder, sys.executable, "-c", snippet)
    assert load(a_users_folder / "child_walk.glb").clips[0].frames == len(embedded_motion("walk"))
    assert hips_range(a_users_folder / "knight_dance.glb").max() > 100, "metres, in the centimetres of its file"


def test_the_commands_of_the_readme_run(a_users_folder):
    (a_users_folder / "knight_dance.glb").unlink(missing_ok=True)
    commands = [line.split("#")[0].split() for block in readme_blocks("sh") for line in block.splitlines()]
    commands = [words[1:] for words in commands if words[:1] == ["retarget"] and words[1] != "view"]  # which waits for its user
    assert commands
    for words in commands:
        run(a_users_folder, sys.executable, "-m", "retarget", *words)
    assert hips_range(a_users_folder / "knight_dance.glb").max() > 100
    assert load(a_users_folder / "knight_moves.glb").clips[-1].frames == 10
