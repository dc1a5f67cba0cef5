"""What an interactive view shows of each body: its skin, bones, sensors, and what touches or penetrates what.

Plain arrays, made once; the live viewer (`viewer.py`) and the report's page (`report_page.py`) draw the same ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from retarget.body.kinematics import joint_transforms, rest_pose
from retarget.body.rotations import unit
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Mesh
from retarget.contact.parts import PARTS
from retarget.contact.sensors import Sensors, paper_layout, place_sensors
from retarget.errors import RetargetError
from retarget.evaluate.report_joints import grounds
from retarget.evaluate.report_surface import CHUNK, OF_POSE, SurfaceTrack, surface_track
from retarget.evaluate.take import Take
from retarget.progress import Tell, untold
from retarget.view.bones import bone_character
from retarget.view.surface import prepare_surface, to_srgb

Array = np.ndarray

TOUCHES = 1
"""Code of a vertex that touches another part of its body."""
DEEPEST_MM = 254
"""Depths are told to the millimetre up to here."""
APART = 0.75
"""Body heights between bodies that stand side by side. Ours."""
CALM = 0.4
"""Seconds over which the camera's path is smoothed."""


@dataclass(frozen=True, eq=False)
class Spots:
    """What touches or penetrates what, as codes of vertices: 1 touches (as the pose means it), 1 + d is d mm inside another
    part of the body. Only vertices with a code are listed, frame after frame."""

    starts: Int[Array, "_"]
    """The first row of each frame, and last the number of rows: frames + 1 of them."""
    vertex: Int[Array, "rows"]
    code: UInt8[Array, "rows"]

    def of_frame(self, frame: int) -> tuple[Int[Array, "rows"], UInt8[Array, "rows"]]:
        """Vertices and codes of one frame."""
        rows = slice(*self.starts[frame : frame + 2])
        return self.vertex[rows], self.code[rows]


@dataclass(frozen=True, eq=False)
class StageBody:
    """One body and its performance, in metres with +Y up."""

    label: str
    take: Take
    character: Character
    """What is drawn: the actor's own, or a body of bones for one without a surface."""
    bare: bool
    """Whether it is a body of bones."""
    floor: float
    """Height of the floor it stands on, metres."""
    colors: UInt8[Array, "vertices 3"]
    """sRGB of the material at each vertex; one colour for bones."""
    parts: Int[Array, "vertices"]
    """Index into `contact.parts.PARTS`; -1 where parts are not known."""
    normals: Float[Array, "vertices 3"]
    """Unit, of the mesh as it is bound; smooth except across sharp edges."""
    spots: Spots
    sensors: Sensors | None
    notes: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        return len(self.take)

    def vertices(self, frames: slice) -> Float[Array, "frames vertices 3"]:
        """Posed vertices, metres."""
        return prepare_skinning(self.character).vertices(self.take.rotations[frames], self.take.positions[frames])

    def sensor_places(self, posed: Float[Array, "vertices 3"], above: float) -> Float[Array, "sensors 3"]:
        """Where the valid sensors are on the posed skin, so many metres above it; none for a body without."""
        if self.sensors is None:
            return np.zeros((0, 3))
        corners = posed[self.character.mesh.faces[self.sensors.faces[self.sensors.valid]]].astype(np.float64)
        normals = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        return np.einsum("sc,sci->si", self.sensors.barycentrics[self.sensors.valid], corners) + above * normals


def stage_body(label: str, take: Take, track: SurfaceTrack | None = None, tell: Tell = untold) -> StageBody:
    """Prepare a body to be shown. `track` is what its skin does, where that is known already.

    A surface whose parts cannot be told is shown without spots and sensors, and a note says why.
    """
    floor = grounds(take, take).floor
    if not take.has_surface:
        character = bone_character(take.actor.skeleton)
        none = np.full(len(character.mesh.vertices), -1)
        surface = vertex_colors(character.mesh), none, smooth_vertex_normals(character.mesh)
        return StageBody(label, take, character, True, floor, *surface, no_spots(len(take)), None)
    character, notes, sensors = take.actor.character, [], None
    spots, parts = no_spots(len(take)), np.full(len(character.mesh.vertices), -1)
    try:
        track = surface_track(take, floor, tell) if track is None else track
        spots, parts = spots_of(track), track.parts.vertex_parts
        sensors = place_sensors(character, take.actor.humanoid, paper_layout())
    except RetargetError as error:
        notes.append(f"{label}: contacts, penetration or sensors are not shown: {error}")
    colors, normals = vertex_colors(character.mesh), smooth_vertex_normals(character.mesh)
    return StageBody(label, take, character, False, floor, colors, parts, normals, spots, sensors, tuple(notes))


