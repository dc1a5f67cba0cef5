"""Run by the mutation test: converts many FBX files in one process, as `fbx_child.py` does one.

    python fbx_many.py FOLDER FIRST LAST

Converts FOLDER/n.fbx to FOLDER/n.glb and prints n when it is done with it, so that the caller can go on behind a file that
took the process down.
"""

import os
import sys
from pathlib import Path

from retarget.io import child, fbx_child

folder, first, last = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
child.limit()
for number in range(first, last):
    try:
        fbx_child.work(str(folder / f"{number}.fbx"), str(folder / f"{number}.glb"))
    except Exception:
        (folder / f"{number}.glb").unlink(missing_ok=True)
    print(number, flush=True)
os._exit(0)
