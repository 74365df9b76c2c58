"""What a policy can take: how it does as one thing after another departs from training.

All points of all sweeps are one batch, and so one compilation. What each of them does to an episode
stands in `quadwalk.task.episode.conditions`.
"""

import dataclasses
import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State
from rich.console import Console

from quadwalk.evaluate.loaded import LoadedRun, training_ranges
from quadwalk.evaluate.options import EvalConfig
from quadwalk.evaluate.recording.provenance import provenance
from quadwalk.evaluate.report.console import print_sweep, simulating
from quadwalk.evaluate.report.panels import draw_sweep
from quadwalk.evaluate.report.plots import save_figure
from quadwalk.evaluate.simulate import (
    CHUNK,
    Policy,
    Report,
    fresh_starts,
    over_devices,
)
from quadwalk.evaluate.summary import SETTLING, WINDOW, mean_figure, share_interval
from quadwalk.physics.rotation import yaw
from quadwalk.task.config import NO_RANDOMISATION
from quadwalk.task.env import QuadrupedEnv
from quadwalk.task.episode.conditions import (
    Conditions,
    draw_conditions,
    latest_drawn,
    possible,
    readings_needed,
    targets_needed,
)
from quadwalk.task.state import motion
from quadwalk.train.runs.directory import write_json_atomic


@dataclass(frozen=True)
class Point:
    """The conditions of some episodes: those of the robot's model, but for what is named."""

    friction: float | None = None  # sliding friction of feet and floor; None: the model's
    mass: float = 0.0  # kg, added to the trunk
    centre: float = 0.0  # m, by which the trunk's centre of mass is further ahead
    strength: float = 100.0  # % of the motors' torque
    kp: float = 100.0  # % of the position gain
    kd: float = 100.0  # % of the velocity gain
    delay: float = 0.0  # ms, of joint targets
    sensor_delay: float = 0.0  # ms
    noise: float = 0.0  # level of the sensor noise
    encoder: float = 0.0  # rad, offset of each joint angle's measurement, to either side
    push: float = 0.0  # m/s, sideways, to either side
    push_ahead: float = 0.0  # m/s, forth or back
    everything: float = 0.0  # how far all that is drawn in training is from the model's; 1: as far


# field of Point -> heading, unit, values
SWEEPS: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "everything": ("everything at once", "x training", (0.0, 0.5, 1.0, 1.5)),
    "friction": ("friction", "", (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25)),
    "mass": ("added trunk mass", "kg", (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0)),
    "centre": ("centre of mass ahead", "m", (-0.06, -0.03, 0.0, 0.03, 0.06)),
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


class Tally(NamedTuple):
    """What is known of a batch of episodes so far, each an array with the axis of episodes."""

    end: Any  # () index into `QuadrupedEnv.ends`, 0 while it goes on
    steps: Any  # () int32, control steps
    speed: Any  # () m/s, sum over its steps of the mean over the step, as training counts it
    heading: Any  # () rad, sum of the size of the yaw angle
    drift: Any  # (3,) sum since the last window of velocity less command: m/s, m/s, rad/s
    errors: Any  # (2,) sum over all judged windows of the size of their mean drift: m/s, rad/s
    windows: Any  # () int32, judged


