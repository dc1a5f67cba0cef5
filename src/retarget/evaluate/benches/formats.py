"""The formats bench: what comes back of what is written, how files of others are read, what damaged files do, and what
`retarget batch` achieves and loses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.casting import cast
from retarget.character import Character, Motion
from retarget.errors import RetargetError
from retarget.evaluate.cases import REPOSITORY, real_files
from retarget.evaluate.contact_cases import embedded_actor, foreign_actors
from retarget.evaluate.damage_run import Outcomes, outcomes
from retarget.evaluate.environment import environment
from retarget.evaluate.validator import errors_found
from retarget.io import READERS, WRITTEN_SUFFIXES, load, save
from retarget.io.gltf_draft import Draft, write_files
from retarget.methods.copy_rotations import CopyRotations
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.progress import Tell, untold

SEED = 1
FORMATS = {
    "gltf": (".glb", ".gltf"), "vrm": (".vrm",), "usd": (".usda", ".usdc", ".usdz"), "fbx": (".fbx",),
}  # fmt: skip
"""Suffixes of each format whose round trip is measured, where this machine can write it."""
BODIES, MOTIONS = ("heavy", "child"), ("wave", "walk")
FRAMES = (0, 7, 20)
"""Frames on which the whole skin is compared."""
DAMAGED, FEW = 2000, 200
"""Damaged files of each kind, and how many with `quick`."""
KILLS = 20
CLIPS, CHARACTERS = 20, ("Knight.glb", "mannequiny.glb", "Barbarian.glb")
"""Real clips and characters by which the speed of `retarget batch` is measured, on two processes."""
BATCH_KILLS = REPOSITORY / "tests" / "batch_kills.py"
SEEDS = REPOSITORY / "tests" / "damage_seeds.py"
LARGEST_SEED = 100_000
"""Bytes of a real file that is damaged."""
BLENDER_READS = REPOSITORY / "tests" / "io" / "blender_reads_fbx.py"


def run(quick: bool = False, tell: Tell = untold) -> dict[str, Any]:
    """Round trips, FBX files of others, the validator, damaged files."""
    with tempfile.TemporaryDirectory(prefix="retarget-") as name:
        folder = Path(name)
        cases = list(_round_trips(folder, quick, tell))
        written = [folder / case["file"] for case in cases if case["file"].endswith(".glb")]
        read = list(_fbx_files(quick, folder, tell))
        tell("validator")
        errors = errors_found(written)
        damage = dict(_damage(folder, quick, tell))
        batch = {} if quick else _batch(folder, tell)
    summary: dict[str, Any] = {}
    for kind in FORMATS:
        found = [case["mm"] for case in cases if case["format"] == kind]
        summary[f"{kind}_round_trip_mm"] = max(found, default=None)
    compared = [each["joint_mm"] for each in read if each["joint_mm"] is not None]
    summary |= {
        "fbx_joint_mm": max(compared, default=None),
        "fbx_read_seconds_worst": max((each["seconds"] for each in read), default=None),
        "validator_errors": None if errors is None else sum(map(len, errors)),
        "validated_files": 0 if errors is None else len(errors),
        "batch_clips_per_minute": batch.get("clips_per_minute"),
        "batch_lost": batch.get("batch_lost"),
        "mutations": min(found.count for found in damage.values()),
        "crashes": sum(found.crashes for found in damage.values()),
        "hangs": sum(found.hangs for found in damage.values()),
    }
    rows = [{"format": kind, **vars(found)} for kind, found in damage.items()]
    lines = [
        f"{row['format']:8} read {row['read']:6} refused {row['refused']:6} (a parser went down {row['contained']:3}) crashes {row['crashes']} hangs {row['hangs']}"
        for row in rows
    ]
    lines += [f"{kind} {fault}" for kind, found in damage.items() for fault in found.faults]
    lines += ["", *(f"{key:36} {'-' if value is None else f'{value:.4g}'}" for key, value in summary.items())]
    return {
        "bench": "formats", "quick": quick, "environment": environment() | {"seeds": {"damage": SEED}}, "summary": summary,
        "rows": rows, "cases": [*cases, *read], "lines": lines,
    }  # fmt: skip


def _performances(folder: Path, quick: bool) -> Iterator[tuple[str, Character, Motion]]:
    """Characters with a motion of their own, in the space of their files."""
    source = embedded_actor("thin")
    for body in BODIES[: 1 if quick else None]:
        actor = embedded_actor(body)
        for name in MOTIONS[: 1 if quick else None]:
            motion = cut(embedded_motion(name), 0.0, 1.0)
            yield f"{body}_{name}", actor.character, CopyRotations().prepare(source, actor)(motion).motion
    motion = cut(embedded_motion("wave"), 0.0, 1.0)
    avatar = cast(_avatar(folder))
    yield "avatar_wave", avatar.original, CopyRotations().prepare(source, avatar)(motion).file_motion
    for name, actor in foreign_actors():
        result = CopyRotations().prepare(source, actor)(motion)
        yield f"{name}_wave", actor.original, result.file_motion
        if quick:
            return


def _avatar(folder: Path) -> Path:
    """An embedded body as a VRM 1.0 file."""
    actor, path = embedded_actor("child"), folder / "avatar.vrm"
    save(path.with_suffix(".gltf"), actor.character, [])
    asset = load(path.with_suffix(".gltf"))
    draft = Draft.of(asset.character.origin.document)
    node = {entry["name"]: number for number, entry in enumerate(draft.json["nodes"])}
    bones = {name: {"node": node[actor.skeleton.names[joint]]} for name, joint in actor.humanoid.joints.items()}
    draft.json["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    draft.json["extensionsUsed"] = ["VRMC_vrm"]
    write_files(draft.glb(path))
    return path


def _round_trips(folder: Path, quick: bool, tell: Tell) -> Iterator[dict[str, Any]]:
    """Largest distance of a joint, or of a vertex from the nearest that came back, on clips that were written and read."""
    for name, character, motion in _performances(folder, quick):
        for kind, suffixes in FORMATS.items():
            for suffix in suffixes:
                path = folder / f"{name}{suffix}"
                tell(f"round trip of {path.name}")
                try:
                    if suffix not in WRITTEN_SUFFIXES:
                        continue
                    save(path, character, [motion])
                except RetargetError:  # a program that writes it is not at hand
                    continue
                yield {"format": kind, "file": path.name, "mm": 1000 * _displacement(path, character, motion)}


def _displacement(path: Path, character: Character, motion: Motion) -> float:
    """How far joints, and the skin on some frames, are from where they should be, metres."""
    from scipy.spatial import cKDTree

    asset = load(path)
    back = asset.motion(len(asset.clips) - 1)
    rotations, places = world_pose(motion)
    other_rotations, other_places = world_pose(back)
    if len(back) != len(motion):
        return float("inf")
    own = [back.skeleton.names.index(name) if name in back.skeleton.names else -1 for name in motion.skeleton.names]
    known = np.flatnonzero(np.array(own) >= 0)
    far = float(np.linalg.norm(other_places[:, np.array(own)[known]] - places[:, known], axis=-1).max())
    if character.skin is None or asset.character.skin is None:
        return far
    here, there = prepare_skinning(character), prepare_skinning(asset.character)
    for frame in FRAMES:
        skin = here.vertices(rotations[frame : frame + 1], places[frame : frame + 1])[0]
        found = there.vertices(other_rotations[frame : frame + 1], other_places[frame : frame + 1])[0]
        used = np.unique(character.mesh.faces)  # vertices of no face are not written
        far = max(far, float(cKDTree(found).query(skin[used])[0].max()))
    return far


def _fbx_files(quick: bool, folder: Path, tell: Tell) -> Iterator[dict[str, Any]]:
    """Real FBX files: how long they take, and, where there is a Python with bpy, how far joints are from where Blender's
    import puts them."""
    python = os.environ.get("RETARGET_BPY_PYTHON")
    for path in list(real_files(".fbx"))[: 3 if quick else None]:
        tell(f"reading {path.name}")
        started = time.perf_counter()
        try:
            asset = load(path)
        except RetargetError as error:
            yield {"file": path.name, "seconds": time.perf_counter() - started, "joint_mm": None, "refused": str(error)}
            continue
        seconds = time.perf_counter() - started
        compared = python is not None and bool(asset.clips) and not quick
        yield {"file": path.name, "seconds": seconds, "joint_mm": _from_blender(path, asset, python, folder) if compared else None}


def _from_blender(path: Path, asset, python: str, folder: Path) -> float | None:
    """Largest distance of a joint, over all takes and frames, from where Blender has it, mm; None where Blender fails. Of its
    two importers, which disagree where bones move along in files bound in another pose, the nearer one counts for a take."""
    seen = folder / "seen.npz"
    if subprocess.run([python, str(BLENDER_READS), str(path), str(seen)], capture_output=True).returncode:
        return None
    far = None
    with np.load(seen) as found:
        names = found["names"].tolist()
        for number, take in enumerate(found["takes"].tolist()):
            if take not in [clip.name for clip in asset.clips]:
                continue
            motion = asset.motion(take)
            shared = [joint for joint in names if joint in motion.skeleton.names]
            own = world_pose(motion)[1][:, [motion.skeleton.index(joint) for joint in shared]]
            columns = [names.index(joint) for joint in shared]
            imports = [found[name][:, columns] for name in (f"{number}", f"{number}_older") if name in found]
            far = max(far or 0.0, min(_apart(theirs, own) for theirs in imports))
    return far


def _apart(theirs: np.ndarray, ours: np.ndarray) -> float:
    """Largest distance of a joint on the frames that both have, mm."""
    frames = min(len(theirs), len(ours))
    return 1000 * float(np.linalg.norm(theirs[:frames] - ours[:frames], axis=-1).max())


def _damage(folder: Path, quick: bool, tell: Tell) -> Iterator[tuple[str, Outcomes]]:
    """What damaged files of every kind come to."""
    seeds = folder / "seeds"
    real = [path for path in real_files(".fbx", ".usdz") if path.stat().st_size < LARGEST_SEED]
    made = subprocess.run([sys.executable, str(SEEDS), str(seeds), *map(str, real[:2])], capture_output=True, text=True)
    made.check_returncode()
    for kind in made.stdout.split():
        tell(f"damaged files: {kind}")
        paths = sorted(path for path in (seeds / kind).iterdir() if path.suffix in READERS)
        yield kind, outcomes(paths, FEW if quick else DAMAGED, str(SEED))


def _batch(folder: Path, tell: Tell) -> dict[str, float | None]:
    """Clips a minute of folders onto folders, and what 20 kills at random moments lose."""
    tell("batch")
    motions, characters, own = folder / "motions", folder / "characters", folder / "batch"
    for place in (motions, characters, own):
        place.mkdir()
    for path in [path for path in real_files(".bvh") if path.parent.name == "cmu_daz"][:CLIPS]:
        (motions / path.name).symlink_to(path)
    for path in real_files(".glb"):
        if path.name in CHARACTERS:
            (characters / path.name).symlink_to(path)
    found: dict[str, float | None] = {"clips_per_minute": None}
    if any(motions.iterdir()) and any(characters.iterdir()):
        command = [sys.executable, "-m", "retarget", "batch", motions, characters, "-o", own, "--jobs", "2", "--fps", "30", "--json"]
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
        found["clips_per_minute"] = json.loads(done.stdout)["clips_per_minute"]
    tell("batch, killed again and again")
    killed = subprocess.run(
        [sys.executable, str(BATCH_KILLS), "--kills", str(KILLS), "--seed", str(SEED)], capture_output=True, text=True
    )
    killed.check_returncode()
    return found | {"batch_lost": json.loads(killed.stdout.splitlines()[-1])["batch_lost"]}
