"""Sweeps: success and speed as one condition after another departs from the robot's model.

All points of all sweeps are one batch, and so one compilation. What each of them does to an episode
stands in `quadwalk.env.randomization`.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from quadwalk.brax import State
from quadwalk.env import randomization
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.load import LoadedRun, find_training_ranges
from quadwalk.evaluation.metrics import (
    WINDOW,
    compute_heading_velocity,
    compute_tracking_errors,
    measure_cells,
    to_roll_pitch_yaw,
)
from quadwalk.evaluation.report.tables import format_value, print_table
from quadwalk.evaluation.rollout import Report, reset_cells, reset_episodes
from quadwalk.render.figures import INK, get_style, make_figure, tidy
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
# The columns of the table beside success, of those that there are.
_COLUMNS = {
    "speed": "speed, m/s",
    "heading_error": "heading error, deg",
    "velocity_error": "velocity error, m/s",
    "yaw_rate_error": "yaw rate error, rad/s",
}


def measure_sweeps(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Return the figures of `measure_points` without perturbation and at each value of a sweep.

    They are plain values for JSON. Each sweep has its condition's nominal value and range too, as
    of `make_task_ranges`.
    """
    points, nominal = make_sweep_points(loaded)
    measured = measure_points(loaded, points, episodes, seed, report)
    figures = dict(zip(points, measured, strict=True))
    ranges = make_task_ranges(loaded.env, nominal)
    sweeps = {
        name: {
            "heading": heading,
            "unit": unit,
            "nominal": getattr(nominal, name),
            "range": list(ranges[name]),
            "points": [
                {"value": value, **figures[replace(nominal, **{name: value})]} for value in values
            ],
        }
        for name, (heading, unit, values) in SWEEPS.items()
    }
    return {"episodes": episodes, "nominal": figures[nominal], "sweeps": sweeps}


def make_task_ranges(env: QuadrupedEnv, nominal: Point) -> dict[str, tuple[float, float]]:
    """Return the range of each sweep's condition in training, or in `REAL_WORLD` without any.

    Ranges are in the sweep's unit. A condition that is not randomized has `nominal`'s value twice.
    """
    config, robot = find_training_ranges(env.config), env.robot
    push = (config.push, robot.froude_speed)
    # field of Point -> range of the settings, and how much of the sweep's unit theirs is
    settings: dict[str, tuple[Range, float]] = {
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
    ranges = {}
    for name, (between, unit) in settings.items():
        usual = getattr(nominal, name)
        ranges[name] = (usual, usual) if between is None else (unit * between[0], unit * between[1])
    return ranges


def make_sweep_points(loaded: LoadedRun) -> tuple[list[Point], Point]:
    """Return the distinct points of all sweeps, and the first of them: without perturbation."""
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
    """Return success, speed and tracking at each point, of `episodes` from the same starts.

    - success: the share that reaches the time limit without a fall.
    - speed: as in an evaluation, distance along world x over the episode's duration, of every
      episode, fallen or not, m/s; with commands, the size of the commanded velocity less that of
      the error, on average.
    - heading_error: mean |yaw|, deg; with commands in its place velocity_error, m/s, and
      yaw_rate_error, rad/s, as in an evaluation, but that the windows do not overlap.

    Speed and errors are entries of `summarize_values`; `success_ci95` is the interval of success.
    """
    env, starts = loaded.env, reset_at_points(loaded.env, points, episodes, seed)
    commands, dt = starts.pipeline_state.command, env.config.control_dt
    velocities = None if commands is None else np.asarray(commands.velocity, float)

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        if velocities is None:
            yaw = to_roll_pitch_yaw(poses[1:, 3:])[:, 2]
            speed = (poses[-1, 0] - poses[0, 0]) / (dt * len(yaw))
            return {"speed": speed, "heading_error": float(np.degrees(np.abs(yaw).mean()))}
        velocity = compute_heading_velocity(poses, dt)
        command = np.broadcast_to(velocities[number], velocity.shape)
        off = np.linalg.norm((velocity - command)[:, :2], axis=1)
        errors = compute_tracking_errors(velocity, command, dt, apart=round(WINDOW / dt))
        speed = float(np.linalg.norm(command[0, :2]) - off.mean())
        return {"speed": speed, "velocity_error": errors[0], "yaw_rate_error": errors[1]}

    return measure_cells(env, loaded.policy.act, starts, episodes, measure, report=report)


def reset_at_points(env: QuadrupedEnv, points: list[Point], episodes: int, seed: int) -> State:
    """Return the first states of `episodes` under the conditions of each point, point by point.

    Each point has the same starts and the same random numbers, which conditions only scale.
    """
    latest = randomization.compute_longest_latencies(find_training_ranges(env.config))
    late = max(p.delay / 1e3 + p.everything * latest[0] for p in points)
    targets = randomization.count_targets(math.ceil(late / env.stepping.dt), env.stepping.substeps)
    sensors = max(p.sensor_delay / 1e3 + p.everything * latest[1] for p in points)
    readings = randomization.count_readings(sensors, env.config.control_dt)

    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 1), episodes)
    points = [p if p.friction is not None else replace(p, friction=env.friction) for p in points]
    rows = np.array([dataclasses.astuple(point) for point in points], np.float32)

    def reset(env: QuadrupedEnv, row: jax.Array, state: State, key: jax.Array) -> State:
        conditions = sample_conditions_at(env, Point(*row), key, targets)
        return env.start_episode(state, readings, conditions=conditions)

    return reset_cells(env, reset, rows, reset_episodes(env, episodes, seed), keys)


