"""Which bodies and motions networks learn from, and which they never see. Written down before the first training.

Three sets, of bodies and of motions alike: `TRAINING`; `VALIDATION`, which may be looked at while building; and `TEST`,
which is only reported. Bodies are drawn by numbered seeds from the whole of the embedded human's shape space, toddlers to the very
heavy. Motions are told apart by the embedded motion's name, for CMU clips by the person who was recorded, for other folders
by their name.
"""

from __future__ import annotations

import numpy as np

from retarget.body.human import PARAMETERS, height_range, human_model
from retarget.errors import RetargetError

TRAINING, VALIDATION, TEST = "training", "validation", "test"

BODY_SEEDS: dict[str, tuple[int, ...]] = {
    TRAINING: tuple(range(700)),
    VALIDATION: tuple(range(8000, 8032)),
    TEST: tuple(range(9000, 9100)),
}
"""Seeds of `drawn_shape`."""
EMBEDDED: dict[str, tuple[str, ...]] = {
    TRAINING: (
        "walk", "turn", "hands_on_hips", "hand_on_belly", "hands_behind_head", "arms_crossed", "squat_hands_on_knees",
    ),
    VALIDATION: ("jump", "clap"),
    TEST: ("demo", "run", "wave", "hand_to_shoulder", "legs_crossed"),
}  # fmt: skip
"""Embedded motions (`motion.library`)."""
CMU_SUBJECTS: dict[str, tuple[str, ...]] = {
    TRAINING: ("01", "02", "03", "07", "09", "13", "14"),
    VALIDATION: ("06", "11"),
    TEST: ("05", "08", "10"),
}
"""People of the CMU clips: the number before the underscore."""
OTHER_FOLDERS: dict[str, tuple[str, ...]] = {
    TRAINING: ("animated_drawings", "makehuman", "kaykit", "quaternius"),
    VALIDATION: (),
    TEST: ("pybvh", "deepmimic"),
}
"""Folders of other recordings."""

BENCH_BODIES = (9000, 9001, 9002, 9003)
"""Seeds of the four unseen performers of the bench."""
BENCH_TARGETS = (9004, 9005, 9006, 9007)
"""Seeds of the bodies that they drive."""
BENCH_NAKED = ("demo", "run", "wave", "legs_crossed")
"""Embedded motions, at hand everywhere: four for naked bodies,"""
BENCH_CLOTHED = ("demo", "run", "hand_to_shoulder")
"""and three for clothed ones."""
BENCH_CAPTURED = ("05_02", "05_14", "08_04", "10_04")
"""CMU clips of test subjects, where they are at hand."""

DETAIL = 0.3
"""How far a finer component of the shape goes: one standard deviation, of at most 1."""


def drawn_shape(seed: int) -> dict[str, float]:
    """Parameters for `human` of the body of a seed; ages from one year to ninety, weights to the heaviest.

    A quarter are children or youths, one in eight is heavier than MakeHuman's heaviest.
    """
    draw = np.random.default_rng([seed, 2023])
    age = 0.01 + 0.39 * draw.random() ** 1.5 if draw.random() < 0.25 else draw.uniform(0.4, 1.0)
    heaviest = draw.random() < 0.125
    shape = {
        "gender": float(draw.uniform(*PARAMETERS["gender"][::2])),
        "age": float(age),
        "muscle": float(draw.uniform(0.1, 1.0)),
        "weight": float(draw.uniform(1.0, 2.0) if heaviest else draw.uniform(0.0, 1.0)),
        "proportions": float(draw.uniform(0.1, 0.9)),
    }
    for name in human_model().detail_names:
        shape[name] = float(np.clip(draw.normal() * DETAIL, -1.0, 1.0))
    low, high = height_range(**shape)
    shape["height"] = float(low + draw.beta(2.0, 3.2) * (high - low))
    return shape


def set_of_clip(folder: str, name: str) -> str:
    """The set that a recorded clip belongs to, by its folder ('cmu_daz', ...; 'embedded' for the library) and name.

    Raises `RetargetError` for a clip that no set names, so that nothing is learnt from by oversight.
    """
    if folder == "embedded":
        table, key = EMBEDDED, name
    elif folder.startswith("cmu"):
        table, key = CMU_SUBJECTS, name.split("_")[0]
    else:
        table, key = OTHER_FOLDERS, folder
    for which, keys in table.items():
        if key in keys:
            return which
    raise RetargetError(f"clip {name!r} of {folder!r} is in none of the sets of evaluate/scan_split.py")
