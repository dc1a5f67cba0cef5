"""What hangs around a body is left out of its cloud; a limb that is elsewhere, and clothes worn close, are not."""

import numpy as np

from retarget.body.human import human
from retarget.geometry.clothes import Outfit, dressed
from retarget.geometry.sampling import sample_surface
from retarget.methods.scan.hanging import CLEAR, SURELY, Cloth, skin_only
from retarget.methods.scan.scan_body import BODY, scan_body
from retarget.rig.fit import HEIGHT
from retarget.rig.fit_model import BodyState

BODY_AT_REST = human(height=HEIGHT)


def at_rest():
    body = scan_body()
    shape = np.zeros(body.shapes)
    return body, [BodyState(shape, np.tile(np.eye(3), (BODY, 1, 1)), body.rest_joints(shape)[0])]


def cloud_of(outfit):
    worn = dressed(BODY_AT_REST, outfit).mesh
    return sample_surface(worn.vertices, worn.faces, 3000, 1)


def far(points):
    """Which points are farther from the bare skin than close garments are."""
    from scipy.spatial import cKDTree

    return cKDTree(BODY_AT_REST.mesh.vertices).query(points)[0] > CLEAR + 0.01


def test_a_skirt_goes_and_the_rest_stays():
    cloud = cloud_of(Outfit(skirt=0.6, flare=0.2))
    kept = skin_only(*at_rest(), cloud)
    assert far(cloud).sum() > 400
    assert far(kept).sum() < 0.02 * far(cloud).sum()
    assert (~far(kept)).sum() > 0.9 * (~far(cloud)).sum()


def test_a_body_in_close_clothes_stays_whole():
    for outfit in (Outfit(), Outfit(top=0.03, sleeves=2, trousers=0.03, shoes=0.01)):
        cloud = cloud_of(outfit)
        assert skin_only(*at_rest(), cloud) is cloud


def test_a_leg_that_is_elsewhere_stays():
    body, states = at_rest()
    cloud = cloud_of(Outfit())
    left = (cloud[:, 1] < 0.75) & (cloud[:, 0] > 0.02)
    assert left.sum() > 300
    cloud[left] += [0.25, 0.0, 0.2]  # to the side and forward of where the body is believed to be
    assert skin_only(body, states, cloud) is cloud


def test_no_points_are_no_points():
    assert len(skin_only(*at_rest(), np.zeros((0, 3)))) == 0


def test_what_is_told_under_cloth_is_kept_to_where_legs_come_out_longer_for_a_while():
    body = scan_body()
    told, larger, huge = (np.zeros(body.shapes) for _ in range(3))
    larger[-1], huge[-1] = 0.06, 0.12  # of the size
    cloth = Cloth(told, told)
    for _ in range(SURELY + 3):
        cloth = cloth.after(body, told, larger)
    assert not cloth.overgrown and np.allclose(cloth.told, told) and 0.05 < cloth.fitted[-1] < 0.06
    assert not cloth.after(body, told, huge).overgrown, "one frame says little"
    cloth = Cloth(told, huge)
    for looks in range(2, SURELY + 1):
        cloth = cloth.after(body, told, huge)
        assert cloth.overgrown == (looks == SURELY)
    assert cloth.after(body, told, told).after(body, told, told).overgrown
