"""Names for places of the embedded human: body parts, seams, landmarks, colour regions. All on the average adult."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

PARTS = (
    "head", "neck", "chest", "abdomen", "pelvis",
    "leftUpperArm", "leftForearm", "leftHand", "rightUpperArm", "rightForearm", "rightHand",
    "leftThigh", "leftShin", "leftFoot", "rightThigh", "rightShin", "rightFoot",
)  # fmt: skip
PART_OF_JOINT = {
    "head": "head", "neck": "neck", "upperChest": "chest", "chest": "chest", "spine": "abdomen", "hips": "pelvis",
    "Shoulder": "chest", "UpperArm": "UpperArm", "LowerArm": "Forearm", "UpperLeg": "Thigh", "LowerLeg": "Shin",
    "Foot": "Foot", "Toes": "Foot",
}  # fmt: skip

MATERIALS = {  # linear RGB
    "skin": (0.60, 0.36, 0.25),
    "shirt": (0.10, 0.22, 0.38),
    "shorts": (0.055, 0.06, 0.075),
    "hair": (0.035, 0.02, 0.013),
    "lips": (0.45, 0.17, 0.14),
    "eyeWhite": (0.80, 0.78, 0.75),
    "iris": (0.07, 0.13, 0.15),
    "pupil": (0.004, 0.004, 0.004),
}


def part_labels(weights: np.ndarray, names: list[str]) -> np.ndarray:
    """The part (index into PARTS) of each vertex: the one whose joints hold most of its weight."""
    total = np.zeros((len(weights), len(PARTS)))
    for j, name in enumerate(names):
        side = next((s for s in ("left", "right") if name.startswith(s)), "")
        part = PART_OF_JOINT.get(name[len(side) :], "Hand")
        total[:, PARTS.index(part if part in PARTS else side + part)] += weights[:, j]
    return total.argmax(axis=1)


def face_parts(labels: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The part of each face: that of most of its corners; of three different ones the last."""
    a, b, c = labels[faces].T
    return np.where(a == b, a, c)


def seams(faces: np.ndarray, parts: np.ndarray) -> list[tuple[int, int, list[int]]]:
    """Closed vertex loops between parts: (part on the left of the loop, part on its right, vertices in order)."""
    owner = {}
    for k, (a, b, c) in enumerate(faces.tolist()):
        owner[a, b] = owner[b, c] = owner[c, a] = k
    ahead: dict[tuple[int, int], dict[int, list[int]]] = {}
    for (a, b), k in owner.items():
        left, right = int(parts[k]), int(parts[owner[b, a]])
        if left < right:
            ahead.setdefault((left, right), {}).setdefault(a, []).append(b)
    loops = []
    for (left, right), step in sorted(ahead.items()):
        while step:
            loop = [min(step)]
            while loop[-1] in step:
                following = step[loop[-1]].pop()
                if not step[loop[-1]]:
                    del step[loop[-1]]
                loop.append(following)
            loops.append((left, right, loop[:-1] if loop[0] == loop[-1] else loop))
    return loops


class Finder:
    """Finds landmark vertices on the average body by directions from its joints."""

    def __init__(
        self, vertices: np.ndarray, joints: dict[str, np.ndarray], labels: np.ndarray, weights: np.ndarray
    ) -> None:
        self.vertices, self.joints, self.labels, self.weights = vertices, joints, labels, weights
        self.names = list(joints)
        self.middle = vertices[:, 0] == 0

    def part(self, *names: str) -> np.ndarray:
        return np.isin(self.labels, [PARTS.index(name) for name in names])

    def ray(self, start: np.ndarray, direction: tuple[float, float, float] | np.ndarray, *parts: str) -> int:
        """The vertex of these parts nearest to a ray; a ray within the midplane finds a vertex of the midline."""
        direction = np.asarray(direction) / np.linalg.norm(direction)
        offset = self.vertices - start
        along = offset @ direction
        beside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
        central = abs(start[0]) < 1e-9 and abs(direction[0]) < 1e-9
        allowed = self.part(*parts) & (self.middle if central else True)
        return self.least(np.where(along > 0, beside, np.inf), allowed)

    def least(self, value: np.ndarray, mask: np.ndarray) -> int:
        return int(np.where(mask, value, np.inf).argmin())

    def most(self, direction: tuple[float, float, float] | np.ndarray, mask: np.ndarray) -> int:
        """The outermost vertex in a direction."""
        return self.least(-self.vertices @ np.asarray(direction, dtype=float), mask)


