"""How often the required joints are found, against the hand-checked truth file of the tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path

from retarget.character import Skeleton
from retarget.correspond.joints import REQUIRED_JOINTS, match_humanoid, scrambled
from retarget.errors import RetargetError
from retarget.evaluate.cases import REPOSITORY, data_folder, real_files
from retarget.io import MOTION_SUFFIXES, load

TRUTH = REPOSITORY / "tests" / "correspond" / "joint_truth.toml"
Truth = Mapping[str, "str | list[str]"]


def truths() -> Iterator[tuple[Path, Truth]]:
    """Files at hand with the right joint, or the equally right ones, of every canonical joint."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    if not TRUTH.is_file() or data_folder() is None:
        return
    entries = tomllib.loads(TRUTH.read_text(encoding="utf-8"))["skeleton"]
    for path in real_files(*MOTION_SUFFIXES):
        where = path.relative_to(data_folder()).as_posix()
        for entry in entries:
            if any(fnmatch(where, pattern) for pattern in entry["files"]):
                yield path, entry["joints"]


def match_rates() -> dict[str, float | None]:
    """Share of files whose required joints are all right, as they are and with every name scrambled."""
    right, right_scrambled, total = 0, 0, 0
    for path, truth in truths():
        total += 1
        try:
            skeleton = load(path).character.skeleton
        except RetargetError:  # a file that cannot be read is a file that is not matched
            continue
        right += _all_right(skeleton, skeleton.names, truth)
        right_scrambled += _all_right(scrambled(skeleton, seed=total), skeleton.names, truth)
    if not total:
        return {"match_rate": None, "match_rate_scrambled": None}
    return {"match_rate": right / total, "match_rate_scrambled": right_scrambled / total}


def _all_right(skeleton: Skeleton, names: tuple[str, ...], truth: Truth) -> bool:
    """Whether every required joint that the truth knows is found; `names` are the real ones, in the same order."""
    try:
        found = match_humanoid(skeleton).joints
    except RetargetError:
        return False
    for canonical in REQUIRED_JOINTS:
        if canonical in truth:
            right = truth[canonical] if isinstance(truth[canonical], list) else [truth[canonical]]
            if canonical not in found or names[found[canonical]] not in right:
                return False
    return True
