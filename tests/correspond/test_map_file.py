"""Map files: written to be read by people, read back as written, refused with words."""

import pytest
from humanoid_rigs import renamed, rig

from retarget.correspond.joints import humanoid_from_names, match_humanoid
from retarget.correspond.map_file import read_map, write_map
from retarget.errors import FileError


def test_a_written_map_reads_back_to_the_same_match(tmp_path):
    (source, _), (target, _) = rig("mixamo"), rig("smpl")
    matches = match_humanoid(source), match_humanoid(target)
    write_map(tmp_path / "map.toml", matches[0], source, matches[1], target)
    tables = read_map(tmp_path / "map.toml")
    for table, skeleton, human in zip(("source", "target"), (source, target), matches):
        assert humanoid_from_names(skeleton, tables[table]).joints == human.joints
    text = (tmp_path / "map.toml").read_text(encoding="utf-8")
    assert "# leftThumbDistal" in text.split("[target]")[1]  # what the other side has is shown as a comment
    assert "# 0." in text or "# 1." in text


def test_names_survive_whatever_they_hold(tmp_path):
    skeleton, truth = rig("mixamo")
    odd = {truth["head"]: 'he said "hi" \\ # not a comment', truth["hips"]: "Hüfte\t= 腰\n\x07"}
    skeleton = renamed(skeleton, odd)
    human = match_humanoid(skeleton)
    write_map(tmp_path / "map.toml", human, skeleton, human, skeleton)
    assert humanoid_from_names(skeleton, read_map(tmp_path / "map.toml")["source"]).joints == human.joints


def test_missing_tables_and_empty_names_are_allowed(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('[target]\nhead = "Kopf"\njaw = ""\n', encoding="utf-8")
    assert read_map(path) == {"source": {}, "target": {"head": "Kopf"}}
    path.write_text("", encoding="utf-8")
    assert read_map(path) == {"source": {}, "target": {}}


@pytest.mark.parametrize(
    "text, words",
    [
        ("[target\n", "not valid TOML"),
        ('[targets]\nhead = "a"\n', "'targets' is not in a map file; nearest: 'target'"),
        ('[target]\nheads = "a"\n', r"\[target\]: humanoid joint 'heads' is not in VRM 1.0; nearest: 'head'"),
        ("[target]\nhead = 3\n", "head must be a joint name in quotes; received 3"),
        ("target = 3\n", r"target must be a table, written \[target\]"),
    ],
)
def test_mistakes_are_named(tmp_path, text, words):
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match=words) as caught:
        read_map(path)
    assert "map.toml" in str(caught.value)


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(FileError, match="cannot be read"):
        read_map(tmp_path / "absent.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match="not UTF-8"):
        read_map(tmp_path / "bytes.toml")


def test_nothing_is_left_where_writing_fails(tmp_path):
    skeleton, _ = rig("smpl")
    human = match_humanoid(skeleton)
    with pytest.raises(FileError, match="cannot be written"):
        write_map(tmp_path / "absent" / "map.toml", human, skeleton, human, skeleton)
    (tmp_path / "taken").mkdir()
    with pytest.raises(FileError, match="cannot be written"):
        write_map(tmp_path / "taken", human, skeleton, human, skeleton)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["taken"]
