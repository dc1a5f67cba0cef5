"""Array shapes named in the types are checked while the tests run (and only then)."""

import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

import retarget.contact.kernels
import retarget.contact.pair_kernels
import retarget.contact.part_field_kernels
import retarget.contact.skin_kernels
import retarget.evaluate.reference.ray_parity  # noqa: F401  (compiled loops: numba cannot take functions that are checked)
import retarget.geometry.capture_kernels
import retarget.geometry.closest_kernels
import retarget.geometry.turn_kernels
import retarget.methods.interaction.part_equation_kernels
import retarget.methods.scan.cloud_kernels
import retarget.methods.scan.fit_kernels
import retarget.motion.limit_kernels
import retarget.rig.fit_kernels
import retarget.train.scan_kernels  # noqa: F401

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


@pytest.fixture
def own_child(monkeypatch, tmp_path):
    """Puts a script in the place of a module that runs in a process of its own: `own_child("fbx_child", text)`."""
    import shutil

    from retarget.io import child

    folder = tmp_path / "packages" / "retarget" / "io"

    def put(module, text):
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(child.__file__, folder / "child.py")
        (folder / f"{module}.py").write_text(text)
        monkeypatch.setattr(child, "PACKAGES", folder.parents[1])

    return put


@pytest.fixture
def interruptible():
    """What the test starts ends on Ctrl-C. Whatever a shell puts into the background ignores it, and so would all that a test run
    started from there."""
    import signal

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def command(monkeypatch, capfd):
    """Runs the program as its entry point does; returns exit code, standard output and standard error."""
    import sys

    from retarget import cli

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["retarget", *map(str, words)])
        code = 0
        try:
            cli.main()
        except SystemExit as leaving:
            code = leaving.code or 0
        out, err = capfd.readouterr()
        return code, out, err

    return run
