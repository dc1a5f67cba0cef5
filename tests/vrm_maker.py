"""VRM avatars and VRM animations made of the embedded human, with node names that mean nothing."""

import json
import random
import struct

from gltf_maker import pack
from made_motions import body

from retarget.correspond.joints import HUMANOID_JOINTS
from retarget.io import save

OLD_THUMBS = {"ThumbMetacarpal": "ThumbProximal", "ThumbProximal": "ThumbIntermediate"}


def split(path):
    """JSON and binary chunk of a GLB."""
    raw = path.read_bytes()
    length = struct.unpack_from("<I", raw, 12)[0]
    return json.loads(raw[20 : 20 + length]), raw[28 + length :]


def old_name(bone):
    """The bone as VRM 0.x calls it."""
    for new, old in OLD_THUMBS.items():
        if bone.endswith(new):
            return bone.removesuffix(new) + old
    return bone


def vrm(path, version="1.0", preset="thin", motions=(), change=None):
    """Write an avatar of the version: '1.0', '0.x' (which faces -z) or 'animation'. `change` edits its JSON at last."""
    plain = path.with_suffix(".glb")
    save(plain, body(preset), list(motions), animation_only=version == "animation")
    document, binary = split(plain)
    names = {node["name"]: number for number, node in enumerate(document["nodes"]) if node["name"] in HUMANOID_JOINTS}
    letters = random.Random(1)
    for number in names.values():
        document["nodes"][number]["name"] = "".join(letters.choice("abcdefghij") for _ in range(8))
    if version == "0.x":
        bones = [{"bone": old_name(bone), "node": node, "useDefaultValues": True} for bone, node in names.items()]
        document["extensions"] = {"VRM": {
            "specVersion": "0.0", "meta": {"title": "Doll", "licenseName": "CC0", "weight": 0.1 + 0.2},
            "humanoid": {"humanBones": bones}, "secondaryAnimation": {"boneGroups": [{"stiffiness": 0.7, "bones": [3]}]},
            "materialProperties": [{"name": "skin", "shader": "VRM/MToon"}],
        }}  # fmt: skip
        document["nodes"].append(
            {"name": "turned", "rotation": [0, 1, 0, 0], "children": document["scenes"][0]["nodes"]}
        )
        document["scenes"][0]["nodes"] = [len(document["nodes"]) - 1]
    else:
        name = "VRMC_vrm" if version == "1.0" else "VRMC_vrm_animation"
        humanoid = {"humanBones": {bone: {"node": node} for bone, node in names.items()}}
        document["extensions"] = {name: {"specVersion": "1.0", "humanoid": humanoid}}
        if version == "1.0":
            document["extensions"][name]["meta"] = {"name": "Doll", "authors": ["nobody"], "weight": 0.1 + 0.2}
            springs = [{"name": "hair", "joints": [{"node": 3, "hitRadius": 0.02, "stiffness": 1 / 3}]}]
            document["extensions"]["VRMC_springBone"] = {"specVersion": "1.0", "springs": springs}
            document["nodes"][5]["extensions"] = {"VRMC_node_constraint": {"constraint": {"roll": {"source": 4}}}}
            for material in document["materials"]:
                material["extensions"] = {
                    "VRMC_materials_mtoon": {"specVersion": "1.0", "shadeColorFactor": [0.3, 0.2, 0.1]}
                }
    document["extensionsUsed"] = list(document["extensions"])
    if change is not None:
        change(document)
    path.write_bytes(pack(json.dumps(document).encode(), binary))
    return path
