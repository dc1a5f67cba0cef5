"""One body in the scene of the live viewer: what is sent of it, and when.

The browser moves the skin: a frame sends the joints that moved, not the vertices. Skins that rigid joints cannot move
(several binds, more than four influences that matter) are sent as vertices, and so are the body parts in their colours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body.skinning import prepare_skinning
from retarget.view.page_data import CLAY
from retarget.view.patches import KINDS, Patch, padded, part_surfaces, patches
from retarget.view.stage import RigidSkin, StageBody, drawn_bones, part_colors, rigid_skin

Array = np.ndarray

MOST_ERROR = 0.001
"""Metres that a skin of rigid joints may stray before vertices are sent instead."""
GLASS = 0.5
"""Opacity of skins that something is to be seen through."""
STILL = 1e-5
"""Metres, or parts of a unit quaternion, that a joint may move before it is sent again."""
SENSOR = 0.006
"""Diameter of a sensor's disc, in body heights."""
BONES = ((95, 25, 65), (40, 55, 75))
"""sRGB of the result's bones and of its sources'."""


@dataclass(frozen=True)
class Wish:
    """How a body is to be seen."""

    move: tuple[float, float, float]
    """Metres by which it is moved from where it performs."""
    layers: frozenset[str]
    """Among skin, skeleton, sensors, body parts, contacts; none hides the body."""
    glass: bool = False
    """Whether something else is to be seen through it."""
    lift: int = 0
    """How many lines its name stands above its head."""


