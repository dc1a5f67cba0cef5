"""Bring what a file held into the space all else works in, metres with +Y up; and say what was inferred on the way.

BVH says nothing of its unit or axes, and glTF files are often exported in centimetres whatever the standard says.
The evidence used here: what the file states, which way the matched body stands (at rest and on average in its
motion), and how tall it is. Every inference ends up in `Actor.notes`; each can be overridden.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose, world_pose
from retarget.character import Character, Mesh, Motion, Skeleton
from retarget.contact.ground import ground_contacts
from retarget.contact.support import leg_length, support_limbs, support_points
from retarget.correspond.joints import Humanoid
from retarget.errors import RetargetError
from retarget.geometry.riding import Riders
from retarget.io.asset import Convention
from retarget.motion.anatomy import Soles
from retarget.motion.graft import Graft, graft

Array = np.ndarray

AXES = {
    f"{sign}{axis}": value * np.eye(3)[i] for sign, value in (("+", 1.0), ("-", -1.0)) for i, axis in enumerate("xyz")
}

# Units that people's skeletons come in, metres; the last is the CMU database's own (an inch divided by 0.45).
UNITS = {"m": 1.0, "cm": 0.01, "dm": 0.1, "mm": 0.001, "inch": 0.0254, "foot": 0.3048, "CMU unit": 0.0254 / 0.45}
LIKELY_HEIGHT = (0.5, 2.6)
"""Metres. A body in this range is believed as it stands."""
TYPICAL_HEIGHT = 1.7
LEAST_STANCE = 0.4
"""Seconds that a foot must stand in all before its motion tells how its sole lies."""
FLOOR_FRAMES = 200
"""Frames of a clip that are looked at, about, to tell the up axis by its floor."""
ORIGIN_ON_FLOOR = 0.3
"""How much a floor away from zero counts against an up axis, against as much wandering of the lowest joint."""
SOLE_TILT = (np.radians(10), np.radians(40))
"""Tilts of a standing sole, against its rest pose, that are believed: less is noise, more is no standing."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """A turn and a scale of space: p' = scale · R p."""

    rotation: Float[Array, "4"]
    scale: float

    def inverse(self) -> Similarity:
        return Similarity(rot.inverse(self.rotation), 1.0 / self.scale)

    def points(self, points: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        return rot.rotate(self.rotation, points) * self.scale

    def skeleton(self, skeleton: Skeleton) -> Skeleton:
        offsets = skeleton.offsets * self.scale
        offsets[0] = rot.rotate(self.rotation, offsets[0])
        rotations = skeleton.rest_rotations.copy()
        rotations[0] = rot.multiply(self.rotation, rotations[0])
        ends = skeleton.end_offsets and {joint: end * self.scale for joint, end in skeleton.end_offsets.items()}
        return replace(skeleton, offsets=offsets, rest_rotations=rotations, end_offsets=ends)

    def mesh(self, mesh: Mesh) -> Mesh:
        return replace(mesh, vertices=self.points(mesh.vertices))

    def character(self, character: Character) -> Character:
        """Skeleton, mesh and binds together: posed vertices turn and scale with the joints.

        Its file no longer fits and is let go, unless nothing changes.
        """
        if self.scale == 1.0 and np.array_equal(self.rotation, rot.IDENTITY):
            return character
        if character.skin is None:
            return replace(character, skeleton=self.skeleton(character.skeleton), origin=None)
        back = np.eye(4)  # mesh coordinates before from mesh coordinates after, then the joint's scale
        back[:3, :3] = rot.to_matrix(rot.inverse(self.rotation)) / self.scale
        inverse_binds = character.skin.inverse_binds @ back
        inverse_binds[:, :3, :] *= self.scale
        return replace(
            character,
            skeleton=self.skeleton(character.skeleton),
            mesh=self.mesh(character.mesh),
            skin=replace(character.skin, inverse_binds=inverse_binds),
            origin=None,
        )

    def motion(self, motion: Motion) -> Motion:
        rotations, translations = motion.rotations.copy(), motion.translations * self.scale
        rotations[:, 0] = rot.multiply(self.rotation, rotations[:, 0])
        translations[:, 0] = rot.rotate(self.rotation, translations[:, 0])
        return replace(motion, skeleton=self.skeleton(motion.skeleton), rotations=rotations, translations=translations)


@dataclass(frozen=True, eq=False)
class Actor:
    """A body in metres with +Y up whose joints are known: what methods prepare on."""

    original: Character
    """As its file has it."""
    character: Character
    """The same in metres with +Y up."""
    humanoid: Humanoid
    house_from_file: Similarity
    """How it came here; its inverse leads back to the file's space."""
    height: float
    """From the soles to the top of the head at rest, metres."""
    notes: tuple[str, ...] = ()
    soles: Soles = field(default_factory=dict)
    """Soles as the motion shows them, for a body without surface (`stance_soles`)."""
    graft: Graft | None = None
    """How `character` hangs together otherwise than its file; None where it does not (`with_grafts`)."""
    cloud: Riders | None = None
    """The points that its surface was closed around, in metres on that surface; None for a body that came with one."""

    @property
    def skeleton(self) -> Skeleton:
        return self.character.skeleton


def with_grafts(actor: Actor) -> Actor:
    """The body with feet and hands on their limbs, where its file keeps them beside (`graft.py`)."""
    if actor.graft is not None:
        return actor
    character, humanoid, found = graft(actor.character, actor.humanoid, actor.height)
    return actor if found is None else replace(actor, character=character, humanoid=humanoid, graft=found)


def body_height(skeleton: Skeleton, humanoid: Humanoid, vertices: Array | None = None) -> float:
    """Height of the body at rest along its own up direction, in the skeleton's units.

    Taken from the surface where there is one; else from legs, trunk and neck laid end to end (a rest pose may crouch),
    with a typical share for what lies beyond the head joint and below the ankle.
    """
    rotations, positions = rest_pose(skeleton)
    if vertices is not None and len(vertices):
        along = vertices @ humanoid.axes[1]
        return float(np.percentile(along, 99.9) - np.percentile(along, 0.1))
    places = {name: positions[joint] for name, joint in humanoid.joints.items()}
    legs = []
    for side in ("left", "right"):
        leg = [places[side + part] for part in ("UpperLeg", "LowerLeg", "Foot")]
        legs.append(float(np.linalg.norm(np.diff(leg, axis=0), axis=1).sum()))
    hips = positions[[humanoid.joints["leftUpperLeg"], humanoid.joints["rightUpperLeg"]]].mean(axis=0)
    trunk = float(np.linalg.norm(positions[humanoid.joints["head"]] - hips))
    # Ankle to sole and head joint to crown, as shares of leg and trunk: measured on the embedded human.
    return max(legs) * 1.09 + trunk * 1.28


def infer_up(humanoid: Humanoid, motion: Motion | None) -> tuple[Float[Array, "3"], str]:
    """The world's up axis: the signed axis nearest to where the body's own up points.

    The rest pose may lie down (some exporters turn the whole body in its first rotation), so the mean direction over
    the motion decides where it is steady and shows a floor; a tumbling motion, and one that crawls or lies throughout,
    falls back on the rest pose.
    """
    up, source = humanoid.axes[1], "the rest pose stands that way"
    if motion is not None and len(motion):
        skeleton, hips = motion.skeleton, humanoid.joints["hips"]
        at_rest, _ = rest_pose(skeleton)
        path = [hips]
        while skeleton.parents[path[-1]] >= 0:
            path.append(int(skeleton.parents[path[-1]]))
        world = np.broadcast_to(rot.IDENTITY, (len(motion), 4))
        for joint in reversed(path):
            world = rot.multiply(world, motion.rotations[:, joint])
        mean = rot.rotate(rot.multiply(world, rot.inverse(at_rest[hips])), up).mean(axis=0)
        if np.linalg.norm(mean) > 0.75 and np.abs(mean).max() > 0.8 * np.linalg.norm(mean):
            standing, lying = _nearest_axis(mean), _nearest_axis(up)
            if np.array_equal(standing, lying) or _has_floor(motion, humanoid, standing, lying):
                return standing, "the body stands that way on average"
            source = "the rest pose stands that way, and what moves lowest keeps to one height"
    return _nearest_axis(up), source


def _nearest_axis(direction: Float[Array, "3"]) -> Float[Array, "3"]:
    """The signed coordinate axis nearest to a direction."""
    nearest = int(np.argmax(np.abs(direction)))
    return np.sign(direction[nearest]) * np.eye(3)[nearest]


def _has_floor(motion: Motion, humanoid: Humanoid, axis: Float[Array, "3"], other: Float[Array, "3"]) -> bool:
    """Whether the motion keeps to a floor along `axis` at least as well as along `other`.

    A body that crawls or lies from first to last is upright along the wrong axis on average. But its lowest joint then
    wanders along that axis, while along the true one it keeps to one height, which is near zero in most files.
    """
    some = slice(None, None, max(1, len(motion) // FLOOR_FRAMES))
    few = replace(motion, rotations=motion.rotations[some], translations=motion.translations[some])
    _, positions = world_pose(few)
    leg = leg_length(motion.skeleton, humanoid)

    def doubt(up: Array) -> float:
        lowest = (positions @ up).min(axis=1) / max(leg, 1e-12)
        low, middle, high = np.percentile(lowest, (10, 50, 90))
        return float(high - low + ORIGIN_ON_FLOOR * min(abs(middle), 1.0))

    return doubt(axis) <= doubt(other)


def infer_unit(height: float) -> tuple[float, str]:
    """Metres per unit from the body's height in units: the known unit that makes it the most likely height."""
    if LIKELY_HEIGHT[0] <= height <= LIKELY_HEIGHT[1]:
        return 1.0, "metres (the body is then of a likely height)"
    fits = {name: abs(np.log(height * unit / TYPICAL_HEIGHT)) for name, unit in UNITS.items()}
    name = min(fits, key=fits.get)
    if LIKELY_HEIGHT[0] <= height * UNITS[name] <= LIKELY_HEIGHT[1]:
        return UNITS[name], f"{name} (the body is then {height * UNITS[name]:.2f} m tall)"
    return (
        TYPICAL_HEIGHT / height,
        f"no known unit fits a height of {height:.4g}; taken as a body of {TYPICAL_HEIGHT} m",
    )


def make_actor(
    character: Character,
    humanoid: Humanoid,
    convention: Convention | None = None,
    motion: Motion | None = None,
    *,
    up: str | None = None,
    unit: float | None = None,
    rest_surface: Float[Array, "vertices 3"] | None = None,
) -> Actor:
    """Bring a matched body into metres with +Y up.

    `convention` is what its file says, `motion` a clip that shows how it stands, `rest_surface` its rest vertices where
    they are known; `up` ('+y', '+z', ...) and `unit` (metres per unit) override every inference. Raises
    `RetargetError` for an unknown axis or a unit that is not positive.
    """
    convention = convention or Convention()
    notes = []
    height = body_height(character.skeleton, humanoid, rest_surface)
    if not height > 0:
        raise RetargetError("the skeleton has no height: its joints lie on one point")
    if up is not None:
        if up not in AXES:
            raise RetargetError(f"up axis {up!r} is unknown; use one of {', '.join(AXES)}")
        up_axis = AXES[up]
    else:
        stated = convention.up
        # Where file and rest pose agree the motion is not asked: some clips lie down or crawl from first to last.
        agreed = stated in AXES and np.array_equal(AXES[stated], infer_up(humanoid, None)[0])
        up_axis, why = infer_up(humanoid, None if agreed else motion)
        name = next(each for each, axis in AXES.items() if np.allclose(axis, up_axis))
        if stated is None:
            notes.append(f"up axis {name}: {why}")
        elif stated != name:
            notes.append(f"up axis: the file's format says {stated}, but {name} is used: {why}")
    if unit is not None:
        if not (np.isfinite(unit) and unit > 0):
            raise RetargetError(f"unit must be positive metres per unit, received {unit}")
        scale = float(unit)
    elif convention.metres_per_unit is not None and 0.2 <= height * convention.metres_per_unit <= 6.0:
        scale = convention.metres_per_unit
    else:
        scale, why = infer_unit(height)
        notes.append(f"unit: {why}")
    similarity = Similarity(rot.swing_between(up_axis, AXES["+y"]), scale)
    placed = similarity.character(character)
    humanoid = replace(humanoid, axes=rot.rotate(similarity.rotation, humanoid.axes))
    soles: Soles = {}
    if motion is not None and character.skin is None:
        soles = stance_soles(placed, humanoid, similarity.motion(motion))
    return Actor(character, placed, humanoid, similarity, height * scale, tuple(notes), soles)


def stance_soles(character: Character, humanoid: Humanoid, motion: Motion) -> Soles:
    """Upward normals of the soles in their foot joints' frames, from how the feet stand in a motion.

    A bare skeleton does not show whether its feet are flat at rest: in skeletons drawn with legs apart they often roll
    out with the shins. On frames where heel and ball both rest the sole is flat on average; feet that rarely stand, or
    whose rest pose agrees within a few degrees, are left as they are.
    """
    limbs = support_limbs(character, humanoid)[:2]
    rotations, positions = world_pose(motion)
    points = np.concatenate(support_points(limbs, rotations, positions), axis=1)
    contacts = ground_contacts(points, motion.fps, leg_length(character.skeleton, humanoid))
    at_rest, _ = rest_pose(character.skeleton)
    soles: Soles = {}
    for foot, (side, limb) in enumerate(zip(("left", "right"), limbs)):
        flat = contacts.touching[:, 2 * foot : 2 * foot + 2].all(axis=1)
        if flat.sum() < LEAST_STANCE * motion.fps:
            continue
        up = np.array([0.0, 1.0, 0.0])
        normals = rot.rotate(rot.inverse(rotations[flat, limb.joints[2]]), up)
        normal = rot.unit(np.median(normals, axis=0))
        tilt = np.arccos(np.clip(normal @ rot.rotate(rot.inverse(at_rest[limb.joints[2]]), up), -1, 1))
        if SOLE_TILT[0] < tilt < SOLE_TILT[1]:
            soles[side] = normal
    return soles


def facing_name(axes: Float[Array, "3 3"]) -> str:
    """The signed axis that the body faces at rest."""
    nearest = int(np.argmax(np.abs(axes[2])))
    return ("+" if axes[2][nearest] > 0 else "-") + "xyz"[nearest]


def same_skeleton(a: Skeleton, b: Skeleton) -> bool:
    return a is b or (
        a.names == b.names and np.array_equal(a.parents, b.parents) and np.allclose(a.offsets, b.offsets, atol=1e-9)
    )
