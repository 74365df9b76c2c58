"""Robustness: success and speed as one condition after another departs from training.

All points of all sweeps are one batch, and so one compilation. What each of them does to an episode
stands in `quadwalk.env.randomization`.
"""

import dataclasses
import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import State
from quadwalk.env import randomization
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.grids.cells import cell_starts, measure_cells
from quadwalk.evaluation.loaded import LoadedRun, training_ranges
from quadwalk.evaluation.motion.course import WINDOW, heading_velocity, tracking_errors
from quadwalk.evaluation.motion.kinematics import roll_pitch_yaw
from quadwalk.evaluation.simulate import Report, fresh_starts
from quadwalk.settings.environment import NO_RANDOMIZATION, Range


@dataclass(frozen=True)
class Point:
    """Conditions of episodes; a field without a value is as in the robot's model."""

    friction: float | None = None  # sliding friction of feet and floor; None: the model's
    mass: float = 0.0  # kg, added to the trunk
    center: float = 0.0  # m, by which the trunk's center of mass is further ahead
    strength: float = 100.0  # % of the motors' torque
    kp: float = 100.0  # % of the position gain
    kd: float = 100.0  # % of the velocity gain
    delay: float = 0.0  # ms, of joint targets
    sensor_delay: float = 0.0  # ms
    noise: float = 0.0  # level of the sensor noise
    encoder: float = 0.0  # rad, offset of each joint angle's measurement, to either side
    push: float = 0.0  # m/s, sideways, to either side
    push_ahead: float = 0.0  # m/s, forth or back
    everything: float = 0.0  # scale of the training randomization; 1: as in training


# field of Point -> heading, unit, values
SWEEPS: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "everything": ("everything at once", "x training", (0.0, 0.5, 1.0, 1.5)),
    "friction": ("friction", "", (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25)),
    "mass": ("added trunk mass", "kg", (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0)),
    "center": ("center of mass ahead", "m", (-0.06, -0.03, 0.0, 0.03, 0.06)),
    "strength": ("motor strength", "%", (80.0, 85.0, 90.0, 95.0, 100.0, 105.0, 110.0)),
    "kp": ("position gain", "%", (80.0, 90.0, 100.0, 110.0, 120.0)),
    "kd": ("velocity gain", "%", (80.0, 90.0, 100.0, 110.0, 120.0)),
    "delay": ("control delay", "ms", (0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 32.0)),
    "sensor_delay": ("sensor delay", "ms", (0.0, 5.0, 10.0, 20.0, 30.0)),
    "noise": ("sensor noise", "level", (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)),
    "encoder": ("encoder offset", "rad", (0.0, 0.01, 0.02, 0.03, 0.04)),
    "push": ("pushes sideways", "m/s", (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)),
    "push_ahead": ("pushes ahead or back", "m/s", (0.0, 0.5, 1.0, 1.5)),
}


