"""The pictures of README and docs, from packaged policies and committed results: `make pictures`.

    python benchmarks/pictures.py [NAME ...]

Draws all of them, or those named, into docs/:

- drive: the README's film, of `benchmarks/film.py`.
- robustness, robustness_all: what studies/robustness/results.json holds.
- terrain: every kind of terrain at full difficulty.
- zoo: the robots of example-robot-data (extra `zoo`) with the masses and speeds of docs/zoo.md.
- universal: robots that `universal` drives without training, each over one stride.
- pipeline: from a URDF to a policy.
- page: the page of `quadwalk demo`, in chromium (Debian's package).
"""

import dataclasses
import io
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import FancyBboxPatch
from PIL import Image, ImageDraw, ImageFont

from benchmarks.film import draw_film
from benchmarks.shared import find_example_robots, make_parser
from quadwalk.cli.process import run_command
from quadwalk.errors import UserError
from quadwalk.evaluation.gait import find_middle_strides
from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.rollout import reset_with_commands, simulate_episodes
from quadwalk.evaluation.suites.gaits import SECONDS, to_held_run
from quadwalk.evaluation.sweep import draw_sweep
from quadwalk.paths import PRETRAINED
from quadwalk.render.canvas import Camera, Canvas
from quadwalk.render.figures import get_style, make_figure, save_figure, tidy
from quadwalk.render.images import make_film_strip, save_png
from quadwalk.robot.bodies import GRAVITY
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.runs.directory import Run
from quadwalk.settings.training import OtherRobotConfig
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

# Those of universal.png.
STRIDES_OF = ("Go2", "Solo12", "Laikago", "ANYmal B", "B1", "HyQ")
PACE = 0.75  # share of the Froude speed that they are commanded to

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


def draw_drive() -> None:
    """Write the README's film."""
    draw_film(DOCS / "drive.webp")


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


def load_sweeps() -> list[dict[str, Any]]:
    """Return the sweeps of `run` and `sprint`, each with its name and steps as `run`."""
    results: list[dict[str, Any]] = json.loads(RESULTS.read_text())["runs"]
    for result in results:
        result["run"] += f", {result['training_steps'] / 1e6:.0f} M steps"
    return results


def draw_robustness() -> None:
    """Write robustness.png: episodes of `run` and `sprint` without a fall as conditions worsen."""
    figure = make_figure((9.6, 4.0), "Episodes without a fall, %")
    panels = figure.subplots(1, 3, sharey=True)
    names = ("trained with randomization", "trained without")
    for axes, condition in zip(panels, ("everything", "push", "delay"), strict=True):
        for k, result in enumerate(load_sweeps()):
            sweep, (color, mark) = result["sweeps"][condition], get_style(k)
            values = [point["value"] for point in sweep["points"]]
            shares = [100 * point["success"] for point in sweep["points"]]
            axes.plot(values, shares, f"{mark}-", color=color, lw=2.5, ms=8, label=names[k])
        tidy(axes, sweep["heading"], sweep["unit"])
        axes.set_ylim(-3, 106)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=13)
    save_figure(figure, DOCS / "robustness.png")


def draw_robustness_all() -> None:
    """Write robustness_all.png: success and speed of `run` and `sprint` over each condition."""
    results = load_sweeps()
    randomized, ideal = (result["run"] for result in results)
    title = f"Trained with randomization ({randomized}) and without ({ideal})"
    save_figure(draw_sweep(results, None, 4, title), DOCS / "robustness_all.png")


def draw_terrain() -> None:
    """Write terrain.png: every kind of terrain, with the robot on it."""
    kinds = tuple(kind for kind in KINDS if kind != "flat")
    config = dataclasses.replace(FLAT, kinds=kinds, levels=1, difficulty=(1.0, 1.0))
    save_png(draw_kinds(config, load_quadruped()), DOCS / "terrain.png")


def locate_example_robots() -> Path:
    """Return the folder of example-robot-data; raise `UserError` where it is not installed."""
    folder = find_example_robots()
    if folder is None:
        raise UserError("example-robot-data is not installed; expected the extra zoo")
    return folder


def draw_zoo() -> None:
    """Write zoo.png: the robots of `ROBOTS` in their home poses, at one scale, with mass and speed.

    Each is read from its URDF; the figures are those of studies/results/zoo.json. Raises
    `UserError` without example-robot-data.
    """
    folder = locate_example_robots()
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


def draw_universal() -> None:
    """Write universal.png: a row for each robot of `STRIDES_OF`, one stride of it in MuJoCo C.

    The packaged `universal` drives them, straight ahead. Raises `UserError` without
    example-robot-data.
    """
    folder = locate_example_robots()
    rows = [draw_stride(name, folder / ROBOTS[name]) for name in STRIDES_OF]
    save_png(make_film_strip(rows, across=1), DOCS / "universal.png")


def draw_stride(name: str, file: Path, across: int = 5) -> np.ndarray:
    """Return `across` pictures of one stride of a robot side by side; its file is a URDF."""
    robot = OtherRobotConfig(urdf=file).find()
    loaded = to_held_run(load_run(Run(PRETRAINED / "universal"), SECONDS, robot=robot))
    env = loaded.env
    height = env.quadruped.home[2]
    speed = round(PACE * (GRAVITY * height) ** 0.5, 1)
    starts = reset_with_commands(env, [(speed, 0.0, 0.0)], 1, seed=0)
    [rollout] = simulate_episodes(env, loaded.policy.act, 1, seed=0, starts=starts)
    start, end = find_middle_strides(rollout, 1, otherwise=0.5)
    canvas = Canvas(env.quadruped.make_full_model(), 288, 216)
    font = ImageFont.load_default(size=16)
    pictures: list[np.ndarray] = []
    for row in np.linspace(start, end, across, endpoint=False).round().astype(int):
        pose = rollout.qpos[row]
        eye = Camera((*pose[:2], 0.75 * height), 3.6 * height, azimuth=118.0, elevation=-14.0)
        picture = Image.fromarray(canvas.draw(pose, eye))
        text = f"{(row - start) * rollout.control_dt:.2f} s" if pictures else f"{name}  {speed} m/s"
        ImageDraw.Draw(picture).text((8, 6), text, fill=(30, 34, 40), font=font)
        pictures.append(np.asarray(picture))
    return make_film_strip(pictures, across)


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
    "universal": draw_universal,
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
