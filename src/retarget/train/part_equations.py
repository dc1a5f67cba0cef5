"""The step of `methods/interaction/part_equations.py` in torch, for a network to learn through: the same numbers, differentiable."""

from __future__ import annotations

import torch
from torch import Tensor

from retarget.contact.part_field import FIGURES, PAIRS
from retarget.methods.interaction.hand_distances import TRIANGLE
from retarget.methods.interaction.looker import ASKED_FROM, AXES_FROM, SEEN
from retarget.methods.interaction.part_equations import (
    CARRIED,
    DAMPED,
    HELD,
    JOINTS,
    LEAST,
    LEVERS,
    MOST,
    PAIRED,
    ROWS,
    SAYS,
    SHIFT,
    STIFF,
)
from retarget.methods.interaction.unknowns import SIZE

TINY = 1e-9


def steps(features: Tensor, turned: Tensor, said: Tensor) -> Tensor:
    """Changes of corrections (frames, SIZE) of what looks see with its levers (frames, features), where corrections stand (frames, SIZE)
    and what a network says (frames, SAID). Single precision."""
    frames, pairs, unknowns = len(features), len(PAIRS), len(ROWS)
    figures = features[:, : FIGURES * pairs].reshape(frames, pairs, FIGURES)
    say, stiffness = said[:, PAIRED].reshape(frames, pairs, SAYS), _factor(said[:, STIFF]) + DAMPED
    joints = torch.from_numpy(JOINTS)
    places = features[:, SEEN:AXES_FROM].reshape(frames, -1, 3)[:, joints]
    axes = features[:, AXES_FROM:ASKED_FROM].reshape(frames, -1, 3, 3)[:, joints]
    first, second = (torch.from_numpy(each).float()[..., None] for each in CARRIED)
    rows = torch.from_numpy(ROWS)

    near, depth, away = figures[..., 1], figures[..., 14], figures[..., 16:19]
    scale = 1.0 / near.clamp(min=TINY)[..., None]
    own = places[:, torch.from_numpy(LEVERS)] + scale * figures[..., 8:11]
    other, asked = scale * figures[..., 11:14], _factor(say[..., 3:4]) * scale * figures[..., 5:8] + SHIFT * say[..., 5:8]
    held = (near > 0).float()
    weight = held * (figures[..., 0] * _factor(say[..., 0]) + near * _factor(say[..., 1]))
    length = away.norm(dim=-1)
    sunk = ((depth > 0) & (length > 0)).float() * _factor(say[..., 2])
    normal = away / length.clamp(min=TINY)[..., None]
    out_at = figures[..., 19:22] / depth.clamp(min=TINY)[..., None]

    where = places[:, None]
    lever = held[..., None, None] * (first * (own[:, :, None] - where) - second * (other[:, :, None] - where))
    moved = torch.linalg.cross(axes[:, None], lever[..., None].expand(-1, -1, -1, -1, 3), dim=-2)  # (frames, pairs, joints, 3, unknowns)
    moved = moved.permute(0, 1, 3, 2, 4).reshape(frames, 3 * pairs, unknowns)
    lever = (first - second) * (out_at[:, :, None] - where)
    crossed = torch.linalg.cross(lever, normal[:, :, None].expand_as(lever), dim=-1)
    pushed = torch.einsum("fpuc,fucd->fpud", crossed, axes).reshape(frames, pairs, unknowns)

    jacobian = torch.cat([moved, pushed], dim=1)
    weights = torch.cat([weight.repeat_interleave(3, dim=1), sunk], dim=1)
    wanted = torch.cat([asked.reshape(frames, -1), _factor(say[..., 4]) * figures[..., 15] + SHIFT * say[..., 8]], dim=1)
    weighed = jacobian * weights[..., None]
    held, low = _factor(said[:, HELD])[:, None], torch.tril_indices(unknowns, unknowns)
    hands = torch.zeros(frames, unknowns, unknowns)
    hands[:, low[0], low[1]] = hands[:, low[1], low[0]] = features[:, ASKED_FROM : ASKED_FROM + TRIANGLE]
    matrix = torch.bmm(weighed.transpose(1, 2), jacobian) + torch.diag_embed(stiffness) + held[..., None] * hands
    right = torch.bmm(weighed.transpose(1, 2), wanted[..., None])[..., 0] - stiffness * turned[:, rows]
    right = right + held * features[:, ASKED_FROM + TRIANGLE :]
    factor, _ = torch.linalg.cholesky_ex(matrix)
    solved = torch.cholesky_solve(right[..., None], factor)[..., 0]
    return said[:, :SIZE].index_add(1, rows, solved)


def _factor(logarithm: Tensor) -> Tensor:
    return logarithm.clamp(LEAST, MOST).exp()