def measure_sweeps(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """The figures of `measure_points` at the nominal point and at each value of each sweep."""
    points, nominal = sweep_points(loaded)
    measured = measure_points(loaded, points, episodes, seed, report)
    found, ranges = dict(zip(points, measured, strict=True)), task_ranges(loaded.env, nominal)
    sweeps = {
        name: {
            "heading": heading,
            "unit": unit,
            "nominal": getattr(nominal, name),
            "range": list(ranges[name]),
            "points": [
                {"value": value, **found[replace(nominal, **{name: value})]} for value in values
            ],
        }
        for name, (heading, unit, values) in SWEEPS.items()
    }
    return {"episodes": episodes, "nominal": found[nominal], "sweeps": sweeps}


def task_ranges(env: QuadrupedEnv, nominal: Point) -> dict[str, tuple[float, float]]:
    """Of each sweep the range in `training_ranges`, without a margin, in the sweep's unit."""
    config, robot = training_ranges(env.config), env.robot
    push = (config.push, robot.froude_speed)
    # field of Point -> range of the settings, and how much of the sweep's unit theirs is
    drawn: dict[str, tuple[Range, float]] = {
        "everything": ((0.0, 1.0), 1.0),
        "friction": (config.friction, 1.0),
        "mass": (config.trunk_mass, robot.mass),
        "center": (config.trunk_center, robot.home_height),
        "strength": (config.strength, 100.0),
        "kp": (config.kp, 100.0),
        "kd": (config.kd, 100.0),
        "delay": (config.latency, 1000.0),
        "sensor_delay": (config.sensor_latency, 1000.0),
        "noise": (config.noise, 1.0),
        "encoder": (config.encoder, 1.0),
        "push": push,
        "push_ahead": push,
    }
    usual = {name: (getattr(nominal, name), getattr(nominal, name)) for name in drawn}
    return {
        name: usual[name] if between is None else (unit * between[0], unit * between[1])
        for name, (between, unit) in drawn.items()
    }


def sweep_points(loaded: LoadedRun) -> tuple[list[Point], Point]:
    """Every distinct point of all sweeps, and the one without any perturbation."""
    nominal = Point(friction=round(loaded.env.friction, 6))
    points = [
        replace(nominal, **{name: value})
        for name, (_, _, values) in SWEEPS.items()
        for value in values
    ]
    return list(dict.fromkeys([nominal, *points])), nominal


def measure_points(
    loaded: LoadedRun,
    points: list[Point],
    episodes: int,
    seed: int,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Success, speed and tracking at each point, of `episodes` from the same starts, in one batch.

    success: the share that reaches the time limit without a fall. speed: as in an evaluation,
    distance along world x over the episode's duration, of every episode, fallen or not, m/s; with
    commands, the size of the commanded velocity less that of the error, on average. heading_error:
    mean |yaw|, deg; with commands in its place velocity_error, m/s, and yaw_rate_error, rad/s, as
    in an evaluation, but that the windows do not overlap.
    """
    env, starts = loaded.env, starts_at(loaded.env, points, episodes, seed)
    commands, dt = starts.pipeline_state.command, env.config.control_dt
    commanded = None if commands is None else np.asarray(commands.velocity, float)

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        if commanded is None:
            yaw = roll_pitch_yaw(poses[1:, 3:])[:, 2]
            speed = (poses[-1, 0] - poses[0, 0]) / (dt * len(yaw))
            return {"speed": speed, "heading_error": float(np.degrees(np.abs(yaw).mean()))}
        velocity = heading_velocity(poses, dt)
        command = np.broadcast_to(commanded[number], velocity.shape)
        off = np.linalg.norm((velocity - command)[:, :2], axis=1)
        errors = tracking_errors(velocity, command, dt, apart=round(WINDOW / dt))
        speed = float(np.linalg.norm(command[0, :2]) - off.mean())
        return {"speed": speed, "velocity_error": errors[0], "yaw_rate_error": errors[1]}

    return measure_cells(env, loaded.policy.act, starts, episodes, measure, report=report)


def starts_at(env: QuadrupedEnv, points: list[Point], episodes: int, seed: int) -> State:
    """The first states of all episodes, under the conditions of their points.

    Each point has the same starts, and the same draws but for their size.
    """
    latest = randomization.latest_drawn(training_ranges(env.config))
    late = max(p.delay / 1e3 + p.everything * latest[0] for p in points)
    kept = randomization.targets_needed(math.ceil(late / env.stepping.dt), env.stepping.substeps)
    sensors = max(p.sensor_delay / 1e3 + p.everything * latest[1] for p in points)
    readings = randomization.readings_needed(sensors, env.config.control_dt)

    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 1), episodes)
    known = [p if p.friction is not None else replace(p, friction=env.friction) for p in points]
    rows = np.array([dataclasses.astuple(point) for point in known], np.float32)

    def start(env: QuadrupedEnv, row: jax.Array, state: State, key: jax.Array) -> State:
        conditions = conditions_at(env, Point(*row), key, kept)
        return env.begun(state, readings, conditions=conditions)

    return cell_starts(env, start, rows, fresh_starts(env, episodes, seed), keys)


def conditions_at(
    env: QuadrupedEnv, point: Point, key: jax.Array, kept: int
) -> randomization.EpisodeRandomization:
    """The conditions of one episode at `point`, whose numbers may be traced."""
    robot, stepping = env.robot, env.stepping
    ideal = dataclasses.replace(NO_RANDOMIZATION, sensor_latency=(0.0, 0.0))
    base = randomization.draw_conditions(ideal, robot, stepping, key, env.friction)
    drawn = randomization.draw_conditions(
        training_ranges(env.config), robot, stepping, key, env.friction
    )
    drawn = drawn._replace(
        targets=base.targets,
        sensor_delay=base.sensor_delay if drawn.sensor_delay is None else drawn.sensor_delay,
    )
    mixed = jax.tree.map(
        lambda usual, own: usual + point.everything * (own - usual),
        base._replace(key=jnp.zeros(())),
        drawn._replace(key=jnp.zeros(())),
    )
    usual = mixed.variation
    assert usual is not None
    lightest = -0.9 * env.robot.geometry.trunk.mass  # kg: a tenth is left
    sides = jax.random.rademacher(jax.random.fold_in(key, 1), (12,), jnp.float32)
    variation = usual._replace(
        friction=usual.friction - env.friction + point.friction,
        trunk_mass=jnp.maximum(usual.trunk_mass + point.mass, lightest),
        trunk_center=usual.trunk_center + jnp.array([1.0, 0.0, 0.0]) * point.center,
        strength=usual.strength * point.strength / 100.0,
        kp=usual.kp * point.kp / 100.0,
        kd=usual.kd * point.kd / 100.0,
    )
    return mixed._replace(
        variation=randomization.possible(variation),
        delay=mixed.delay + point.delay / (1000.0 * stepping.dt),
        sensor_delay=mixed.sensor_delay + point.sensor_delay / 1000.0 / stepping.control_dt,
        push=mixed.push + jnp.stack([point.push_ahead, point.push]),
        noise=mixed.noise + point.noise,
        encoder=mixed.encoder + point.encoder * sides,
        targets=jnp.tile(base.targets[:1], (kept, 1)),
        key=base.key,
    )
