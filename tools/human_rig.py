"""The skeleton of the embedded human on MakeHuman's data: joints, merged skinning weights, joint regressor."""

from __future__ import annotations

import numpy as np
from human_source import BODY_VERTICES, BaseMesh, Source
from scipy import sparse
from scipy.optimize import nnls

FINGERS = {
    "Thumb": ("Metacarpal", "Proximal", "Distal"),
    "Index": ("Proximal", "Intermediate", "Distal"),
    "Middle": ("Proximal", "Intermediate", "Distal"),
    "Ring": ("Proximal", "Intermediate", "Distal"),
    "Little": ("Proximal", "Intermediate", "Distal"),
}
TOES = tuple(f"l-toe-{k}-1" for k in range(1, 6))
TOE_TIPS = ("l-toe-1-3", "l-toe-2-4", "l-toe-3-4")

# name: (parent, joint cubes whose mean is the joint); left side only, the right one is mirrored
CENTRE = {
    "hips": (None, ("pelvis",)),
    "spine": ("hips", ("spine-4",)),
    "chest": ("spine", ("spine-2",)),
    "upperChest": ("chest", ("spine-1",)),
    "neck": ("upperChest", ("neck",)),
    "head": ("neck", ("head",)),
}
LEFT = {
    "Shoulder": ("upperChest", ("l-clavicle",)),
    "UpperArm": ("Shoulder", ("l-shoulder",)),
    "LowerArm": ("UpperArm", ("l-elbow",)),
    "Hand": ("LowerArm", ("l-hand",)),
    "UpperLeg": ("hips", ("l-upper-leg",)),
    "LowerLeg": ("UpperLeg", ("l-knee",)),
    "Foot": ("LowerLeg", ("l-ankle",)),
    "Toes": ("Foot", TOES),
}
HAND = {
    finger + phalanx: ("Hand" if i == 0 else finger + phalanges[i - 1], (f"l-finger-{k}-{i + 1}",))
    for k, (finger, phalanges) in enumerate(FINGERS.items(), start=1)
    for i, phalanx in enumerate(phalanges)
}
ENDS = {"head": ("head-2",), "leftToes": TOE_TIPS} | {
    f"left{finger}Distal": (f"l-finger-{k}-4",) for k, finger in enumerate(FINGERS, start=1)
}

# Prefixes of MakeHuman's bones -> our joint; everything else above the neck is the face and follows the head.
BONES = {
    "root": "hips", "pelvis": "hips", "spine05": "hips", "spine04": "spine", "spine03": "spine", "spine02": "chest",
    "spine01": "upperChest", "breast": "upperChest", "neck": "neck", "clavicle": "Shoulder", "shoulder01": "Shoulder",
    "upperarm": "UpperArm", "lowerarm": "LowerArm", "wrist": "Hand", "metacarpal": "Hand", "upperleg": "UpperLeg",
    "lowerleg": "LowerLeg", "foot": "Foot", "toe": "Toes",
} | {f"finger{k}-{i + 1}": finger + phalanx for k, (finger, phalanges) in enumerate(FINGERS.items(), 1)
     for i, phalanx in enumerate(phalanges)}  # fmt: skip


def joint_table() -> tuple[list[str], list[int], list[tuple[str, ...]]]:
    """Names, parents and joint cubes of the 52 joints: 22 of the body, then 15 a hand, left before right."""
    rows: list[tuple[str, str | None, tuple[str, ...]]] = [(name, *spec) for name, spec in CENTRE.items()]
    for table in (LEFT, HAND):
        for side in ("left", "right"):
            for name, (parent, cubes) in table.items():
                above = parent if parent in CENTRE else side + parent
                ours = cubes if side == "left" else tuple(cube.replace("l-", "r-", 1) for cube in cubes)
                rows.append((side + name, above, ours))
    names = [row[0] for row in rows]
    return names, [-1 if row[1] is None else names.index(row[1]) for row in rows], [row[2] for row in rows]


def mirrored_name(name: str) -> str:
    swap = {"left": "right", "right": "left"}
    return next((swap[side] + name[len(side) :] for side in swap if name.startswith(side)), name)


def end_table(names: list[str]) -> list[tuple[int, tuple[str, ...]]]:
    """(joint, cubes of the end of its bone) for head, toes and fingertips, both sides."""
    both = dict(ENDS)
    for name, cubes in ENDS.items():
        if name.startswith("left"):
            both[mirrored_name(name)] = tuple(cube.replace("l-", "r-", 1) for cube in cubes)
    return [(names.index(name), cubes) for name, cubes in sorted(both.items(), key=lambda item: names.index(item[0]))]


