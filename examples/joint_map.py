"""Name the joints by hand where matching finds none, or the wrong ones.

    python examples/joint_map.py OUT_FOLDER

The body below has joint names that say nothing. A map names the fifteen joints that every humanoid needs; whatever is
not in it keeps its rest rotation. `retarget map` writes such a map as a file, `retarget run --map` reads it.
"""

import sys
from dataclasses import replace
from pathlib import Path

from retarget import Hints, embedded_motion, human, retarget, save

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
folder.mkdir(parents=True, exist_ok=True)

JOINTS = {
    "hips": "bassin", "spine": "colonne", "head": "tete",
    "leftUpperLeg": "cuisse.g", "leftLowerLeg": "jambe.g", "leftFoot": "pied.g",
    "rightUpperLeg": "cuisse.d", "rightLowerLeg": "jambe.d", "rightFoot": "pied.d",
    "leftUpperArm": "bras.g", "leftLowerArm": "avantbras.g", "leftHand": "main.g",
    "rightUpperArm": "bras.d", "rightLowerArm": "avantbras.d", "rightHand": "main.d",
}  # fmt: skip

body = human(height=1.6)
names = tuple(JOINTS.get(name, f"os_{number}") for number, name in enumerate(body.skeleton.names))
body = replace(body, skeleton=replace(body.skeleton, names=names))

result = retarget(embedded_motion("walk"), body, target_hints=Hints(joints=JOINTS))
save(folder / "mapped_by_hand.glb", body, [result.motion])
print(f"{folder / 'mapped_by_hand.glb'}: {len(result.motion)} frames, status {result.status}")
