"""How soon a robot stands that starts in any pose, in MuJoCo C with every shape."""

import dataclasses
import math
from typing import Any

import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.robot_arrays import STANDING_HEIGHT, STANDING_TILT
from quadwalk.evaluation.grids.cells import measure_cells
from quadwalk.evaluation.grids.sweep import Point, starts_at
from quadwalk.evaluation.loaded import LoadedRun
from quadwalk.evaluation.simulate import GROUP, Report
from quadwalk.settings.environment import REAL_WORLD

SECONDS = (2.0, 3.0, 6.0)  # after the start, when it is looked at


def standing_run(loaded: LoadedRun) -> LoadedRun:
    """`loaded` in MuJoCo C, for as long as it is looked at."""
    return loaded.in_mujoco(episode_seconds=max(SECONDS))


def measure_standing(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """The share that stands after `SECONDS` under several conditions, as plain values for JSON.

    `loaded` is by `standing_run`. Each condition has `episodes` from the same starts. success: the
    share that stands after 3 s.
    """
    env = loaded.env
    points = standing_points(env)
    starts = starts_at(env, list(points.values()), episodes, seed)

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        found = standing(env, poses)
        return {"success": found[1], **dict(zip(_NAMES, found, strict=True))}

    found = measure_cells(env, loaded.policy.act, starts, episodes, measure, GROUP, report)
    return {
        "engine": env.engine,
        "episodes": episodes,
        "conditions": [
            {"name": name, **dataclasses.asdict(point), **figures}
            for (name, point), figures in zip(points.items(), found, strict=True)
        ],
    }


_NAMES = tuple(f"standing_{seconds:g}s" for seconds in SECONDS)


def standing_points(env: QuadrupedEnv) -> dict[str, Point]:
    """The conditions, by name: the heaviest load and the weakest motors of `REAL_WORLD`."""
    assert REAL_WORLD.trunk_mass is not None
    assert REAL_WORLD.strength is not None
    mass = round(REAL_WORLD.trunk_mass[1] * env.robot.mass, 1)
    strength = 100.0 * REAL_WORLD.strength[0]
    worst = Point(mass=mass, strength=strength)
    return {
        "model": Point(),
        "friction 0.4": Point(friction=0.4),
        "friction 1.25": Point(friction=1.25),
        f"+{mass:g} kg": Point(mass=mass),
        f"{strength:g} % torque": Point(strength=strength),
        "all, friction 0.4": dataclasses.replace(worst, friction=0.4),
        "all, friction 1.25": dataclasses.replace(worst, friction=1.25),
    }


def standing(env: QuadrupedEnv, poses: np.ndarray) -> tuple[bool, ...]:
    """Return True where a trunk of `poses` (T + 1, 7), m and wxyz, stands at `SECONDS`.

    The floor is flat. It does not stand where the episode ended before.
    """
    up = 1.0 - 2.0 * (poses[:, 4] ** 2 + poses[:, 5] ** 2)
    high = poses[:, 2] > STANDING_HEIGHT * env.robot.home_height
    stands = high & (up > math.cos(STANDING_TILT))
    steps = [round(seconds / env.config.control_dt) for seconds in SECONDS]
    return tuple(step < len(stands) and bool(stands[step]) for step in steps)
