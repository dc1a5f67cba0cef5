"""The Khronos glTF validator, where Node and its package are at hand."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

from retarget.evaluate.cases import REPOSITORY

PROGRAM = REPOSITORY / "tools" / "validate_gltf.mjs"
NOT_INSTALLED = 3


def errors_found(paths: list[Path]) -> list[list[str]] | None:
    """The errors of each file; None where the validator is not at hand."""
    if not paths or shutil.which("node") is None or not PROGRAM.exists():
        return None
    run = subprocess.run(["node", str(PROGRAM), *map(str, paths)], capture_output=True, text=True, timeout=600)
    if run.returncode == NOT_INSTALLED:
        return None
    run.check_returncode()
    return [json.loads(line) for line in run.stdout.splitlines()]
