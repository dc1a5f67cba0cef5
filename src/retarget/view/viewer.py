"""The live viewer: bodies in motion in a browser on this machine, through viser.

The browser moves the skins: a frame sends the joints, not the vertices. Skins that rigid joints cannot move (several
binds, more than four influences that matter) are sent as vertices. The world moves under the camera, so that it follows
the bodies and stays free to turn.
"""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body.skinning import Skinner, prepare_skinning
from retarget.errors import RetargetError
from retarget.view.page_data import CLAY
from retarget.view.patches import KINDS, Clock, part_surfaces, patches
from retarget.view.report_page import joint_table
from retarget.view.stage import RigidSkin, StageBody, camera_path, drawn_bones, facing, layout, part_colors, rigid_skin

Array = np.ndarray

HOST = "127.0.0.1"
"""The only address that is listened on."""
MOST_ERROR = 0.001
"""Metres that a skin of rigid joints may stray before vertices are sent instead."""
SPEEDS = {"0.1 ×": 0.1, "0.25 ×": 0.25, "0.5 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0}
BESIDE, OVERLAID = "side by side", "overlaid"
FAINT = 0.45
"""Opacity of the bodies that another one is laid over."""
IDLE = 1 / 60
"""Seconds between looks at the controls."""


def require_viser() -> Any:
    """The package viser. Raises `RetargetError` naming what to install where it is absent."""
    try:
        import viser
    except ImportError:
        raise RetargetError("the viewer needs viser, which is not installed: pip install retarget[view]") from None
    return viser


def _quiet() -> contextlib.AbstractContextManager:
    """What viser prints of its start and end is left out: the address is told by us."""
    return contextlib.redirect_stdout(io.StringIO())


class Viewer:
    """A running viewer; `close` ends it. Listens on the loopback address only.

    `port` None takes any free one. Raises `RetargetError` where viser is not installed or the port is taken.
    """

    def __init__(self, bodies: Sequence[StageBody], port: int | None = None, by_vertices: bool = False) -> None:
        viser = require_viser()
        self.bodies = list(bodies)
        with _quiet():
            self.server = viser.ViserServer(host=HOST, port=port or 0, label="retarget", verbose=False)
        if port is not None and self.server.get_port() != port:
            self.close()
            raise RetargetError(f"port {port} is taken; leave --port out for any free one")
        self.address = f"http://{HOST}:{self.server.get_port()}"
        self.clock = Clock(bodies[0].take.motion.seconds, playing=bodies[0].frames > 1)
        self.sent = 0
        """Frames that were sent."""
        self._moves = {name: layout(bodies, name == OVERLAID) for name in (BESIDE, OVERLAID)}
        self._path = camera_path(bodies[0])
        self._changed = threading.Event()
        self._changed.set()
        self._set_scene()
        self._shown = [_Shown(self.server, number, body, by_vertices) for number, body in enumerate(bodies)]
        self._set_controls()
        self._place()
        self.show()

    # --- setting up ---------------------------------------------------------------------------------------------

    def _set_scene(self) -> None:
        scene, body = self.server.scene, self.bodies[0]
        scene.set_up_direction("+y")
        self._world = scene.add_frame("/world", show_axes=False)
        scene.add_grid(
            "/world/ground", 40.0, 40.0, plane="xz", cell_color=(205, 208, 213), section_color=(180, 184, 190),
            cell_size=0.5, section_size=1.0, fade_distance=14.0, shadow_opacity=0.35, plane_color=(240, 241, 243),
            plane_opacity=1.0,
        )  # fmt: skip
        scene.configure_environment_map(None)  # costs most of the time where there is no graphics card
        scene.add_light_hemisphere("/light", sky_color=(255, 255, 255), ground_color=(190, 185, 180), intensity=1.6)
        forward, tall = facing(body), max(each.take.actor.height for each in self.bodies)
        aside = np.cross([0.0, 1.0, 0.0], forward)
        wide = float(np.linalg.norm(self._moves[BESIDE][0] - self._moves[BESIDE][-1])) if len(self.bodies) > 1 else 0.0
        camera, middle = self.server.initial_camera, np.array([0.0, 0.48 * tall, 0.0])
        away = 1.25 * tall + 0.75 * wide
        camera.fov = 0.7
        camera.position = tuple(
            middle + away * 1.35 * (0.93 * forward - 0.33 * aside) + np.array([0.0, 0.28 * tall, 0.0])
        )
        camera.look_at = tuple(middle)
        camera.up = (0.0, 1.0, 0.0)

    def _set_controls(self) -> None:
        gui, changed = self.server.gui, self._changed
        gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        with gui.add_folder("Timeline"):
            self._play = gui.add_button("Pause" if self.clock.playing else "Play")
            self._scrub = gui.add_slider("second", 0.0, max(self.clock.seconds, 0.01), 0.01, 0.0)
            self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 ×")
        with gui.add_folder("Show"):
            self._layout = gui.add_dropdown("layout", (BESIDE, OVERLAID), initial_value=BESIDE)
            names = ("skin", "skeleton", "sensors", "body parts", "contacts", "camera follows", "shadows")
            on = ("skin", "contacts", "camera follows", "shadows")
            self._boxes = {name: gui.add_checkbox(name, name in on) for name in names}
            self._who = [gui.add_checkbox(body.label.split(":")[0], True) for body in self.bodies]
            legend = "".join(
                f'<span style="color:rgb{color};font-size:1.3em">■</span> {words} '
                for (_, color, *_), words in zip(KINDS, ("touches", "up to 1 cm inside", "deeper"))
            )
            gui.add_html(f'<div style="padding:0 1em;font-size:0.8em">{legend}</div>')
        with gui.add_folder("Joints matched", expand_by_default=False):
            gui.add_html(_mapping(self.bodies))
        self._play.on_click(lambda _: self._toggle())
        self._scrub.on_update(self._scrubbed)
        self._speed.on_update(lambda _: self._set_clock(speed=SPEEDS[self._speed.value]))
        for handle in (self._layout, *self._boxes.values(), *self._who):
            handle.on_update(lambda _: changed.set())

    # --- what the controls do -----------------------------------------------------------------------------------

    def _set_clock(self, **what: Any) -> None:
        self.clock = replace(self.clock, **what)
        self._changed.set()

    def _toggle(self) -> None:
        self._set_clock(playing=not self.clock.playing)

    def _scrubbed(self, event: Any) -> None:
        if event.client is not None:  # by a hand, not by the clock
            self.clock = self.clock.at(self._scrub.value)
            self._changed.set()

    def _place(self) -> None:
        """Bring what the switches say to the scene."""
        moves = self._moves[self._layout.value]
        with self.server.atomic():
            for shown, move, box in zip(self._shown, moves, self._who):
                faint = self._layout.value == OVERLAID and shown.number > 0
                shown.switch(move, box.value, {name: each.value for name, each in self._boxes.items()}, faint)
            self.server.scene.configure_default_lights(cast_shadow=self._boxes["shadows"].value)
            self._play.label = "Pause" if self.clock.playing else "Play"

    # --- playing ------------------------------------------------------------------------------------------------

    def show(self) -> None:
        """Send the clock's moment."""
        frame = min(int(round(self.clock.time * self.bodies[0].take.fps)), self.bodies[0].frames - 1)
        moves = self._moves[self._layout.value]
        middle = self._path[frame if self._boxes["camera follows"].value else 0] + moves[0]
        with self.server.atomic():
            # Between the bodies, or at the one place where all are.
            self._world.position = (moves[0] - moves.mean(axis=0) - middle) * [1.0, 0.0, 1.0]
            for shown in self._shown:
                shown.show(frame)
            if abs(self._scrub.value - self.clock.time) > 0.005:
                self._scrub.value = round(self.clock.time, 2)
        self.sent += 1

    def play(self, until: Callable[[], bool] = lambda: False) -> None:
        """Play, and do what the controls ask, until `until` says so or Ctrl-C comes (`KeyboardInterrupt`)."""
        step = 1.0 / self.bodies[0].take.fps
        before = due = time.perf_counter()
        while not until():
            now = time.perf_counter()
            if self._changed.is_set():
                self._changed.clear()
                self._place()
                self.show()
            if not self.clock.playing:
                before = due = now
            elif now >= due:
                self.clock = self.clock.after(now - before)
                self.show()
                before, due = now, max(due + step, now - step)  # late by less than a frame is caught up with
            time.sleep(max(min(IDLE, due - time.perf_counter()), 0.001) if self.clock.playing else IDLE)

    def close(self) -> None:
        """End the server; browsers see that it is gone."""
        with _quiet():
            self.server.stop()


class _Shown:
    """The nodes of one body in viser's scene."""

    def __init__(self, server: Any, number: int, body: StageBody, by_vertices: bool) -> None:
        self.number, self._body, self._scene = number, body, server.scene
        self._root = f"/world/body{number}"
        self._frame = self._scene.add_frame(self._root, show_axes=False)
        self._skinner = prepare_skinning(body.character)
        skin = rigid_skin(body)
        self._mesh = None if by_vertices or skin.error > MOST_ERROR else self._skinned(skin)
        self._bones = self._mesh is not None
        if self._mesh is None:
            self._mesh = self._scene.add_mesh_simple(
                f"{self._root}/skin", skin.vertices.astype(np.float32), body.character.mesh.faces,
                color=CLAY[number % len(CLAY)], side="double",
            )  # fmt: skip
        self._label = self._scene.add_label(f"{self._root}/label", body.label, font_screen_scale=0.9)
        self._patches: dict[str, Any] = {}
        self._on: dict[str, bool] = {}
        self._child = drawn_bones(body)
        self._skeleton = self._sensors = None
        self._parts: list[tuple[Array, Any]] = []
        self._places: Array | None = None
        self._frame_shown = -1

    def _skinned(self, skin: RigidSkin) -> Any:
        dense = np.zeros((len(skin.vertices), len(skin.positions)))
        np.add.at(dense, (np.arange(len(dense))[:, None], skin.columns), skin.weights)
        return self._scene.add_mesh_skinned(
            f"{self._root}/skin", skin.vertices, self._body.character.mesh.faces,
            bone_wxyzs=skin.rotations[:, [3, 0, 1, 2]], bone_positions=skin.positions, skin_weights=dense,
            color=CLAY[self.number % len(CLAY)], side="double",
        )  # fmt: skip

    def switch(self, move: Float[Array, "3"], visible: bool, on: dict[str, bool], faint: bool) -> None:
        """Place the body and show the layers that are on."""
        self._frame.position, self._frame.visible = move, visible
        in_parts = on["body parts"] and not self._body.bare
        self._mesh.visible = on["skin"] and not in_parts
        self._mesh.opacity = FAINT if faint or on["skeleton"] else None  # bones are seen through the skin
        self._on = on if visible else {}
        self._frame_shown = -1
        if not on["contacts"]:
            self._drop_patches()
        self._skeleton = self._wanted(self._skeleton, on["skeleton"], self._add_skeleton)
        self._sensors = self._wanted(self._sensors, on["sensors"] and self._body.sensors is not None, self._add_sensors)
        for _, handle in self._parts:
            handle.remove()
        self._parts = self._add_parts() if in_parts else []

    def _wanted(self, handle: Any, wanted: bool, add: Callable[[], Any]) -> Any:
        if wanted and handle is None:
            return add()
        if not wanted and handle is not None:
            handle.remove()
            return None
        return handle

    def _add_skeleton(self) -> Any:
        color = (95, 25, 65) if self.number == 0 else (40, 55, 75)
        return self._scene.add_line_segments(
            f"{self._root}/bones", self._segments(0), colors=color, thickness=4.0, thickness_units="screen"
        )

    def _segments(self, frame: int) -> Float[Array, "bones 2 3"]:
        at = self._body.take.positions[frame].astype(np.float32)
        return np.stack([at[self._body.character.skeleton.parents[self._child]], at[self._child]], axis=1)

    def _add_sensors(self) -> Any:
        if self._places is None:
            self._places = self._body.sensor_places()
        return self._scene.add_point_cloud(
            f"{self._root}/sensors",
            self._places[0],
            (30, 30, 30),
            point_size=0.012,
            point_shape="circle",
            precision="float32",
        )

    def _add_parts(self) -> list[tuple[Array, Any]]:
        """The vertices and the mesh of each body part."""
        colors, posed, found = [*map(tuple, part_colors().tolist()), (170, 170, 170)], self._posed(0), []
        for part, (kept, faces) in part_surfaces(self._body.character.mesh.faces, self._body.parts).items():
            name = f"{self._root}/part{part}"
            found.append(
                (kept, self._scene.add_mesh_simple(name, posed[kept], faces, color=colors[part], side="double"))
            )
        return found

    def _posed(self, frame: int) -> Float[Array, "vertices 3"]:
        return _posed(self._skinner, self._body, frame)

    def show(self, frame: int) -> None:
        """Bring the body to a frame."""
        if frame == self._frame_shown or not self._on:
            return
        self._frame_shown = frame
        take, posed = self._body.take, None
        vertex, code = self._body.spots.of_frame(frame)
        spotted = self._on["contacts"] and self._on["skin"] and len(vertex) > 0
        if not self._bones or spotted or self._parts:
            posed = self._posed(frame)
        if self._bones:
            turns = take.rotations[frame][:, [3, 0, 1, 2]]
            for bone, turn, place in zip(self._mesh.bones, turns, take.positions[frame]):
                bone.wxyz, bone.position = turn, place
        else:
            self._mesh.vertices = posed
        top = self._body.floor + 1.06 * take.actor.height
        self._label.position = take.positions[frame][0] * [1.0, 0.0, 1.0] + [0.0, top, 0.0]
        if self._skeleton is not None:
            self._skeleton.points = self._segments(frame)
        if self._sensors is not None:
            self._sensors.points = self._places[frame]
        for kept, handle in self._parts:
            handle.vertices = posed[kept]
        if spotted:
            found = patches(posed, self._body.character.mesh.faces, vertex, code)
            for name, color, *_ in KINDS:
                self._show_patch(name, color, found[name])
        else:
            self._drop_patches()

    def _show_patch(self, name: str, color: tuple[int, int, int], patch: Any) -> None:
        if len(patch.faces):
            self._patches[name] = self._scene.add_mesh_simple(
                f"{self._root}/{name}", patch.vertices.astype(np.float32), patch.faces, color=color, side="double",
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        elif name in self._patches:
            self._patches.pop(name).remove()

    def _drop_patches(self) -> None:
        for handle in self._patches.values():
            handle.remove()
        self._patches.clear()


def _posed(skinner: Skinner, body: StageBody, frame: int) -> Float[Array, "vertices 3"]:
    part = slice(frame, frame + 1)
    return skinner.vertices(body.take.rotations[part], body.take.positions[part])[0]


def _mapping(bodies: Sequence[StageBody]) -> str:
    """The table of matched joints as HTML."""
    heads = "".join(f"<th>{escape(body.label.split(':')[0])}</th>" for body in bodies)
    rows = "".join(
        f"<tr><td>{escape(name)}</td>"
        + "".join(f"<td>{'–' if each is None else escape(each[0])}</td>" for each in told)
        + "</tr>"
        for name, told, _ in joint_table(bodies)
    )
    style = "font-size:0.75em;border-spacing:0.8em 0.1em;text-align:left"
    return f'<table style="{style}"><tr><th>joint</th>{heads}</tr>{rows}</table>'
