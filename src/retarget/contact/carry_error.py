"""How far carrying errs: to be printed beside every figure that is judged by it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body.human import human_model
from retarget.contact.carry import Carrier, prepare_carry
from retarget.contact.sensors import Sensors, surface_points

Array = np.ndarray

REGIONS: dict[str, tuple[str, ...]] = {
    "limbs": ("UpperArm", "Forearm", "Thigh", "Shin"),
    "arms": ("UpperArm", "Forearm"),
    "legs": ("Thigh", "Shin"),
    "trunk": ("chest", "abdomen", "pelvis"),
    "head": ("head",),
    "neck": ("neck",),
    "hands": ("Hand",),
    "feet": ("Foot",),
}
"""Parts of the embedded human, without their side."""


@dataclass(frozen=True)
class CarryingError:
    """Errors in per cent of height, over points spread evenly over the source's body."""

    truth: dict[str, float] | None
    """Mean distance from the true place, in % of the target's height, by region and for 'all', with its 95th
    percentile as 'p95'; None where the bodies are not both on the embedded topology, so that nobody knows it."""
    round_trip: float
    """Mean distance from where a point started when it is carried there and back, in % of the source's height. Known
    for every pair; it shows gaps and tears but not what both ways get equally wrong."""
    round_trip_p95: float
    valid: float
    """Share of the points that come out valid."""

    def __str__(self) -> str:
        way = f"there and back {self.round_trip:.2f}% of height (95%: {self.round_trip_p95:.2f}%)"
        if self.truth is not None:
            each = ", ".join(f"{name} {self.truth[name]:.2f}%" for name in ("limbs", "trunk", "head", "hands", "feet"))
            way = f"{self.truth['all']:.2f}% of height (95%: {self.truth['p95']:.2f}%; {each}); {way}"
        return f"carrying errs by {way}; {100 * self.valid:.1f}% of points carried"


def carrying_error(source: Sensors, target: Sensors, points: int = 4000, seed: int = 0) -> CarryingError:
    """Measure how well `carry` takes places from one body to the other, against the truth where it is known.

    Two characters on the embedded human's topology correspond face by face. Raises as `prepare_carry` does.
    """
    there, back = prepare_carry(source, target), prepare_carry(target, source)
    faces, shares = spread_points(source, points, seed)
    carried = there(faces, shares)
    again = back(carried.faces, carried.barycentrics)
    start = _places(source, faces, shares)
    trip = 100 * np.linalg.norm(_places(source, again.faces, again.barycentrics) - start, axis=1) / source.stance.height
    return CarryingError(
        truth=_against_truth(there, faces, shares, carried.faces, carried.barycentrics),
        round_trip=float(trip.mean()),
        round_trip_p95=float(np.percentile(trip, 95)),
        valid=float(carried.valid.mean()),
    )


def spread_points(sensors: Sensors, count: int, seed: int = 0) -> tuple[Int[Array, "points"], Float[Array, "points 3"]]:
    """Points spread evenly (by area) over a body without its props: faces and barycentrics."""
    stance, rng = sensors.stance, np.random.default_rng(seed)
    corners = stance.rest[stance.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) * stance.body
    faces = rng.choice(len(area), size=count, p=area / area.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    return faces, np.stack([1 - u, u * (1 - v), u * v], axis=1)


def _places(sensors: Sensors, faces: Array, shares: Array) -> Float[Array, "points 3"]:
    return surface_points(sensors.stance.rest, sensors.stance.faces, faces, shares)


def _against_truth(
    carrier: Carrier, faces: Array, shares: Array, carried_faces: Array, carried_shares: Array
) -> dict[str, float] | None:
    model, target = human_model(), carrier.target
    if not all(np.array_equal(each.stance.faces, model.faces) for each in (carrier.source, target)):
        return None
    away = _places(target, carried_faces, carried_shares) - _places(target, faces, shares)
    error = 100 * np.linalg.norm(away, axis=1) / target.stance.height
    part = np.array([name.removeprefix("left").removeprefix("right") for name in model.part_names])
    part = part[model.face_parts[faces]]
    means = {region: float(error[np.isin(part, names)].mean()) for region, names in REGIONS.items()}
    return means | {"all": float(error.mean()), "p95": float(np.percentile(error, 95))}
