"""The choice of a GL library; without one that works, rays draw and nothing is printed."""

import os
import subprocess
import sys

import pytest

from quadwalk.render import opengl
from quadwalk.render.canvas import Canvas
from quadwalk.render.opengl import find_working_library

SCRIPT = """
import numpy as np
from quadwalk.render.canvas import Camera, Canvas
from quadwalk.robot.quadruped import load_quadruped
quadruped = load_quadruped()
canvas = Canvas(quadruped.make_full_model(), 32, 20)
assert canvas.draw(quadruped.home, Camera(np.zeros(3), 1.5, 90, -20)).std() > 1
print(canvas.library)
"""


@pytest.fixture
def machine(monkeypatch):
    """Return a function that pretends that there are these libraries, and no screen."""

    def pretend(libraries: tuple[str, ...], **environment: str) -> None:
        for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
            monkeypatch.delenv(name, raising=False)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(sys, "platform", "linux")
        monkeypatch.setattr("ctypes.util.find_library", lambda name: name in libraries or None)
        find_working_library.cache_clear()

    yield pretend
    find_working_library.cache_clear()


@pytest.mark.parametrize(
    ("libraries", "environment", "library"),
    [
        ((), {}, None),
        (("EGL",), {}, "egl"),
        (("EGL", "OSMesa"), {}, "osmesa"),
        (("EGL", "OSMesa"), {"DISPLAY": ":0"}, "window"),
        (("EGL", "OSMesa"), {"WAYLAND_DISPLAY": "wayland-0"}, "window"),
        (("OSMesa",), {"MUJOCO_GL": "EGL", "DISPLAY": ":0"}, "egl"),
        (("EGL",), {"MUJOCO_GL": "osmesa"}, "osmesa"),
        (("EGL",), {"MUJOCO_GL": "glfw"}, "window"),
        (("EGL", "OSMesa"), {"MUJOCO_GL": "disable", "DISPLAY": ":0"}, None),
        (("EGL", "OSMesa"), {"MUJOCO_GL": "off"}, None),
    ],
)
def test_the_environment_and_then_what_there_is_decide(machine, libraries, environment, library):
    machine(libraries, **environment)
    assert opengl.choose_library() == library


class Broken:
    """A context that complains on stderr in every way, and fails at `at`."""

    at = ""

    def __init__(self, width: int, height: int) -> None:
        os.write(2, b"libEGL warning: no device\n")
        print("no display", file=sys.stderr)
        self._fail("init")

    def _fail(self, at: str) -> None:
        if self.at == at:
            raise RuntimeError("no device")

    def make_current(self) -> None:
        self._fail("make_current")

    def free(self) -> None:
        pass

    def __del__(self) -> None:
        raise AttributeError("never set")


@pytest.mark.parametrize("at", ["import", "init", "make_current", "render"])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_library_that_fails_means_rays_and_silence(machine, monkeypatch, quadruped, capfd, at):
    def context_class(library: str) -> type:
        if at == "import":
            raise AttributeError("'NoneType' object has no attribute 'glGetError'")
        return type("Context", (Broken,), {"at": at})

    machine(("EGL",))
    monkeypatch.setattr(opengl, "_load_context_class", context_class)
    assert Canvas(quadruped.make_full_model(), 16, 16).library == "rays"
    assert find_working_library() is None
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("library", [None, "glfw"])
def test_drawing_is_silent_from_start_to_end(library):
    """Check the machine as it is, and a window where there is no screen."""
    hidden = ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY") if library else ()
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    if library:
        environment["MUJOCO_GL"] = library
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=environment
    )
    assert (done.returncode, done.stderr) == (0, "")
    if library:
        assert done.stdout == "rays\n"
