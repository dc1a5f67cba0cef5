"""Seconds and memory of rigging one mesh, in a process of its own, so that nothing else is counted."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from retarget.errors import RetargetError
from retarget.evaluate.remeshed import collapsed
from retarget.evaluate.rig_cases import rig_case
from retarget.geometry.resample import Surface

SEED = 0
"""The case whose body is rigged."""
LONGEST = 300
"""Seconds that are waited."""
CHILD = """
import json, sys, time
import numpy as np
from retarget.character import Mesh
from retarget.rig.rigging import rig
from retarget.rig.templates import human_template
with np.load(sys.argv[1], allow_pickle=False) as archive:
    mesh = Mesh(archive["vertices"], archive["faces"])
start = time.perf_counter()
human_template()
ready = time.perf_counter()
rig(mesh)
done = time.perf_counter()
try:
    import resource
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform != "darwin" else 1024**2)
except ImportError:  # Windows
    peak = None
print(json.dumps({"template_seconds": ready - start, "seconds": done - ready, "peak_mb": peak}))
"""


def rigging_cost(vertices: int) -> dict[str, float | None]:
    """`template_seconds` (once a process), `seconds` of `rig()` and `peak_mb` (None where the system does not tell) for a body
    of about so many vertices. Raises `RetargetError` where the process fails."""
    case = rig_case(SEED)
    body = Surface(case.posed, case.character.mesh.faces)
    mesh, _ = collapsed(body, vertices, np.random.default_rng(SEED))
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        path = Path(folder) / "mesh.npz"
        np.savez(path, vertices=mesh.vertices, faces=mesh.faces)
        done = subprocess.run([sys.executable, "-c", CHILD, str(path)], capture_output=True, text=True, timeout=LONGEST)
    if done.returncode:
        raise RetargetError(f"rigging {vertices} vertices failed: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return json.loads(done.stdout)
