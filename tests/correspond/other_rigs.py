"""Skeletons of things that are no human."""

from __future__ import annotations

import numpy as np
from humanoid_rigs import skeleton_of

from retarget.character import Skeleton

Chain = tuple[str, str | None, list[tuple[float, float, float]]]


def chains(rows: list[Chain], mirror: tuple[str, ...] = ()) -> Skeleton:
    """Joints in chains: name, the joint it hangs on, places. Chains whose name begins with 'L_' get an 'R_' twin."""
    names, parents, points = [], [], []
    for name, above, places in rows:
        for side in ("L_", "R_") if name.startswith("L_") else ("",):
            own = side + name[2:] if side else name
            parent = above
            if above is not None and above.startswith("L_"):
                parent = side + above[2:]
            last = -1 if parent is None else names.index(parent)
            for number, place in enumerate(places):
                names.append(f"{own}{number}")
                parents.append(last)
                points.append(np.array(place) * ([-1.0, 1.0, 1.0] if side == "R_" else [1.0, 1.0, 1.0]))
                last = len(names) - 1
    return skeleton_of(names, parents, np.array(points))


def quadruped(neck: float = 0.35, legs: float = 0.6, tail: bool = True) -> Skeleton:
    rows: list[Chain] = [
        ("spine", None, [(0, legs, -0.4), (0, legs + 0.02, -0.2), (0, legs + 0.02, 0.0), (0, legs, 0.2)]),
        ("neck", "spine3", [(0, legs + 0.1, 0.3), (0, legs + neck, 0.45), (0, legs + neck, 0.6)]),
        ("L_ear", "neck1", [(0.05, legs + neck + 0.05, 0.42), (0.06, legs + neck + 0.12, 0.42)]),
        (
            "L_hindleg",
            "spine0",
            [
                (0.1, legs - 0.05, -0.4),
                (0.1, legs * 0.6, -0.32),
                (0.1, legs * 0.3, -0.45),
                (0.1, 0.03, -0.42),
                (0.1, 0, -0.35),
            ],
        ),
        (
            "L_foreleg",
            "spine3",
            [
                (0.08, legs - 0.02, 0.22),
                (0.1, legs * 0.7, 0.2),
                (0.1, legs * 0.35, 0.22),
                (0.1, 0.03, 0.2),
                (0.1, 0, 0.27),
            ],
        ),
    ]
    if tail:
        rows.append(
            ("tail", "spine0", [(0, legs, -0.5), (0, legs - 0.1, -0.6), (0, legs - 0.2, -0.7), (0, legs - 0.3, -0.75)])
        )
    return chains(rows)


def bird() -> Skeleton:
    return chains(
        [
            ("body", None, [(0, 0.3, -0.05), (0, 0.33, 0.05)]),
            ("neck", "body1", [(0, 0.38, 0.1), (0, 0.43, 0.13), (0, 0.48, 0.15), (0, 0.48, 0.22)]),
            (
                "L_wing",
                "body1",
                [(0.04, 0.34, 0.05), (0.15, 0.36, 0.0), (0.3, 0.37, 0.05), (0.45, 0.36, 0.0), (0.6, 0.35, -0.05)],
            ),
            (
                "L_leg",
                "body0",
                [(0.04, 0.28, -0.05), (0.05, 0.2, 0.0), (0.05, 0.1, -0.06), (0.05, 0.01, -0.03), (0.05, 0.0, 0.03)],
            ),
            ("tail", "body0", [(0, 0.28, -0.15), (0, 0.27, -0.25)]),
        ]
    )


def spider(pairs: int = 4) -> Skeleton:
    rows: list[Chain] = [
        ("body", None, [(0, 0.2, 0)]),
        ("abdomen", "body0", [(0, 0.25, -0.2), (0, 0.25, -0.4)]),
        ("head", "body0", [(0, 0.2, 0.15)]),
    ]
    for i in range(pairs):
        angle = np.radians(-55 + 110 * i / max(pairs - 1, 1))
        out = np.array([np.cos(angle), 0.0, np.sin(angle)])
        rows.append(
            (
                f"L_leg{'abcdefgh'[i]}",
                "body0",
                [tuple(out * r + [0, y, 0]) for r, y in ((0.08, 0.2), (0.25, 0.4), (0.5, 0.3), (0.65, 0.0))],
            )
        )
    return chains(rows)


