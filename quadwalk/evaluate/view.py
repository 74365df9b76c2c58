"""An episode in MuJoCo's viewer, on a screen."""

import contextlib
import os
import sys
import time

from rich.console import Console

from quadwalk.errors import UserError
from quadwalk.evaluate.rollout import Rollout, finite_part
from quadwalk.robot.quadruped import Quadruped

_FPS = 60
_PAUSE = 0.7  # s, between the end of an episode and its beginning


def check_screen() -> None:
    """Raise `UserError` in one line where there is no screen to open a window on."""
    elsewhere = "expected a screen; the MCAP files show the same, and --video draws without one"
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise UserError(f"cannot --view: neither DISPLAY nor WAYLAND_DISPLAY is set; {elsewhere}")
    if os.environ.get("MUJOCO_GL", "").lower() in ("osmesa", "egl"):
        chosen = os.environ["MUJOCO_GL"]
        raise UserError(f"cannot --view: MUJOCO_GL is {chosen}, which has no window; {elsewhere}")
    import glfw

    said: list[str] = []
    glfw.set_error_callback(lambda _, text: said.append(os.fsdecode(text)))
    window = None
    if glfw.init():
        # The viewer opens its window in a thread, and would be waited for in vain without one.
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "quadwalk", None, None)
        glfw.default_window_hints()
    glfw.set_error_callback(None)  # type: ignore[arg-type]
    if not window:
        reason = " ".join(" ".join(said).split()) or "GLFW opens no window"
        raise UserError(f"cannot --view: {reason}; {elsewhere}")
    glfw.destroy_window(window)


def view(rollout: Rollout, quadruped: Quadruped, console: Console) -> None:
    """Play the episode in real time, again and again, until the window is closed."""
    import mujoco.viewer  # it loads a window library, which nothing else needs

    rollout = finite_part(rollout)
    model = quadruped.full_model()
    data = mujoco.MjData(model)
    length = rollout.steps * rollout.control_dt
    try:
        handle = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except Exception as error:  # macOS without mjpython: RuntimeError; no OpenGL: FatalError
        raise UserError(f"cannot --view: {' '.join(str(error).split())}") from error
    console.print(
        f"playing episode {rollout.episode}, {length:.1f} s, in MuJoCo's viewer: close its window "
        "or press Ctrl-C to end"
    )
    with contextlib.suppress(KeyboardInterrupt), handle as window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = model.body(quadruped.trunk).id
        window.cam.distance, window.cam.azimuth, window.cam.elevation = 2.0, 118.0, -14.0
        began = time.monotonic()
        while window.is_running():
            seconds = (time.monotonic() - began) % (length + _PAUSE)
            row = min(int(seconds / rollout.control_dt), rollout.steps)
            with window.lock():
                data.qpos[:], data.qvel[:] = rollout.qpos[row], rollout.qvel[row]
                data.time = row * rollout.control_dt
                mujoco.mj_forward(model, data)
            window.sync()
            time.sleep(1 / _FPS)
