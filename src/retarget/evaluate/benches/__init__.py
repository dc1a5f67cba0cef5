"""Benches by name; each module has `run(quick, tell) -> report` with a flat `summary`, `rows`, `environment` and `lines`.

Those in `PICTURED` take `show` too: called with each row of a sheet (label, mesh, vertices, captions).
"""

from __future__ import annotations

import importlib
from types import ModuleType

BENCHES = {
    "contact": "retarget.evaluate.benches.contact",
    "formats": "retarget.evaluate.benches.formats",
    "interaction": "retarget.evaluate.benches.interaction",
    "interaction-learned": "retarget.evaluate.benches.interaction_learned",
    "rig-transfer": "retarget.evaluate.benches.rig_transfer",
    "scan": "retarget.evaluate.benches.scan",
    "shape-transfer": "retarget.evaluate.benches.shape_transfer",
    "skeletal": "retarget.evaluate.benches.skeletal",
}
PICTURED = ("rig-transfer", "scan", "shape-transfer")


def load_bench(name: str) -> ModuleType:
    return importlib.import_module(BENCHES[name])
