"""A skinned body with other triangles, its skin and weights where they were, for benches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from retarget.character import Character, Mesh, Skin
from retarget.geometry.closest import Places

Array = np.ndarray

INFLUENCES = 6
"""Joints that a vertex keeps at most."""


def remeshed_body(character: Character, faces: Array, places: Places) -> Character:
    """The character whose vertices are `places` on its mesh, and whose faces are others."""
    skin, mesh = character.skin, character.mesh
    columns = len(skin.joints)
    dense = np.zeros((len(mesh.vertices), columns))
    np.add.at(
        dense, (np.repeat(np.arange(len(dense)), skin.columns.shape[1]), skin.columns.ravel()), skin.weights.ravel()
    )
    weights = places.matrix(len(dense)) @ dense
    most = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(weights, most, axis=1)
    own = Skin(skin.joints, skin.inverse_binds, most, kept / kept.sum(axis=1, keepdims=True))
    return replace(character, mesh=Mesh(places.of(mesh.vertices), faces), skin=own, origin=None)
