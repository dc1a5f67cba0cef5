"""What pairs of parts ask of the joints, as one small linear system: a damped Gauss-Newton step on the field by pairs of parts.

The figures of a pair (`contact/part_field.py`) say where its first part should go against its second, at which places, and which
way is out of it. How turns of joints move those places is known (they hang on the joints of their bones), so what all pairs ask
together is a least-squares problem in the turns of twenty joints: three rows where parts are near each other on the performer, one
where one has sunk into the other, distances of hands from what is near them (`hand_distances.py`), and every turn's closeness to the
copied pose. What each row weighs, by how much its target is mistaken, and how stiff each joint is, a network says frame by frame; what
the field by parts is too coarse to ask, it adds. Ye 2024 has none of this: there a network says all rotations. Lengths are shares
of the target's height.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.part_field import FIGURES, PAIRS
from retarget.contact.sensor_bones import SIDES
from retarget.contact.skin_levers import TURNING
from retarget.methods.interaction.unknowns import SIZE

Array = np.ndarray

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")
TURNED = tuple(name for name in TURNING if not any(finger in name for finger in FINGERS))
"""Joints that the system turns; knuckles are the network's alone."""
JOINTS = np.array([TURNING.index(name) for name in TURNED])
ROWS = np.array([3 * TURNING.index(name) + axis for name in TURNED for axis in range(3)])
"""Where their turns are in a correction."""
SAYS, FACTORS = 9, 5
"""Numbers said of a pair, and how many of them, the first, are logarithms: of weights (touching, near, sunk in), of what the move that
is asked for and the depth are multiplied by; then what is added to that move (three, in the hips' axes) and to the depth, in `SHIFT`s."""
SHIFT = 0.05
PAIRED, STIFF = slice(SIZE, SIZE + SAYS * len(PAIRS)), slice(SIZE + SAYS * len(PAIRS), SIZE + SAYS * len(PAIRS) + len(ROWS))
HELD = STIFF.stop
SAID = HELD + 1
"""Numbers that a network says of a frame: an added turn of every joint (`unknowns.SIZE`), `SAYS` of every pair, the logarithm of the
stiffness of every unknown of the system, and that of what distances of hands weigh (`hand_distances.py`)."""
LEAST, MOST = -10.0, 10.0
"""Bounds of logarithms: figures unlike all that was learnt from stay numbers."""
DAMPED = 1e-4
"""Added to every stiffness."""

_TRUNK = {"spine": 1, "chest": 4, "neck": 5, "head": 6}
"""How many of the first joints of `TURNING` carry a bone of the trunk: the lower half of it goes with the hips."""
_LIMBS = (("Shoulder", "UpperArm", "LowerArm", "Hand"), ("UpperLeg", "LowerLeg", "Foot"))


def carrying(bone: str) -> set[str]:
    """The joints that carry a bone of `contact/sensor_bones.py`."""
    if bone in _TRUNK:
        return set(TURNING[: _TRUNK[bone]])
    side = next(each for each in SIDES if bone.startswith(each))
    limb = next(each for each in _LIMBS if bone.removeprefix(side) in each)
    above = TURNING[: _TRUNK["chest"]] if limb[0] == "Shoulder" else TURNING[:1]
    return {*above, *(side + part for part in limb[: limb.index(bone.removeprefix(side)) + 1])}


CARRIED: Float[Array, "2 pairs turned"] = np.array(
    [[[float(name in carrying(pair[which])) for name in TURNED] for pair in PAIRS] for which in range(2)]
)
"""1 where a joint carries the first, and the second, part of a pair, else 0."""
LEVERS: Int[Array, "pairs"] = np.array([TURNED.index(own) for own, _ in PAIRS])
"""The joint that each pair's place on the first part is measured from."""


def part_steps(
    features: Float[Array, "frames features"],
    places: Float[Array, "frames turning 3"],
    axes: Float[Array, "frames turning 3 3"],
    turned: Float[Array, "frames SIZE"],
    asked: Float[Array, "frames ASKED"],
    said: Float[Array, "frames SAID"],
) -> Float[Array, "frames SIZE"]:
    """The changes of corrections `turned` that solve each frame's system, and what the network adds.

    `features` begin with the figures of all pairs; `places` and `axes` are those of `Unknowns.levers`, `asked` those of
    `HandDistances.equations`. Finite for finite figures; a frame whose system cannot be solved gets what is added alone.
    """
    from retarget.methods.interaction.part_equation_kernels import solve_parts

    figures = features[:, : FIGURES * len(PAIRS)].reshape(-1, len(PAIRS), FIGURES)
    change = said[:, :SIZE].astype(np.float64)
    pairs = said[:, PAIRED].astype(np.float64).reshape(-1, len(PAIRS), SAYS)
    pairs[..., :FACTORS] = _factor(pairs[..., :FACTORS])
    pairs[..., FACTORS:] *= SHIFT
    steps = np.zeros((len(figures), len(ROWS)))
    given = (
        figures, places[:, JOINTS], axes[:, JOINTS], turned[:, ROWS], pairs, _factor(said[:, STIFF]) + DAMPED,
        CARRIED[0], CARRIED[1], LEVERS, asked, _factor(said[:, HELD]),
    )  # fmt: skip
    # all alike for the compiled loop, which is else compiled anew for every kind of array
    solve_parts(*(each if each is LEVERS else np.ascontiguousarray(each, dtype=np.float64) for each in given), steps)
    change[:, ROWS] += steps
    return change


def _factor(logarithm: Float[Array, "*any"]) -> Float[Array, "*any"]:
    return np.exp(np.clip(logarithm.astype(np.float64), LEAST, MOST))
