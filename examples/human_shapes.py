"""Write bodies of the embedded parametric human as GLB files.

    python examples/human_shapes.py OUT_FOLDER

Heights are metres; the other parameters run from 0 to 1 around a neutral 0.5.
"""

import sys
from pathlib import Path

from retarget import human, save
from retarget.body.human import PRESETS, human_model

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
folder.mkdir(parents=True, exist_ok=True)

bodies = {name: human(**PRESETS[name]) for name in ("child", "muscular")}
bodies["tall_and_thin"] = human(height=1.95, weight=0.1)
bodies["wide_hips"] = human(gender=0.1, hips=0.8)  # `hips` is one of the finer components

for name, body in bodies.items():
    save(folder / f"{name}.glb", body, [])
    vertices = body.mesh.vertices
    print(f"{name}.glb: {vertices[:, 1].max() - vertices[:, 1].min():.2f} m tall, {len(vertices)} vertices")

# All bodies share one topology, so vertex n is the same place on each of them.
nose = human_model().landmark("nose")
print("height of the nose:", {name: round(float(body.mesh.vertices[nose, 1]), 2) for name, body in bodies.items()})
print("finer components:", ", ".join(human_model().detail_names))