def landmarks(find: Finder, mirror: np.ndarray, eye_centre: int) -> dict[str, int]:
    """Vertex of every landmark; those of the left side are mirrored to the right."""
    x, y, z = find.vertices.T
    j, middle = find.joints, mirror == np.arange(len(mirror))
    head = find.part("head")
    mouth_y = j["head"][1] - 0.028
    centre = {
        "crown": find.most((0, 1, 0), head & middle),
        "forehead": find.least(np.abs(y - j["head"][1] - 0.085), head & middle & (z > j["head"][2])),
        "nose": find.most((0, 0, 1), head & middle & (y > mouth_y)),
        "chin": find.most((0, -0.7, 1), head & middle & (y < mouth_y)),
        "mouth": find.least(np.abs(y - mouth_y), head & middle & (z > j["head"][2])),
        "backOfHead": find.most((0, 0, -1), head & middle),
        "throat": find.ray(j["neck"], (0, 0.3, 1), "neck"),
        "nape": find.ray(j["neck"], (0, 0.6, -1), "neck", "head"),
        "chest": find.ray(j["upperChest"], (0, 0, 1), "chest"),
        "belly": find.ray(j["spine"], (0, 0, 1), "abdomen", "pelvis"),
        "navel": find.least(z - 100 * (np.abs(y - j["chest"][1] + 0.092) < 0.025), middle & (z > j["chest"][2]) & find.part("abdomen", "pelvis")),
        "upperBack": find.ray(j["upperChest"], (0, 0, -1), "chest"),
        "lowerBack": find.ray(j["spine"], (0, 0, -1), "abdomen", "pelvis"),
        "pubis": find.ray(j["hips"], (0, -0.25, 1), "pelvis"),
        "crotch": find.most((0, -1, 0), middle & find.part("pelvis", "leftThigh", "rightThigh")),
    }  # fmt: skip
    left = _left_head_and_trunk(find, x, y, z, eye_centre) | _left_arm(find) | _left_leg(find, y, z)
    sided = {f"left{name}": v for name, v in left.items()} | {
        f"right{name}": int(mirror[v]) for name, v in left.items()
    }
    return centre | dict(sorted(sided.items()))


def _left_head_and_trunk(find: Finder, x: np.ndarray, y: np.ndarray, z: np.ndarray, eye_centre: int) -> dict[str, int]:
    j, head = find.joints, find.part("head")
    arm = j["leftUpperArm"]
    return {
        "Eye": eye_centre,
        "Ear": find.most((1, 0, 0), head),
        "Temple": find.ray(j["head"] + [0, 0.055, 0.055], (1, 0, 0), "head"),
        "Cheek": find.ray(j["head"] + [0, 0.005, 0.05], (0.7, 0, 0.7), "head"),
        "NeckSide": find.ray(j["neck"] + [0, 0.03, 0.02], (1, 0, 0), "neck"),
        "ShoulderTop": find.ray(0.5 * (arm + j["leftShoulder"]), (0, 1, 0), "chest"),
        "ShoulderTip": find.ray(arm, (0.8, 0.6, 0), "leftUpperArm", "chest"),
        "ShoulderFront": find.ray(arm, (0.1, 0, 1), "leftUpperArm", "chest"),
        "ShoulderBlade": find.ray(j["upperChest"] + [0.09, 0.02, 0], (0, 0, -1), "chest"),
        "Armpit": find.ray(arm, (-0.15, -1, 0), "chest", "leftUpperArm"),
        "Breast": find.most((0, 0, 1), find.part("chest") & (x > 0.03)),
        "Ribs": find.ray(j["chest"] + [0, 0.06, 0.02], (1, 0, 0), "chest", "abdomen"),
        "Waist": find.ray(j["spine"] + [0, 0.06, 0.03], (1, 0, 0), "abdomen", "chest"),
        "HipSide": find.ray(j["leftUpperLeg"], (1, 0, 0), "pelvis", "leftThigh"),
        "HipFront": find.ray(j["leftUpperLeg"] + [0, 0.06, 0], (0.1, 0, 1), "pelvis", "leftThigh"),
        "Buttock": find.most((0, 0, -1), find.part("pelvis", "leftThigh") & (x > 0)),
    }


