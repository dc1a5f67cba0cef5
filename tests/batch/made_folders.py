"""Small folders of motions and characters, and what a batch made of them."""

import hashlib
import json
from dataclasses import replace

import numpy as np
from made_bodies import box_figure
from made_motions import body, fingerless, stand, walk

from retarget.casting import cast
from retarget.geometry.closest import Places
from retarget.io import save
from retarget.motion.filter import cut
from retarget.performing import ScanPerformer
from retarget.rig.rigging import Rigged

QUICK = ["--method", "copy-rotations", "--jobs", "2"]


def short(motion, name, seconds=0.5):
    return replace(fingerless(cut(motion, 0.0, seconds)), name=name)


def make_motions(folder):
    """Three files at two depths, one of them with two clips."""
    (folder / "sub").mkdir(parents=True)
    save(folder / "walk2.bvh", fingerless(body()), [short(walk(), "walk")])
    save(folder / "walk10.bvh", fingerless(body()), [short(walk(), "walk", 1.0)])
    save(folder / "sub" / "two.glb", fingerless(body()), [short(stand(), "one"), short(walk(), "two|2", 0.8)])
    return folder


def make_characters(folder):
    folder.mkdir(parents=True)
    save(folder / "heavy.glb", fingerless(body("heavy")), [])
    save(folder / "child.glb", fingerless(body("child")), [])
    return folder


NAMES = sorted(
    f"{body}/{name}.glb" for body in ("heavy", "child") for name in ("walk2", "walk10", "sub/two/one", "sub/two/two_2")
)
"""What a batch of these is called."""


def contents(folder):
    """Hash of every file below a folder but the manifest."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != "manifest.jsonl"]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def records(folder, word="done"):
    """Lines of the manifest that hold a word."""
    return [record for record in map(json.loads, open(folder / "manifest.jsonl")) if word in record]


def known_rig(mesh, unit=None, tell=None):
    """As `rig`, which takes seconds, where the mesh is known to be the figure of boxes."""
    nowhere = Places(np.zeros((0, 3), dtype=int), np.zeros((0, 3)))
    return Rigged(box_figure(), 1.0, nowhere, np.zeros((0, 3)), np.zeros((0, 3)), 1.0, ())


def follows_at_once(capture, hints=None, convention=None, regressor=None, causal=False, tell=None):
    """As `cast_scan`, which takes seconds, where everyone walks."""
    motion = replace(short(walk(), capture.name, (len(capture) - 1) / 30), fps=capture.fps)
    return ScanPerformer(cast(fingerless(body())), motion, np.ones(len(capture), dtype=bool), ())