def sweep(loaded: LoadedRun, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Sweep, print the table, write sweep.json and sweep.png to `out`; return the former."""
    env = loaded.env
    points, nominal = sweep_points(loaded)
    what = f"simulating {len(points)} x {config.episodes} episodes in {env.engine}"
    with simulating(console, what, env.config.episode_steps, env.config.control_dt) as report:
        measured = measure_points(loaded, points, config.episodes, config.seed, report)
    found = dict(zip(points, measured, strict=True))
    sweeps = {
        name: {
            "heading": heading,
            "unit": unit,
            "nominal": getattr(nominal, name),
            "points": [{"value": value, **found[_point(nominal, name, value)]} for value in values],
        }
        for name, (heading, unit, values) in SWEEPS.items()
    }
    results = {
        **provenance(loaded, config.seed),
        "episodes": config.episodes,
        "nominal": found[nominal],
        "sweeps": sweeps,
    }
    print_sweep(results)
    write_json_atomic(out / "sweep.json", results)
    save_figure(draw_sweep([results]), out / "sweep.png")
    console.print(f"written to {out}: sweep.json, sweep.png")
    return results


def sweep_points(loaded: LoadedRun) -> tuple[list[Point], Point]:
    """Every distinct point of all sweeps, and the one without any perturbation."""
    nominal = Point(friction=round(loaded.env.friction, 6))
    points = [
        _point(nominal, name, value) for name, (_, _, values) in SWEEPS.items() for value in values
    ]
    return list(dict.fromkeys([nominal, *points])), nominal


def _point(nominal: Point, name: str, value: float) -> Point:
    return replace(nominal, **{name: value})


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
    env = loaded.env
    tally = _simulate(env, loaded.policy.act, points, episodes, seed, report)
    success = tally.end == env.ends.index("time limit")
    figures = {"speed": tally.speed / tally.steps}
    if env.config.command.given:
        with np.errstate(invalid="ignore"):  # NaN where an episode was too short to be judged
            errors = tally.errors / tally.windows[:, None]
        figures |= {"velocity_error": errors[:, 0], "yaw_rate_error": errors[:, 1]}
    else:
        figures["heading_error"] = np.degrees(tally.heading / tally.steps)
    measured = []
    for k in range(len(points)):
        own = slice(k * episodes, (k + 1) * episodes)
        count = int(success[own].sum())
        measured.append(
            {
                "success": count / episodes,
                "success_ci95": list(share_interval(count, episodes)),
                **{name: mean_figure(values[own]) for name, values in figures.items()},
            }
        )
    return measured


def _simulate(
    env: QuadrupedEnv,
    policy: Policy,
    points: list[Point],
    episodes: int,
    seed: int,
    report: Report | None,
) -> Tally:
    """What len(points) * episodes episodes came to, point by point."""

    @env.jit
    def chunk(policy: Policy, states: State, tally: Tally) -> tuple[State, Tally]:
        def step(carry: tuple[State, Tally], _: None) -> tuple[tuple[State, Tally], None]:
            states, tally = carry
            after = jax.vmap(env.step)(states, policy(states.obs))
            return (after, jax.vmap(partial(_tallied, env))(tally, states, after)), None

        return jax.lax.scan(step, (states, tally), None, length=CHUNK)[0]

    states = _starts(env, points, episodes, seed)
    zero = np.zeros(len(points) * episodes, np.float32)
    none, pair, triple = zero.astype(np.int32), np.stack([zero] * 2, 1), np.stack([zero] * 3, 1)
    tally = over_devices(env, Tally(none, none, zero, zero, triple, pair, none))
    states, simulated = over_devices(env, states), 0
    while not np.all(tally.end):
        states, tally = chunk(policy, states, tally)
        simulated += CHUNK
        if report is not None:
            report(simulated)
    return jax.device_get(tally)


def _tallied(env: QuadrupedEnv, tally: Tally, before: State, after: State) -> Tally:
    """The tally of an episode after one more step; what has ended stays as it is."""
    dt = env.config.control_dt
    settling, window = round(SETTLING / dt), round(WINDOW / dt)
    begun, state = before.pipeline_state, after.pipeline_state
    steps = tally.steps + 1
    drift = tally.drift + motion(begun.qpos, state.qpos, dt) - begun.velocity_command
    full = (steps - settling) % window == 0
    judged = full & (steps >= settling + window)
    mean = drift / window
    errors = jnp.stack([jnp.linalg.norm(mean[:2]), jnp.abs(mean[2])])
    new = Tally(
        end=after.info["end"],
        steps=steps,
        speed=tally.speed + after.metrics["speed"],
        heading=tally.heading + jnp.abs(yaw(state.qpos[3:7])),
        drift=jnp.where(full, 0.0, drift),
        errors=tally.errors + jnp.where(judged, errors, 0.0),
        windows=tally.windows + judged,
    )
    return jax.tree.map(lambda old, new: jnp.where(tally.end > 0, old, new), tally, new)


def _starts(env: QuadrupedEnv, points: list[Point], episodes: int, seed: int) -> State:
    """The first states of all episodes, under the conditions of their points.

    Each point has the same starts, and the same draws but for their size.
    """
    latest = latest_drawn(training_ranges(env.config))
    late = max(p.delay / 1e3 + p.everything * latest[0] for p in points)
    kept = targets_needed(math.ceil(late / env.stepping.dt), env.stepping.substeps)
    sensors = max(p.sensor_delay / 1e3 + p.everything * latest[1] for p in points)
    readings = readings_needed(sensors, env.config.control_dt)

    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 1), episodes)
    known = [p if p.friction is not None else _point(p, "friction", env.friction) for p in points]
    rows = np.array([dataclasses.astuple(point) for point in known], np.float32)

    def start(row: jax.Array, state: State, key: jax.Array) -> State:
        conditions = conditions_at(env, Point(*row), key, kept)
        return env.begun(state, readings, conditions=conditions)

    of_point = jax.vmap(start, in_axes=(None, 0, 0))
    of_all = env.jit(jax.vmap(of_point, in_axes=(0, None, None)))
    states = of_all(jnp.asarray(rows), fresh_starts(env, episodes, seed), keys)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), states)


def conditions_at(env: QuadrupedEnv, point: Point, key: jax.Array, kept: int) -> Conditions:
    """The conditions of one episode at `point`, whose numbers may be traced."""
    robot, stepping = env.robot, env.stepping
    ideal = dataclasses.replace(NO_RANDOMISATION, sensor_latency=(0.0, 0.0))
    base = draw_conditions(ideal, robot, stepping, key, env.friction)
    drawn = draw_conditions(training_ranges(env.config), robot, stepping, key, env.friction)
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
    lightest = -0.9 * env.geometry.trunk.mass  # kg: a tenth is left
    sides = jax.random.rademacher(jax.random.fold_in(key, 1), (12,), jnp.float32)
    variation = usual._replace(
        friction=usual.friction - env.friction + point.friction,
        trunk_mass=jnp.maximum(usual.trunk_mass + point.mass, lightest),
        trunk_centre=usual.trunk_centre + jnp.array([1.0, 0.0, 0.0]) * point.centre,
        strength=usual.strength * point.strength / 100.0,
        kp=usual.kp * point.kp / 100.0,
        kd=usual.kd * point.kd / 100.0,
    )
    return mixed._replace(
        variation=possible(variation),
        delay=mixed.delay + point.delay / (1000.0 * stepping.dt),
        sensor_delay=mixed.sensor_delay + point.sensor_delay / 1000.0 / stepping.control_dt,
        push=mixed.push + jnp.stack([point.push_ahead, point.push]),
        noise=mixed.noise + point.noise,
        encoder=mixed.encoder + point.encoder * sides,
        targets=jnp.tile(base.targets[:1], (kept, 1)),
        key=base.key,
    )
