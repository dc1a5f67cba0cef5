"""Landmarks that the user names: places of the template, by name, and where they are on the mesh."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError, unknown_name
from retarget.geometry.resample import Surface
from retarget.rig.template import Template

Array = np.ndarray

FEWEST_LANDMARKS = 4
"""From so many on landmarks lead the search; a template that is no human needs them."""
APART = 0.03
"""Share of all their extent that landmarks are apart at least, where nothing else leads the search."""
SHOWN = 30
"""Names of landmarks in a message, at most."""


@dataclass(frozen=True, eq=False)
class Given:
    """Landmarks that the user named."""

    vertices: Int[Array, "given"]
    """On the template."""
    places: Float[Array, "given 3"]
    """On the mesh, in its own units."""
    names: tuple[str, ...]

    def __bool__(self) -> bool:
        return len(self.names) > 0

    @staticmethod
    def of(template: Template, surface: Surface, landmarks: Mapping[str, int | Float[Array, "3"]]) -> Given:
        """Check names and vertices. Raises `RetargetError` for those that do not exist, for a place named twice, and for too
        few where only landmarks tell how the template lies."""
        vertices, places, names = [], [], []
        for spelled, where in landmarks.items():
            name, vertex = template_vertex(template, spelled)
            if name in names:
                raise RetargetError(f"landmark {name!r} is given twice")
            names.append(name)
            vertices.append(vertex)
            if np.ndim(where) == 0:
                if not 0 <= int(where) < len(surface):
                    raise RetargetError(f"landmark {name!r} is vertex {int(where)}; the mesh has {len(surface)}")
                places.append(surface.vertices[int(where)])
            else:
                places.append(np.asarray(where, dtype=np.float64))
        return Given(np.array(vertices, dtype=np.int64), np.array(places).reshape(-1, 3), tuple(names))


def template_vertex(template: Template, spelled: str) -> tuple[str, int]:
    """A landmark's name as the template has it, and its vertex: a name in its own or in the canonical spelling (`left_hand`),
    or the number of a vertex of the template's file. Raises `RetargetError` for what is neither."""
    for name in (spelled, re.sub(r"_(\w)", lambda match: match[1].upper(), spelled)):
        if name in template.landmarks:
            return name, template.landmarks[name]
    if not spelled.isdecimal():
        raise unknown_name("landmark", spelled, template.landmarks, "the template")
    if len(spelled) > 12 or int(spelled) >= len(template.file_vertices):
        raise RetargetError(
            f"landmark {spelled[:12]} is a vertex of the template, which has {len(template.file_vertices)}"
        )
    return spelled, int(template.file_vertices[int(spelled)])


def expect_landmarks(template: Template, given: Given) -> None:
    """Raises `RetargetError` where a template that is no human has too few landmarks to be laid in by, or those it has lie in
    one place."""
    if template.human:
        return
    vertices = template.model.points[given.vertices]
    count = len(vertices)
    if count < FEWEST_LANDMARKS:
        names = [name for name in template.landmarks if name not in given.names]
        raise RetargetError(
            f"a template that is no human is laid in by {FEWEST_LANDMARKS} landmarks or more, spread over the body; {count} given. "
            f"Its landmarks: {', '.join(names[:SHOWN])}{', ...' if len(names) > SHOWN else ''}, or any vertex of it by number: "
            f"--landmarks {','.join(f'{name}=N' for name in names[:FEWEST_LANDMARKS])}"
        )
    for points, side in ((vertices, "the template"), (given.places, "the mesh")):
        between = np.linalg.norm(points[:, None] - points, axis=2) + np.diag(np.full(count, np.inf))
        one, other = np.unravel_index(int(between.argmin()), between.shape)
        if between[one, other] <= APART * float(np.ptp(points, axis=0).max()):
            raise RetargetError(
                f"landmarks {given.names[one]!r} and {given.names[other]!r} lie in one place on {side}; spread them over the body"
            )
