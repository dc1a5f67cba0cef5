"""How often the required joints are found, against the truth file of the tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from retarget.correspond.joints import REQUIRED_JOINTS, match_humanoid, scrambled
from retarget.errors import MatchError, RetargetError
from retarget.evaluate.cases import REPOSITORY, data_folder, real_files
from retarget.io import load

TRUTH = REPOSITORY / "tests" / "correspond" / "joint_truth.toml"


def truths() -> Iterator[tuple[Path, dict[str, str]]]:
    """Files at hand with the hand-checked joint name of every canonical joint."""
    try:
        import tomllib
    except ModuleNotFoundError:  # Python 3.10
        import tomli as tomllib

    if not TRUTH.is_file() or data_folder() is None:
        return
    entries = tomllib.loads(TRUTH.read_text())
    for path in real_files(".bvh", ".glb", ".gltf"):
        name = path.relative_to(data_folder()).as_posix()
        if name in entries:
            yield path, entries[name]


def match_rates() -> dict[str, float | None]:
    """Share of files whose required joints are all right, as they are and with every name scrambled."""
    right, right_scrambled, total = 0, 0, 0
    for path, truth in truths():
        skeleton = load(path).character.skeleton
        total += 1
        right += _all_right(skeleton, skeleton, truth)
        right_scrambled += _all_right(scrambled(skeleton, seed=total), skeleton, truth)
    if not total:
        return {"match_rate": None, "match_rate_scrambled": None}
    return {"match_rate": right / total, "match_rate_scrambled": right_scrambled / total}


def _all_right(skeleton, named, truth: dict[str, str]) -> bool:
    try:
        found = match_humanoid(skeleton).joints
    except MatchError:
        return not truth
    except RetargetError:
        return False
    return all(
        found.get(name) is not None and named.names[found[name]] == truth[name] for name in REQUIRED_JOINTS if name in truth
    )