def sample_conditions_at(
    env: QuadrupedEnv, point: Point, key: jax.Array, targets: int
) -> randomization.EpisodeRandomization:
    """Sample the conditions of one episode at `point`, whose numbers may be JAX tracers.

    They are those of the robot's model plus `point.everything` times the training's randomization,
    then changed as the other fields of `point` say. The history of joint targets has `targets`
    rows.
    """
    robot, stepping = env.robot, env.stepping
    ideal = dataclasses.replace(NO_RANDOMIZATION, sensor_latency=(0.0, 0.0))
    base = randomization.sample_randomization(ideal, robot, stepping, key, env.friction)
    trained = randomization.sample_randomization(
        find_training_ranges(env.config), robot, stepping, key, env.friction
    )
    trained = trained._replace(
        targets=base.targets,
        sensor_delay=base.sensor_delay if trained.sensor_delay is None else trained.sensor_delay,
    )
    mixed = jax.tree.map(
        lambda usual, sampled: usual + point.everything * (sampled - usual),
        base._replace(key=jnp.zeros(())),
        trained._replace(key=jnp.zeros(())),
    )
    variation = mixed.variation
    assert variation is not None
    lightest = -0.9 * env.robot.geometry.trunk.mass  # kg: a tenth is left
    sides = jax.random.rademacher(jax.random.fold_in(key, 1), (12,), jnp.float32)
    variation = variation._replace(
        friction=variation.friction - env.friction + point.friction,
        trunk_mass=jnp.maximum(variation.trunk_mass + point.mass, lightest),
        trunk_center=variation.trunk_center + jnp.array([1.0, 0.0, 0.0]) * point.center,
        strength=variation.strength * point.strength / 100.0,
        kp=variation.kp * point.kp / 100.0,
        kd=variation.kd * point.kd / 100.0,
    )
    return mixed._replace(
        variation=randomization.clip_to_physical(variation),
        delay=mixed.delay + point.delay / (1000.0 * stepping.dt),
        sensor_delay=mixed.sensor_delay + point.sensor_delay / 1000.0 / stepping.control_dt,
        push=mixed.push + jnp.stack([point.push_ahead, point.push]),
        noise=mixed.noise + point.noise,
        encoder=mixed.encoder + point.encoder * sides,
        targets=jnp.tile(base.targets[:1], (targets, 1)),
        key=base.key,
    )


def print_sweep(results: dict[str, Any]) -> None:
    """Print a table of success, speed and tracking at each point of a sweep.

    Success is the share without a fall. A star marks the value of the robot's model.
    """
    headings = {name: heading for name, heading in _COLUMNS.items() if name in results["nominal"]}
    rows: list[Sequence[str] | None] = []
    for sweep in results["sweeps"].values():
        heading = sweep["heading"] + (f", {sweep['unit']}" if sweep["unit"] else "")
        for number, point in enumerate(sweep["points"]):
            low, high = (100 * end for end in point["success_ci95"])
            star = "*" if point["value"] == sweep["nominal"] else " "
            success = f"{100 * point['success']:.0f} ({low:.0f} to {high:.0f})"
            name = "" if number else heading
            figures = [format_value(point[figure]) for figure in headings]
            rows.append((name, f"{point['value']:g}{star}", success, *figures))
        rows.append(None)
    title = (
        f"{results['run']}: {results['episodes']} episodes at each point, mean ± 95 %, * the "
        "model's"
    )
    print_table(title, ("", "value", "success, %", *headings.values()), rows)


