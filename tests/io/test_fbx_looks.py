"""Pictures of FBX files: embedded or beside the file, on every corner as the file lays them, and never from elsewhere."""

import io
import os
import struct

import numpy as np
import pytest
from fbx_maker import Picture, document, strip
from gltf_maker import PNG

from retarget.body.skinning import rest_vertices
from retarget.io import load, save
from retarget.io.fbx_surface import cut_at_seams
from retarget.io.pictures import WIDEST, picture_beside, picture_kind


def read(folder, picture, **settings):
    folder.mkdir(exist_ok=True)
    path = folder / "strip.fbx"
    path.write_text(document(unit=100.0, picture=picture, **settings))
    return load(path)


def look(asset):
    return asset.character.mesh.materials[0]


def test_an_embedded_picture_stands_in_place_of_the_colour(tmp_path):
    asset = read(tmp_path, Picture(PNG))
    assert look(asset).image == PNG and look(asset).base_color == (1.0, 1.0, 1.0, 1.0) and len(asset.notes) == 1


def test_each_corner_has_its_own_coordinate_and_copies_keep_place_and_weights(tmp_path):
    mesh, skin = (character := read(tmp_path, Picture(PNG, uv=2.0)).character).mesh, character.skin
    vertices, quads, upper = strip()
    assert len(mesh.vertices) == 10 + 6, "the vertices of the three inner rows lie on seams"
    assert mesh.vertices[:10] == pytest.approx(vertices, abs=1e-6), "the file's own vertices keep their numbers"
    wanted = dict(zip("0123", np.array([[0, 1], [2, 1], [2, -1], [0, -1]])))
    for number, quad in enumerate(quads):
        for triangle in mesh.faces[2 * number : 2 * number + 2]:
            for vertex in triangle:
                corner = int(np.argmin(np.linalg.norm(vertices[list(quad)] - mesh.vertices[vertex], axis=1)))
                assert mesh.uvs[vertex] == pytest.approx(wanted[str(corner)], abs=1e-6)
    of = np.array([int(np.argmin(np.linalg.norm(vertices - place, axis=1))) for place in mesh.vertices])
    joint = character.skeleton.index("Upper")
    share = (skin.weights * (skin.joints[skin.columns] == joint)).sum(axis=1)
    assert share == pytest.approx(upper[of], abs=1e-6)
    assert rest_vertices(character) == pytest.approx(vertices[of], abs=1e-6)


def test_without_a_picture_no_vertex_is_taken_apart(tmp_path):
    asset = read(tmp_path, Picture(PNG, slot="Unheard"))
    assert len(asset.character.mesh.vertices) == 10 and asset.character.mesh.uvs is None


def test_the_picture_goes_into_a_written_glb(tmp_path):
    asset = read(tmp_path, Picture(PNG))
    save(tmp_path / "out.glb", asset.character, [asset.motion()])
    again = load(tmp_path / "out.glb")
    assert look(again).image == PNG and again.character.mesh.uvs == pytest.approx(asset.character.mesh.uvs)


def test_a_normal_map_is_kept_for_the_written_file(tmp_path):
    asset = read(tmp_path, Picture(PNG, slot="NormalMap"))
    entry = asset.character.origin.document.json["materials"][0]
    assert entry["normalTexture"] == {"index": 0} and "baseColorTexture" not in entry["pbrMetallicRoughness"]
    assert look(asset).base_color[:3] == pytest.approx((0.2, 0.4, 0.6), abs=1e-3)


@pytest.mark.parametrize("place", ["sub/paint.png", "paint.png", "textures/paint.png", "strip.fbm/paint.png"])
@pytest.mark.parametrize("said", ["sub/paint.png", "sub\\\\paint.png", "..\\\\..\\\\art\\\\paint.png"])
def test_pictures_inside_the_folder_are_found(tmp_path, place, said):
    """Where the file says, or by name alone; the artist's own disk is in the absolute path."""
    target = tmp_path / "home" / place
    target.parent.mkdir(parents=True)
    target.write_bytes(PNG)
    found = look(read(tmp_path / "home", Picture(relative=said))).image == PNG
    assert found == (place != "sub/paint.png" or "art" not in said)


@pytest.mark.parametrize("said", ["../secret.png", "{out}/secret.png", "link.png", "sub/../../secret.png", "folder.png", "pipe.png", "", "secret.png"])
def test_pictures_outside_the_folder_are_not_read(tmp_path, said):
    (tmp_path / "secret.png").write_bytes(PNG)
    home = tmp_path / "home"
    (home / "folder.png").mkdir(parents=True)
    (home / "sub").mkdir()
    (home / "link.png").symlink_to(tmp_path / "secret.png")
    os.mkfifo(home / "pipe.png")
    said = said.format(out=tmp_path)
    asset = read(home, Picture(relative=said, absolute=said))
    assert look(asset).image is None and look(asset).base_color[:3] == pytest.approx((0.2, 0.4, 0.6), abs=1e-3)
    assert any("is neither in the file nor in its folder, and is left out" in note for note in asset.notes)
    assert asset.character.mesh.uvs is not None, "the coordinates come along for a picture that is found later"


