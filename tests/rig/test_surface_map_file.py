"""Maps that the user already has, from files: followed, or refused in one line, whatever the file holds."""

import random
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rig_bodies import case, mapped

from retarget.correspond.functional_map import functional_map
from retarget.errors import FileError
from retarget.geometry.resample import subdivide
from retarget.geometry.spectral import spectral_basis
from retarget.rig.map_file import read_surface_map
from retarget.rig.rigging import rig
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template

sys.path.append(str(Path(__file__).parents[1] / "io"))
sys.path.append(str(Path(__file__).parents[1]))
from file_faults import mutated  # noqa: E402
from made_bodies import sphere  # noqa: E402
from test_npz_mutations import WORDS, members, zipped  # noqa: E402

CLEAN = 6
MUTATIONS = 2000


@cache
def bases(count=100):
    truth, template = case(CLEAN), human_template()
    return (
        spectral_basis(truth.mesh.vertices, truth.mesh.faces, count),
        spectral_basis(template.model.points, template.faces, count),
    )


@cache
def lumps():
    """A small surface without symmetry, its finer copy, their bases, and for each vertex of the copy the one it lies next to."""
    coarse = sphere(2)
    coarse = type(coarse)(coarse.vertices * [1.0, 1.7, 2.6] + 0.3 * coarse.vertices[:, [1]] ** 2, coarse.faces)
    fine, placing = subdivide(coarse)
    near = np.asarray(placing.argmax(axis=1)).ravel()
    return spectral_basis(fine.vertices, fine.faces, 20), spectral_basis(coarse.vertices, coarse.faces, 20), near


def functional(rows, columns, mesh, template, places):
    C = functional_map(template.first(columns), mesh.first(rows), places)
    return {"C": C, "mesh_basis": mesh.vectors, "template_basis": template.vectors}


@pytest.mark.parametrize("rows, columns", [(100, 80), (20, 20)])
def test_a_functional_map_gives_the_rig_of_the_places_behind_it(tmp_path, rows, columns):
    """Joints within 3 mm on average, the surface at rest within 10 mm."""
    truth, template = case(CLEAN), human_template()
    np.savez(tmp_path / "map.npz", **functional(rows, columns, *bases(), truth.places))
    found = rig(truth.mesh, surface_map=read_surface_map(tmp_path / "map.npz", len(template.model.points)))
    true = mapped(CLEAN)
    body = slice(len(MAIN))
    apart = np.linalg.norm(found.joints[body] - true.joints[body], axis=1) / truth.scale
    assert apart.mean() < 0.003 and apart.max() < 0.01
    away = np.linalg.norm(found.character.mesh.vertices - true.character.mesh.vertices, axis=1)
    assert away.mean() < 0.01
    assert "given map" in found.notes[-1]


def test_a_functional_map_is_read_as_points(tmp_path):
    fine, coarse, near = lumps()
    np.savez(tmp_path / "map.npz", **functional(20, 20, fine, coarse, near))
    places = read_surface_map(tmp_path / "map.npz", len(coarse.vectors))
    assert len(places.corners) == len(fine.vectors)
    old = slice(len(coarse.vectors))  # copies of the coarse surface's own vertices come first
    assert (places.corners[old, 0] == np.arange(len(coarse.vectors))).mean() > 0.9


def test_more_functions_than_the_map_has_do_not_matter(tmp_path):
    fine, coarse, near = lumps()
    arrays = functional(12, 10, fine, coarse, near)
    np.savez(tmp_path / "all.npz", **arrays)
    np.savez(
        tmp_path / "own.npz", C=arrays["C"], mesh_basis=fine.vectors[:, :12], template_basis=coarse.vectors[:, :10]
    )
    one, other = (read_surface_map(tmp_path / name, len(coarse.vectors)) for name in ("all.npz", "own.npz"))
    assert np.array_equal(one.corners, other.corners)


