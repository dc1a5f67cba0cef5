"""Blender in a process of its own; FBX, and Alembic of a character's surface, written by it.

Blender's licence (GPL) and its Python stay there: we write a GLB, `blender_child.py` turns it into what is wanted. FBX is
written in centimetres with +Y up, no scale and no quarter turn on any object, bones with the axes that they have here, and
a key on every frame: read again, joints stand within a hundredth of a millimetre of where they stood. Alembic holds the
moving surfaces only; mesh sequences in Alembic are the matter of `alembic.py`.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from retarget.character import Character, Motion
from retarget.errors import FileError
from retarget.io import gltf
from retarget.io.child import ChildFailed, ChildTimeout, run_program
from retarget.io.ogawa import erase_date
from retarget.io.whole_file import written_whole

CHILD = Path(__file__).with_name("blender_child.py")
VARIABLE = "RETARGET_BLENDER"
"""Names Blender's program, or a Python that has bpy."""
CLIP = "retarget clip "
"""What clips are called on the way, by number: the character may have others of their names, which stay behind."""
DONE = {"write": "written", "read": "read"}
SECONDS = 600.0
"""How long Blender may take for a file."""


def save(
    path: str | Path, character: Character, motions: Sequence[Motion], *, animation_only: bool = False, root: str = ""
) -> None:
    """Write a character with its motions (.fbx), or the surface that the only one moves (.abc). `root` names a bone at the
    ground that shall carry the skeleton; where there is none of that name at the top of it, FBX gets one.

    The file appears whole or not at all. Raises `FileError` where there is no Blender, or where it fails, and for several
    motions of an Alembic file or of different rates.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind == "abc" and len(motions) != 1:
        raise FileError(path, f"an Alembic file holds one clip, received {len(motions)}; write one file a clip")
    rates = {motion.fps for motion in motions}
    if len(rates) > 1:
        raise FileError(path, f"clips of one file have one frame rate here, received {', '.join(f'{r:g}' for r in sorted(rates))}; bring them to one (--fps), or choose one clip (--clip)")
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        source, output = Path(folder) / "from.glb", Path(folder) / f"to.{kind}"
        named = [replace(motion, name=f"{CLIP}{number}") for number, motion in enumerate(motions)]
        gltf.save(source, character, named, animation_only=animation_only)
        job = {
            "glb": str(source), "output": str(output), "format": kind, "fps": rates.pop() if rates else 30.0,
            "clips": {wanted.name: motion.name for wanted, motion in zip(named, motions)}, "root": root,
        }  # fmt: skip
        run_blender(path, CHILD, job, Path(folder))
        keep(path, output)


def keep(path: Path, made: Path) -> None:
    """Bring what Blender made to its place, whole, an Alembic file without the time of day. Raises `FileError` where it made
    nothing, or the file cannot be written."""
    if not made.exists():
        raise FileError(path, "Blender ended without an error and without a file")
    if made.suffix == ".abc":
        try:
            erase_date(made)
        except FileError as error:
            raise FileError(path, f"Blender made a file that {error.problem}") from None
    with written_whole(path) as file, made.open("rb") as content:
        shutil.copyfileobj(content, file)


def blender(path: Path, child: Path = CHILD, verb: str = "write") -> list[str]:
    """The command that runs the program `child`, without its arguments. Raises `FileError` of the file that is to be written
    (`verb` "read": to be read) where there is no Blender."""
    named = os.environ.get(VARIABLE)
    if named and not shutil.which(named):
        raise FileError(path, f"{VARIABLE} names {named}, which is no program")
    found = shutil.which(named or "blender")
    if found:
        found = os.path.abspath(found)  # it starts in another folder
        if "blender" in Path(found).name.lower():
            return [found, "--background", "--factory-startup", "--python-use-system-env", "--python", str(child)]
        return [found, str(child)]
    if importlib.util.find_spec("bpy") is not None:
        return [sys.executable, str(child)]
    raise FileError(
        path,
        f"is {DONE[verb]} by Blender: put blender on the PATH, name it in {VARIABLE}, or pip install 'retarget[blender]' "
        "(Python 3.11); a .glb needs none and opens in Blender, Unreal, Unity and Godot",
    )


def run_blender(path: Path, child: Path, job: Mapping[str, Any], folder: Path, verb: str = "write") -> None:
    """Run the program `child` with a job, which is put into `folder`. Raises `FileError` where Blender is not there, fails, or
    takes too long."""
    order = folder / "job.json"
    order.write_text(json.dumps(job), encoding="utf-8")
    try:  # the seed: identities in an FBX file are hashes of names
        run_program([*blender(path, child, verb), "--", str(order)], SECONDS, os.environ | {"PYTHONHASHSEED": "0"})
    except ChildTimeout:
        raise FileError(path, f"Blender takes longer than {SECONDS:g} s to {verb} it") from None
    except ChildFailed as error:
        raise FileError(path, f"Blender cannot {verb} it ({error})") from None
