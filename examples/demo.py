"""The point of the project in one run: a thin human's performance on three other bodies, as files, pictures, figures.

python examples/demo.py out/demo
"""

import sys
import time
from pathlib import Path

from retarget import cast, embedded_motion, human, prepare, save
from retarget.body.human import PRESETS, textured
from retarget.evaluate.benches.skeletal import Case, measure
from retarget.evaluate.touch import observe, prepare_judge
from retarget.motion.library import PERFORMER
from retarget.view.picture import save_png, sheet
from retarget.view.rows import motion_row

BODIES = ("heavy", "child", "muscular")
FIGURES = (
    "direction_error_deg", "orientation_error_deg", "foot_slide_cm", "floor_error_cm", "jerk_ratio", "contacts_kept",
    "penetration_percent",
)  # fmt: skip
FRAMES = 8


def main(folder: Path) -> None:
    started = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    performance = embedded_motion("demo")
    thin = textured(human(**PRESETS[PERFORMER], name=PERFORMER))
    source = cast(thin)
    save(folder / f"{PERFORMER}.glb", thin, [performance])
    touch = observe(source, performance)
    rows = [motion_row(f"source: {PERFORMER}", thin, performance, FRAMES)]
    print(f"{'':10}" + "".join(name.rjust(23) for name in FIGURES))
    for body in BODIES:
        character = textured(human(**PRESETS[body], name=body))
        target = cast(character)
        result = prepare(source, target)(performance)
        save(folder / f"{body}.glb", character, [result.motion])
        rows.append(motion_row(body, character, result.motion, FRAMES))
        figures = measure(Case("demo", body, "seen", source, target, performance))
        figures |= prepare_judge(touch, target)(touch, result.motion)
        print(f"{body:10}" + "".join(f"{figures[name]:23.3f}" for name in FIGURES))
    save_png(folder / "demo.png", sheet(rows, size=360, title="one performance, four bodies"))
    print(f"\n{time.perf_counter() - started:.1f} s; open in any glTF viewer or Blender:")
    for path in sorted(folder.iterdir()):
        print(f"  {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo"))