def wrong_maps():
    fine, coarse, near = lumps()
    good = functional(16, 14, fine, coarse, near)
    square = functional(16, 16, fine, coarse, near)
    sign = np.where(np.arange(16) % 2, 1.0, -1.0)
    yield (
        "no bases",
        {"C": good["C"]},
        "'C' means nothing without the eigenfunctions it is between; 'mesh_basis' is missing",
    )
    yield "one basis", {key: good[key] for key in ("C", "mesh_basis")}, "'template_basis' is missing"
    yield "a row", good | {"C": good["C"][0]}, r"'C' must have rows and columns; its shape is \(14,\)"
    yield "no functions", good | {"C": good["C"][:0]}, r"'C' must have rows and columns; its shape is \(0, 14\)"
    yield (
        "turned",
        good | {"C": good["C"].T, "mesh_basis": fine.vectors[:, :13]},
        r"'C' \(14 x 16\) takes .* 'mesh_basis' has 13 columns",
    )
    yield (
        "a basis turned",
        good | {"template_basis": coarse.vectors.T},
        "'template_basis' must have a row for every vertex",
    )
    yield "signs", square | {"C": square["C"] * sign[:, None]}, "'C' is no map between its bases: points read from it"
    yield "nothing", good | {"C": 0 * good["C"]}, "'C' is no map between its bases: points read from it give back 0%"
    yield "too large", good | {"C": 1e60 * good["C"]}, "C: holds numbers that are not finite, or absurdly large"
    yield "no numbers", good | {"mesh_basis": fine.vectors * np.nan}, "'?mesh_basis'?.*not finite"
    yield (
        "another template",
        good | {"template_basis": coarse.vectors[:-1]},
        "'template_basis' has 65 rows; the template has 66 vertices",
    )


@pytest.mark.parametrize("arrays, reason", [pytest.param(*rest, id=name) for name, *rest in wrong_maps()])
def test_matrices_that_are_no_maps(tmp_path, arrays, reason):
    np.savez(tmp_path / "map.npz", **arrays)
    with pytest.raises(FileError, match=reason) as caught:
        read_surface_map(tmp_path / "map.npz", 66)
    assert str(caught.value).startswith(str(tmp_path / "map.npz")) and "\n" not in str(caught.value)


def test_maps_of_too_many_functions(tmp_path):
    wide = np.eye(1001)
    np.savez(tmp_path / "map.npz", C=wide, mesh_basis=wide, template_basis=wide)
    with pytest.raises(FileError, match="'C' is 1001 x 1001; maps of up to 1000 functions are read"):
        read_surface_map(tmp_path / "map.npz", 1001)


@pytest.mark.parametrize("kind", ["functions", "places", "vertices"])
def test_damaged_archives_are_followed_or_refused(tmp_path, kind):
    fine, coarse, near = lumps()
    seeds = {
        "functions": functional(4, 3, fine.first(4), coarse.first(3), near),
        "places": {"corners": np.stack([near] * 3, axis=1), "weights": np.full((len(near), 3), 1 / 3)},
        "vertices": {"map": near},
    }
    np.savez(tmp_path / "seed.npz", **seeds[kind])
    contents, path, chance = members(tmp_path / "seed.npz"), tmp_path / "damaged.npz", random.Random(kind)
    outcomes = {"read": 0, "refused": 0}
    for number in range(MUTATIONS // 3):
        if number % 3:
            name = chance.choice(list(contents))
            raw = zipped(contents | {name: mutated(contents[name], chance, WORDS)}, 0)
        else:
            raw = mutated(zipped(contents, 0), chance, WORDS)
        path.write_bytes(raw)
        try:
            places = read_surface_map(path, len(coarse.vectors))
        except FileError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
        else:
            assert places.corners.min() >= 0 and places.corners.max() < len(coarse.vectors)
            outcomes["read"] += 1
    assert outcomes["read"] > 20 and outcomes["refused"] > 100, outcomes
