"""The contacts file: what is written is read back, and every mistake is one line with its place."""

import re

import numpy as np
import pytest

from retarget.contact.contact_file import GROUPS, ContactEdit, ContactEdits, read_contacts, write_contacts
from retarget.contact.contact_list import ContactEvent
from retarget.errors import FileError, RetargetError

EVENTS = [
    ContactEvent(("leftHand", "abdomen"), 0.5, 2.25, 12, -0.01, 0.9),
    ContactEvent(("rightHand", "head"), 1.0, 1.0, 3, 0.01, 0.2),
]


def read(folder, text):
    (folder / "contacts.toml").write_text(text)
    return read_contacts(folder / "contacts.toml")


def test_what_is_written_is_read_back_and_edits_nothing(tmp_path):
    write_contacts(tmp_path / "c.toml", EVENTS)
    assert read_contacts(tmp_path / "c.toml") == ContactEdits(
        tuple(ContactEdit(event.parts, event.start, event.end) for event in EVENTS)
    )
    write_contacts(tmp_path / "none.toml", [])
    assert read_contacts(tmp_path / "none.toml") == ContactEdits()


def test_everything_a_user_may_write(tmp_path):
    found = read(
        tmp_path,
        """
        [strength]
        leftArm = 0.5
        girth = 1
        [[contact]]
        parts = ["head", "rightHand"]
        does = "add"
        gap = 0.02
        strength = 10
        end = 2
        """,
    )
    assert found.edits == (ContactEdit(("head", "rightHand"), None, 2.0, "add", 10.0, 0.02),)
    assert (found.kind("girth"), found.kind("pose"), found.of_pair(("head", "leftHand"))) == (1.0, 1.0, 0.5)
    assert found.of_pair(("head", "rightHand")) == 1.0, "lines of kinds speak of no part"
    again = read_contacts(tmp_path / "contacts.toml")
    assert again == found and hash(again) == hash(found), "a setting of a method is hashable"


def test_an_entry_may_be_for_one_clip(tmp_path):
    edits = read(tmp_path, entry() + "\n" + entry(clip='"walk"', does='"release"'))
    assert [edit.clip for edit in edits.edits] == [None, "walk"]
    assert [len(edits.of_clip(name).edits) for name in ("walk", "run", "")] == [2, 1, 1]


@pytest.mark.parametrize(
    ("made", "problem"),
    [
        (lambda: ContactEdit(("leftHnd", "head")), "part 'leftHnd' is not in the body; nearest: 'leftHand'"),
        (lambda: ContactEdit(("head", "head")), "cannot touch itself"),
        (lambda: ContactEdit(("leftHand", "head"), 2.0, 1.0), "start must not be after end; received 2 and 1"),
        (lambda: ContactEdit(("leftHand", "head"), does="hold"), "does must be one of auto, keep, release, add"),
        (lambda: ContactEdit(("leftHand", "head"), strength=float("nan")), "strength must be from 0 to 10; received nan"),
        (lambda: ContactEdit(("leftHand", "head"), gap=0.1), "gap goes with does"),
        (lambda: ContactEdits(strength=(("leftArn", 1.0),)), "name 'leftArn'.*nearest: 'leftArm'"),
        (lambda: ContactEdits(strength=(("arms", 11.0),)), "arms must be from 0 to 10; received 11"),
    ],
)
def test_entries_made_in_code_are_checked_like_those_of_files(made, problem):
    with pytest.raises(RetargetError, match=problem):
        made()


def entry(**changes):
    rows = {"parts": '["leftHand", "head"]', "start": "1.0", "end": "2.0"} | changes
    return "[[contact]]\n" + "\n".join(f"{key} = {value}" for key, value in rows.items())


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[[contact]]\nparts = @", r"not valid TOML.*line 2"),
        ("[contacts]", r"table 'contacts' is not in .*nearest: 'contact'"),
        ("contact = 3", r"contact: entries must be tables"),
        ("contact = [3]", r"contact: entries must be tables"),
        ("strength = 3", r"strength must be a table"),
        ("[strength]\nleftArn = 1", r"\[strength\]: name 'leftArn'.*nearest: 'leftArm'.*arms, legs, hands, .*trunk"),
        ("[strength]\narms = -1", r"\[strength\]: arms must be from 0 to 10; received -1"),
        ("[strength]\narms = nan", r"arms must be from 0 to 10; received nan"),
        ("[strength]\narms = true", r"arms must be a number; received True"),
        (entry(does='"hold"'), r"\[\[contact\]\] 1: does must be one of auto, keep, release, add; received 'hold'"),
        (entry(does="[1]"), r"does must be one of"),
        (entry(part="1"), r"key 'part' is not in .*nearest: 'parts'"),
        (entry(parts='["leftHnd", "head"]'), r"part 'leftHnd' is not in .*nearest: 'leftHand'"),
        (entry(parts='["leftHand"]'), r"parts must be two names"),
        (entry(parts="3"), r"parts must be two names"),
        (entry(clip="3"), r"\[\[contact\]\] 1: clip must be the name of one; received 3"),
        (entry(parts='["head", "head"]'), r"cannot touch itself"),
        (entry() + "\n" + entry(start="3.0"), r"\[\[contact\]\] 2: start must not be after end; received 3 and 2"),
        (entry(start='"1"'), r"start must be a number"),
        (entry(end="inf"), r"end must be from 0 to 1e\+06; received inf"),
        (entry(start="-0.5"), r"start must be from 0"),
        (entry(strength="11"), r"strength must be from 0 to 10; received 11"),
        (entry(gap="0.1"), r"gap goes with"),
        (entry(gap="-0.1", does='"add"'), r"gap must be from 0"),
        (entry(start="1" + "0" * 400), r"start must be from 0.*received 1000+\.\.\."),
        (entry(start="1" + "0" * 5000), r"not valid TOML|start must be from 0"),
        (entry(start="0x" + "f" * 5000), r"received a number too large to print|received 0|received \d+\.\.\."),
        ("#" * 1_000_001, r"has 1000001 bytes, more than"),
    ],
)
def test_mistakes_are_one_line_with_path_and_place(tmp_path, text, problem):
    with pytest.raises(FileError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "contacts.toml")) and "\n" not in message
    assert re.search(problem, message), message


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(FileError, match="cannot be read"):
        read_contacts(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"# \xff")
    with pytest.raises(FileError, match="byte 2: is not UTF-8"):
        read_contacts(tmp_path / "binary.toml")


def test_damaged_files_are_refused_or_read_but_never_crash(tmp_path):
    write_contacts(tmp_path / "c.toml", EVENTS)
    lines = (tmp_path / "c.toml").read_text().splitlines()
    random = np.random.default_rng(0)
    values = ["[]", '"x"', "-1", "nan", "{}", "", "1979-05-27", "9" * 400, "true", "[[1]]"]
    outcomes = set()
    for _ in range(150):
        damaged = list(lines)
        line = int(random.integers(len(damaged)))
        if random.random() < 0.5:
            del damaged[line]
        else:
            damaged[line] = damaged[line].split("=")[0] + "= " + values[random.integers(len(values))]
        try:
            read(tmp_path, "\n".join(damaged))
            outcomes.add("read")
        except FileError:
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}


def test_groups_hold_parts_that_exist():
    from retarget.contact.parts import PARTS

    assert all(set(parts) <= set(PARTS) for parts in GROUPS.values())
