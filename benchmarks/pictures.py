"""The pictures of README and docs, from packaged policies and committed results: `make pictures`.

    python benchmarks/pictures.py [NAME ...]

Draws all of them, or those named, into docs/:

- drive: `drive`, with `getup` behind it, in MuJoCo C with every shape, along a course of commands,
  thrown over on the way.
- robustness, robustness_all: what studies/robustness/results.json holds.
- terrain: every kind of terrain at full difficulty.
- zoo: the robots of example-robot-data (extra `zoo`) with the masses and speeds of docs/zoo.md.
- pipeline: from a URDF to a policy.
- page: the page of `quadwalk demo`, in chromium (Debian's package).
"""

import dataclasses
import importlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.patches import FancyBboxPatch
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console

from benchmarks.shared import find_example_robots, make_parser
from quadwalk.cli.process import run_command
from quadwalk.errors import UserError
from quadwalk.evaluation.sweep import draw_sweep
from quadwalk.export.bundle import export_run
from quadwalk.files import open_atomic
from quadwalk.paths import PRETRAINED
from quadwalk.render.canvas import Camera, Canvas
from quadwalk.render.figures import make_figure, save_figure
from quadwalk.render.images import make_film_strip, save_png
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.runs.directory import Run
from quadwalk.terrain.picture import draw_kinds
from quadwalk.terrain.terrain import FLAT
from quadwalk.terrain.tiles import KINDS
from quadwalk.web.robots import LiveSite
from quadwalk.web.serve import serve_page
from studies.tables import load_result
from tests.web.browser import PROGRAM, open_browser, wait_until

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
RESULTS = ROOT / "studies" / "robustness" / "results.json"

SIZE = (1280, 600)  # pixels
FPS = 25
# s from the start, and from then on: what is said, and the command (m/s, m/s, rad/s)
COURSE: list[tuple[float, str, tuple[float, float, float]]] = [
    (0.0, "stand", (0.0, 0.0, 0.0)),
    (1.0, "walk", (0.8, 0.0, 0.0)),
    (3.0, "run", (3.5, 0.0, 0.0)),
    (6.0, "turn", (1.5, 0.0, 1.5)),
    (8.0, "thrown over", (1.5, 0.0, 0.0)),
    (8.8, "walk on", (1.5, 0.0, 0.0)),
    (11.0, "stand", (0.0, 0.0, 0.0)),
]
SECONDS = 12.0
THROWN = 8.0  # s
THROW_SPEED = 3.5  # m/s to the left
THROW_SPIN = 12.0  # rad/s about the trunk's x axis

# name in docs/zoo.md -> file in example-robot-data
ROBOTS = {
    "A1": "a1_description/urdf/a1.urdf",
    "ANYmal B": "anymal_b_simple_description/robots/anymal.urdf",
    "ANYmal C": "anymal_c_simple_description/urdf/anymal.urdf",
    "B1": "b1_description/urdf/b1.urdf",
    "Go1": "go1_description/urdf/go1.urdf",
    "Go2": "go2_description/urdf/go2.urdf",
    "HyQ": "hyq_description/robots/hyq_no_sensors.urdf",
    "Laikago": "laikago_description/urdf/laikago.urdf",
    "Solo12": "solo_description/robots/solo12.urdf",
}

# of the pipeline: name -> x, y of its middle, what is in it
STAGES = {
    "URDF": (1.1, 1.9, "any 12-joint robot"),
    "MJCF": (3.2, 1.9, "checked, with motors"),
    "environment": (5.3, 1.9, "2048 robots, JAX"),
    "PPO": (7.4, 1.9, "symmetric networks"),
    "policy": (9.5, 1.9, "joint targets, 50 Hz"),
    "eval": (11.9, 3.1, "MJX, MuJoCo C"),
    "view": (11.9, 1.9, "drive it, share it"),
    "export": (11.9, 0.7, "ONNX, deploy.yaml"),
}
ARROWS = [
    *(("URDF", "MJCF"), ("MJCF", "environment"), ("environment", "PPO"), ("PPO", "policy")),
    *(("policy", "eval"), ("policy", "view"), ("policy", "export")),
]
# x from, to -> the command
COMMANDS = {(0.3, 4.0): "quadwalk robot", (4.5, 10.3): "quadwalk train"}


def export_drive(folder: Path) -> Any:
    """Export `drive` with `getup` to `folder`; return the simulation of its run_policy.py.

    `folder` stays on `sys.path`.
    """
    drive, getup = (Run(PRETRAINED / name) for name in ("drive", "getup"))
    export_run(drive, "last", folder, Console(quiet=True), getup)
    sys.path.insert(0, str(folder))
    run_policy = importlib.import_module("run_policy")
    return run_policy.Simulation(folder, [0.0, 0.0, 0.0])


