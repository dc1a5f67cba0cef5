"""The published ways on a case of the bench of rig transfer, given the true map or none; and ours given the same map."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.correspond.functional_map import functional_map
from retarget.errors import RetargetError
from retarget.evaluate import metrics
from retarget.evaluate.reference import pyfm_pipeline
from retarget.evaluate.reference.rest_pose import (
    FIXED,
    GROWING,
    NONE,
    FoundPose,
    closed_form_pose,
    optimised_pose,
    rest_vertices,
)
from retarget.evaluate.reference.rig_transfer import (
    FUNCTIONS,
    MappedTemplate,
    joint_regressor,
    joints_by_functions,
    joints_by_points,
)
from retarget.evaluate.remeshed import TOUCHING
from retarget.evaluate.rig_cases import RigCase
from retarget.evaluate.rig_judge import (
    Truth,
    judge_rest,
    judge_rig,
    main_weights,
    map_figures,
    places_for_all,
)
from retarget.geometry.closest import Places, SurfaceIndex
from retarget.geometry.resample import Surface, decimate
from retarget.geometry.spectral import SpectralBasis, laplacian, spectral_basis
from retarget.geometry.topology import vertex_normals
from retarget.rig.rigging import rig
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template

Array = np.ndarray

COARSE = 8_000
"""Vertices of the surface that a spectrum is found on, at most."""
FUNCTION, POINTS, ADJOINT, COORDINATES, LOW_PASS = "function", "p2p", "p2p, adjoint", "eq. 10", "low-pass"
OURS_MAPPED = "ours, true map"
RESTS = {"rest, no lambda": NONE, "rest, fixed lambda": FIXED, "rest, growing lambda": GROWING}
REST_CLOSED, REST_TRUE = "rest, closed form", "rest, closed form, true joints and weights"
SPATIAL, SPECTRAL = "MMMC21, spatial", "MMMC21, spectral"
PYFM = "pyFM"


def given_the_true_map(case: RigCase, truth: Truth) -> Iterator[dict[str, Any]]:
    """The paper's three ways over the functional map of the true point map, joints, rest poses, and ours from that map.

    On the body's own surface: clothes have no truth, and a spectrum of several pieces is none of the body's.
    """
    body, used = _body_of(case)
    mapped = _mapped(case, body, used)
    template = human_template().weights
    rows = {
        FUNCTION: mapped.by_function(template),
        POINTS: mapped.by_points(template),
        ADJOINT: mapped.by_points(template, adjoint=True),
        COORDINATES: mapped.by_coordinates(template),
    }
    places = mapped.low_pass_places()
    rows[LOW_PASS] = places.of(template)
    for method, weights in rows.items():
        yield {"method": method, **_weight_figures(truth.weights[used], weights)}
    yield from _joints_and_rest(case, truth, mapped, used, main_weights(rows[LOW_PASS]))
    yield {"method": OURS_MAPPED, **judge_rig(case, truth, rig(case.mesh, surface_map=_for_all(case, places, used)))}


def found_by_pyfm(case: RigCase) -> dict[str, Any]:
    """The map of pyFM's automatic pipeline on the whole mesh, at the vertices of its decimated copy."""
    from scipy.spatial import cKDTree

    from retarget.body.human import human_model

    template, rest = human_template(), human_template().model.points
    mesh = Surface(case.mesh.vertices, case.mesh.faces)
    vertices, found = pyfm_pipeline.places_on_template(Surface(rest, template.faces), mesh)
    near = cKDTree(case.mesh.vertices).query(vertices)[1]
    true, mirrored = (case.places.of(each)[near] for each in (rest, rest[human_model().mirror]))
    own = case.body[near]
    weights = human_template().weights[cKDTree(rest).query(found[own])[1]]
    return {
        "method": PYFM,
        **map_figures(found[own], true[own], mirrored[own]),
        **_weight_figures(case.places.of(human_template().weights)[near[own]], weights),
    }


def _body_of(case: RigCase) -> tuple[Surface, Int[Array, "used"]]:
    """The body without clothes, and the vertices that it consists of."""
    faces = case.mesh.faces[case.body[case.mesh.faces].all(axis=1)]
    used, packed = np.unique(faces, return_inverse=True)
    return Surface(case.mesh.vertices[used], packed.reshape(-1, 3)), used


def _mapped(case: RigCase, body: Surface, used: Int[Array, "used"]) -> MappedTemplate:
    template = human_template()
    places = Places(case.places.corners[used], case.places.weights[used])
    target = basis_of(body)
    return MappedTemplate.of(template.model.points, template.faces, _template_basis(), target, places)


