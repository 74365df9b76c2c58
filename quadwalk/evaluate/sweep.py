"""What a policy can take: success and speed as one thing after another departs from training.

All points of all sweeps are one batch, and so one compilation. `quadwalk.task.conditions` says how
delays, pushes and noise are applied, `varied_quadruped` how friction and mass are.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import quadwalk.physics.mjx  # noqa: F401  # before Brax, which imports MJX less quietly

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State
from rich.console import Console

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
    until_all_ended,
)
from quadwalk.evaluate.subject import Subject
from quadwalk.evaluate.summary import mean_interval, share_interval
from quadwalk.physics.batching import stack_models
from quadwalk.robot.quadruped import Quadruped
from quadwalk.task.conditions import first_conditions, targets_needed
from quadwalk.task.env import QuadrupedEnv
from quadwalk.train.runs.directory import write_json_atomic


@dataclass(frozen=True)
class Point:
    """The conditions of some episodes: those of training, but for what is named."""

    friction: float | None = None  # sliding friction of feet and floor; None: the model's
    mass: float = 0.0  # kg, added to the trunk
    strength: float = 100.0  # % of the motors' torque
    delay: float = 0.0  # ms, rounded to physics steps
    push: float = 0.0  # m/s, sideways
    noise: float = 0.0  # level of the sensor noise


# field of Point -> heading, unit, values
SWEEPS: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "friction": ("friction", "", (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.2)),
    "mass": ("added trunk mass", "kg", (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0)),
    "strength": ("motor strength", "%", (80.0, 85.0, 90.0, 95.0, 100.0, 105.0, 110.0)),
    "delay": ("control delay", "ms", (0.0, 4.0, 8.0, 12.0, 16.0, 24.0, 32.0, 40.0)),
    "push": ("pushes", "m/s", (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)),
    "noise": ("sensor noise", "level", (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)),
}


class Outcome(NamedTuple):
    """Control steps of a batch of episodes."""

    end: Any  # (steps, episodes) index into `QuadrupedEnv.ends`
    speed: Any  # (steps, episodes) m/s, mean over the step, as training counts it


def sweep(subject: Subject, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Sweep, print the table, write sweep.json and sweep.png to `out`; return the former."""
    env = subject.env
    points, nominal = sweep_points(subject)
    what = f"simulating {len(points)} x {config.episodes} episodes in {env.engine}"
    with simulating(console, what, env.config.episode_steps, env.config.control_dt) as report:
        measured = measure_points(subject, points, config.episodes, config.seed, report)
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
        **provenance(subject, config.seed),
        "episodes": config.episodes,
        "nominal": found[nominal],
        "sweeps": sweeps,
    }
    print_sweep(results)
    write_json_atomic(out / "sweep.json", results)
    save_figure(draw_sweep(results), out / "sweep.png")
    console.print(f"written to {out}: sweep.json, sweep.png")
    return results


def sweep_points(subject: Subject) -> tuple[list[Point], Point]:
    """Every distinct point of all sweeps, and the one without any perturbation."""
    geoms = ("floor", *subject.env.quadruped.feet)
    friction = float(max(subject.env.mj_model.geom(name).friction[0] for name in geoms))
    nominal = Point(friction=round(friction, 6))
    points = [
        _point(nominal, name, value) for name, (_, _, values) in SWEEPS.items() for value in values
    ]
    return list(dict.fromkeys([nominal, *points])), nominal


def _point(nominal: Point, name: str, value: float) -> Point:
    return replace(nominal, **{name: value})


