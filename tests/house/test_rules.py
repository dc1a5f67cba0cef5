"""The rules of docs/architecture.md, read from the source."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src" / "retarget"
FILES = sorted(SOURCE.rglob("*.py"))

# Imports go down only, in this one line. The front door and the command line stand above everything.
LINE = (
    "errors progress character body geometry io correspond contact rig motion methods casting performing retargeting live batch evaluate view train commands_train commands_evaluate commands_view commands_contacts commands commands_run commands_rig commands_repair commands_batch commands_sequence commands_convert commands_capture commands_scan cli_options cli_files cli_rig cli_train cli_capture cli_scan cli_view cli"
).split()
HEAVY = {"robust_laplacian", "potpourri3d", "fast_simplification", "cholespy", "scipy", "PIL", "onnxruntime", "viser", "matplotlib", "bpy", "warp", "numba", "trimesh", "torch", "pxr", "pyFM"}
COMPILED = {"retarget.contact.kernels", "retarget.contact.pair_kernels", "retarget.contact.part_field_kernels", "retarget.contact.skin_kernels", "retarget.evaluate.reference.ray_parity", "retarget.geometry.capture_kernels", "retarget.geometry.closest_kernels", "retarget.geometry.turn_kernels", "retarget.methods.interaction.part_equation_kernels", "retarget.methods.scan.cloud_kernels", "retarget.methods.scan.fit_kernels", "retarget.motion.limit_kernels", "retarget.rig.fit_kernels", "retarget.train.scan_kernels"}
"""Modules of compiled loops: they import numba at their top, so nothing may import them at its own."""
NETWORKS = {
    "retarget.evaluate.reference.interaction_networks", "retarget.evaluate.reference.residual_network",
    "retarget.evaluate.reference.scan_networks",
}
"""Modules of networks outside `train`: they import torch at their top, so only `train` may import them at its own."""
CHILDREN = {"retarget.io.blender_child", "retarget.io.alembic_child"}
"""Programs for another interpreter: nothing imports them."""
BANNED_NAMES = {"utils", "helpers", "common", "manager"}


def room(path: Path) -> str:
    parts = path.relative_to(SOURCE).parts
    return parts[0] if len(parts) > 1 else path.stem


def imported(tree: ast.AST):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_go_down(path):
    if room(path) in ("__init__", "__main__"):
        return
    own = LINE.index(room(path))
    for module in imported(ast.parse(path.read_text())):
        if module.startswith("retarget."):
            other = module.split(".")[1]
            assert other in LINE, f"{path.name} imports {module}, which is not in the line"
            assert LINE.index(other) <= own, f"{room(path)} must not import {other}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_a_method_never_imports_another(path):
    if room(path) != "methods" or path.stem == "__init__":
        return
    for module in imported(ast.parse(path.read_text())):
        own = ".".join(("retarget", *path.relative_to(SOURCE).parent.parts)) + "."  # a method in several files has a folder
        shared = module == "retarget.methods.base" or (own != "retarget.methods." and module.startswith(own))
        assert not module.startswith("retarget.methods.") or shared, module


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_nothing_heavy_at_module_level(path):
    tree = ast.parse(path.read_text())
    top = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
    if f"retarget.{'.'.join(path.relative_to(SOURCE).with_suffix('').parts)}" in COMPILED | CHILDREN | NETWORKS:
        return
    for node in top:
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
        for name in names:
            root = name.split(".")[0]
            assert root not in HEAVY or room(path) == "train", f"{path.name} imports {root} at its top"
            members = {name} | {f"{name}.{alias.name}" for alias in node.names if isinstance(node, ast.ImportFrom)}
            assert not members & COMPILED, f"{path.name} imports compiled loops at its top"
            assert not members & NETWORKS or room(path) == "train", f"{path.name} imports torch by a network at its top"
            assert not members & CHILDREN, f"{path.name} imports a program of another process"


def test_torch_only_where_networks_are_trained():
    for path in FILES:
        roots = {module.split(".")[0] for module in imported(ast.parse(path.read_text()))}
        if "torch" in roots:
            assert room(path) == "train" or "reference" in path.parts, path


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_files_are_small_and_named_for_what_they_hold(path):
    assert len(path.read_text().splitlines()) <= 420, f"{path.name} is too long: split it"
    assert path.stem not in BANNED_NAMES


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_every_module_and_public_class_says_what_it_is(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree) or not tree.body, f"{path.name} has no docstring"
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{path.name}: {node.name}"


def fresh(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_the_package_loads_nothing_heavy():
    loaded = fresh("import sys, retarget; print(' '.join(sys.modules))").split()
    assert not HEAVY & {name.split(".")[0] for name in loaded}


def test_help_does_not_even_load_numpy():
    code = "import sys\nfrom typer.testing import CliRunner\nimport retarget.cli as c\nassert CliRunner().invoke(c.app, ['--help']).exit_code == 0\nprint(' '.join(sys.modules))"
    assert "numpy" not in fresh(code).split()


def test_public_names_resolve_and_have_docstrings():
    import retarget

    for name in retarget.__all__:
        value = getattr(retarget, name)
        assert isinstance(value, (str, dict)) or value.__doc__, name
