"""Load a motion file and a character file, retarget, save.

    python examples/retarget_files.py OUT_FOLDER [MOTION.bvh CHARACTER.glb]

Without files of your own an embedded walk is written as BVH and a heavy embedded body as GLB, and these are used.
"""

import sys
from pathlib import Path

from retarget import cast, embedded_motion, human, load, prepare, save


def main(folder: Path, motion_file: Path, character_file: Path) -> None:
    source, target = load(motion_file), load(character_file)
    motion = source.motion()  # the first clip; source.motion("name") takes another
    production = prepare(cast(source, motion=motion), cast(target))  # joints matched, units and axes settled
    result = production(motion)
    output = folder / f"{character_file.stem}_{motion_file.stem}.glb"
    result.save(output)  # the character as it was read, with one clip more, in its file's own unit and axes
    for note in result.stats["notes"]:
        print(note)
    print(f"{output}: {len(result.motion)} frames, status {result.status}")


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
    folder.mkdir(parents=True, exist_ok=True)
    files = [Path(each) for each in sys.argv[2:4]]
    if len(files) < 2:
        files = [folder / "walk.bvh", folder / "heavy.glb"]
        body, walk = human(weight=1.0), embedded_motion("walk")
        save(files[0], body, [walk])
        save(files[1], body, [])
    main(folder, *files)