def drawn_bones(body: StageBody) -> Int[Array, "bones"]:
    """The joints to whose parents a line is drawn: all below the hips. Roots on the floor and control joints that hang on
    them are no bones of a body."""
    parents, hips = body.take.actor.skeleton.parents, body.take.actor.humanoid.joints["hips"]
    below = np.zeros(len(parents), dtype=bool)
    for joint in range(hips + 1, len(parents)):
        below[joint] = parents[joint] == hips or below[parents[joint]]
    return np.flatnonzero(below)


def no_spots(frames: int) -> Spots:
    """For a body whose skin is not known."""
    return Spots(np.zeros(frames + 1, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint8))


def spots_of(track: SurfaceTrack) -> Spots:
    """Codes of a body's vertices over a clip. Contacts that only its girth makes are left out."""
    frames, parts, faces = len(track.take), track.parts, track.take.actor.character.mesh.faces
    contacts = track.contacts
    meant = contacts.tracks.pose_probability[contacts.track] >= OF_POSE
    starts, vertices, codes = [np.zeros(1, dtype=np.int64)], [], []
    for start in range(0, frames, CHUNK):
        stop = min(start + CHUNK, frames)
        code = np.zeros((stop - start, len(parts.vertex_parts)), dtype=np.uint8)
        rows = np.flatnonzero(meant & (contacts.frame >= start) & (contacts.frame < stop))
        at = contacts.frame[rows] - start
        touched = np.concatenate([contacts.vertex[rows][:, None], faces[contacts.face[rows]]], axis=1)
        code[at[:, None], parts.welded[touched]] = TOUCHES
        code = code[:, parts.welded]
        depth = np.minimum(np.round(1000 * track.depths.dense(start, stop, parts)), DEEPEST_MM).astype(np.uint8)
        code = np.where(depth > 0, depth + 1, code).astype(np.uint8)
        frame, vertex = np.nonzero(code)
        starts.append(np.bincount(frame, minlength=stop - start))
        vertices.append(vertex)
        codes.append(code[frame, vertex])
    none = no_spots(0)
    return Spots(
        np.cumsum(np.concatenate(starts)),
        np.concatenate([none.vertex, *vertices]).astype(np.int64),
        np.concatenate([none.code, *codes]).astype(np.uint8),
    )


def vertex_colors(mesh: Mesh) -> UInt8[Array, "vertices 3"]:
    """The material's base colour at each vertex, sRGB. A vertex between two materials shows the last face's."""
    surface = prepare_surface(mesh)
    corners, owner = surface.mesh.faces.ravel(), np.repeat(surface.material, 3)
    color = surface.factors[owner]
    for index, levels in enumerate(surface.textures):
        if levels is not None:
            mine = np.flatnonzero(owner == index)
            high, wide = levels[0].shape[:2]
            x, y = np.floor((surface.mesh.uvs[corners[mine]] % 1.0) * [wide, high]).astype(np.int64).T
            color[mine] *= levels[0][np.minimum(y, high - 1), np.minimum(x, wide - 1)]
    colors = np.full((len(mesh.vertices), 3), 158, dtype=np.uint8)
    colors[surface.kept[corners]] = to_srgb(color)
    return colors


def smooth_vertex_normals(mesh: Mesh) -> Float[Array, "vertices 3"]:
    """Unit normals. Halves of a vertex split by a texture seam are lit as one, those split by a sharp edge are not."""
    _, group = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)
    triangles = mesh.vertices[mesh.faces]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])  # weighted by area
    own, together = np.zeros_like(mesh.vertices), np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(own, mesh.faces[:, corner], normal)
        np.add.at(together, group.reshape(-1)[mesh.faces[:, corner]], normal)
    own, together = unit(own), unit(together[group.reshape(-1)])
    alike = (own * together).sum(axis=1) > 0.75
    return np.where(alike[:, None], together, own)


# --- where bodies stand ---------------------------------------------------------------------------------------------


def facing(body: StageBody) -> Float[Array, "3"]:
    """The horizontal direction, unit, that the body faces on average; +Z where it turns all round."""
    left, right = (body.take.joints([f"{side}UpperLeg"])[:, 0] for side in ("left", "right"))
    forward = np.cross(unit(left - right), [0.0, 1.0, 0.0]).mean(axis=0) * [1.0, 0.0, 1.0]
    length = np.linalg.norm(forward)
    return forward / length if length > 0.2 else np.array([0.0, 0.0, 1.0])


def same_sizes(bodies: Sequence[StageBody]) -> list[float]:
    """By how much each body is to be enlarged to be as tall as the first."""
    return [bodies[0].take.actor.height / body.take.actor.height for body in bodies]