def _left_arm(find: Finder) -> dict[str, int]:
    j = find.joints
    arm, elbow, wrist = j["leftUpperArm"], j["leftLowerArm"], j["leftHand"]
    point = 2 * elbow - arm - wrist  # away from the inside of the bent elbow
    index, little, middle = (j[f"left{f}Proximal"] for f in ("Index", "Little", "Middle"))
    palm = np.cross(little - wrist, index - wrist)  # out of the palm on the left hand
    palm = palm / np.linalg.norm(palm)
    centre = 0.35 * wrist + 0.65 * (index + little + middle) / 3
    both = ("leftForearm", "leftHand")
    found = {
        "UpperArmFront": find.ray(0.5 * (arm + elbow), -point, "leftUpperArm"),
        "UpperArmBack": find.ray(0.5 * (arm + elbow), point, "leftUpperArm"),
        "Elbow": find.ray(elbow, point, "leftUpperArm", "leftForearm"),
        "ElbowInside": find.ray(elbow, -point, "leftUpperArm", "leftForearm"),
        "ForearmInside": find.ray(0.5 * (elbow + wrist), palm, "leftForearm"),
        "ForearmOutside": find.ray(0.5 * (elbow + wrist), -palm, "leftForearm"),
        "WristInside": find.ray(wrist, palm, *both),
        "WristOutside": find.ray(wrist, -palm, *both),
        "Palm": find.ray(centre, palm, "leftHand"),
        "BackOfHand": find.ray(centre, -palm, "leftHand"),
    }
    for finger in ("Thumb", "Index", "Middle", "Ring", "Little"):
        joint = f"left{finger}Distal"
        before = j[f"left{finger}{'Proximal' if finger == 'Thumb' else 'Intermediate'}"]
        mine = find.weights[:, find.names.index(joint)] > 0.5
        found[f"{finger}Tip"] = find.most(j[joint] - before, mine)
    return found


def _left_leg(find: Finder, y: np.ndarray, z: np.ndarray) -> dict[str, int]:
    j = find.joints
    hip, knee, ankle, toes = (j[f"left{name}"] for name in ("UpperLeg", "LowerLeg", "Foot", "Toes"))
    foot, leg = find.part("leftFoot"), ("leftThigh", "leftShin")
    return {
        "ThighFront": find.ray(0.5 * (hip + knee), (0, 0, 1), "leftThigh"),
        "ThighBack": find.ray(0.5 * (hip + knee), (0, 0, -1), "leftThigh"),
        "ThighOutside": find.ray(0.5 * (hip + knee), (1, 0, 0), "leftThigh"),
        "ThighInside": find.ray(0.5 * (hip + knee), (-1, 0, 0), "leftThigh"),
        "Knee": find.ray(knee, (0, 0, 1), *leg),
        "KneeBack": find.ray(knee, (0, 0, -1), *leg),
        "Shin": find.ray(0.5 * (knee + ankle), (0, 0, 1), "leftShin"),
        "Calf": find.ray(0.7 * knee + 0.3 * ankle, (0, 0, -1), "leftShin"),
        "AnkleOutside": find.ray(ankle, (1, 0, 0), "leftFoot", "leftShin"),
        "AnkleInside": find.ray(ankle, (-1, 0, 0), "leftFoot", "leftShin"),
        "Heel": find.most((0, -0.3, -1), foot),
        "HeelSole": find.least(np.linalg.norm(find.vertices - [ankle[0], y[foot].min(), ankle[2] - 0.025], axis=1), foot),
        "Ball": find.least(np.linalg.norm(find.vertices - [toes[0] - 0.02, y[foot].min(), toes[2]], axis=1), foot),
        "BallOutside": find.least(np.linalg.norm(find.vertices - [toes[0] + 0.035, y[foot].min(), toes[2] - 0.02], axis=1), foot),
        "FootTop": find.ray(0.5 * (ankle + toes), (0, 1, 0.3), "leftFoot"),
        "BigToeTip": find.most((-0.3, 0, 1), foot),
        "LittleToeTip": find.most((1, 0, 0.35), foot & (z > toes[2] - 0.03)),
    }  # fmt: skip


