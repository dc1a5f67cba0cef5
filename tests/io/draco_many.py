"""Run by the mutation test: decodes many pieces of Draco data in one process, as `draco_child.py` does one file's.

    python draco_many.py FOLDER FIRST LAST

Prints 'read' or 'refused' for each FOLDER/n.in, so that the caller can go on behind one that took the process down.
"""

import os
import sys
from pathlib import Path

from retarget.io import child, draco_child

folder, first, last = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
child.limit()
for number in range(first, last):
    try:
        draco_child.work(str(folder / f"{number}.in"), str(folder / "out"))
        print("read", flush=True)
    except Exception:
        print("refused", flush=True)
os._exit(0)