def layout(
    bodies: Sequence[StageBody], overlaid: bool = False, sizes: Sequence[float] | None = None
) -> Float[Array, "bodies 3"]:
    """How far each body is moved, after it was enlarged by `sizes` (1 if not given): the first ends in the middle of the
    row or all in one place, starting there, with the floor at height 0. Side by side they stand across the first one's
    facing, each further one to the left on the screen."""
    sizes = [1.0] * len(bodies) if sizes is None else sizes
    forward = facing(bodies[0])
    aside = np.cross([0.0, 1.0, 0.0], forward)  # the body's left, the screen's right
    apart = APART * max(size * body.take.actor.height for size, body in zip(sizes, bodies))
    apart += max(size * _reach(body) for size, body in zip(sizes, bodies))
    moves = []
    for number, (size, body) in enumerate(zip(sizes, bodies)):
        start = body.take.joints(["hips"])[0, 0]
        move = -size * np.array([start[0], body.floor, start[2]])
        moves.append(move if overlaid else move - aside * (number - (len(bodies) - 1) / 2) * apart)
    return np.stack(moves)


def _reach(body: StageBody) -> float:
    """How much farther than half a body height its joints reach from the hips, at most half a body height."""
    hips = body.take.joints(["hips"])
    far = float(np.percentile(np.abs((body.take.positions - hips)[..., [0, 2]]).max(axis=(1, 2)), 95))
    return min(max(far - 0.5 * body.take.actor.height, 0.0), 0.5 * body.take.actor.height)


def camera_path(body: StageBody) -> Float[Array, "frames 3"]:
    """What the camera looks at to follow the body: its hips without their sway, at half the body's height over the floor."""
    from scipy.ndimage import gaussian_filter1d

    path = body.take.joints(["hips"])[:, 0].copy()
    path[:, 1] = body.floor + 0.5 * body.take.actor.height
    return gaussian_filter1d(path, CALM * body.take.fps, axis=0, mode="nearest")


# --- what the browser moves by itself -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RigidSkin:
    """A skin as browsers know it: at most so many influences a vertex, each a rigid bone that starts at rest."""

    vertices: Float[Array, "vertices 3"]
    """At rest, metres."""
    columns: Int[Array, "vertices influences"]
    weights: Float[Array, "vertices influences"]
    rotations: Float[Array, "joints 4"]
    """World rotations at rest, xyzw; a column is a joint."""
    positions: Float[Array, "joints 3"]
    error: float
    """The farthest that a vertex strays from where the full skin has it, over the clip, metres."""


def strongest(
    columns: Int[Array, "vertices influences"], weights: Float[Array, "vertices influences"], most: int
) -> tuple[Int[Array, "vertices most"], Float[Array, "vertices most"]]:
    """The `most` strongest influences of each vertex, their weights brought to a sum of one; filled up with zeros."""
    missing = max(most - weights.shape[1], 0)
    columns, weights = (np.pad(values, ((0, 0), (0, missing))) for values in (columns, weights))
    order = np.argsort(-weights, axis=1, kind="stable")[:, :most]
    columns, weights = np.take_along_axis(columns, order, axis=1), np.take_along_axis(weights, order, axis=1)
    return columns, weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)


def rigid_skin(body: StageBody, most: int = 4, looks: int = 24) -> RigidSkin:
    """The body's skin with `most` influences over rigid bones, and what that errs by on `looks` frames of the clip."""
    character = body.character
    rotations, positions = rest_pose(character.skeleton)
    rest = prepare_skinning(character).vertices(rotations[None], positions[None])[0].astype(np.float64)
    columns, weights = strongest(character.skin.joints[character.skin.columns], character.skin.weights, most)
    binds = np.linalg.inv(joint_transforms(rotations, positions))
    skin = replace(
        character.skin, joints=np.arange(len(positions)), inverse_binds=binds, columns=columns, weights=weights
    )
    plain = replace(character, mesh=replace(character.mesh, vertices=rest), skin=skin)
    chosen = np.unique(np.linspace(0, body.frames - 1, looks).round().astype(int))
    pose = body.take.rotations[chosen], body.take.positions[chosen]
    off = prepare_skinning(plain).vertices(*pose) - prepare_skinning(character).vertices(*pose)
    return RigidSkin(rest, columns, weights, rotations, positions, float(np.linalg.norm(off, axis=-1).max(initial=0.0)))


def part_colors() -> UInt8[Array, "parts 3"]:
    """A colour for each of `PARTS`: left and right alike in hue, the right darker."""
    import colorsys

    hues = {name.removeprefix("left").removeprefix("right"): None for name in PARTS}
    found = []
    for name in PARTS:
        bare = name.removeprefix("left").removeprefix("right")
        hue = list(hues).index(bare) / len(hues)
        value = 0.62 if name.startswith("right") else 0.88
        found.append([round(255 * each) for each in colorsys.hsv_to_rgb(hue, 0.5, value)])
    return np.array(found, dtype=np.uint8)