def snake(joints: int = 40) -> Skeleton:
    return chains([("snake", None, [(0.1 * np.sin(0.5 * i), 0.0, 0.1 * i) for i in range(joints)])])


def chair() -> Skeleton:
    return chains(
        [
            ("seat", None, [(0, 0.45, 0), (0, 0.46, -0.2)]),
            ("L_front", "seat0", [(0.2, 0.43, 0.2), (0.2, 0.22, 0.2), (0.2, 0, 0.2)]),
            ("L_back", "seat0", [(0.2, 0.43, -0.2), (0.2, 0.22, -0.2), (0.2, 0, -0.2)]),
            ("rest", "seat1", [(0, 0.7, -0.22), (0, 0.95, -0.25)]),
            ("L_arm", "seat1", [(0.22, 0.5, -0.2), (0.22, 0.65, -0.18), (0.22, 0.65, 0.15)]),
        ]
    )


def hand(both: bool = False) -> Skeleton:
    side = "L_" if both else ""
    rows: list[Chain] = [("origin", None, [(0, 0, 0)]), (f"{side}arm", "origin0", [(0.3, 0, 0), (0.3, 0, 0.25)])]
    for finger, x in (("thumb", 0.2), ("index", 0.27), ("middle", 0.3), ("ring", 0.32), ("little", 0.345)):
        rows.append((f"{side}{finger}", f"{side}arm1", [(x, 0, 0.32), (x, 0, 0.36), (x, 0, 0.39), (x, 0, 0.41)]))
    return chains(rows)


def robot_arm() -> Skeleton:
    return chains(
        [
            ("base", None, [(0, 0, 0), (0, 0.3, 0), (0, 0.8, 0.1), (0, 0.9, 0.6), (0, 0.85, 0.75), (0, 0.75, 0.75)]),
            ("L_finger", "base5", [(0.05, 0.72, 0.75), (0.05, 0.65, 0.75)]),
        ]
    )


def fish() -> Skeleton:
    return chains(
        [
            ("spine", None, [(0, 0, 0.1 * i) for i in range(8)]),
            ("L_fin", "spine5", [(0.05, 0, 0.5), (0.15, -0.02, 0.45), (0.22, -0.03, 0.42)]),
            ("L_pelvicfin", "spine3", [(0.04, -0.05, 0.3), (0.1, -0.1, 0.27), (0.14, -0.13, 0.25)]),
            ("dorsal", "spine4", [(0, 0.1, 0.4), (0, 0.2, 0.35)]),
        ]
    )


def car() -> Skeleton:
    return chains(
        [
            ("body", None, [(0, 0.5, 0)]),
            ("L_front", "body0", [(0.8, 0.3, 1.2)]),
            ("L_rear", "body0", [(0.8, 0.3, -1.2)]),
            ("wheel", "body0", [(0.3, 0.9, 0.3)]),
        ]
    )


def octopus() -> Skeleton:
    rows: list[Chain] = [("mantle", None, [(0, 0.5, 0), (0, 0.8, 0)])]
    for i in range(8):
        angle = 2 * np.pi * (i + 0.5) / 8
        rows.append(
            (
                f"arm{'abcdefgh'[i]}",
                "mantle0",
                [(r * np.cos(angle), 0.5 - 0.5 * r, r * np.sin(angle)) for r in (0.1, 0.3, 0.5, 0.7, 0.9)],
            )
        )
    return chains(rows)


def random_tree(seed: int, joints: int | None = None) -> Skeleton:
    rng = np.random.default_rng(seed)
    count = joints or int(rng.integers(10, 70))
    parents = [-1] + [int(rng.integers(max(0, i - 6), i)) for i in range(1, count)]
    points = np.zeros((count, 3))
    for i in range(1, count):
        points[i] = points[parents[i]] + rng.normal(size=3) * 0.15
    return skeleton_of([f"node{i}" for i in range(count)], parents, points)


THINGS = {
    "dog": lambda: quadruped(),
    "horse": lambda: quadruped(0.7, 1.1),
    "pig without tail": lambda: quadruped(0.1, 0.35, False),
    "bird": bird,
    "spider": spider,
    "ant": lambda: spider(3),
    "snake": snake,
    "rope of 1500 joints": lambda: snake(1500),
    "chair": chair,
    "hand": hand,
    "two hands": lambda: hand(True),
    "robot arm": robot_arm,
    "fish": fish,
    "car": car,
    "octopus": octopus,
    "one joint": lambda: snake(1),
    "two joints": lambda: snake(2),
}
