"""The suite "standing": how soon a robot stands up from any pose, in MuJoCo C with every shape."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import STANDING_HEIGHT, STANDING_TILT
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.metrics import measure_cells
from quadwalk.evaluation.report.tables import print_table
from quadwalk.evaluation.rollout import GROUP, Report
from quadwalk.evaluation.sweep import Point, reset_at_points
from quadwalk.settings.environment import REAL_WORLD

SECONDS = (2.0, 3.0, 6.0)  # after the start, when the robot is checked
_NAMES = tuple(f"standing_{seconds:g}s" for seconds in SECONDS)


def to_standing_run(loaded: LoadedRun) -> LoadedRun:
    """Return `loaded` in MuJoCo C, in episodes that last as long as the last of `SECONDS`."""
    return loaded.to_mujoco(episode_seconds=max(SECONDS))


def measure_standing(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Return the shares of robots that stand 2, 3 and 6 s after the start, plain values for JSON.

    A robot stands as `check_standing` says. There is an entry for each of several conditions, with
    `episodes` from the same starts; its `success` is the share after 3 s. `loaded` comes from
    `to_standing_run`.
    """
    env = loaded.env
    points = make_standing_points(env)
    starts = reset_at_points(env, list(points.values()), episodes, seed)

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        stands = check_standing(env, poses)
        return {"success": stands[1], **dict(zip(_NAMES, stands, strict=True))}

    cells = measure_cells(env, loaded.policy.act, starts, episodes, measure, GROUP, report)
    return {
        "engine": env.engine,
        "episodes": episodes,
        "conditions": [
            {"name": name, **dataclasses.asdict(point), **figures}
            for (name, point), figures in zip(points.items(), cells, strict=True)
        ],
    }


def make_standing_points(env: QuadrupedEnv) -> dict[str, Point]:
    """Return conditions by name: floors, the heaviest load and weakest motors of `REAL_WORLD`."""
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


def check_standing(
    env: QuadrupedEnv, poses: np.ndarray, seconds: Sequence[float] = SECONDS
) -> tuple[bool, ...]:
    """Return for each of `seconds` True if the robot stands then, on a flat floor.

    Its trunk is then higher than `STANDING_HEIGHT` of the home height, and leans by less than
    `STANDING_TILT`. `poses` (T + 1, 7), m and wxyz, are those of the trunk. After the end of an
    episode the robot does not stand.
    """
    up = 1.0 - 2.0 * (poses[:, 4] ** 2 + poses[:, 5] ** 2)
    high = poses[:, 2] > STANDING_HEIGHT * env.robot.home_height
    stands = high & (up > math.cos(STANDING_TILT))
    steps = [round(time / env.config.control_dt) for time in seconds]
    return tuple(step < len(stands) and bool(stands[step]) for step in steps)


def print_standing(results: dict[str, Any]) -> None:
    """Print a table of the shares of robots that stand after each of `SECONDS`, by condition."""
    rows = []
    for condition in results["conditions"]:
        low, high = (100 * end for end in condition["success_ci95"])
        shares = [f"{100 * condition[name]:.1f}" for name in _NAMES]
        rows.append((condition["name"], *shares, f"{low:.1f} to {high:.1f}"))
    title = f"standing in MuJoCo C, of {results['episodes']} random poses"
    headings = [f"after {seconds:g} s, %" for seconds in SECONDS]
    print_table(title, ("", *headings, "95 % at 3 s"), rows)