class Wardrobe:
    """Colour regions as signed distances (metres, positive inside) at points of the average body."""

    def __init__(self, joints: dict[str, np.ndarray], eye: np.ndarray) -> None:
        self.joints, self.eye = joints, eye

    def fields(self, points: np.ndarray, parts: np.ndarray) -> dict[str, np.ndarray]:
        """`shirt`, `shorts` and `hair` at points (points, 3) on body parts (points,)."""
        points = points * [1, 1, 1]
        points[:, 0] = np.abs(points[:, 0])
        waist = points[:, 1] - self.joints["spine"][1] - 0.010
        collar = np.linalg.norm((points - self.joints["neck"] - [0, 0.025, 0.04]) * [1, 1, 0.8], axis=1) - 0.096
        trunk = _on(parts, "neck", "chest", "abdomen", "pelvis")
        sleeve = self._before("leftUpperArm", "leftLowerArm", 0.47, points)
        leg = self._before("leftUpperLeg", "leftLowerLeg", 0.75, points)
        outside = np.full(len(points), -0.05)
        shirt = np.where(trunk, np.minimum(waist, collar), outside)
        shorts = np.where(trunk, np.minimum(-waist, collar), outside)
        return {
            "shirt": np.where(_on(parts, "leftUpperArm", "rightUpperArm"), sleeve, shirt),
            "shorts": np.where(_on(parts, "leftThigh", "rightThigh"), leg, shorts),
            "hair": np.where(_on(parts, "head", "neck"), self._hair(points), outside),
        }

    def _before(self, start: str, end: str, share: float, points: np.ndarray) -> np.ndarray:
        """Distance to a plane across a limb, positive on the body's side."""
        axis = self.joints[end] - self.joints[start]
        length = np.linalg.norm(axis)
        return share * length - (points - self.joints[start]) @ axis / length

    def _hair(self, points: np.ndarray) -> np.ndarray:
        x, up, forward = (points - self.joints["head"]).T
        line = np.interp(up, [-0.06, 0.0, 0.045, 0.05, 0.085, 0.105, 0.122, 0.13],
                         [-0.025, -0.008, 0.012, 0.03, 0.042, 0.062, 0.1, 0.25])  # fmt: skip
        behind_ear = np.interp(up, [-0.04, 0.0, 0.03, 0.05], [-0.032, -0.026, -0.022, -0.002])
        ear = np.maximum.reduce([0.069 - x, up - 0.051, behind_ear - forward, forward - 0.04])
        return np.minimum.reduce([line - forward, up + 0.03 + 0.25 * np.minimum(forward + 0.06, 0), ear])

    def brow(self, points: np.ndarray) -> np.ndarray:
        """Eyebrows: positive within a thin arch above the eye."""
        x, up = np.abs(points[:, 0]) - self.eye[0], points[:, 1] - self.eye[1]
        arch = 0.0195 - 9.0 * (x - 0.006) ** 2
        half_width = np.interp(x, [-0.016, -0.012, 0.008, 0.02], [0.0, 0.0032, 0.0028, 0.0])
        return np.where(points[:, 2] > self.eye[2] - 0.04, half_width - np.abs(up - arch), -1.0)


def _on(parts: np.ndarray, *names: str) -> np.ndarray:
    return np.isin(parts, [PARTS.index(name) for name in names])


def face_materials(
    vertices: np.ndarray,
    faces: np.ndarray,
    parts: np.ndarray,
    wardrobe: Wardrobe,
    eyes: dict[str, set[frozenset[int]]],
    lips: np.ndarray,
) -> np.ndarray:
    """Colour region (index into MATERIALS) of each face: T-shirt, shorts, a cap of hair, lips and eyes on skin.

    `lips` (faces,) says in [0, 1] how much a face is lip.
    """
    names = list(MATERIALS)
    field = wardrobe.fields(vertices[faces].mean(axis=1), parts)
    clothed = smooth_region(vertices, faces, np.maximum(field["shirt"], field["shorts"]))
    side = np.where(field["shorts"] > field["shirt"], 1, -1)
    lower = smooth_region(vertices, faces, side * np.maximum(np.abs(field["shorts"]), 0.001))
    region = np.full(len(faces), names.index("skin"))
    region[smooth_region(vertices, faces, field["hair"])] = names.index("hair")
    region[clothed] = names.index("shirt")
    region[clothed & lower] = names.index("shorts")
    region[smooth_region(vertices, faces, 0.02 * (lips - 0.5), softness=1e-5)] = names.index("lips")
    for k, face in enumerate(faces.tolist()):
        for kind, members in eyes.items():
            if frozenset(face) in members:
                region[k] = names.index(kind)
    return region


def smooth_region(vertices: np.ndarray, faces: np.ndarray, field: np.ndarray, softness: float = 2e-4) -> np.ndarray:
    """Faces inside a field, with the border shortened: the minimal cut between area misplaced and border length.

    A border by thresholds has teeth, one for every other triangle; the cut moves by at most a triangle and has none.
    """
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    owner = {edge: k for k, face in enumerate(faces.tolist()) for edge in zip(face, face[1:] + face[:1], strict=True)}
    pairs = np.array([(k, owner[b, a], a, b) for (a, b), k in owner.items()])
    length = np.linalg.norm(vertices[pairs[:, 2]] - vertices[pairs[:, 3]], axis=1)
    unit = 1e7  # the solver counts in integers
    pull = np.round(unit * area * np.clip(np.abs(field), 0, 0.03) / softness).astype(np.int64)
    source, sink = len(faces), len(faces) + 1
    face = np.arange(len(faces))
    rows = np.concatenate([pairs[:, 0], np.where(field > 0, source, face)])
    columns = np.concatenate([pairs[:, 1], np.where(field > 0, face, sink)])
    capacity = np.concatenate([np.round(unit * length).astype(np.int64), pull]).astype(np.int32)
    graph = sparse.csr_matrix((capacity, (rows, columns)), shape=(len(faces) + 2,) * 2)
    flow = csgraph.maximum_flow(graph, source, sink).flow
    residual = (graph - flow).tocsr()
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    inside = np.zeros(len(faces) + 2, bool)
    inside[csgraph.breadth_first_order(residual, source, return_predecessors=False)] = True
    return inside[: len(faces)]