def draw_sweep(
    results: list[dict[str, Any]],
    names: Sequence[str] | None = None,
    columns: int = 4,
    title: str = "",
) -> Figure:
    """Draw a panel for each sweep, or each of `names`: success and speed, with 95 % intervals.

    Success is the share without a fall, %. `results` are those of one run or several, at the same
    points. The range of each condition in the task of the first run is shaded. `columns` panels
    are side by side; `title` stands in place of the runs' names.
    """
    first = results[0]
    sweeps = first["sweeps"]
    quantities = list(names or sweeps)
    rows = math.ceil(len(quantities) / columns)
    text = title or f"{', '.join(result['run'] for result in results)}: robustness"
    text += f" ({first['episodes']} episodes of {first['seconds']:g} s at each point)"
    figure = make_figure((3.6 * columns, 0.8 + 2.9 * rows), text)
    top = max(
        point["speed"]["mean"]
        for result in results
        for name in quantities
        for point in result["sweeps"][name]["points"]
    )
    panels: Any = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for place, (axes, name) in enumerate(zip(panels, quantities, strict=False)):
        tidy(axes, sweeps[name]["heading"], sweeps[name]["unit"])
        axes.set_ylim(-3, 106)
        axes.axvline(sweeps[name]["nominal"], color=INK, linewidth=1, linestyle=":")
        speed = axes.twinx()
        speed.spines["top"].set_visible(False)
        lowest = min(
            _draw_points(axes, speed, result, name, *get_style(k))
            for k, result in enumerate(results)
        )
        (left, right), (low, high) = axes.get_xlim(), sweeps[name]["range"]
        axes.axvspan(max(left, low), min(right, high), color="0.92", zorder=0)
        # The same scale in every panel, and as high as that of success: 100 % is the top speed.
        speed.set_ylim(min(-0.03 * max(top, 0.1), 1.05 * lowest), 1.06 * max(top, 0.1))
        if place % columns == 0:
            axes.set_ylabel("episodes without a fall, %")
        last = place % columns == columns - 1 or place == len(quantities) - 1
        speed.tick_params(labelright=last)
        if last:
            speed.set_ylabel("speed, m/s")
    for axes in panels[len(quantities) :]:
        axes.set_axis_off()
    _draw_legend(figure, [result["run"] for result in results])
    return figure


def _draw_points(
    axes: Axes, speed: Axes, result: dict[str, Any], name: str, color: str, mark: str
) -> float:
    """Draw a run's sweep `name`: success on `axes`, speed on `speed`, in `color`, with `mark`.

    Returns the lowest end of the speeds' intervals, m/s, at most 0.
    """
    points = result["sweeps"][name]["points"]
    values = [point["value"] for point in points]
    low, high = 100 * np.array([point["success_ci95"] for point in points]).T
    axes.fill_between(values, low, high, color=color, alpha=0.2, lw=0)
    shares = [100 * point["success"] for point in points]
    axes.plot(values, shares, f"{mark}-", color=color, linewidth=2, label=result["run"])
    means = [point["speed"]["mean"] for point in points]
    errors = [point["speed"]["ci95"] or 0.0 for point in points]
    speed.errorbar(values, means, yerr=errors, fmt="--", color=color, linewidth=1, capsize=2)
    return min(0.0, *(mean - error for mean, error in zip(means, errors, strict=True)))


def _draw_legend(figure: Figure, runs: list[str]) -> None:
    """Draw the legend of a figure of sweeps: the color of each run, and what each line means.

    A thick line is the share without a fall, a dashed one speed, a dotted one the robot's model.
    """
    handles: list[Any] = []
    for k, run in enumerate(runs):
        color, mark = get_style(k)
        handles.append(Line2D([], [], color=color, marker=mark, lw=2, label=run))
    handles += [
        Line2D([], [], color=INK, lw=2, label="without a fall"),
        Line2D([], [], color=INK, lw=1, ls="--", label="speed"),
        Line2D([], [], color=INK, lw=1, ls=":", label="the robot's model"),
        Patch(color="0.92", label="range of the task"),
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles), frameon=False)