def test_other_kinds_of_pictures_are_noted(tmp_path):
    for content in (b"GIF89a" + bytes(50), PNG[:16] + struct.pack(">II", WIDEST + 1, 4) + PNG[24:], b"\xff\xd8\xff\xe0"):
        asset = read(tmp_path, Picture(content))
        assert look(asset).image is None
        assert any("'paint.png' is neither PNG nor JPEG, or too large" in note for note in asset.notes)


def test_notes_about_what_is_shown_differently(tmp_path):
    notes = read(tmp_path, Picture(PNG, uv_set="map2", scale=2.0)).notes
    assert any("a texture of the material 'Skin' is moved or scaled" in note for note in notes), notes
    assert any("lie on its first coordinates, not on 'map2'" in note for note in notes), notes


def test_coordinates_that_are_no_numbers_are_left_out(tmp_path):
    asset = read(tmp_path, Picture(PNG, uv=1e9))
    assert asset.character.mesh.uvs is None and any("texture coordinates that are no numbers" in note for note in asset.notes)


def test_cutting_at_seams():
    corners = np.array([0, 1, 2, 2, 1, 3])
    uvs = np.array([[0, 0], [1, 0], [0, 1], [0, 1], [5, 5], [1, 1]], float)
    origin, copies = cut_at_seams(corners, uvs, 5)
    assert origin.tolist() == [0, 1, 2, 3, 4, 1] and copies.tolist() == [0, 1, 2, 2, 5, 3]
    for seed in range(20):
        random = np.random.default_rng(seed)
        corners, uvs = random.integers(0, 9, 60), random.integers(0, 3, (60, 2)).astype(float)
        origin, copies = cut_at_seams(corners, uvs, 9)
        assert (origin[:9] == np.arange(9)).all() and (origin[copies] == corners).all()
        at = np.full((len(origin), 2), np.nan)
        at[copies] = uvs
        assert (at[copies] == uvs).all(), "one coordinate a copy"
        assert len(origin) == 9 + sum(max(len({tuple(uv) for uv in uvs[corners == v].tolist()}) - 1, 0) for v in range(9))


def test_kinds_and_sides_of_pictures():
    from PIL import Image

    for kind, options in (("PNG", {}), ("JPEG", {}), ("JPEG", {"progressive": True})):
        out = io.BytesIO()
        Image.new("RGB", (7, 5)).save(out, kind, **options)
        data = out.getvalue()
        assert picture_kind(data) == f"image/{kind.lower()}"
        for cut in range(len(data) // 2):
            picture_kind(data[:cut])
    assert picture_kind(b"\xff\xd8\xff\xff\xff\xc0" + struct.pack(">HBHH", 17, 8, 5, 7)) == "image/jpeg", "fill bytes"
    assert picture_kind(b"\xff\xd8\xff\xc0" + struct.pack(">HBHH", 17, 8, 0, 7)) is None
    assert picture_kind(b"") is None and picture_kind(PNG[:20]) is None


def test_large_files_are_passed_over(tmp_path, monkeypatch):
    (tmp_path / "large.png").write_bytes(PNG)
    assert picture_beside(str(tmp_path.resolve()), ["", "a\0b", "large.png"], set()) == PNG
    monkeypatch.setattr("retarget.io.pictures.LARGEST", 10)
    assert picture_beside(str(tmp_path.resolve()), ["large.png"], set()) is None and picture_kind(PNG) is None


@pytest.mark.parametrize(("layers", "said"), [(0, "shows a texture without a picture"), (2, "of 2 pictures in one layered texture")])
def test_layered_textures_show_their_first_picture(tmp_path, layers, said):
    text = document(picture=Picture(PNG)).replace('"OP",40,20, "DiffuseColor"', '"OP",45,20, "DiffuseColor"')
    other = text[text.index(" Texture: 40") : text.index(" Video: 41")].replace("40", "42", 1)
    text = text.replace(" Texture: 40", ' LayeredTexture: 45, "LayeredTexture::L", "" {\n  LayeredTexture: 101\n }\n' + other + " Texture: 40")
    text = text.replace("Connections: {", "Connections: {\n" + '\n'.join([' C: "OO",40,45', ' C: "OO",42,45', ' C: "OO",41,42'][: 3 if layers else 0]))
    (tmp_path / "strip.fbx").write_text(text)
    asset = load(tmp_path / "strip.fbx")
    assert any(said in note for note in asset.notes), asset.notes
    assert (look(asset).image == PNG) == bool(layers)
