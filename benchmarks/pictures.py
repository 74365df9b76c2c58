"""The moving picture of the README, from the packaged policies: `make pictures`.

    python benchmarks/pictures.py [--out docs/drive.webp]

Drives `drive`, with `getup` behind it, in MuJoCo C with every shape, along a course of commands,
and throws it over on the way.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from quadwalk.drawing.canvas import Camera, Canvas
from quadwalk.evaluate.loaded import LoadedRun
from quadwalk.files import atomic_write
from quadwalk.paths import PRETRAINED
from quadwalk.train.runs.directory import Run
from quadwalk.view.choices import LAST, getup_of, open_run
from quadwalk.view.live import LiveRobot

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


def poses(loaded: LoadedRun) -> Iterator[tuple[np.ndarray, str]]:
    """qpos (19,) of each picture, and what is written on it."""
    robot = LiveRobot(loaded, getup=getup_of(loaded, Run(PRETRAINED / "getup")))
    dt = robot.env.stepping.control_dt
    every = round(1.0 / FPS / dt)
    for step in range(round(SECONDS / dt)):
        _, name, command = [part for part in COURSE if part[0] <= step * dt + 1e-9][-1]
        robot.command[:] = command
        if step == round(THROWN / dt):
            robot.throw()
        robot.step()
        if step % every == 0:
            text = "getting up" if robot.rising else name
            speed = f"{robot.velocity[0]:.1f} m/s"
            yield robot.data.qpos.copy(), f"{text}   {speed}"


def pictures() -> Iterator[Image.Image]:
    """Each picture, the camera beside the robot and slowly after it."""
    loaded = open_run(Run(PRETRAINED / "drive"), LAST)
    canvas = Canvas(loaded.env.quadruped.full_model(), *SIZE)
    font = ImageFont.load_default(size=30)
    focus = None
    for qpos, text in poses(loaded):
        place = np.array([*qpos[:2], 0.3])
        focus = place if focus is None else focus + 0.25 * (place - focus)
        camera = Camera(focus, distance=1.7, azimuth=118.0, elevation=-12.0)
        picture = Image.fromarray(canvas.draw(qpos, camera))
        ImageDraw.Draw(picture).text((24, 18), text, fill=(30, 34, 40), font=font)
        yield picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("docs/drive.webp"))
    options = parser.parse_args()
    first, *others = pictures()
    duration = round(1000 / FPS)
    with atomic_write(options.out) as file:
        first.save(
            file,
            format="WEBP",
            save_all=True,
            append_images=others,
            duration=duration,
            loop=0,
            quality=40,
            method=3,
        )
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
