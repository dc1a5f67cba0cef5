"""The live viewer: bodies in motion in a browser on this machine, through viser.

One thread, the one that plays, owns the clock and the scene; what viser's threads hear from browsers waits in a queue
until it looks. The world moves under the camera, so that the camera follows the bodies and stays free to turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from queue import Empty, SimpleQueue

import numpy as np

from retarget.view.live_body import LiveBody, Wish
from retarget.view.live_panel import OVERLAID, Acts, Panel
from retarget.view.live_server import HOST, quiet, start_server
from retarget.view.patches import Clock
from retarget.view.stage import StageBody, camera_path, facing, layout, same_sizes

Array = np.ndarray

IDLE = 1 / 60
"""Seconds between looks at the controls."""
FIELD = 0.6
"""The camera's vertical field of view, radians."""


class Viewer:
    """A running viewer; `close` ends it. Listens on the loopback address only.

    `port` None takes any free one; `by_vertices` sends vertices where joints would do. Raises `RetargetError` where viser
    is not installed or the port is taken.
    """

    def __init__(self, bodies: Sequence[StageBody], port: int | None = None, by_vertices: bool = False) -> None:
        self.bodies, self._by_vertices = list(bodies), by_vertices
        self.server = start_server(port)
        self.address = f"http://{HOST}:{self.server.get_port()}"
        self.clock = Clock(bodies[0].take.motion.seconds, playing=bodies[0].frames > 1)
        self.sent = 0
        """Frames that were sent."""
        self._asked: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._path = camera_path(bodies[0])
        self._set_scene()
        ask = self._asked.put
        acts = Acts(
            toggle=lambda: ask(lambda: self._set_clock(playing=not self.clock.playing)),
            seek=self.seek,
            step=lambda frames: ask(lambda: self._step(frames)),
            speed=lambda speed: ask(lambda: self._set_clock(speed=speed)),
            changed=lambda: ask(lambda: None),
        )
        self.panel = Panel(self.server.gui, bodies, self.clock, acts)
        self.shown = [LiveBody(self.server.scene, *each, by_vertices=by_vertices) for each in enumerate(bodies)]
        self.place()
        self.show()

    def _set_scene(self) -> None:
        scene, body = self.server.scene, self.bodies[0]
        scene.set_up_direction("+y")
        self._world = scene.add_frame("/world", show_axes=False)
        scene.add_grid(
            "/world/ground", 40.0, 40.0, plane="xz", cell_color=(214, 217, 222), section_color=(190, 194, 200),
            cell_size=0.5, section_size=1.0, fade_distance=14.0, shadow_opacity=0.35, plane_color=(233, 235, 238),
            plane_opacity=1.0,
        )  # fmt: skip
        scene.configure_environment_map(None)  # costs most of the time where there is no graphics card
        forward, tall = facing(body), max(each.take.actor.height for each in self.bodies)
        right = np.cross([0.0, 1.0, 0.0], forward)  # the screen's, as the bodies face the camera
        scene.configure_default_lights(False)  # they come from above and behind
        scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(196, 190, 184), intensity=1.7)
        self._key = scene.add_light_directional(
            "/light/key",
            color=(255, 248, 238),
            intensity=3.2,
            cast_shadow=True,
            position=forward - 0.6 * right + _up(1.3),
        )
        scene.add_light_directional(
            "/light/rim", color=(225, 236, 255), intensity=1.2, position=right - forward + _up(0.6)
        )
        moves = layout(self.bodies)
        wide = float(np.linalg.norm(moves[0] - moves[-1]))
        # Beside the panel a window is about as wide as high; above the heads stand two lines of names.
        away = max(1.4 * tall, 0.85 * (wide + 0.9 * tall)) / (2 * np.tan(FIELD / 2))
        camera, middle = self.server.initial_camera, _up(0.54 * tall)
        camera.fov = FIELD
        camera.position = tuple(middle + away * (0.97 * forward - 0.22 * right) + _up(0.12 * away))
        camera.look_at, camera.up = tuple(middle), (0.0, 1.0, 0.0)

    # --- what the controls do -------------------------------------------------------------------------------------

    def seek(self, second: float) -> None:
        """Have the player stand still at a second; from any thread."""
        self._asked.put(lambda: self._set_clock(time=self.clock.at(second).time, playing=False))

    def refresh(self) -> None:
        """Have the player look at the switches; from any thread."""
        self._asked.put(lambda: None)

    def _set_clock(self, **what: object) -> None:
        self.clock = replace(self.clock, **what)

    def _step(self, frames: int) -> None:
        fps = self.bodies[0].take.fps
        self.clock = self.clock.at((round(self.clock.time * fps) + frames) / fps)

    def _answer(self) -> None:
        """Do what was asked for since the last look, and show what came of it."""
        asked = False
        while True:
            try:
                act = self._asked.get_nowait()
            except Empty:
                break
            act()
            asked = True
        if asked:
            self.place()
            self.show()

    def place(self) -> None:
        """Bring what the switches say to the scene. Where bodies become another size they are made anew."""
        panel = self.panel
        sizes = same_sizes(self.bodies) if panel.boxes["same size"].value else [1.0] * len(self.bodies)
        overlaid = panel.layout.value == OVERLAID
        self._moves = layout(self.bodies, overlaid, sizes)
        with self.server.atomic():
            for number, size in enumerate(sizes):
                if self.shown[number].size != size:
                    self.shown[number].remove()
                    self.shown[number] = LiveBody(
                        self.server.scene, number, self.bodies[number], size, self._by_vertices
                    )
                layers = panel.layers() if panel.who[number].value else frozenset()
                # Laid over each other, sources are seen through the result; names stand above each other.
                glass, lift = (overlaid and number == 0, number) if overlaid else (False, 0)
                self.shown[number].show_as(Wish(tuple(self._moves[number].tolist()), layers, glass, lift))
            if self._key.cast_shadow != panel.boxes["shadows"].value:
                self._key.cast_shadow = panel.boxes["shadows"].value

    # --- playing --------------------------------------------------------------------------------------------------

    def show(self) -> None:
        """Send the clock's moment."""
        frame = min(int(round(self.clock.time * self.bodies[0].take.fps)), self.bodies[0].frames - 1)
        middle = self._path[frame if self.panel.boxes["camera follows"].value else 0] + self._moves[0]
        with self.server.atomic():
            # Between the bodies, or at the one place where all are.
            self._world.position = (self._moves[0] - self._moves.mean(axis=0) - middle) * [1.0, 0.0, 1.0]
            for shown in self.shown:
                shown.show(frame)
            self.panel.tell(self.clock, time.perf_counter())
        self.sent += 1

    def play(self, until: Callable[[], bool] = lambda: False) -> None:
        """Play, and do what the controls ask, until `until` says so or Ctrl-C comes (`KeyboardInterrupt`)."""
        step = 1.0 / self.bodies[0].take.fps
        before = due = time.perf_counter()
        while not until():
            self._answer()
            now = time.perf_counter()
            if not self.clock.playing:
                before = due = now
            elif now >= due:
                self.clock = self.clock.after(now - before)
                self.show()
                before, due = now, max(due + step, now - step)  # late by less than a frame is caught up with
            time.sleep(max(min(IDLE, due - time.perf_counter()), 0.001) if self.clock.playing else IDLE)

    def close(self) -> None:
        """End the server; browsers see that it is gone."""
        with quiet():
            self.server.stop()


def _up(metres: float) -> Array:
    return np.array([0.0, metres, 0.0])
