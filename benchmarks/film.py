"""The README's film: packaged policies in MuJoCo C, as docs/drive.webp (`make pictures`).

`drive` runs at its fastest, turns, and is thrown over; `getup` gets it up; `rough` climbs stairs.
A strip below shows which feet are on the ground, and an arrow the command.
"""

import dataclasses
import importlib
import sys
import tempfile
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console

from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.metrics import average_windows
from quadwalk.evaluation.rollout import simulate_episodes
from quadwalk.export.bundle import export_run
from quadwalk.files import open_atomic
from quadwalk.paths import PRETRAINED
from quadwalk.render.canvas import Camera, Canvas
from quadwalk.runs.directory import Run
from quadwalk.terrain.terrain import FLAT

SIZE = (960, 540)  # pixels
FPS = 25
INK, ORANGE, PAPER = (30, 34, 40), (213, 94, 0), (255, 255, 255)

# s of the simulation, and from then on: what is said, and the command (m/s, m/s, rad/s)
COURSE: list[tuple[float, str, tuple[float, float, float]]] = [
    (0.0, "run", (4.5, 0.0, 0.0)),
    (4.7, "turn", (1.5, 0.0, 1.8)),
    (6.0, "thrown over", (1.0, 0.0, 0.0)),
    (7.0, "walk on", (1.0, 0.0, 0.0)),
]
SHOWN = (3.0, 9.0)  # s of that, of which the film shows what lies between
THROWN = 6.0  # s
THROW_SPEED = 3.5  # m/s to the left
THROW_SPIN = 12.0  # rad/s about the trunk's x axis
STAIRS = (4.0, 6.0)  # s of the climb that the film shows
PACE = 0.8  # m/s on stairs

FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")
STRIP_SECONDS = 1.5
SMOOTHING = 0.4  # s: the camera follows the mean of the path


@dataclass(frozen=True)
class Frame:
    """A moment of the film: the pose (19,), what is said, and the command (m/s, m/s, rad/s)."""

    qpos: np.ndarray
    text: str
    command: tuple[float, float, float]


def draw_film(path: Path) -> None:
    """Write the film to `path`, a WEBP."""
    first, *others = [*render_drive(), *render_stairs()]
    with open_atomic(path) as file:
        first.save(
            file,
            format="WEBP",
            save_all=True,
            append_images=others,
            duration=round(1000 / FPS),
            loop=0,
            quality=18,
            method=6,
        )


def render_drive() -> Iterator[Image.Image]:
    """Yield the frames of `drive` and `getup` on a level floor."""
    with tempfile.TemporaryDirectory() as folder:
        robot = export_drive(Path(folder))
        yield from render(robot.model, list(simulate_drive(robot)))


def export_drive(folder: Path) -> Any:
    """Export `drive` with `getup` to `folder`; return the simulation of its run_policy.py.

    `folder` stays on `sys.path`.
    """
    drive, getup = (Run(PRETRAINED / name) for name in ("drive", "getup"))
    export_run(drive, "last", folder, Console(quiet=True), getup)
    sys.path.insert(0, str(folder))
    run_policy = importlib.import_module("run_policy")
    return run_policy.Simulation(folder, [0.0, 0.0, 0.0])


def simulate_drive(robot: Any) -> Iterator[Frame]:
    """Yield the film's frames of the course; `robot` is the simulation of `export_drive`."""
    steps_of_frame = round(1.0 / FPS / robot.period)
    start, end = (round(time / robot.period) for time in SHOWN)
    for step in range(end):
        name, command = [part[1:] for part in COURSE if part[0] <= step * robot.period + 1e-9][-1]
        robot.command = robot.clip_command(command)
        if step == round(THROWN / robot.period):
            robot.data.qvel[:2] += THROW_SPEED * compute_left(robot.data.qpos)
            robot.data.qvel[3] -= THROW_SPIN
        robot.step()
        if step >= start and (step - start) % steps_of_frame == 0:
            text = "getting up" if robot.controller is robot.riser else name
            left = compute_left(robot.data.qpos)
            forward = robot.data.qvel[:2] @ (left[1], -left[0])
            yield Frame(robot.data.qpos.copy(), f"{text}   {forward:.1f} m/s", command)


def compute_left(qpos: np.ndarray) -> np.ndarray:
    """Return the direction (2,) to the left of the heading of a robot at `qpos`."""
    w, x, y, z = qpos[3:7]
    heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.array([-np.sin(heading), np.cos(heading)])


