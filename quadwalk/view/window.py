"""A live robot in MuJoCo's own window, on a screen."""

import queue
import time
from typing import Any

import mujoco
import mujoco.viewer
import numpy as np
from rich.console import Console

from quadwalk.errors import UserError
from quadwalk.runs.directory import Run
from quadwalk.view.choices import LAST, getup_of, open_run
from quadwalk.view.live import LiveRobot
from quadwalk.view.pace import Pace
from quadwalk.view.traces import Traces, velocity_arrows

_FRAME = 1 / 60  # s
_PUSH = 1.0  # m/s
_PRESSES = 10  # of a key, from 0 to the end of a command's range
_WENT, _DOES, _TOLD = (0.45, 0.45, 0.5, 1.0), (0.2, 0.43, 0.86, 1.0), (0.24, 0.67, 0.31, 1.0)
_PATH = 60  # pieces of the path that are drawn
_WIDTH = 0.012  # m, of an arrow
# GLFW's numbers of keys, for MuJoCo's window has meanings of its own for letters: which number of
# the command, and which way. Up and down, left and right, PageUp and PageDown.
_COMMANDS = {265: (0, 1), 264: (0, -1), 263: (2, 1), 262: (2, -1), 266: (1, 1), 267: (1, -1)}
_SPACE, _ENTER, _DELETE, _HOME, _END = 32, 257, 261, 268, 269
_HELP = (
    "arrows: faster, slower, left, right; PageUp, PageDown: sideways; End: stop; Space: pause; "
    "Home: reset; Enter: push; Delete: throw over"
)


class Keys:
    """What the keys that were pressed do to `live`. MuJoCo's window presses in its own thread."""

    def __init__(self, live: LiveRobot) -> None:
        self.playing = True
        self._live = live
        self._pressed: queue.SimpleQueue[int] = queue.SimpleQueue()
        config = live.env.config.command
        self._ranges = np.array([config.forward, config.lateral, config.yaw_rate])

    def press(self, key: int) -> None:
        """Remember that `key`, GLFW's number, was pressed."""
        self._pressed.put(key)

    def answer(self) -> None:
        while not self._pressed.empty():
            key, live = self._pressed.get(), self._live
            if key in _COMMANDS:
                index, sign = _COMMANDS[key]
                low, high = self._ranges[index]
                more = live.command[index] + sign * (high if sign > 0 else -low) / _PRESSES
                live.command[index] = np.clip(more, low, high)
            elif key == _END:
                live.command[:] = 0.0
            elif key == _SPACE:
                self.playing = not self.playing
            elif key == _HOME:
                live.reset()
            elif key == _ENTER:
                live.push(0.0, _PUSH)
            elif key == _DELETE:
                live.throw()


def drive_in_window(
    run: Run, console: Console, getup: Run | None = None, policy: str = LAST
) -> None:
    """Drive a policy of `run` with keys until the window is closed; `getup` gets a robot up."""
    loaded = open_run(run, policy)
    for note in loaded.notes:
        console.print(note)
    live = LiveRobot(loaded, getup=getup_of(loaded, getup))
    live.prepare()  # now, not when time goes
    keys, dt = Keys(live), live.env.stepping.control_dt
    pace, traces = Pace(dt), Traces(dt)
    # The window draws from its own state, at its own time.
    model, shown = live.model, mujoco.MjData(live.model)
    try:
        handle = mujoco.viewer.launch_passive(
            model, shown, key_callback=keys.press, show_left_ui=False, show_right_ui=False
        )
    except Exception as error:  # macOS without mjpython: RuntimeError; no OpenGL: FatalError
        reason = " ".join(str(error).split())
        raise UserError(f"no window: {reason}; --browser shows a page instead") from error
    console.print(f"{run.name} in MuJoCo's window. {_HELP}. Close it or press Ctrl-C to end.")
    with handle as window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = model.body(live.env.quadruped.trunk).id
        window.cam.distance, window.cam.azimuth, window.cam.elevation = 2.5, 118.0, -14.0
        window.opt.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = True
        while window.is_running():
            keys.answer()
            due = pace.due() if keys.playing else 0
            for _ in range(due):
                began = time.perf_counter()
                live.step()
                pace.done(time.perf_counter() - began)
                traces.add(live)
            if not keys.playing:
                pace.restart()
            with window.lock():
                shown.qpos[:], shown.qvel[:] = live.data.qpos, live.data.qvel
                shown.qfrc_applied[:] = live.data.qfrc_applied
                mujoco.mj_forward(model, shown)
                draw_overlay(window.user_scn, live, traces)
            window.set_texts((None, None, run.name, _said(live, pace)))
            window.sync()
            time.sleep(_FRAME)


def draw_overlay(scene: mujoco.MjvScene, live: LiveRobot, traces: Traces) -> None:
    """Path, velocity and velocity command as shapes of `scene`, in place of what it has."""
    scene.ngeom = 0
    path = traces.path
    pieces = path[:: 1 + len(path) // _PATH]
    for start, end in zip(pieces[:, 0], [*pieces[1:, 0], path[-1, 1]], strict=True):
        _connect(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, start, end, _WENT)
    for (start, end), color in zip(velocity_arrows(live), (_DOES, _TOLD), strict=True):
        _connect(scene, mujoco.mjtGeom.mjGEOM_ARROW, start, end, color)


def _connect(scene: mujoco.MjvScene, kind: int, start: Any, end: Any, color: Any) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    nothing, turn = np.zeros(3), np.eye(3).ravel()
    mujoco.mjv_initGeom(geom, kind, nothing, nothing, turn, np.float32(color))
    mujoco.mjv_connector(geom, kind, _WIDTH, start.astype(float), end.astype(float))
    scene.ngeom += 1


def _said(live: LiveRobot, pace: Pace) -> str:
    kept = "" if pace.kept else f", not in real time: {pace.reached:.2f}"
    forward, left, turning = live.command
    command = ""
    if live.env.config.command.active:
        command = f", command {forward:.2f} {left:.2f} {turning:.2f}"
    return f"{live.velocity[0]:.2f} m/s{command}{kept}"
