"""Shape in local frames and volumes of parts: what stays under motion, and where their steps lead."""

import numpy as np
import pytest
from made_motions import actor

from retarget.body import rotations as rot
from retarget.body.skinning import rest_vertices
from retarget.contact.parts import body_parts
from retarget.evaluate.reference.part_tree import closed_parts, part_tree
from retarget.evaluate.reference.shape_terms import (
    fixed_neighbours,
    local_frames,
    part_volumes,
    target_shape,
    uniform_laplacian,
    volume_step,
)

FACES = actor("thin").character.mesh.faces
THIN, HEAVY = (rest_vertices(actor(name).character) for name in ("thin", "heavy"))
TREE = part_tree(FACES, body_parts(actor("thin").character, actor("thin").humanoid))
SOLIDS = closed_parts(FACES, TREE.face_parts, len(TREE.names), len(THIN))
MOVE = rot.to_matrix(rot.from_rotation_vector(np.array([0.4, -1.1, 2.0])))


def test_the_laplacian_is_the_neighbours_mean_minus_the_vertex():
    laplacian = uniform_laplacian(FACES, len(THIN) + 1)
    for vertex in (0, 17, 5000):
        around = np.setdiff1d(FACES[(FACES == vertex).any(axis=1)], vertex)
        wanted = THIN[around].mean(axis=0) - THIN[vertex]
        np.testing.assert_allclose((laplacian @ np.vstack([THIN, np.ones(3)]))[vertex], wanted, atol=1e-12)
    assert np.abs(laplacian @ np.ones(len(THIN) + 1)).max() < 1e-12
    assert laplacian[len(THIN)].nnz == 0 or np.abs(laplacian[len(THIN)].data).max() == 0  # a vertex without neighbours


def test_frames_are_orthonormal_and_turn_with_the_body():
    neighbours = fixed_neighbours(THIN, FACES)
    edges = {tuple(edge) for edge in FACES[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()}
    assert all((a, b) in edges or (b, a) in edges for a, b in enumerate(neighbours.tolist()))
    frames = local_frames(THIN, FACES, neighbours)
    np.testing.assert_allclose(
        np.einsum("vai,vbi->vab", frames, frames), np.tile(np.eye(3), (len(THIN), 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-9)
    turned = local_frames(THIN @ MOVE.T + 2.0, FACES, neighbours)
    np.testing.assert_allclose(turned, frames @ MOVE.T, atol=1e-9)


def test_a_body_at_rest_is_where_its_shape_wants_it():
    step, _ = target_shape(HEAVY, FACES).step(HEAVY)
    assert np.abs(step).max() < 1e-12
    step, _ = target_shape(HEAVY, FACES).step(HEAVY @ MOVE.T + [5.0, 0.0, -3.0])
    assert np.abs(step).max() < 1e-9
    step, _ = target_shape(HEAVY, FACES).step(THIN)  # another body is not
    assert np.abs(step).max() > 1e-3


def test_the_offsets_are_blind_to_the_pose_of_the_whole():
    shape = target_shape(HEAVY, FACES)
    of = lambda body: np.einsum(  # noqa: E731
        "vai,vi->va", local_frames(body, FACES, shape.neighbours), shape.laplacian @ body
    )
    np.testing.assert_allclose(of(HEAVY @ MOVE.T - 1.0), shape.offsets, atol=1e-9)
    assert np.abs(of(THIN) - shape.offsets).max() > 1e-3


def test_volumes_are_those_of_known_solids():
    corners = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    places = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    whole = closed_parts(corners, np.zeros(4, dtype=np.int64), 1, 4)
    assert part_volumes(whole, places) == pytest.approx([1 / 6])
    halves = closed_parts(corners, np.array([0, 0, 1, 1]), 2, 4)
    assert part_volumes(halves, places + 7.0).sum() == pytest.approx(1 / 6)


def test_the_volume_s_step_is_the_way_of_steepest_volume():
    """Central differences of a part's volume by its vertices run along the normals, which the step is made of, and the step
    leads from too little to more."""
    normals = target_shape(THIN, FACES).step(THIN)[1]
    seams = np.unique(FACES[np.isin(FACES, np.concatenate(TREE.seams[1:])).any(axis=1)])
    inner = np.setdiff1d(np.arange(len(THIN)), seams)
    for vertex in np.random.default_rng(1).choice(inner, 6, replace=False):
        part, slope = TREE.vertex_parts[vertex], np.zeros(3)
        for axis in range(3):
            there, here = THIN.copy(), THIN.copy()
            there[vertex, axis] += 1e-4
            here[vertex, axis] -= 1e-4
            slope[axis] = (part_volumes(SOLIDS, there) - part_volumes(SOLIDS, here))[part] / 2e-4
        assert slope @ normals[vertex] / np.linalg.norm(slope) == pytest.approx(1.0, abs=1e-6)
    missing = part_volumes(SOLIDS, HEAVY) - part_volumes(SOLIDS, THIN)
    step = volume_step(normals, TREE.vertex_parts, missing)
    np.testing.assert_allclose((step * normals).sum(axis=1), missing[TREE.vertex_parts], atol=1e-12)
    for part in range(len(missing)):
        alone = volume_step(normals, TREE.vertex_parts, np.where(np.arange(len(missing)) == part, missing, 0.0))
        gained = part_volumes(SOLIDS, THIN + 0.1 * alone) - part_volumes(SOLIDS, THIN)
        assert np.sign(gained[part]) == np.sign(missing[part])
