"""The long run of damaged files: many of one format, read one after the other, with what became of them.

    python tools/damage_many.py .glb 100000 [--seed 5] [FILE ...]

damages the given files (or small ones that are made for it) in seeded ways and reads each: a result or one line is right; any
other exception is a crash, more than ten seconds is a hang, and both are printed with the number that makes the file again
(`--first N --count 1` with the same seed and files). Parsers that run in a process of their own are forked from this one, which has loaded
them, instead of started anew: the same work under the same limits, at a twentieth of the time. Linux and macOS.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from retarget.body.human import human
from retarget.character import Character, Mesh, Skin
from retarget.errors import RetargetError
from retarget.evaluate.damage import damaged
from retarget.io import child, load, save
from retarget.io.obj_ply import save as save_surface
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion

SECONDS = 10
NATIVE = {".fbx": ("fbx", "fbx_child"), ".usda": ("usd", "usd_child"), ".usdc": ("usd", "usd_child"), ".usdz": ("usd", "usd_child")}


class Hang(BaseException):
    """Raised by the alarm."""


def few_triangles(character: Character) -> Character:
    """The first faces of a body: damage then falls on what describes, not on thousands of vertices."""
    faces = character.mesh.faces[:40]
    used, packed = np.unique(faces, return_inverse=True)
    skin = character.skin
    return Character(
        character.skeleton, Mesh(character.mesh.vertices[used], packed.reshape(-1, 3)),
        Skin(skin.joints, skin.inverse_binds, skin.columns[used], skin.weights[used]), name="few",
    )  # fmt: skip


def made(suffix: str, folder: Path) -> Path:
    """A small file of the format."""
    path, body = folder / f"seed{suffix}", few_triangles(human())
    if suffix in (".obj", ".ply"):
        save_surface(path, body.mesh)
    elif suffix == ".npz":
        np.savez(path, poses=np.full((6, 156), 0.1), trans=np.zeros((6, 3)), gender="male", mocap_framerate=30.0)
    else:
        save(path, body, [cut(embedded_motion("wave"), 0.0, 0.2)])
    return path


def forked(module: str, arguments: Any, seconds: float) -> Any:
    """As `child.run_child`, in a fork of this process."""
    work = importlib.import_module(f"retarget.io.{module}").work
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        reply = Path(folder) / "reply.json"
        process = os.fork()
        if process == 0:
            signal.setitimer(signal.ITIMER_REAL, 0)
            child.limit()
            try:
                told = {"told": work(*map(str, arguments))}
            except child.Refused as refusal:
                told = {"refused": " ".join(str(refusal).split())}
            except BaseException as error:
                told = {"failed": " ".join(str(error).split())}
            reply.write_text(json.dumps(told))
            os._exit(0)
        ends = time.monotonic() + seconds
        while True:
            done, status = os.waitpid(process, os.WNOHANG)
            if done:
                break
            if time.monotonic() > ends:
                os.kill(process, signal.SIGKILL)
                os.waitpid(process, 0)
                raise child.ChildTimeout(f"it takes longer than {seconds:g} s")
            time.sleep(0.0005)
        if status or not reply.exists():
            raise child.ChildFailed("its process went down")
        told = json.loads(reply.read_text())
    if "refused" in told:
        raise child.Refused(told["refused"])
    if "failed" in told:
        raise child.ChildFailed(told["failed"])
    return told["told"]


def read(path: Path) -> str:
    """What becomes of one file."""
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        asset = load(path)
        if asset.clips:
            asset.motion(0)
        return "read"
    except RetargetError as error:
        return "refused" if "\n" not in str(error) else "crash"
    except Hang:
        return "hang"
    except Exception:
        traceback.print_exc(limit=-3)
        return "crash"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("suffix")
    words.add_argument("count", type=int)
    words.add_argument("files", nargs="*", type=Path)
    words.add_argument("--seed", type=int, default=1)
    words.add_argument("--first", type=int, default=0)
    asked = words.parse_args()

    def alarm(*_: Any) -> None:
        raise Hang

    signal.signal(signal.SIGALRM, alarm)
    if asked.suffix in NATIVE:
        reader, module = NATIVE[asked.suffix]
        importlib.import_module(f"retarget.io.{module}")
        for name in ("ufbx",) if asked.suffix == ".fbx" else ("Gf", "Sdf", "Usd", "UsdGeom", "UsdShade", "UsdSkel", "UsdUtils", "Vt"):
            importlib.import_module(name if name == "ufbx" else f"pxr.{name}")
        importlib.import_module(f"retarget.io.{reader}").run_child = forked
    elif asked.suffix in (".glb", ".gltf"):
        importlib.import_module("retarget.io.gltf_draco").run_child = forked
    found = dict.fromkeys(("read", "refused", "crash", "hang"), 0)
    with tempfile.TemporaryDirectory() as folder:
        files = asked.files or [made(asked.suffix, Path(folder))]
        contents = [path.read_bytes() for path in files]
        own = Path(folder) / f"damaged{asked.suffix}"
        started = time.perf_counter()
        for number in range(asked.first, asked.first + asked.count):
            own.write_bytes(damaged(contents[number % len(contents)], np.random.default_rng([asked.seed, number])))
            became = read(own)
            found[became] += 1
            if became in ("crash", "hang"):
                print(f"{became}: number {number} of seed {asked.seed}", flush=True)
        seconds = time.perf_counter() - started
    print(f"{asked.suffix}: {asked.count} files in {seconds:.0f} s: " + ", ".join(f"{n} {word}" for word, n in found.items()))
    sys.exit(bool(found["crash"] or found["hang"]))


if __name__ == "__main__":
    main()