class LiveBody:
    """The nodes of one body in viser's scene. `size` enlarges the whole body, about the origin of its motion."""

    def __init__(self, scene: Any, number: int, body: StageBody, size: float = 1.0, by_vertices: bool = False) -> None:
        self.body, self.size = body, size
        self._number, self._scene, self._root = number, scene, f"/world/body{number}"
        self._frame = scene.add_frame(self._root, show_axes=False)
        self._skinner, self._bones = prepare_skinning(body.character), drawn_bones(body)
        skin = rigid_skin(body)
        self.by_joints = not by_vertices and skin.error <= MOST_ERROR
        """Whether the browser moves the skin."""
        self._skin = self._rigid(skin) if self.by_joints else self._surface("skin", skin.vertices * size)
        self._label = scene.add_label(
            f"{self._root}/label", body.label.split(":")[0], font_screen_scale=1.1, anchor="bottom-center"
        )
        self._layers: dict[str, Any] = {}
        self._parts: list[tuple[Array, Any]] = []
        self._patches: dict[str, Any] = {}
        self._capacity: dict[str, tuple[int, int]] = {}
        self._wish = Wish((0.0, 0.0, 0.0), frozenset())
        self._frame_shown = -1

    def remove(self) -> None:
        """Take the body out of the scene."""
        self._frame.remove()

    # --- what is there --------------------------------------------------------------------------------------------

    # Skins throw shadows on the ground and receive none: what falls on themselves comes out as stripes.

    def _rigid(self, skin: RigidSkin) -> Any:
        dense = np.zeros((len(skin.vertices), len(skin.positions)))
        np.add.at(dense, (np.arange(len(dense))[:, None], skin.columns), skin.weights)
        self._used = np.flatnonzero(dense.any(axis=0))
        """Joints that move the skin; no others are sent."""
        self._sent = np.concatenate([skin.rotations, skin.positions * self.size], axis=1)
        return self._scene.add_mesh_skinned(
            f"{self._root}/skin", (skin.vertices * self.size).astype(np.float32), self.body.character.mesh.faces,
            bone_wxyzs=skin.rotations[:, [3, 0, 1, 2]], bone_positions=skin.positions * self.size, skin_weights=dense,
            color=CLAY[self._number % len(CLAY)], side="double", receive_shadow=False,
        )  # fmt: skip

    def _surface(self, name: str, vertices: Array, faces: Array | None = None, **look: Any) -> Any:
        look = {"color": CLAY[self._number % len(CLAY)], "side": "double", "receive_shadow": False} | look
        faces = self.body.character.mesh.faces if faces is None else faces
        return self._scene.add_mesh_simple(f"{self._root}/{name}", vertices.astype(np.float32), faces, **look)

    def show_as(self, wish: Wish) -> None:
        """Place the body and show the layers that are wished for. The next `show` brings them to a frame."""
        layers = wish.layers
        self._wish, self._frame_shown = wish, -1
        self._frame.position, self._frame.visible = wish.move, bool(layers)
        in_parts = "body parts" in layers and not self.body.bare
        glass = GLASS if wish.glass or "skeleton" in layers else None
        self._skin.visible, self._skin.opacity = "skin" in layers and not in_parts, glass
        self._want("skeleton", "skeleton" in layers, self._add_skeleton)
        self._want("sensors", "sensors" in layers and self.body.sensors is not None, self._add_sensors)
        if in_parts and not self._parts:
            self._parts = self._add_parts()
        for _, handle in self._parts:
            handle.visible, handle.opacity = in_parts, glass

    def _want(self, name: str, wanted: bool, add: Callable[[], Any]) -> None:
        if wanted and name not in self._layers:
            self._layers[name] = add()
        elif not wanted and name in self._layers:
            self._layers.pop(name).remove()

    def _add_skeleton(self) -> Any:
        color = BONES[min(self._number, 1)]
        return self._scene.add_line_segments(
            f"{self._root}/bones", self._segments(0), colors=color, thickness=4.0, thickness_units="screen"
        )

    def _segments(self, frame: int) -> Float[Array, "bones 2 3"]:
        at = self._joints(frame).astype(np.float32)
        return np.stack([at[self.body.character.skeleton.parents[self._bones]], at[self._bones]], axis=1)

    def _add_sensors(self) -> Any:
        size = SENSOR * self.body.take.actor.height * self.size
        return self._scene.add_point_cloud(
            f"{self._root}/sensors", self._sensor_places(self._posed(0)), (30, 30, 30), point_size=size,
            point_shape="circle", precision="float32",
        )  # fmt: skip

    def _sensor_places(self, posed: Float[Array, "vertices 3"]) -> Float[Array, "sensors 3"]:
        above = SENSOR * self.body.take.actor.height * self.size  # as their discs are wide, which would lie half in it
        return self.body.sensor_places(posed, above).astype(np.float32)

    def _add_parts(self) -> list[tuple[Array, Any]]:
        """The vertices and the mesh of each body part."""
        colors, posed = [*map(tuple, part_colors().tolist()), (170, 170, 170)], self._posed(0)
        return [
            (kept, self._surface(f"part{part}", posed[kept], faces, color=colors[part]))
            for part, (kept, faces) in part_surfaces(self.body.character.mesh.faces, self.body.parts).items()
        ]

    # --- a frame --------------------------------------------------------------------------------------------------

    def _joints(self, frame: int) -> Float[Array, "joints 3"]:
        return self.body.take.positions[frame] * self.size

    def _posed(self, frame: int) -> Float[Array, "vertices 3"]:
        part = slice(frame, frame + 1)
        return self._skinner.vertices(self.body.take.rotations[part], self.body.take.positions[part])[0] * self.size

    def show(self, frame: int) -> None:
        """Bring the body to a frame."""
        layers = self._wish.layers
        if frame == self._frame_shown or not layers:
            return
        self._frame_shown = frame
        vertex, code = self.body.spots.of_frame(frame)
        spotted = "contacts" in layers and "skin" in layers and len(vertex) > 0
        in_parts = "body parts" in layers and bool(self._parts)
        needed = spotted or in_parts or "sensors" in self._layers or not self.by_joints
        posed = self._posed(frame) if needed else None
        if self.by_joints:
            self._move_joints(frame)
        else:
            self._skin.vertices = posed
        for kept, handle in self._parts if in_parts else ():
            handle.vertices = posed[kept]
        above = 1.04 + 0.07 * self._wish.lift
        top = self.size * (self.body.floor + above * self.body.take.actor.height)
        self._label.position = self._joints(frame)[0] * [1.0, 0.0, 1.0] + [0.0, top, 0.0]
        if "skeleton" in self._layers:
            self._layers["skeleton"].points = self._segments(frame)
        if "sensors" in self._layers:
            self._layers["sensors"].points = self._sensor_places(posed)
        found = patches(posed, self.body.character.mesh.faces, vertex, code) if spotted else {}
        for name, color, *_ in KINDS:
            self._show_patch(name, color, found.get(name))

    def _move_joints(self, frame: int) -> None:
        now = np.concatenate([self.body.take.rotations[frame], self._joints(frame)], axis=1)
        apart = np.abs(now - self._sent)[self._used]
        bones = self._skin.bones
        for joint in self._used[apart[:, :4].max(axis=1) > STILL]:
            bones[joint].wxyz = now[joint, [3, 0, 1, 2]]
            self._sent[joint, :4] = now[joint, :4]
        for joint in self._used[apart[:, 4:].max(axis=1) > STILL]:
            bones[joint].position = now[joint, 4:]
            self._sent[joint, 4:] = now[joint, 4:]

    def _show_patch(self, name: str, color: tuple[int, int, int], patch: Patch | None) -> None:
        """A patch keeps its node, and its buffers while they suffice: a new node costs the browser a new shader."""
        handle, seen = self._patches.get(name), patch is not None and len(patch.faces) > 0
        if not seen:
            if handle is not None:
                handle.visible = False
            return
        vertices, faces = padded(patch, *self._capacity.get(name, (0, 0)))
        grows = len(vertices) >= self._capacity.get(name, (0, 0))[0]
        self._capacity[name] = len(vertices), len(faces)
        if handle is None:
            self._patches[name] = self._surface(name, vertices, faces, color=color, cast_shadow=False)
        else:
            # A browser may draw between two changes; no face may then name a vertex that is not there.
            for what, values in (("vertices", vertices), ("faces", faces))[:: 1 if grows else -1]:
                setattr(handle, what, values)
            handle.visible = True
