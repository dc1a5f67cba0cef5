"""Clothes and hair on the embedded human: what scanners see of people, moved by the bones of the body beneath.

Close garments are the skin itself, moved outward by up to 4 cm, unevenly and with wrinkles; skirts, coats, long hair,
hats and shoes are surfaces of their own. How they are shaped is ours, and no cloth is simulated: everything follows the
nearest skin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.human import HumanModel, human_model
from retarget.character import Character, Material, Mesh, Skin
from retarget.errors import RetargetError
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface, subdivide
from retarget.geometry.topology import vertex_normals

Array = np.ndarray

THICKEST = 0.04
"""Metres that a close garment stands away from the skin, at most, on a body of 1.7 m."""
SLEEVES = (("UpperArm",), ("UpperArm", "Forearm"))
LEGS = (("Thigh",), ("Thigh", "Shin"))
ROUND, DOWN = 48, 14
"""Vertices of a hanging surface, around the body and down."""
CLOTH = Material("cloth", (0.35, 0.4, 0.5, 1.0), double_sided=True)


@dataclass(frozen=True)
class Outfit:
    """What is worn. Lengths are metres on a body of 1.7 m and grow with it."""

    top: float = 0.0
    """How far shirt, jumper or jacket stand away; 0 is none."""
    sleeves: int = 1
    """0 none, 1 to the elbow, 2 to the wrist."""
    trousers: float = 0.0
    legs: int = 2
    """0 none, 1 to the knee, 2 to the ankle."""
    wrinkles: float = 0.3
    """Height of wrinkles, as a part of how far the garment stands away."""
    skirt: float = 0.0
    """How far a skirt hangs below the waist, as a part of the way to the ground; 0 is none."""
    coat: bool = False
    """Whether what hangs begins at the chest."""
    flare: float = 0.1
    """How much wider it gets at its hem."""
    hair: float = 0.0
    """How far hair stands away from the scalp."""
    hair_length: float = 0.0
    """How far it hangs below the ears."""
    hat: float = 0.0
    """How far a hat stands away; 0 is none."""
    brim: float = 0.0
    shoes: float = 0.0
    """How far shoes stand away; 0 is none."""


def random_outfit(seed: int | Sequence[int]) -> Outfit:
    """An outfit as people wear them. The same seed gives the same."""
    draw = np.random.default_rng(seed)
    hat = draw.random() < 0.2
    return Outfit(
        top=float(draw.uniform(0.004, THICKEST)) if draw.random() < 0.9 else 0.0,
        sleeves=int(draw.integers(0, 3)),
        trousers=float(draw.uniform(0.004, 0.03)) if draw.random() < 0.75 else 0.0,
        legs=int(draw.integers(1, 3)),
        wrinkles=float(draw.uniform(0.1, 0.5)),
        skirt=float(draw.uniform(0.3, 0.9)) if draw.random() < 0.35 else 0.0,
        coat=bool(draw.random() < 0.35),
        flare=float(draw.uniform(0.02, 0.25)),
        hair=float(draw.uniform(0.005, 0.05)) if draw.random() < 0.85 else 0.0,
        hair_length=float(draw.uniform(0.05, 0.4)) if draw.random() < 0.4 else 0.0,
        hat=float(draw.uniform(0.01, 0.03)) if hat else 0.0,
        brim=float(draw.uniform(0.03, 0.1)) if hat and draw.random() < 0.6 else 0.0,
        shoes=float(draw.uniform(0.005, 0.015)) if draw.random() < 0.8 else 0.0,
    )


def dressed(character: Character, outfit: Outfit | None = None, seed: int | Sequence[int] = 0) -> Character:
    """An embedded human in clothes: the same skeleton, more surface, which moves with the skin beneath.

    The first vertices are the body's, in their order, those under close garments moved outward. `outfit` is one of the
    seed if not given. Equal input gives equal output. Raises `RetargetError` for a character on another topology.
    """
    model = human_model()
    if character.mesh is None or not np.array_equal(character.mesh.faces, model.faces):
        raise RetargetError(
            f"{character.name or 'the character'} is not on the embedded human's topology, for which clothes are cut"
        )
    outfit = outfit or random_outfit(seed)
    draw = np.random.default_rng(seed)
    body = Surface(character.mesh.vertices, model.faces)
    size = float(np.ptp(body.vertices[:, 1])) / 1.7
    close = Surface(body.vertices + size * _close_garments(body, model, outfit, size, draw), body.faces)
    pieces = [*_hanging_pieces(close, model, outfit, size, draw), *_worn_pieces(close, model, outfit, size)]
    faces, count = [close.faces], len(close)
    for piece, _ in pieces:
        faces.append(piece.faces + count)
        count += len(piece)
    vertices = np.concatenate([close.vertices, *(piece.vertices for piece, _ in pieces)])
    skin = _skin(character.skin, close, pieces)
    materials = (*character.mesh.materials, CLOTH)
    own = (
        character.mesh.face_materials
        if character.mesh.face_materials is not None
        else np.zeros(len(close.faces), dtype=np.int64)
    )
    cloth = np.full(sum(map(len, faces[1:])), len(materials) - 1)
    mesh = Mesh(vertices, np.concatenate(faces), materials=materials, face_materials=np.concatenate([own, cloth]))
    return replace(character, mesh=mesh, skin=skin, name=f"{character.name} dressed", origin=None)


def layer(
    fine: Surface, placing: object, body: Surface, parts: list[int], away: float, above: bool = False
) -> tuple[Surface, Places]:
    """A copy of parts of the skin, held away from it, with a border; of the upper half of a head only for a hat
    (`above`).

    `fine` and `placing` are `subdivide(body)`; `body` is on the embedded topology. Also tells where each vertex lies on
    the body.
    """
    model = human_model()
    inside = np.isin(model.vertex_parts, parts)
    if above:
        crown, chin = (body.vertices[model.landmark(name)] for name in ("crown", "chin"))
        inside &= (body.vertices - chin) @ (crown - chin) > 0.55 * ((crown - chin) ** 2).sum()
    reach = placing @ inside.astype(float)
    faces = fine.faces[(reach[fine.faces] > 0.9).all(axis=1)]
    used, packed = np.unique(faces, return_inverse=True)
    outward = vertex_normals(fine.vertices, fine.faces)[used]
    rows = placing[used].tocsr()
    corners = np.zeros((len(used), 3), dtype=np.int64)
    weights = np.zeros((len(used), 3))
    for row in range(len(used)):
        own = slice(rows.indptr[row], rows.indptr[row + 1])
        count = own.stop - own.start
        corners[row, :count], weights[row, :count] = rows.indices[own], rows.data[own]
    return Surface(fine.vertices[used] + away * outward, packed.reshape(-1, 3)), Places(corners, weights)


def smoothed(
    values: Float[Array, "vertices *axes"], surface: Surface, rounds: int = 6
) -> Float[Array, "vertices *axes"]:
    """Values of vertices, mixed with those of their neighbours."""
    from scipy.sparse import csr_matrix, diags

    rows, columns = surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T
    graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(surface), len(surface)))
    graph = diags(1.0 / np.maximum(np.asarray(graph.sum(axis=1)).ravel(), 1)) @ graph
    for _ in range(rounds):
        values = 0.5 * values + 0.5 * (graph @ values)
    return values


def _parts(model: HumanModel, *names: str) -> Bool[Array, "vertices"]:
    """Vertices of body parts; those of limbs are named without their side."""
    wanted = [
        number
        for number, part in enumerate(model.part_names)
        if part.removeprefix("left").removeprefix("right") in names
    ]
    return np.isin(model.vertex_parts, wanted)


def _close_garments(
    body: Surface, model: HumanModel, outfit: Outfit, size: float, draw: np.random.Generator
) -> Float[Array, "vertices 3"]:
    """What moves the skin outward, on a body of 1.7 m."""
    places = body.vertices / size
    away = np.zeros(len(body))
    top = ("chest", "abdomen", *sum(SLEEVES[max(outfit.sleeves, 1) - 1 : outfit.sleeves], ()))
    trousers = ("pelvis", *sum(LEGS[max(outfit.legs, 1) - 1 : outfit.legs], ()))
    for thickness, names in ((outfit.top, top), (outfit.trousers, trousers)):
        uneven = 1.0 + 0.5 * _waves(places, (0.2, 0.6), draw)
        folds = _waves(places, (0.04, 0.1), draw) * (0.6 + 0.4 * _waves(places, (0.3, 0.6), draw))
        garment = (
            thickness * (uneven + outfit.wrinkles * folds) * smoothed(_parts(model, *names).astype(float), body, 3)
        )
        away = np.maximum(away, np.clip(garment, 0.0, THICKEST))
    tufts = 1.0 + 0.4 * _waves(places, (0.03, 0.12), draw)
    away = np.maximum(away, np.clip(outfit.hair * tufts, 0.0, 0.08) * smoothed(_scalp(body, model), body, 3))
    outward = smoothed(vertex_normals(body.vertices, body.faces), body, 4)
    return away[:, None] * outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)


def _scalp(body: Surface, model: HumanModel) -> Float[Array, "vertices"]:
    """1 where hair grows: behind the face, and above it."""
    nose, back, brow, crown = (
        body.vertices[model.landmark(name)] for name in ("nose", "backOfHead", "forehead", "crown")
    )
    forward = (nose - back) * [1.0, 0.0, 1.0]
    behind = (body.vertices - back) @ forward < 0.5 * (forward @ forward)
    high = body.vertices[:, 1] > brow[1] + 0.35 * (crown - brow)[1]
    low = body.vertices[:, 1] < nose[1] - (crown - nose)[1] * 0.35
    return (_parts(model, "head") & (behind | high) & ~low).astype(float)


def _waves(
    places: Float[Array, "vertices 3"], lengths: tuple[float, float], draw: np.random.Generator
) -> Float[Array, "vertices"]:
    """A random smooth function of space between about -1 and 1: six waves of random direction, length (metres) and
    phase."""
    along = draw.normal(size=(6, 3))
    along *= 2 * np.pi / (draw.uniform(*lengths, size=(6, 1)) * np.linalg.norm(along, axis=1, keepdims=True))
    return np.sin(places @ along.T + draw.uniform(0, 2 * np.pi, 6)).sum(axis=1) / np.sqrt(12)


def _hanging_pieces(close: Surface, model: HumanModel, outfit: Outfit, size: float, draw: np.random.Generator) -> list:
    """Skirt or coat, and long hair, each with the vertices of the body that it follows."""
    found = []
    waist, ground = close.vertices[model.landmark("navel")][1], close.vertices[:, 1].min()
    if outfit.skirt:
        names = ("pelvis", "Thigh", "Shin", "abdomen") + (("chest",) if outfit.coat else ())
        own = np.flatnonzero(_parts(model, *names))
        begin = close.vertices[model.landmark("chest")][1] if outfit.coat else waist
        end = waist - outfit.skirt * (waist - ground) * 0.95
        ease = 0.012 if outfit.coat else 0.006
        found.append((_hanging(close.vertices[own], begin, end, (-np.pi, np.pi), ease, outfit.flare, size, draw), own))
    if outfit.hair and outfit.hair_length:
        ear = close.vertices[model.landmark("leftEar")]
        middle = 0.5 * (ear + close.vertices[model.landmark("rightEar")])
        narrow = (
            np.abs(close.vertices[:, 0] - middle[0]) < 0.09 * size
        )  # hair falls behind the shoulders, not over them
        own = np.flatnonzero(_parts(model, "head", "neck") | (_parts(model, "chest") & narrow))
        end = ear[1] - outfit.hair_length * size
        span = (0.55 * np.pi, 1.45 * np.pi)
        found.append(
            (_hanging(close.vertices[own], ear[1] + 0.03 * size, end, span, 0.005, 0.02, size, draw, middle), own)
        )
    if outfit.hat and outfit.brim:
        own = np.flatnonzero(_parts(model, "head"))
        crown, chin = (close.vertices[model.landmark(name)] for name in ("crown", "chin"))
        rim = chin[1] + 0.56 * (crown - chin)[1]
        middle = close.vertices[own].mean(axis=0)
        ends = (rim, rim - 0.01 * size)
        found.append(
            (_hanging(close.vertices[own], *ends, (-np.pi, np.pi), outfit.hat, outfit.brim, size, draw, middle), own)
        )
    return found


def _hanging(
    points: Float[Array, "points 3"],
    begin: float,
    end: float,
    span: tuple[float, float],
    ease: float,
    flare: float,
    size: float,
    draw: np.random.Generator,
    middle: Float[Array, "3"] | None = None,
) -> Surface:
    """A surface that hangs around points from one height to another: as far out as what it passes, never narrower
    below, with folds that grow to its hem. `span` are angles about +Y from +Z towards +X; lengths beside heights grow
    with `size`."""
    middle = points.mean(axis=0) if middle is None else middle
    whole = span[1] - span[0] >= 2 * np.pi - 1e-9
    angles = np.linspace(*span, ROUND, endpoint=not whole)
    toward = np.stack([np.sin(angles), np.cos(angles)])
    levels = np.linspace(begin, end, DOWN)
    apart = points[:, [0, 2]] - middle[[0, 2]]
    reach = np.zeros((DOWN, ROUND))
    for row, level in enumerate(levels):
        near = np.abs(points[:, 1] - level) < 0.05 * size
        reach[row] = (apart[near] @ toward).max(axis=0, initial=0.0)
    reach = np.maximum.accumulate(reach, axis=0)
    down = np.linspace(0.0, 1.0, DOWN)[:, None]
    waves = np.sin(angles * draw.integers(5, 14) + draw.uniform(0, 2 * np.pi)) * draw.uniform(0.1, 0.35)
    reach = reach + size * (ease + flare * down**1.2 * (1.0 + waves))
    vertices = np.stack(
        [reach * toward[0] + middle[0], np.broadcast_to(levels[:, None], reach.shape), reach * toward[1] + middle[2]],
        axis=-1,
    )
    here = np.arange(DOWN * ROUND).reshape(DOWN, ROUND)
    here = np.concatenate([here, here[:, :1]], axis=1) if whole else here
    a, b, c, d = here[:-1, :-1].ravel(), here[:-1, 1:].ravel(), here[1:, 1:].ravel(), here[1:, :-1].ravel()
    return Surface(vertices.reshape(-1, 3), np.concatenate([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)]))


def _worn_pieces(close: Surface, model: HumanModel, outfit: Outfit, size: float) -> list:
    """Shoes and hat, each with the vertices of the body that it follows."""
    found = []
    if not (outfit.shoes or outfit.hat):
        return found
    fine, placing = subdivide(close)
    number = {name: number for number, name in enumerate(model.part_names)}
    if outfit.shoes:
        for side in ("left", "right"):
            shoe, _ = layer(fine, placing, close, [number[f"{side}Foot"]], outfit.shoes * size)
            lowest = close.vertices[:, 1].min()
            shoe = Surface(
                np.maximum(shoe.vertices, [-np.inf, lowest, -np.inf]), shoe.faces
            )  # soles stand on the floor
            found.append((shoe, model.part_vertices(f"{side}Foot")))
    if outfit.hat:
        hat, _ = layer(fine, placing, close, [number["head"]], outfit.hat * size, above=True)
        found.append((hat, model.part_vertices("head")))
    return found


def _skin(skin: Skin, close: Surface, pieces: list[tuple[Surface, Int[Array, "_"]]]) -> Skin:
    """The body's skin, and for what is worn that of the nearest vertex beneath, smoothed over each piece."""
    from scipy.spatial import cKDTree

    count = skin.columns.shape[1]
    dense = np.zeros((len(close), len(skin.joints)))
    np.add.at(dense, (np.arange(len(close))[:, None], skin.columns), skin.weights)
    columns, weights = [skin.columns], [skin.weights]
    for piece, own in pieces:
        nearest = own[cKDTree(close.vertices[own]).query(piece.vertices)[1]]
        soft = smoothed(dense[nearest], piece, 8)
        chosen = np.argsort(-soft, axis=1, kind="stable")[:, :count]
        share = np.take_along_axis(soft, chosen, axis=1)
        columns.append(chosen)
        weights.append(share / share.sum(axis=1, keepdims=True))
    return replace(skin, columns=np.concatenate(columns), weights=np.concatenate(weights))
