"""A picture of every kind of terrain, with the robot on it."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from quadwalk.render.canvas import Camera, Canvas
from quadwalk.render.images import make_film_strip
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import Heightfield, lay
from quadwalk.terrain.terrain import GroundConfig, Place, make_terrain, measure_leg

_ACROSS = 3  # pictures in a row, where there is one level
_SIZE = (480, 320)  # pixels of one
_SETTLED = 0.6  # s, in which the robot comes to stand
_TEXT: dict[str, Any] = {"fill": (30, 34, 40), "stroke_width": 2, "stroke_fill": "white"}


def draw_kinds(config: GroundConfig, quadruped: Quadruped) -> np.ndarray:
    """Draw every kind of `config` at every level, with the robot, (height, width, 3) uint8.

    Each row has one kind, level by level; if there is one level, each row has three kinds.
    """
    leg = measure_leg(quadruped.make_full_model(visuals=False), quadruped.feet[0])
    terrain = make_terrain(config, leg)
    spec = quadruped.spec.copy()
    lay(spec, terrain.field)
    model = replace(quadruped, spec=spec).make_full_model(timestep=0.004)
    canvas, font = Canvas(model, *_SIZE), ImageFont.load_default(size=22)
    pictures = []
    for place in terrain.tiles:
        qpos = _settle(model, quadruped, place, terrain.field)
        eye = Camera(qpos[:3], distance=8.5 * quadruped.home[2], azimuth=60.0, elevation=-22.0)
        picture = Image.fromarray(canvas.draw(qpos, eye))
        label = f"{place.kind.replace('_', ' ')}, difficulty {place.difficulty:.2g}"
        ImageDraw.Draw(picture).text((10, 8), label, font=font, **_TEXT)
        pictures.append(np.asarray(picture))
    return make_film_strip(pictures, config.levels if config.levels > 1 else _ACROSS)


def _settle(
    model: mujoco.MjModel, quadruped: Quadruped, place: Place, field: Heightfield
) -> np.ndarray:
    """Return the pose (19,) of the robot some time after it was put down at the start of a tile."""
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    data.qpos[:2] = place.start
    mujoco.mj_kinematics(model, data)
    feet = np.array([data.geom(name).xpos[:2] for name in quadruped.feet])
    data.qpos[2] += field.compute_height(feet).max()
    stiff = 1.4 * model.body_subtreemass[0] * quadruped.gravity * quadruped.home[2]
    while data.time < _SETTLED:
        torque = stiff * (quadruped.home[7:] - data.qpos[7:] - 0.025 * data.qvel[6:])
        data.ctrl = np.clip(torque, -quadruped.effort, quadruped.effort)
        mujoco.mj_step(model, data)
    return data.qpos.copy()