def render_stairs() -> Iterator[Image.Image]:
    """Yield the frames of `rough`, which climbs stairs."""
    ground = dataclasses.replace(FLAT, kinds=("stairs_up",), levels=1, difficulty=(0.8, 0.8))
    command = (PACE, 0.0, 0.0)
    loaded = load_run(
        Run(PRETRAINED / "rough"), STAIRS[1], engine="mujoco", ground=ground, command=command
    )
    rollout = next(iter(simulate_episodes(loaded.env, loaded.policy.act, 1, seed=0)))
    rows = np.arange(*STAIRS, 1.0 / FPS) / rollout.control_dt
    poses = rollout.qpos[np.minimum(rows.round().astype(int), rollout.steps)]
    frames = [Frame(qpos, f"climb   {PACE:.1f} m/s", command) for qpos in poses]
    yield from render(loaded.env.quadruped.make_full_model(), frames)


def render(model: mujoco.MjModel, frames: list[Frame]) -> Iterator[Image.Image]:
    """Yield pictures of `frames`, from a camera beside the robot that follows its mean path."""
    canvas = Canvas(model, *SIZE)
    width = round(SMOOTHING * FPS) // 2 * 2 + 1
    path = np.array([frame.qpos[:3] for frame in frames])
    path = average_windows(np.pad(path, ((width // 2, width // 2), (0, 0)), "edge"), width)
    contacts: deque[np.ndarray] = deque(maxlen=round(STRIP_SECONDS * FPS))
    for frame, middle in zip(frames, path, strict=True):
        contacts.append(find_feet_on_ground(model, frame.qpos))
        focus = middle - (0.0, 0.0, 0.12)
        camera = Camera(focus, distance=1.25, azimuth=118.0, elevation=-10.0)
        picture = Image.fromarray(canvas.draw(frame.qpos, camera))
        draw_text(picture, frame.text)
        draw_command(picture, frame.command)
        draw_strip(picture, contacts)
        yield picture


def find_feet_on_ground(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Return which of `FEET` touch the ground in a pose, (4,) bool."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    touching = data.contact.geom.ravel()
    return np.isin([model.geom(name).id for name in FEET], touching)


def draw_text(picture: Image.Image, text: str) -> None:
    """Write what the robot does into the upper left corner."""
    font = ImageFont.load_default(size=30)
    ImageDraw.Draw(picture).text((24, 18), text, fill=INK, font=font)


def draw_command(picture: Image.Image, command: tuple[float, float, float]) -> None:
    """Draw the command into the upper right corner, seen from above with the head up.

    The arrow is the commanded velocity, the arc the commanded yaw rate.
    """
    draw, center = ImageDraw.Draw(picture), np.array([SIZE[0] - 80.0, 80.0])
    forward, lateral, yaw_rate = command
    draw.ellipse([*(center - 58), *(center + 58)], fill=PAPER, outline=INK, width=2)
    speed = float(np.hypot(forward, lateral))
    if speed > 0.0:
        ahead = np.array([-lateral, -forward]) / speed
        tip = center + 18.0 * np.sqrt(speed) * ahead  # so that a slow one can be seen
        aside = np.array([-ahead[1], ahead[0]])
        draw.line([*center, *tip], fill=ORANGE, width=7)
        corners = [tip + 9.0 * ahead, tip + 9.0 * aside, tip - 9.0 * aside]
        draw.polygon([tuple(corner) for corner in corners], fill=ORANGE)
    if yaw_rate:
        angle = float(np.degrees(yaw_rate)) * 0.7
        start, end = sorted((-90.0, -90.0 - angle))
        draw.arc([*(center - 50), *(center + 50)], start, end, fill=ORANGE, width=6)


def draw_strip(picture: Image.Image, contacts: deque[np.ndarray]) -> None:
    """Draw a bar for each foot below the robot, dark while the foot is on the ground.

    `contacts` are those of the last `STRIP_SECONDS`, the newest at the right.
    """
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(size=16)
    left, top, row = 70.0, SIZE[1] - 104.0, 22.0
    cell = 300.0 / round(STRIP_SECONDS * FPS)
    draw.rectangle([16, top - 8, left + 308, SIZE[1] - 10], fill=PAPER, outline=INK)
    for k, name in enumerate(FEET):
        y = top + k * row
        draw.text((26, y - 1), name.split("_")[0], fill=INK, font=font)
        for n, touching in enumerate(contacts):
            if touching[k]:
                x = left + n * cell
                draw.rectangle([x, y + 2, x + cell, y + 15], fill=INK)
