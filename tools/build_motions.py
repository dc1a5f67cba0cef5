"""Builds `src/retarget/motion/library.npz`: the embedded motions, made here from nothing but this code and the embedded human.

    python tools/build_motions.py            # all of them, some minutes
    python tools/build_motions.py walk demo  # only these; the others stay as they are in the file

The result is the same bytes for the same code, human and versions of numpy and scipy: all randomness is seeded.
"""

from __future__ import annotations

import argparse
import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import motion_actions as actions
import motion_crossing as crossing
import motion_gestures as gestures
import numpy as np
from motion_body import PERFORMER, Performer, performer
from motion_clip import Clip
from motion_time import FPS

RESULT = Path(__file__).resolve().parents[1] / "src" / "retarget" / "motion" / "library.npz"
CLIPS: dict[str, Callable[[Performer], Clip]] = {
    "demo": gestures.demo,
    "walk": actions.walk,
    "run": actions.run,
    "jump": actions.jump,
    "turn": actions.turn,
    "wave": actions.wave,
    "hands_on_hips": gestures.hands_on_hips,
    "hand_to_shoulder": gestures.hand_to_shoulder,
    "hand_on_belly": gestures.hand_on_belly,
    "hands_behind_head": gestures.hands_behind_head,
    "arms_crossed": gestures.arms_crossed,
    "clap": gestures.clap,
    "legs_crossed": crossing.legs_crossed,
    "squat_hands_on_knees": gestures.squat_hands_on_knees,
}
STEPS = 32767
"""Quaternion components are stored as integers: 1 is this many."""


def clip_arrays(clip: Clip) -> dict[str, np.ndarray]:
    """One clip as it is stored. Contacts come as (start, end) in seconds and a pair of names each."""
    return {
        f"{clip.name}/rotations": np.round(clip.rotations * STEPS).astype(np.int16),
        f"{clip.name}/hips": clip.hips.astype(np.float32),
        f"{clip.name}/contact_times": np.array([c[:2] for c in clip.contacts], dtype=np.float32).reshape(-1, 2),
        f"{clip.name}/contact_parts": np.array([c[2:] for c in clip.contacts], dtype="U16").reshape(-1, 2),
    }


def write(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """An npz whose bytes depend on the arrays alone (numpy's own carries the time of writing)."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(array, order="C"), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(2020, 1, 1, 0, 0, 0))
            entry.compress_type, entry.external_attr, entry.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
            archive.writestr(entry, buffer.getvalue(), compresslevel=9)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", metavar="CLIP", help=f"which to make: {', '.join(CLIPS)} (default: all)")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.clips) - set(CLIPS))
    if unknown:
        parser.error(f"no such clip: {', '.join(unknown)}; there are {', '.join(CLIPS)}")
    kept: dict[str, np.ndarray] = {}
    if arguments.clips and arguments.output.exists():
        with np.load(arguments.output) as archive:
            kept = {name: archive[name] for name in archive.files}
    body = performer()
    made = {}
    for name in arguments.clips or CLIPS:
        made |= clip_arrays(CLIPS[name](body))
        print(f"{name}: {len(made[f'{name}/hips']) / FPS:.1f} s")
    arrays = {"performer": np.array(PERFORMER), "joint_names": np.array(body.names), "fps": np.array(FPS)}
    for clip in CLIPS:
        for source in (made, kept):
            found = {name: array for name, array in source.items() if name.startswith(clip + "/")}
            if found:
                arrays |= found
                break
    write(arguments.output, arrays)
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
