"""The 3D picture of a live robot in a page: its shapes, its path, and arrows for what it feels."""

import copy
from typing import Any

import numpy as np
import viser
from mjviser import ViserMujocoScene

from quadwalk.view.live import LiveRobot
from quadwalk.view.traces import Traces, force_arrows, velocity_arrows

_COLLISION, _VISUAL = 3, 2  # groups of the robot's shapes
_TOLD, _DOES, _PUSHED, _WENT = (60, 170, 80), (50, 110, 220), (230, 120, 40), (120, 120, 130)


class Stage:
    """Draws one live robot with mjviser, which moves the world so that the view can stay."""

    def __init__(self, server: viser.ViserServer, live: LiveRobot) -> None:
        server.scene.reset()
        server.scene.configure_default_lights(cast_shadow=True)
        height = live.env.robot.home_height
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.position = tuple(height * np.array([-2.6, -4.2, 1.7]))
        self.follow = True
        self._server, self._height = server, height
        self._focus = np.zeros(3)
        self._scene = ViserMujocoScene(server, copy.copy(live.model), num_envs=1)
        # It keeps the body that it tracks in the middle. We track a place that does not sway: it is
        # handed over as the place of the world's own body, which has nothing to be drawn.
        self._scene._tracked_body_id = 0
        self.show_collision(False)
        self._feet = [live.model.geom(name).id for name in live.env.quadruped.feet]
        nothing = np.zeros((4, 2, 3))
        size: dict[str, Any] = {"shaft_radius": 0.012, "head_radius": 0.03, "head_length": 0.06}
        self._forces = server.scene.add_arrows("/forces", nothing, _PUSHED, **size)
        self._velocity = server.scene.add_arrows(
            "/velocity", nothing[:2], np.array([_DOES, _TOLD]), **size
        )
        self._path = server.scene.add_line_segments("/path", nothing[:1], _WENT, thickness=0.02)

    def show_collision(self, shown: bool) -> None:
        """Show the shapes that collide in place of those that are only seen."""
        visible = self._scene.geom_groups_visible
        visible[_COLLISION], visible[_VISUAL] = shown, not shown
        self._scene._sync_visibilities()

    def draw(self, live: LiveRobot, traces: Traces) -> None:
        data = live.data
        trunk = data.qpos[:3]
        if self.follow:
            level = trunk[2] - live.height
            self._focus = np.array([trunk[0], trunk[1], level + 0.7 * self._height])
        places = data.xpos.copy()[None]
        places[0, 0] = self._focus
        with self._server.atomic():
            self._scene.update_from_arrays(places, data.xmat.reshape(1, -1, 3, 3))
            # Arrows and path are placed as the view is: a slow browser draws them late, but there.
            feet = data.geom_xpos[self._feet]
            self._forces.points = self._seen(force_arrows(live, feet))
            self._velocity.points = self._seen(velocity_arrows(live))
            self._path.points = self._seen(traces.path)

    def _seen(self, points: np.ndarray) -> np.ndarray:
        """`points` (..., 3) m, world frame, from the middle of the view."""
        return (points - self._focus).astype(np.float32)
