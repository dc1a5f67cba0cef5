"""Array shapes named in the types are checked while the tests run (and only then)."""

import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

import retarget.contact.kernels
import retarget.contact.pair_kernels
import retarget.contact.skin_kernels
import retarget.motion.limit_kernels  # noqa: F401
import retarget.evaluate.reference.ray_parity  # noqa: F401  (compiled loops: numba cannot take functions that are checked)

hook = install_import_hook("retarget", "beartype.beartype")

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real files; tests that want it are skipped where it is absent."""
    if not DATA.is_dir():
        pytest.skip("real files are not at hand")
    return DATA


@pytest.fixture(scope="session")
def data_or_none() -> Path | None:
    """The folder of real files, None where it is absent."""
    return DATA if DATA.is_dir() else None
