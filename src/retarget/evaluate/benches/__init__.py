"""Benches by name; each module has `run(quick, tell) -> report` with a flat `summary`, `rows`, `environment` and `lines`."""

from __future__ import annotations

import importlib
from types import ModuleType

BENCHES = {
    "contact": "retarget.evaluate.benches.contact",
    "formats": "retarget.evaluate.benches.formats",
    "interaction": "retarget.evaluate.benches.interaction",
    "skeletal": "retarget.evaluate.benches.skeletal",
}


def load_bench(name: str) -> ModuleType:
    return importlib.import_module(BENCHES[name])