def simulate_drive(robot: Any) -> Iterator[tuple[np.ndarray, str]]:
    """Yield the pose (19,) for each frame of the film, and the text to write on it.

    `robot` is the simulation of `export_drive`. The text says what it does, and its speed along the
    heading, m/s.
    """
    steps_of_picture = round(1.0 / FPS / robot.period)
    for step in range(round(SECONDS / robot.period)):
        _, name, command = [part for part in COURSE if part[0] <= step * robot.period + 1e-9][-1]
        robot.command = robot.clip_command(command)
        if step == round(THROWN / robot.period):
            robot.data.qvel[:2] += THROW_SPEED * compute_left(robot.data)
            robot.data.qvel[3] -= THROW_SPIN
        robot.step()
        if step % steps_of_picture == 0:
            text = "getting up" if robot.controller is robot.riser else name
            forward = robot.data.qvel[:2] @ (compute_left(robot.data)[::-1] * (1.0, -1.0))
            yield robot.data.qpos.copy(), f"{text}   {forward:.1f} m/s"


def compute_left(data: mujoco.MjData) -> np.ndarray:
    """Return the direction (2,) to the left of the robot's heading."""
    w, x, y, z = data.qpos[3:7]
    heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.array([-np.sin(heading), np.cos(heading)])


def render_drive() -> Iterator[Image.Image]:
    """Yield each frame of the film, from a camera beside the robot that follows slowly."""
    with tempfile.TemporaryDirectory() as folder:
        robot = export_drive(Path(folder))
        canvas = Canvas(robot.model, *SIZE)
        font = ImageFont.load_default(size=30)
        focus = None
        for qpos, text in simulate_drive(robot):
            place = np.array([*qpos[:2], 0.3])
            focus = place if focus is None else focus + 0.25 * (place - focus)
            camera = Camera(focus, distance=1.7, azimuth=118.0, elevation=-12.0)
            picture = Image.fromarray(canvas.draw(qpos, camera))
            ImageDraw.Draw(picture).text((24, 18), text, fill=(30, 34, 40), font=font)
            yield picture


def draw_drive() -> None:
    """Write the README's film drive.webp: `drive` follows commands, is thrown over, gets up."""
    first, *others = render_drive()
    with open_atomic(DOCS / "drive.webp") as file:
        first.save(
            file,
            format="WEBP",
            save_all=True,
            append_images=others,
            duration=round(1000 / FPS),
            loop=0,
            quality=40,
            method=3,
        )


def draw_page() -> None:
    """Write page.png: the page of `quadwalk demo` in chromium, with the robot at a gallop.

    Raises `UserError` without chromium.
    """
    if PROGRAM is None:
        raise UserError("there is no chromium; expected Debian's package of that name")
    runs = [Run(PRETRAINED / name) for name in ("rough", "walk", "run")]
    site = LiveSite(Run(PRETRAINED / "drive"), "last", Run(PRETRAINED / "getup"), runs)
    with serve_page("127.0.0.1", 8310) as server:
        server.set_files(site.files)
        with open_browser(server.url) as browser:
            browser.resize(1280, 760)
            started = "(globalThis.quadwalk?.simulation?.time ?? 0) > 0.1"
            wait_until(lambda: browser.evaluate(started), 60.0)
            browser.evaluate("document.getElementById('panel').open = true")
            browser.evaluate("quadwalk.scene.adapt = () => {}")  # as with a graphics card
            browser.evaluate("Object.assign(quadwalk.scene.orbit, {turn: 0.5, distance: 2})")
            for code in ("KeyW", "ShiftLeft"):
                browser.send_key("keyDown", code)
            gallops = "quadwalk.simulation.velocity[0] > 3.6"
            wait_until(lambda: browser.evaluate(gallops), 120.0)
            time.sleep(20.0)  # it is drawn without a graphics card, and so slowly
            picture = Image.open(io.BytesIO(browser.screenshot()))
    save_png(np.asarray(picture.convert("RGB")), DOCS / "page.png")


def draw_robustness() -> None:
    """Write robustness.png: success and speed of `run` and `sprint` as six conditions get worse."""
    _draw_sweep("robustness", ("everything", "friction", "mass", "delay", "noise", "push"), 3)


def draw_robustness_all() -> None:
    """Write robustness_all.png: success and speed of `run` and `sprint` over each condition."""
    _draw_sweep("robustness_all", None, 4)