def basis_of(body: Surface) -> SpectralBasis:
    """The first `FUNCTIONS` eigenfunctions; those of a surface beyond `COARSE` vertices are found on a decimated copy, read
    at the nearest places of it, and made orthonormal again. A spectrum of 35,000 vertices takes ten seconds."""
    if len(body) <= COARSE:
        return spectral_basis(body.vertices, body.faces, FUNCTIONS)
    small = decimate(body, COARSE)
    coarse = spectral_basis(small.vertices, small.faces, FUNCTIONS)
    size = TOUCHING * float(np.ptp(body.vertices, axis=0).max())
    lifted = (
        np.concatenate([each.vertices, size * vertex_normals(each.vertices, each.faces)], axis=1)
        for each in (small, body)
    )
    index, points = SurfaceIndex(next(lifted), small.faces), next(lifted)
    read = index.closest(points, candidates=16).of(coarse.vectors)
    _, masses = laplacian(body.vertices, body.faces)
    masses = masses / masses.sum()
    lower = np.linalg.cholesky(read.T @ (masses[:, None] * read))
    return SpectralBasis(coarse.values, np.linalg.solve(lower, read.T).T, masses)


def _for_all(case: RigCase, places: Places, used: Int[Array, "used"]) -> Places:
    """Places of the vertices in use, carried to all the body's own, then to the clothes."""
    at = np.zeros(len(case.body), dtype=np.int64)
    at[used] = np.arange(len(used))
    own = np.flatnonzero(case.body)
    if len(own) != len(used):
        raise RetargetError(f"case {case.seed} has {len(own) - len(used)} vertices of no face")
    return places_for_all(case, Places(places.corners[at[own]], places.weights[at[own]]))


@lru_cache(maxsize=1)
def _template_basis() -> SpectralBasis:
    template = human_template()
    return spectral_basis(template.model.points, template.faces, FUNCTIONS)


def _weight_figures(truth: Float[Array, "vertices joints"], result: Float[Array, "vertices joints"]) -> dict[str, Any]:
    by_joint = metrics.weight_mse_x100(main_weights(result), main_weights(truth))
    return {
        "weight_mse_x100": float(by_joint.mean()),
        "weight_mse_x100_52": float(metrics.weight_mse_x100(result, truth).mean()),
        "weight_mse_x100_by_joint": dict(zip(MAIN, by_joint.tolist())),
    }


def _joints_and_rest(
    case: RigCase, truth: Truth, mapped: MappedTemplate, used: Int[Array, "used"], weights: Float[Array, "used main"]
) -> Iterator[dict[str, Any]]:
    """MMMC21's joints, and every way back to rest from its spatial ones (from the true ones for the last row)."""
    from scipy.spatial import cKDTree

    model = human_template().body
    middle = case.mesh.vertices[used].mean(axis=0)
    metres = (case.mesh.vertices[used] - middle) / case.scale
    order = [case.character.skeleton.index(name) for name in MAIN]
    true = (case.joints[order] - middle) / case.scale
    regressor = joint_regressor(model.points, model.joints, model.weights, model.parents)
    back = cKDTree(case.places.of(model.points)[used]).query(model.points)[1]
    spatial = joints_by_points(regressor, metres, back)
    C_target_to_template = functional_map(mapped.target, mapped.template, back)
    spectral = joints_by_functions(regressor, mapped.template, mapped.target, C_target_to_template, metres)
    for method, joints in ((SPATIAL, spatial), (SPECTRAL, spectral)):
        errors = metrics.joint_error_cm(joints, true, case.height / case.scale)
        yield {
            "method": method,
            "joint_error_cm": float(errors.mean()),
            "joint_errors_cm": dict(zip(MAIN, errors.tolist())),
        }
    rest, parents = model.joints, model.parents
    for method, lambdas in RESTS.items():
        yield _rest_row(
            method,
            case,
            truth,
            used,
            spatial,
            metres,
            weights,
            lambda j, own=lambdas: optimised_pose(rest, parents, j, own),
        )
    yield _rest_row(
        REST_CLOSED, case, truth, used, spatial, metres, weights, lambda j: closed_form_pose(rest, parents, j)
    )
    exact = main_weights(truth.weights[used])
    yield _rest_row(REST_TRUE, case, truth, used, true, metres, exact, lambda j: closed_form_pose(rest, parents, j))


def _rest_row(
    method: str,
    case: RigCase,
    truth: Truth,
    used: Int[Array, "used"],
    joints: Float[Array, "main 3"],
    vertices: Float[Array, "used 3"],
    weights: Float[Array, "used main"],
    solve: Any,
) -> dict[str, Any]:
    """A way back to rest. The target is turned as a whole first, as its joints lie to the template's: the paper's bodies
    stand upright, and its regularisation would count that turn."""
    import time

    model = human_template().body
    centred, wanted = joints - joints.mean(axis=0), model.joints - model.joints.mean(axis=0)
    u, _, vt = np.linalg.svd(centred.T @ wanted)
    turn = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    start = time.perf_counter()
    found: FoundPose = solve(joints @ turn.T)
    seconds = time.perf_counter() - start
    whole = np.zeros((len(case.body), 3))
    whole[used] = rest_vertices(found, weights, vertices @ turn.T)
    return {"method": method, "rest_vertex_error_cm": judge_rest(case, truth, whole), "seconds": seconds}
