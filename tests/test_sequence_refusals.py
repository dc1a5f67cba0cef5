"""Commands that follow joints meet a mesh sequence: one line that says what can be done with it, and nothing is written."""

import pytest
from made_motions import actor

from retarget.body.skinning import bake
from retarget.io import save, save_sequence
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A character with a clip, and its surface as an archive and as a folder."""
    folder = tmp_path_factory.mktemp("sequences")
    motion = cut(embedded_motion("wave"), 0.5, 0.7)
    save(folder / "man.glb", actor().character, [motion])
    for name in ("wave.npz", "wave"):
        save_sequence(folder / name, bake(actor().character, motion))
    return folder


@pytest.mark.parametrize("sequence", ["wave.npz", "wave"])
@pytest.mark.parametrize(
    "words",
    [
        "map SEQUENCE man.glb -o OUT/m.toml",
        "map man.glb SEQUENCE -o OUT/m.toml",
        "view SEQUENCE",
        "view man.glb SEQUENCE",
        "report SEQUENCE man.glb -o OUT/r.html",
        "report man.glb SEQUENCE -o OUT/r.html",
        "evaluate SEQUENCE --source man.glb",
        "evaluate man.glb --source SEQUENCE",
        "repair SEQUENCE -o OUT/r.glb",
        "run man.glb SEQUENCE -o OUT/r.glb",
    ],
)
def test_one_line_says_what_can_be_done(files, tmp_path, monkeypatch, command, words, sequence):
    monkeypatch.chdir(files)
    code, out, err = command(*words.replace("SEQUENCE", sequence).replace("OUT", str(tmp_path)).split())
    assert code == 2 and out == "" and err.count("\n") == 1, (code, out, err)
    assert f"{sequence}: " in err and "mesh sequence" in err
    assert "`retarget run` takes it as a motion, `info` and `picture` show it, `convert` writes it in other formats" in err
    assert list(tmp_path.iterdir()) == []
