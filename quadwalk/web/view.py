"""`quadwalk view` and `quadwalk demo`: serve the page with a run's robot until interrupted."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from quadwalk.bounds import Port, Settings
from quadwalk.cli.arguments import make_console, parse, take_value
from quadwalk.cli.shell import import_extra
from quadwalk.errors import UsageError, UserError
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run, find_any_run, find_ready, list_runs
from quadwalk.settings.training import OtherRobotConfig, RobotConfig

if TYPE_CHECKING:
    from quadwalk.web.serve import PageServer

LOCAL = ("127.0.0.1", "localhost", "::1")
_LOOK = 1.0  # s between looks for a newer policy
_OTHERS = 8  # runs beside the chosen one that the page offers


@dataclass(frozen=True)
class ViewConfig(Settings):
    """Drive a trained policy in a page of the browser, which steps MuJoCo itself."""

    # name or path of a run, or "latest"; before any training: drive, which comes trained
    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = "latest"
    # name or path of a run that gets the robot up where it has fallen; None: getup or, for another
    # robot than the AlienGo, universal_getup, which come trained
    getup: str | None = None
    policy: Literal["last", "best"] = "last"  # the run's last, or that of its best checkpoint
    window: bool = False  # show it in MuJoCo's own window instead
    host: str = "127.0.0.1"  # address that the page is served at; the default: to this machine only
    port: Port = 8080  # of the page; if it is taken, the next that is free
    runs: Path = Path("runs")  # folder that holds all runs
    robot: OtherRobotConfig = field(default_factory=OtherRobotConfig)


def main(args: Sequence[str], prog: str = "quadwalk view") -> None:
    """Run `quadwalk view` with command-line arguments `args`; `prog` is its name in messages."""
    view(parse(ViewConfig, args, prog))


def main_demo(args: Sequence[str], prog: str = "quadwalk demo") -> None:
    """Run `quadwalk demo [ROBOT]`: drive the robot of a file, or the one that comes trained.

    The former is driven by the run `universal`, or the one that `--run` names.
    """
    run, words = take_value(args, "--run")
    if words and not words[0].startswith("-"):
        words = [run or "universal", "--robot.urdf", *words]
    elif run is not None:
        raise UsageError("--run without a robot's file: expected quadwalk view RUN")
    else:
        words = ["drive", *words]
    view(parse(ViewConfig, words, prog))


def main_alongside(args: Sequence[str], prog: str) -> None:
    """Serve the page until standard input, which a training holds open, is closed."""

    relay = Relay()
    threading.Thread(target=relay.read, daemon=True).start()
    view(parse(ViewConfig, args, prog), relay)


class Relay:
    """Lines of JSON between a training, at standard input and output, and the open pages."""

    def __init__(self) -> None:
        self.changes: list[dict[str, Any]] = []  # at the desk, which still hold
        self._desk: str | None = None  # the newest state of the desk
        self._server: PageServer | None = None
        self._lock = threading.Lock()

    def connect(self, server: "PageServer") -> None:
        """Connect the training with the pages of `server` from now on."""
        server.on_message = self.write
        with self._lock:
            self._server = server
            if self._desk is not None:
                server.forward(self._desk)

    def read(self) -> None:
        """Read the training's lines; when it has ended, end this process too."""
        for line in sys.stdin:
            with self._lock:
                self._take(line.strip())
        os.kill(os.getpid(), signal.SIGTERM)  # scripts have SIGINT ignored in the background

    def write(self, text: str) -> None:
        """Send a page's message to the training."""
        with contextlib.suppress(OSError, ValueError), self._lock:
            print(text, flush=True)

    def _take(self, line: str) -> None:
        with contextlib.suppress(ValueError, AttributeError):  # then it is no message
            message = json.loads(line)
            if message.get("type") == "desk":
                self._desk, self.changes = line, message["changes"]
            if self._server is not None:
                self._server.forward(line)


def view(config: ViewConfig, relay: Relay | None = None) -> None:
    """Serve the page of a run's robot until Ctrl-C, or open MuJoCo's viewer (`config.window`).

    With a `relay` a training's desk is in the page.
    """
    run = find_ready(config.runs, config.run, "drive")
    getup = None if config.getup is None else find_any_run(config.runs, config.getup)
    robot = config.robot.find()
    import_extra("onnx", "the page", "view")
    if config.window:
        show_window(run, config.policy, getup, robot)
        return
    from quadwalk.web.serve import serve_page

    console = make_console()
    with serve_page(config.host, config.port) as server:
        if server.port != config.port:
            console.print(f"port {config.port} is taken, so the page is at port {server.port}")
        console.print(f"drive it at {server.url} (Ctrl-C ends)")
        if config.host not in LOCAL:
            console.print("whoever reaches this address can drive a robot of their own")
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(server.url)
        with console.status("loading"):
            from quadwalk.web.robots import LiveSite  # it imports JAX

            site = LiveSite(run, config.policy, getup, list_others(config.runs, run), robot)
        for note in site.notes:
            console.print(note)
        if relay is not None:
            site.add_comparison(lambda: relay.changes)
            relay.connect(server)
        server.set_files(site.files, site.make_actor)
        watch(run, config.policy, lambda: server.send_policy(site.load_newest()))


def list_others(root: Path, run: Run) -> list[Run]:
    """Return the runs that the page offers beside `run`: the newest, and the packaged ones."""
    runs = [*list_runs(root)[:_OTHERS], *list_runs(PRETRAINED)]
    return [other for other in runs if other.path != run.path and other.policy.exists()]


def watch(run: Run, which: str, send: Callable[[], None]) -> None:
    """Call `send` whenever training replaces policy `which`, "last" or "best"; never return."""
    file = run.best if which == "best" else run.policy
    last = get_time(file)
    while True:
        time.sleep(_LOOK)
        newest = get_time(file)
        if newest is not None and newest != last:
            last = newest
            with contextlib.suppress(UserError):  # it may be gone, or half of it copied
                send()


def get_time(file: Path) -> int | None:
    """Return when a file was written, in ns; None where it is missing."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return None


def show_window(run: Run, which: str, getup: Run | None, robot: RobotConfig | None) -> None:
    """Export the policy to a temporary folder, and run it in MuJoCo's window."""
    from quadwalk.export.bundle import export_run, load_flat
    from quadwalk.web.robots import load_getup

    if getup is None:
        riser = load_getup(load_flat(run, which, robot), None)
        getup = None if riser is None else riser.run
    with tempfile.TemporaryDirectory() as folder:
        export_run(run, which, Path(folder), make_console(), getup, robot)
        command = [sys.executable, f"{folder}/run_policy.py", "--view", "--seconds", "1e9"]
        if subprocess.run(command, check=False).returncode:
            raise UserError("MuJoCo's window does not open here; quadwalk view shows a page")
