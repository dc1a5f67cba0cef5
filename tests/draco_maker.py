"""Draco-compressed twins of glTF files made in code."""

import copy

import DracoPy
import numpy as np
from gltf_reference import DTYPES, Reference

EXTENSION = "KHR_draco_mesh_compression"


def stored(reference, number):
    """An accessor's values in its own component type."""
    entry, values = reference.json["accessors"][number], reference.accessor(number)
    kind = np.dtype(DTYPES[entry["componentType"]])
    return (np.round(values * np.iinfo(kind).max) if entry.get("normalized") else values).astype(kind)


def compressed(maker, path, bits=16, required=True, keep_plain=False):
    """The maker's document with its primitives compressed; written to `path` first, so that their data can be read.

    `keep_plain` leaves the plain data for readers that know no Draco. Vertices keep their order.
    """
    reference = Reference(maker.glb(path))
    maker = copy.deepcopy(maker)
    for mesh in maker.json["meshes"]:
        for primitive in mesh["primitives"]:
            if "indices" not in primitive:
                continue
            values = {name: stored(reference, number) for name, number in primitive["attributes"].items()}
            generic = {
                number: np.ascontiguousarray(values[name])
                for number, name in enumerate(sorted(values), start=20)
                if name.startswith(("JOINTS_", "WEIGHTS_"))
            }
            options = {}
            if "TEXCOORD_0" in values:
                options = {"tex_coord": values["TEXCOORD_0"].astype(float), "tex_coord_quantization_bits": bits}
            data = DracoPy.encode(
                np.ascontiguousarray(values["POSITION"], np.float32),
                stored(reference, primitive["indices"]).astype(np.uint32).reshape(-1, 3),
                quantization_bits=bits, preserve_order=True, generic_attributes=generic, **options,
            )  # fmt: skip
            mine = {each["attribute_type"]: each["unique_id"] for each in DracoPy.decode(data).attributes}
            ids = {name: number for number, name in enumerate(sorted(values), start=20) if number in generic}
            ids |= {"POSITION": mine[0]} | ({"TEXCOORD_0": mine[3]} if options else {})
            primitive["extensions"] = {EXTENSION: {"bufferView": maker.view(data), "attributes": ids}}
            for number in () if keep_plain else (*primitive["attributes"].values(), primitive["indices"]):
                maker.json["accessors"][number].pop("bufferView", None)
                maker.json["accessors"][number].pop("byteOffset", None)
    maker.json["extensionsUsed"] = [EXTENSION]
    if required:
        maker.json["extensionsRequired"] = [EXTENSION]
    return maker
