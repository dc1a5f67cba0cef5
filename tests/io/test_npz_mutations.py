"""Damaged archives, from without (the zip) and from within (arrays zipped again): read, or refused in one line."""

import io
import os
import random
import zipfile

import numpy as np
import pytest
from file_faults import mutated
from smpl_maker import amass, angles
from test_smpl_model import tiny

from retarget.errors import RetargetError
from retarget.io import load

MUTATIONS = int(os.environ.get("RETARGET_MUTATIONS", 1000))
WORDS = [b"'<f8'", b"'|O'", b"(3,)", b"()", b"(99999999999,", b"True", b"'>i2'", b"'<U9'", b"1L"]


def members(path):
    with zipfile.ZipFile(path) as file:
        return {info.filename: file.read(info) for info in file.infolist()}


def zipped(contents, compression):
    raw = io.BytesIO()
    with zipfile.ZipFile(raw, "w", compression) as file:
        for name, content in contents.items():
            file.writestr(name, content)
    return raw.getvalue()


@pytest.mark.parametrize("kind", ["whole", "parts", "on a model", "model"])
def test_damaged_archives_are_read_or_refused(tmp_path, kind):
    poses = angles(5, 22, left_knee=[0.4, 0, 0])
    rng = random.Random(kind)
    model = tmp_path / "model.npz"
    np.savez(model, **tiny())
    if kind == "parts":
        flat = poses.reshape(5, -1)
        np.savez(tmp_path / "seed.npz", root_orient=flat[:, :3], pose_body=flat[:, 3:], transl=np.zeros((5, 3)), fps=30)
    elif kind == "model":
        np.savez(tmp_path / "seed.npz", **tiny())
    else:
        amass(tmp_path / "seed.npz", poses, np.zeros((5, 3)))
    contents, path = members(tmp_path / "seed.npz"), tmp_path / "damaged.npz"
    options = {"smpl_model": model} if kind == "on a model" else {}
    outcomes = {"read": 0, "refused": 0}
    for number in range(MUTATIONS // 4):
        compression = rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
        if number % 3:
            name = rng.choice(list(contents))
            raw = zipped(contents | {name: mutated(contents[name], rng, WORDS)}, compression)
        else:
            raw = mutated(zipped(contents, compression), rng, WORDS)
        path.write_bytes(raw)
        try:
            asset = load(path, **options)
            if asset.clips:
                asset.motion(0)
            outcomes["read"] += 1
        except RetargetError as error:
            assert "\n" not in str(error) and "damaged.npz" in str(error)
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 0.01 * MUTATIONS, outcomes