def merged_weights(source: Source, names: list[str]) -> np.ndarray:
    """Dense weights (13380, joints): MakeHuman's 163 bones merged onto ours; rows sum to one."""
    weights = np.zeros((BODY_VERTICES, len(names)))
    for bone, entries in source.json("rigs/standard/weights.default.json")["weights"].items():
        stem, _, side = bone.partition(".")
        prefix = max((p for p in BONES if stem.startswith(p)), key=len, default=None)
        name = BONES[prefix] if prefix else "head"
        if name not in names:
            name = {"L": "left", "R": "right"}[side] + name
        for vertex, weight in entries:
            if vertex < BODY_VERTICES:
                weights[vertex, names.index(name)] += weight
    return weights / weights.sum(axis=1, keepdims=True)


def finish_weights(
    weights: np.ndarray, faces: np.ndarray, mirror: np.ndarray, names: list[str], rounds: int = 2
) -> np.ndarray:
    """Weights of the light mesh: smoothed over neighbours, made symmetric, the four largest kept, rows sum to one."""
    count = len(weights)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    near = sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count)).tocsr()
    near = sparse.diags(1 / np.asarray(near.sum(axis=1)).ravel()) @ near
    for _ in range(rounds):
        weights = 0.5 * weights + 0.5 * (near @ weights)
    swap = [names.index(mirrored_name(name)) for name in names]
    weights = 0.5 * (weights + weights[mirror][:, swap])
    # Larger than the fifth, not among the first four: on the midline left and right tie, and go or stay together.
    fifth = np.sort(weights, axis=1)[:, -5]
    weights = np.where((weights > fifth[:, None] + 1e-9) & (weights > 0.004), weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def fit_regressor(
    base: BaseMesh, cubes: list[tuple[str, ...]], samples: np.ndarray, combine: sparse.csr_matrix, mirror: np.ndarray
) -> np.ndarray:
    """Non-negative weights (points, vertices), rows summing to one, that give joint positions from the light mesh.

    `samples` (samples, originals, 3) are whole bodies; each joint is fitted to the mean of its helper cubes on all of
    them by non-negative least squares over nearby vertices. Right rows mirror the left ones.
    """
    bodies = np.stack([combine @ sample for sample in samples])
    rows: dict[tuple[str, ...], np.ndarray] = {}
    for cube in cubes:
        if any(name.startswith("r-") for name in cube):
            continue
        goal = np.mean([base.joint(name, samples) for name in cube], axis=0)
        central = not any(name.startswith("l-") for name in cube)
        rows[cube] = _fit_point(bodies, goal, mirror if central else None)
    for cube in cubes:
        if cube not in rows:
            rows[cube] = rows[tuple(name.replace("r-", "l-", 1) for name in cube)][mirror]
    return np.stack([rows[cube] for cube in cubes])


def _fit_point(bodies: np.ndarray, goal: np.ndarray, mirror: np.ndarray | None, candidates: int = 300) -> np.ndarray:
    distance = np.linalg.norm(bodies[0] - goal[0], axis=1)
    # The nearest vertices all lie to one side of a deep joint; those within three nearest distances are around it,
    # and the joints of the spine, which run close to the back, take in the belly as well.
    near = np.flatnonzero(
        distance < max(3.0 * distance.min(), np.sort(distance)[60], 0.17 if mirror is not None else 0.0)
    )
    if len(near) > candidates:
        near = near[np.linspace(0, len(near) - 1, candidates).astype(int)]
    if mirror is not None:
        near = np.unique(np.concatenate([near, mirror[near]]))
    matrix = bodies[:, near].transpose(0, 2, 1).reshape(-1, len(near))
    # The average body counts more; a little ridge spreads the weights, so that one odd vertex never moves a joint.
    share = np.repeat(np.where(np.arange(len(bodies)) == 0, 5.0, 1.0), 3)
    rows = np.vstack([matrix * share[:, None], np.full((1, len(near)), 100.0), np.eye(len(near))])
    solution, _ = nnls(rows, np.concatenate([goal.ravel() * share, [100.0], np.zeros(len(near))]), maxiter=6000)
    solution[solution < 2e-4] = 0.0
    row = np.zeros(bodies.shape[1])
    row[near] = solution / solution.sum()
    return row if mirror is None else 0.5 * (row + row[mirror])