def measure_points(
    subject: Subject,
    points: list[Point],
    episodes: int,
    seed: int,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Success and speed at each point, of `episodes` from the same starts, all in one batch.

    success: the share that reaches the time limit without a fall. speed: as in an evaluation,
    distance along world x over the episode's duration, of every episode, fallen or not, m/s; with
    commands, the size of the commanded velocity less that of the error, on average.
    """
    env = subject.env
    outcome = _simulate(env, subject.policy.act, points, episodes, seed, report)
    last = np.argmax(outcome.end > 0, axis=0)
    success = outcome.end[last, np.arange(len(last))] == env.ends.index("time limit")
    lasted = np.arange(len(outcome.end))[:, None] <= last
    speed = np.mean(outcome.speed, axis=0, where=lasted)
    measured = []
    for k in range(len(points)):
        own = slice(k * episodes, (k + 1) * episodes)
        count = int(success[own].sum())
        mean, half_width = mean_interval(speed[own])
        measured.append(
            {
                "success": count / episodes,
                "success_ci95": list(share_interval(count, episodes)),
                "speed": {"mean": mean, "ci95": half_width},
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
) -> Outcome:
    """The outcome of len(points) * episodes episodes, point by point."""
    varied, assemble = _models(env, points, episodes)

    def one_step(varied: list[Any], policy: Policy, state: State) -> State:
        return env.step_with(assemble(varied), state, policy(state.obs))

    batched = jax.vmap(one_step, in_axes=(0, None, 0))

    @jax.jit
    def chunk(varied: list[Any], policy: Policy, states: State) -> tuple[State, Outcome]:
        def step(states: State, _: None) -> tuple[State, Outcome]:
            states = batched(varied, policy, states)
            return states, Outcome(states.info["end"], states.metrics["speed"])

        return jax.lax.scan(step, states, None, length=CHUNK)

    first = over_devices(env, _starts(env, points, episodes, seed))
    varied = over_devices(env, varied) if varied else []
    return until_all_ended(partial(chunk, varied, policy), first, report)


def _starts(env: QuadrupedEnv, points: list[Point], episodes: int, seed: int) -> State:
    """The first states of all episodes, under the conditions of their points.

    Each point has the same starts, and the same noise and pushes but for their size.
    """
    dt, count = env.stepping.dt, len(points)
    delays = np.array([round(point.delay / 1000 / dt) for point in points], np.int32)
    kept = targets_needed(int(delays.max()), env.stepping.substeps)
    home = jnp.asarray(env.robot.home_joints, jnp.float32)
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 1), episodes)
    states, keys = jax.tree.map(
        lambda x: jnp.tile(x, (count,) + (1,) * (x.ndim - 1)),
        (fresh_starts(env, episodes, seed), keys),
    )
    delay, push, noise = (
        jnp.repeat(column, episodes)
        for column in (
            delays,
            np.array([point.push for point in points], np.float32),
            np.array([point.noise for point in points], np.float32),
        )
    )
    conditions = jax.vmap(partial(first_conditions, home, kept=kept))(delay, push, noise, keys)
    return jax.jit(jax.vmap(env.with_conditions))(states, conditions)


def _models(
    env: QuadrupedEnv, points: list[Point], episodes: int
) -> tuple[list[Any], Callable[[list[Any]], Any]]:
    """What differs between the episodes' models, as arrays, and how to make a model of it."""
    kinds = list(dict.fromkeys((p.friction, p.mass, p.strength) for p in points))
    robots = {
        kind: env.model_of(varied_quadruped(env.quadruped, *kind))
        for kind in dict.fromkeys((friction, mass) for friction, mass, _ in kinds)
    }
    models = []
    for friction, mass, strength in kinds:
        model = robots[friction, mass]
        motor = model.motor._replace(strength=np.full(12, strength / 100))
        models.append(model._replace(motor=motor))
    stacked, assemble = stack_models(models)
    kind = np.repeat([kinds.index((p.friction, p.mass, p.strength)) for p in points], episodes)
    return [leaf[kind] for leaf in stacked], assemble


def varied_quadruped(
    quadruped: Quadruped, friction: float | None = None, added_mass: float = 0.0
) -> Quadruped:
    """The robot on another floor, carrying a load.

    `friction` is the sliding friction between feet and floor; None leaves it. (MuJoCo takes the
    greater of the two geoms', so both get it.) `added_mass`, kg, is a point mass in the trunk's
    centre of mass, which leaves that point and the inertia about it as they are; the compiler
    derives subtree masses, inverse weights and mean inertia anew.
    """
    spec = quadruped.spec.copy()
    if friction is not None:
        for name in ("floor", *quadruped.feet):
            spec.geom(name).friction[0] = friction
    spec.body(quadruped.trunk).mass += added_mass
    return replace(quadruped, spec=spec)
