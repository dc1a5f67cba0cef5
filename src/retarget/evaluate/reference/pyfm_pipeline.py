"""The automatic pipeline of pyFM (RobinMagnet/pyFM, PyPI's `pyfmaps`) as its documentation shows it: wave kernel signatures,
a map that commutes with descriptors and Laplacians, the orientation term, ZoomOut.

Only the bench uses it (extra `bench`); where it is not installed there is no row of it.
"""

from __future__ import annotations

import importlib.util

import numpy as np
from jaxtyping import Float

from retarget.geometry.resample import Surface, cleaned, decimate, largest_pieces

Array = np.ndarray

VERTICES = 2_000
"""Of both surfaces, decimated: ZoomOut on all vertices of more takes minutes."""
FUNCTIONS = (35, 35)
"""Of the first map; ZoomOut adds `STEP` in each of `ROUNDS`."""
ROUNDS, STEP = 12, 5
WEIGHTS = {"w_descr": 1e-1, "w_lap": 1e-3, "w_dcomm": 1.0, "w_orient": 1e-1}
"""Without the orientation term the map is as often mirrored as not, its documentation says."""


def installed() -> bool:
    """Whether pyFM can be imported."""
    return importlib.util.find_spec("pyFM") is not None


def places_on_template(
    template: Surface, target: Surface
) -> tuple[Float[Array, "target_vertices 3"], Float[Array, "target_vertices 3"]]:
    """Vertices of the decimated target, and where each of them lies on the template."""
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh

    small = [decimate(largest_pieces(cleaned(each))[0], VERTICES) for each in (template, target)]
    meshes = [TriMesh(each.vertices, each.faces, area_normalize=True, center=True) for each in small]
    model = FunctionalMapping(*meshes)
    model.preprocess(n_descr=100, descr_type="WKS", subsample_step=5, k_process=120, verbose=False)
    model.fit(K=FUNCTIONS, verbose=False, **WEIGHTS)
    refined = model.zoomout_refine(FM=model.FM, nit=ROUNDS, step=STEP, verbose=False)
    if isinstance(refined, tuple):
        refined = refined[0]
    return small[1].vertices, small[0].vertices[np.asarray(model.get_p2p(FM=refined))]
