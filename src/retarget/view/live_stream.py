"""A character that moves as poses arrive, in a browser on this machine, through viser."""

from __future__ import annotations

import numpy as np

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.errors import RetargetError
from retarget.live import LivePose
from retarget.motion.align import Actor
from retarget.view.live_server import HOST, quiet, start_server

Array = np.ndarray

SKIN = (205, 196, 186)
"""sRGB of the body."""


class StreamViewer:
    """A running viewer of one body; `close` ends it. Listens on the loopback address only.

    Raises `RetargetError` where viser is not installed, the port is taken, or the character has no surface.
    """

    def __init__(self, target: Actor, port: int | None = None) -> None:
        if target.character.skin is None:
            raise RetargetError("--view shows surfaces, and the character has none")
        self._skinner = prepare_skinning(target.character)
        self.server = start_server(port)
        self.address = f"http://{HOST}:{self.server.get_port()}"
        scene = self.server.scene
        scene.set_up_direction("+y")
        scene.add_grid("/ground", 40.0, 40.0, plane="xz", cell_size=0.5, section_size=1.0, fade_distance=14.0)
        scene.configure_environment_map(None)
        mesh = target.character.mesh
        self._body = scene.add_mesh_simple("/body", mesh.vertices.astype(np.float32), mesh.faces, color=SKIN)
        camera, tall = self.server.initial_camera, target.height
        camera.position, camera.look_at, camera.up = (0.4 * tall, 1.1 * tall, 2.6 * tall), (0.0, 0.5 * tall, 0.0), (0.0, 1.0, 0.0)
        self._state = self.server.gui.add_markdown("waiting for somebody")

    def show(self, pose: LivePose) -> None:
        """Show the character in a pose; one that shows nobody leaves it as it is."""
        self._state.content = f"frame {pose.frame}: {pose.status}, confidence {pose.confidence:.2f}"
        if pose.motion is not None:
            self._body.vertices = self._skinner.vertices(*world_pose(pose.motion))[0]

    def close(self) -> None:
        """End the server; browsers see that it is gone."""
        with quiet():
            self.server.stop()
