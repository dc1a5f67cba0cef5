"""Clouds that networks learn from, made on the fly: bodies of the whole shape space in real and made-up poses, as scanners see them.

Bodies are baked once to samples spread evenly over their skin, and kept in a folder outside the package. Every batch
is a function of its number alone, so a training that is taken up again sees what it would have seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import forward
from retarget.evaluate.scan_split import BODY_SEEDS, drawn_shape
from retarget.geometry.topology import vertex_normals
from retarget.methods.scan.features import CELL, JOINTS, Bodies, Clouds
from retarget.train.poses import Poses, drawn_poses, gather_poses

Array = np.ndarray

SAMPLES = 8192
"""Evenly spread samples of a body; its vertices come behind them."""
INFLUENCES = 5
ROOM = 9216
"""Points of a cloud at most."""
STRAYS, FLOOR = 0.02, 600
"""Share of points anywhere, and number of points on the floor, at most."""
GARMENTS = {
    "none": (4, 5, 9, 17), "trunk": (0, 1, 2, 3, 6, 14), "sleeves": (7, 15), "cuffs": (8, 16), "thighs": (10, 18),
    "shins": (11, 19), "shoes": (12, 13, 20, 21), "hair": (),
}  # fmt: skip
"""What may be worn, and by the skin of which joints; hair by the back and top of the head."""
HUNG_AROUND = ("pelvis", "Thigh", "Shin", "abdomen", "chest")
"""Parts of the body that skirts and coats reach around."""
USUAL, LOOSEST = (0.0, 0.7, 0.7, 0.4, 0.8, 0.6, 0.7, 0.5), (0.0, 0.04, 0.035, 0.035, 0.04, 0.04, 0.02, 0.07)
"""Chance of each garment on a dressed body, and how far it stands off at most (metres on a body 1.7 m tall)."""
SKIRT = 0.35
"""Share of dressed bodies with a skirt, or a coat."""
LEVELS, AROUND = 16, 24
"""Of the table of how far a body reaches out: heights from the chest to the ground, and directions."""
HALF_VIEWS = 0.85
"""Chance that cameras look at a body that is not plain (in the regressor's first two trainings .55)."""
SORTS = ("clean", "noise", "holes", "half", "cloth", "sparse", "skirt")
"""What clouds are tested on: one trouble at a time."""


@dataclass(frozen=True, eq=False)
class Wardrobe:
    """Bodies, baked. Axis `samples`: spread samples, then vertices, each in random order."""

    rests: Float[Array, "bodies samples 3"]
    normals: Float[Array, "bodies samples 3"]
    columns: Integer[Array, "bodies samples influences"]
    weights: Float[Array, "bodies samples influences"]
    garments: Integer[Array, "bodies samples"]
    joints: Float[Array, "bodies joints 3"]
    heights: Float[Array, "bodies"]
    reaches: Float[Array, "bodies levels around"]
    """Metres from the body's axis to its trunk's and legs' hull, from the chest's height down to the ground."""
    axes: Float[Array, "bodies 5"]
    """x and z of that axis, heights (metres) of chest, waist and ground."""


def bake_bodies(seeds: Sequence[int], cache: Path | None = None) -> Wardrobe:
    """The bodies of these seeds of `scan_split.drawn_shape`; taken from the folder `cache` where it has them."""
    path = None if cache is None else cache / f"reaching_bodies_{seeds[0]}_{seeds[-1]}_{len(seeds)}.npz"
    if path is not None and path.exists():
        with np.load(path) as stored:
            return Wardrobe(**{name: stored[name] for name in stored.files})
    baked = [_baked(seed) for seed in seeds]
    wardrobe = Wardrobe(*(np.stack(column) for column in zip(*baked)))
    if path is not None:
        cache.mkdir(parents=True, exist_ok=True)
        np.savez(path.with_suffix(".part.npz"), **vars(wardrobe))
        path.with_suffix(".part.npz").rename(path)
    return wardrobe


def _baked(seed: int) -> tuple[Array, ...]:
    draw = np.random.default_rng([seed, 3])
    body, model = human(**drawn_shape(seed)), human_model()
    vertices, faces = body.mesh.vertices, body.mesh.faces
    normals = vertex_normals(vertices, faces)
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = faces[draw.choice(len(faces), size=SAMPLES, p=areas / areas.sum())]
    shares = draw.dirichlet(np.ones(3), SAMPLES)
    dense = np.zeros((len(vertices), len(model.joint_names)))
    np.add.at(dense, (np.arange(len(vertices))[:, None], body.skin.columns), body.skin.weights)
    mixed = np.einsum("sc,scj->sj", shares, dense[chosen])
    order = draw.permutation(len(vertices))
    weights = np.concatenate([mixed, dense[order]])
    rest = np.concatenate([np.einsum("sc,sca->sa", shares, vertices[chosen]), vertices[order]])
    normal = np.concatenate([rot.unit(np.einsum("sc,sca->sa", shares, normals[chosen])), normals[order]])
    columns = np.argsort(-weights, axis=1)[:, :INFLUENCES]
    kept = np.take_along_axis(weights, columns, axis=1)
    kept /= kept.sum(axis=1, keepdims=True)
    height = float(np.ptp(vertices[:, 1]))
    joints = model.joints(vertices)
    return (
        rest.astype(np.float32), normal.astype(np.float32), columns.astype(np.uint8), kept.astype(np.float32),
        _garments(rest, columns[:, 0], vertices), joints, np.array(height), *_reaches(vertices, height),
    )  # fmt: skip


def _reaches(vertices: Array, height: float) -> tuple[Array, Array]:
    """What hangs around a body hangs around this, as in `geometry.clothes`."""
    model = human_model()
    names = [name.removeprefix("left").removeprefix("right") for name in model.part_names]
    own = vertices[np.isin(model.vertex_parts, [n for n, name in enumerate(names) if name in HUNG_AROUND])]
    middle = own.mean(axis=0)
    chest, waist = (vertices[model.landmark(name)][1] for name in ("chest", "navel"))
    angles = np.linspace(-np.pi, np.pi, AROUND, endpoint=False)
    toward, apart = np.stack([np.sin(angles), np.cos(angles)]), own[:, [0, 2]] - middle[[0, 2]]
    reach = np.zeros((LEVELS, AROUND))
    for row, level in enumerate(np.linspace(chest, vertices[:, 1].min(), LEVELS)):
        near = np.abs(own[:, 1] - level) < 0.03 * height
        reach[row] = (apart[near] @ toward).max(axis=0, initial=0.0)
    return reach.astype(np.float32), np.array([middle[0], middle[2], chest, waist, vertices[:, 1].min()])


def _garments(rest: Array, owner: Array, vertices: Array) -> Array:
    """Which of `GARMENTS` each sample would wear."""
    worn = np.zeros(len(rest), dtype=np.uint8)
    for number, joints in enumerate(GARMENTS.values()):
        worn[np.isin(owner, joints)] = number
    crown, eyes, nape = (vertices[human_model().landmark(name)] for name in ("crown", "nose", "chin"))
    behind = rest[:, 2] < 0.5 * (crown[2] + eyes[2])
    scalp = (owner == 5) & ((rest[:, 1] > eyes[1] + 0.45 * (crown[1] - eyes[1])) | (behind & (rest[:, 1] > nape[1])))
    worn[scalp] = list(GARMENTS).index("hair")
    return worn


@dataclass(frozen=True, eq=False)
class CloudMaker:
    """Makes batches; `prepare_clouds` gathers what it needs."""

    wardrobe: Wardrobe
    poses: Poses
    seed: int = 0
    made_up: bool = True
    """Whether poses are mixed, replaced and shaken, or frames as they are."""

    def batch(self, number: int, count: int, sort: str = "") -> tuple[Clouds, Bodies]:
        """The batch of a number: clouds, and the true joints in them. `sort` is one of `SORTS`; '' mixes all troubles."""
        from retarget.train.scan_kernels import scan_all

        draw = np.random.default_rng([self.seed, number, 7])
        chosen = draw.integers(len(self.wardrobe.joints), size=count)
        turns, places, transforms = self._posed(chosen, draw)
        look = _look(self.wardrobe, chosen, draw, sort)
        clouds = np.empty((count, ROOM, 3), np.float32), np.empty((count, ROOM + 1), np.int32)
        boxes, blocks = np.empty((count, 6, ROOM), np.float32), np.empty(count, np.int64)
        own = self.wardrobe
        chance = draw.normal(size=1 << 16).astype(np.float32)
        middles = scan_all(
            draw.integers(1 << 31, size=count), chosen, own.rests, own.normals, own.columns, own.weights, own.garments,
            *look[:2], transforms, *look[2:4], *_skirts(own, chosen, look[-1], draw), *look[4:-1], chance, CELL, *clouds, boxes,
            blocks,
        )  # fmt: skip
        found = Clouds(*clouds, boxes, blocks, middles)
        return found, Bodies((places - middles[:, None]).astype(np.float32), turns.astype(np.float32))

    def _posed(self, chosen: Int[Array, "count"], draw: np.random.Generator) -> tuple[Array, Array, Array]:
        """World turns (as matrices) and places of the body's joints, and what skins the samples."""
        parents = human_model().parents
        scale = draw.uniform(0.94, 1.06, size=(len(chosen), 1, 1))
        joints = self.wardrobe.joints[chosen] * scale
        offsets = joints - np.where(parents[:, None] >= 0, joints[:, parents], 0.0)
        turns, places = forward(parents, drawn_poses(self.poses, len(chosen), draw, self.made_up), offsets)
        matrices = rot.to_matrix(turns)
        shift = places - np.matmul(matrices, joints[..., None])[..., 0]
        transforms = np.concatenate([matrices * scale[..., None], shift[..., None]], axis=-1).astype(np.float32)
        transforms = transforms.reshape(*transforms.shape[:2], 12)
        return matrices[:, :JOINTS], places[:, :JOINTS], transforms


def _look(own: Wardrobe, chosen: Int[Array, "count"], draw: np.random.Generator, sort: str) -> tuple[Array, ...]:
    """How each body is dressed and scanned: what `scan_all` takes, from `starts` on but for skirts, and who wears one."""
    count = len(chosen)

    def mostly(share: float) -> Array:
        return draw.random(count) < share

    plain = mostly(0.22)
    troubles = {
        "noise": ~plain & mostly(0.6), "holes": ~plain & mostly(0.35), "half": ~plain & mostly(HALF_VIEWS),
        "cloth": ~plain & mostly(0.55), "sparse": mostly(0.25), "strays": ~plain & mostly(0.25),
    }  # fmt: skip
    if sort:
        wanted = {sort} | ({"noise"} if sort == "half" else {"cloth"} if sort == "skirt" else set())
        troubles = {name: np.full(count, name in wanted) for name in troubles}
    skirts = troubles["cloth"] & (mostly(SKIRT) if not sort else sort == "skirt")
    vertices = mostly(0.3) & ~troubles["half"]
    starts = np.where(vertices, SAMPLES, 0)
    ends = np.where(vertices, own.rests.shape[1], SAMPLES)
    amount = np.array(LOOSEST) * draw.uniform(size=(count, len(LOOSEST))) * (draw.random((count, len(USUAL))) < USUAL)
    loose = np.where(troubles["cloth"][:, None], amount, 0.0) * own.heights[chosen, None] / 1.7
    waves = np.concatenate([draw.uniform(6, 25, (count, 3)), draw.uniform(0, 2 * np.pi, (count, 3))], axis=1)
    cameras, views = _cameras(count, draw)
    views = np.where(troubles["half"], 1 if sort else views, 0)
    holes = np.where(troubles["holes"], draw.integers(1, 7, count), 0)
    noise = np.where(troubles["noise"], 0.01 if sort else np.abs(draw.normal(size=count)) * 0.008, 0.0)
    few = 500 if sort else np.exp(draw.uniform(np.log(400), np.log(3000), count))
    many = SAMPLES if sort else draw.integers(2500, 6500, count)
    wanted = np.where(troubles["sparse"], few, many).astype(np.int64)
    strays = np.where(troubles["strays"], draw.uniform(0, STRAYS, count), 0.0)
    floor = np.where(troubles["strays"] & mostly(0.5), draw.integers(20, FLOOR, count), 0)
    return (
        starts, ends, loose.astype(np.float32), waves.astype(np.float32), cameras, views, holes,
        draw.uniform(0.04, 0.14, count).astype(np.float32), noise.astype(np.float32), wanted, strays, floor, skirts,
    )  # fmt: skip


def _skirts(
    own: Wardrobe, chosen: Int[Array, "count"], worn: Bool[Array, "count"], draw: np.random.Generator
) -> tuple[Array, Array]:
    """Skirts and coats of the bodies that wear one, drawn as `geometry.clothes.random_outfit` does: how far each stands from the
    body's axis (count x levels x around), and x and z of that axis, heights of chest and ground, where it begins and ends."""
    count, size = len(chosen), own.heights[chosen] / 1.7
    middle_x, middle_z, chest, waist, ground = own.axes[chosen].T
    coat = draw.random(count) < 0.35
    begin = np.where(coat, chest, waist)
    end = waist - draw.uniform(0.3, 0.9, count) * (waist - ground) * 0.95
    heights = chest[:, None] + (ground - chest)[:, None] * np.linspace(0.0, 1.0, LEVELS)
    hung = np.where((heights <= begin[:, None] + 1e-3)[..., None], own.reaches[chosen], 0.0)
    down = np.clip((begin[:, None] - heights) / (begin - end)[:, None], 0.0, 1.0)
    angles = np.linspace(-np.pi, np.pi, AROUND, endpoint=False)
    folds = np.sin(angles * draw.integers(5, 12, count)[:, None] + draw.uniform(0, 2 * np.pi, (count, 1)))
    folds *= draw.uniform(0.1, 0.35, (count, 1))
    flare, ease = draw.uniform(0.02, 0.25, count), np.where(coat, 0.012, 0.006)
    away = ease[:, None, None] + (flare[:, None] * down**1.2)[..., None] * (1.0 + folds[:, None])
    reach = np.maximum.accumulate(hung, axis=1) + size[:, None, None] * away
    end = np.where(worn, end, begin + 1.0)
    return reach.astype(np.float32), np.stack([middle_x, middle_z, chest, ground, begin, end], axis=1).astype(np.float32)


def _cameras(count: int, draw: np.random.Generator) -> tuple[Array, Array]:
    """Directions to three cameras all around, most of them level, and how many of them look."""
    around, up = draw.uniform(0, 2 * np.pi, (count, 3)), draw.normal(size=(count, 3)) * 0.3
    flat = np.cos(up)
    directions = np.stack([flat * np.cos(around), np.sin(up), flat * np.sin(around)], axis=2)
    return directions.astype(np.float32), draw.choice([1, 1, 1, 1, 2, 3], size=count)


def prepare_clouds(which: str, data: Path | None, cache: Path, seed: int = 0, bodies: int | None = None) -> CloudMaker:
    """A maker of clouds of one of the sets of `scan_split`, its bodies (the first so many) and poses kept in `cache`."""
    cache.mkdir(parents=True, exist_ok=True)
    path = cache / f"poses_{which}.npz"
    if path.exists():
        with np.load(path) as stored:
            poses = Poses(stored["rotations"], stored["clips"], int(stored["embedded"]), tuple(stored["names"].tolist()))
    else:
        poses = gather_poses(which, data)
        np.savez(path, rotations=poses.rotations, clips=poses.clips, embedded=poses.embedded, names=np.array(poses.names))
    return CloudMaker(bake_bodies(BODY_SEEDS[which][:bodies], cache), poses, seed)
