"""Networks of the package, as ONNX files that tell what they are: `network` and `version` among their properties."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from retarget.errors import FileError


def open_network(path: Path, kind: str, version: str) -> Any:
    """A session for a network's file, on one thread. Raises `FileError` where it is missing, damaged, another network or another
    version."""
    import onnxruntime

    if not path.is_file():
        raise FileError(path, "the network's weights are not there; install the package again")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime has a class for every fault, without a common one
        raise FileError(path, f"no readable ONNX network ({type(error).__name__}); install the package again") from error
    told = session.get_modelmeta().custom_metadata_map
    if told.get("network") != kind:
        raise FileError(path, f"holds the network {told.get('network', '?')!r} instead of {kind!r}")
    if told.get("version") != version:
        raise FileError(path, f"weights of version {told.get('version', '?')}, but this program needs version {version}")
    return session
