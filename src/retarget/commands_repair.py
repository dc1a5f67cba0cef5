"""What `retarget repair` does: take self-penetration and foot slide out of the clips of one character."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from retarget.casting import Hints, cast
from retarget.character import Provenance
from retarget.commands_run import correction_lines
from retarget.errors import FileError, RetargetError
from retarget.io import check_output, load
from retarget.methods import Interaction, save_results
from retarget.progress import progress_line
from retarget.retargeting import prepare


@dataclass(frozen=True)
class Repair:
    """What `retarget repair` was asked."""

    file: Path
    output: Path
    clip: str | None = None
    foot_lock: bool = True
    map_file: Path | None = None
    up: str | None = None
    unit: float | None = None


def repair_file(order: Repair, progress: bool = False) -> dict[str, Any]:
    """Repair one clip or all and write the character with the repaired clips behind its own. Raises `RetargetError`."""
    check_output(order.output)
    if order.output.resolve() == order.file.resolve():
        raise FileError(order.output, "would replace the file that is repaired; name another")
    joints = None
    if order.map_file is not None:
        from retarget.correspond.map_file import read_map

        joints = read_map(order.map_file)["target"] or None
    asset = load(order.file)
    asset.expect_joints()
    if asset.character is None or asset.character.skin is None:
        raise FileError(order.file, "has no skinned character; only a body with a surface can penetrate itself")
    if not asset.clips:
        raise FileError(order.file, "holds no animation to repair")
    names = [clip.name for clip in asset.clips]
    if order.clip is not None:
        asset.motion(order.clip)  # raises, naming the nearest
    chosen = range(len(names)) if order.clip is None else [names.index(order.clip)]
    actor = cast(asset, Hints(joints, order.up, order.unit), asset.motion(chosen[0]))
    method = Interaction(foot_lock=order.foot_lock, keep_depth=False, steady=False, limits=False)
    production = prepare(actor, actor, method)
    results, reports = [], []
    with progress_line(progress, len(chosen)) as tell:
        for number in chosen:
            tell(f"repairing {names[number]}")
            motion = asset.motion(number)
            if len(motion) == 0:
                raise RetargetError(f"{order.file}: the clip {names[number]!r} has no frames")
            named = replace(motion, name=f"{motion.name} repaired" if motion.name else "repaired")
            result = production(named, Provenance.whole(order.file, motion))
            results.append(result)
            reports.append({"clip": names[number], "status": result.status, "stats": result.stats})
            tell("", 1)
    save_results(order.output, results)
    lines = [f"{order.output}: {len(results)} clips repaired"]
    for each in reports:
        lines += [f"{each['clip']}: {each['status']}", *correction_lines(each["stats"])]
    return {"output": str(order.output), "clips": reports, "lines": lines}