def _draw_sweep(name: str, conditions: tuple[str, ...] | None, columns: int) -> None:
    """Write docs/`name`.png: the sweep in results.json over `conditions`, None for all.

    `columns` panels are side by side.
    """
    results = json.loads(RESULTS.read_text())["runs"]
    for result in results:
        result["run"] += f", {result['training_steps'] / 1e6:.0f} M steps"
    randomized, ideal = (result["run"] for result in results)
    title = f"Trained with randomization ({randomized}) and without ({ideal})"
    save_figure(draw_sweep(results, conditions, columns, title), DOCS / f"{name}.png")


def draw_terrain() -> None:
    """Write terrain.png: every kind of terrain, with the robot on it."""
    kinds = tuple(kind for kind in KINDS if kind != "flat")
    config = dataclasses.replace(FLAT, kinds=kinds, levels=1, difficulty=(1.0, 1.0))
    save_png(draw_kinds(config, load_quadruped()), DOCS / "terrain.png")


def draw_zoo() -> None:
    """Write zoo.png: the robots of `ROBOTS` in their home poses, at one scale, with mass and speed.

    Each is read from its URDF; the figures are those of studies/results/zoo.json. Raises
    `UserError` without example-robot-data.
    """
    folder = find_example_robots()
    if folder is None:
        raise UserError("example-robot-data is not installed; expected the extra zoo")
    figures = {row["robot"]: row for row in load_result("zoo")["figures"]}
    font, pictures = ImageFont.load_default(size=22), []
    for name, file in ROBOTS.items():
        quadruped = load_quadruped(folder / file)
        canvas = Canvas(quadruped.make_full_model(), 480, 340)
        eye = Camera((0.0, 0.0, 0.36), distance=1.9, azimuth=130.0, elevation=-12.0)
        picture = Image.fromarray(canvas.draw(quadruped.home, eye))
        row = figures[name]
        text = f"{name}   {row['mass']} kg   {row['speed']:.1f} m/s"
        ImageDraw.Draw(picture).text((12, 8), text, fill=(30, 34, 40), font=font)
        pictures.append(np.asarray(picture))
    save_png(make_film_strip(pictures, across=3), DOCS / "zoo.png")


def _make_box(x: float, y: float) -> FancyBboxPatch:
    """Return a box of the diagram with its center at `x`, `y`."""
    corner, style = (x - 0.8, y - 0.42), "round,pad=0.1"
    return FancyBboxPatch(corner, 1.6, 0.84, boxstyle=style, fc="#eef4fb", ec="#0072b2", lw=1.5)


def draw_pipeline() -> None:
    """Write pipeline.png: the steps from a URDF to a policy as boxes and arrows."""
    figure = make_figure((13, 3.8), "")
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set(xlim=(0, 13), ylim=(0, 3.8))
    for name, (x, y, text) in STAGES.items():
        axes.add_patch(_make_box(x, y))
        axes.text(x, y + 0.18, name, ha="center", va="center", fontsize=15, weight="bold")
        axes.text(x, y - 0.2, text, ha="center", va="center", fontsize=10.5)
    for start, end in ARROWS:
        (x0, y0, _), (x1, y1, _) = STAGES[start], STAGES[end]
        axes.annotate(
            "",
            (x1 - 0.92, y1),
            (x0 + 0.92, y0),
            arrowprops={"arrowstyle": "-|>", "color": "#22262b", "lw": 1.6},
        )
    for (low, high), text in COMMANDS.items():
        axes.plot((low, high), (1.05, 1.05), color="#d55e00", lw=2)
        label = axes.text((low + high) / 2, 0.75, text, ha="center", va="center", fontsize=12)
        label.set(color="#a04000", family="monospace")
    save_figure(figure, DOCS / "pipeline.png")


DRAWINGS = {
    "drive": draw_drive,
    "robustness": draw_robustness,
    "robustness_all": draw_robustness_all,
    "terrain": draw_terrain,
    "zoo": draw_zoo,
    "pipeline": draw_pipeline,
    "page": draw_page,
}


def main() -> None:
    """Write the pictures that are named, or all, into docs/."""
    parser = make_parser(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(DRAWINGS)}")
    options = parser.parse_args()
    for name in options.names or DRAWINGS:
        if name not in DRAWINGS:
            parser.error(f"no picture {name!r}; expected one of: {', '.join(DRAWINGS)}")
        DRAWINGS[name]()
        print(f"drew {name}", flush=True)


if __name__ == "__main__":
    run_command(main)
