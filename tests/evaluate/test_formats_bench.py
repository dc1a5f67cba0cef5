"""The formats bench finds what it should find: files that come back changed, and readers that fail."""

import pytest

from retarget.evaluate.benches import formats
from retarget.evaluate.damage_run import Outcomes


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(formats, "FEW", 20)
    monkeypatch.setattr(formats, "real_files", lambda *suffixes: iter(()))
    monkeypatch.setattr(formats, "foreign_actors", lambda: iter(()))
    monkeypatch.setattr(formats, "FORMATS", {"gltf": (".glb", ".gltf"), "vrm": (".vrm",)})


def test_what_is_written_comes_back(small):
    report = formats.run(quick=True)
    summary = report["summary"]
    assert summary["gltf_round_trip_mm"] < 0.1 and summary["vrm_round_trip_mm"] < 0.1
    assert summary["mutations"] == 20 and summary["crashes"] == summary["hangs"] == 0
    assert summary["validator_errors"] in (None, 0)
    assert {row["format"] for row in report["rows"]} >= {"bvh", "glb", "gltf", "vrm", "morph", "amass", "smpl", "sequence", "obj", "ply", "fbx", "draco", "meshopt"}


def test_what_comes_back_changed_is_seen(small, monkeypatch):
    from dataclasses import replace

    real = formats.save
    monkeypatch.setattr(
        formats, "save", lambda path, body, motions: real(path, body, [replace(m, translations=m.translations + 0.001) for m in motions])
    )  # fmt: skip
    monkeypatch.setattr(formats, "_damage", lambda *_: iter([("obj", Outcomes(1, 0, 2, 1, 0, ("3: hangs",)))]))
    report = formats.run(quick=True)
    summary = report["summary"]
    assert summary["gltf_round_trip_mm"] == pytest.approx(1000 * 0.001 * 3**0.5, rel=0.05)
    assert summary["crashes"] == 2 and summary["hangs"] == 1 and "obj 3: hangs" in report["lines"]
