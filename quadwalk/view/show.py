"""Where a live robot is shown: in MuJoCo's window where there is a screen, or in a page."""

import contextlib
import importlib.util
import os
import sys
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quadwalk.bounds import Port, Settings
from quadwalk.cli.arguments import make_console, parse
from quadwalk.cli.shell import suggest_install
from quadwalk.errors import UserError
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run, find_any_run, find_ready


@dataclass(frozen=True)
class ViewConfig(Settings):
    """Drive a trained policy live, in MuJoCo C with every collision shape."""

    # name or path of a run, or "latest"; before any training: drive, which comes trained
    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = "latest"
    # name or path of a run that gets the robot up where it has fallen; None: getup, which comes
    # trained, where the robot is of its kind
    getup: str | None = None
    policy: Literal["last", "best"] = "last"  # the run's last, or that of its best checkpoint
    browser: bool = False  # in a page of the browser, even where there is a screen for a window
    host: str = "127.0.0.1"  # address that the page is served at; the default: to this machine only
    port: Port = 8080  # of the page; if it is taken, the next that is free
    runs: Path = Path("runs")  # folder that holds all runs


def main(args: Sequence[str], prog: str = "quadwalk view") -> None:
    """Drive the run that the arguments name."""
    drive(parse(ViewConfig, args, prog))


def drive(config: ViewConfig) -> None:
    """Show the run's policy live, until it is interrupted or the window closed."""
    run = find_ready(config.runs, config.run, "drive")
    packaged = Run(PRETRAINED / "getup")
    getup = packaged if packaged.policy.exists() else None
    if config.getup is not None:
        getup = find_any_run(config.runs, config.getup)
    console = make_console()
    missing = no_window()
    in_page = config.browser or missing is not None
    if in_page and importlib.util.find_spec("mjviser") is None:
        because = "" if missing is None else f"there is no window ({missing}), and "
        raise UserError(
            f"{because}a page needs mjviser, which is not installed: {suggest_install('view')}"
        )
    with contextlib.suppress(KeyboardInterrupt):
        if not in_page:
            _prepare_jax()
            from quadwalk.view.window import drive_in_window

            drive_in_window(run, console, getup, config.policy)
            return
        from quadwalk.view.server import serving, url_of

        with serving(config.host, config.port, console) as server:
            if missing is None:
                webbrowser.open(url_of(config.host, server.get_port()))
            with console.status("loading"):
                _prepare_jax()
                from quadwalk.view.page import Page  # what it needs takes seconds

                page = Page(server, run, config.runs, config.policy, getup)
            page.run_for()


def no_window() -> str | None:
    """Why no window can be opened here; None where one can."""
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return "neither DISPLAY nor WAYLAND_DISPLAY is set"
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    if chosen in ("osmesa", "egl"):
        return f"MUJOCO_GL is {chosen}, which has no window"
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
        return " ".join(" ".join(said).split()) or "GLFW opens no window"
    glfw.destroy_window(window)
    return None


def _prepare_jax() -> None:
    """One robot needs no accelerator, which takes long to set up, and no second device."""
    if "jax" not in sys.modules:
        os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from quadwalk.learn.devices import set_up_devices

    set_up_devices(1)
    import jax

    # A step is too short to be handed to another thread: that would take as long again.
    jax.config.update("jax_cpu_enable_async_dispatch", False)
