"""What a policy can take: success and speed as one thing after another departs from training.

All points of all sweeps are one batch in MJX, and so one compilation. How each perturbation is
applied is said in `perturbation`: `Perturbation` and `varied_quadruped`.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from quadwalk.evaluate.options import EvalConfig
from quadwalk.evaluate.perturbation import (
    Perturbation,
    Perturbed,
    begin,
    history,
    noise_scale,
    perturbed_step,
    stack_models,
    varied_quadruped,
)
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
from quadwalk.physics.quiet_mjx import mjx
from quadwalk.task.env import ENDS
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

    end: Any  # (steps, episodes) index into ENDS
    speed: Any  # (steps, episodes) m/s, mean over the step, as training counts it


def sweep(subject: Subject, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Sweep, print the table, write sweep.json and sweep.png to `out`; return the former."""
    env = subject.env
    points, nominal = sweep_points(subject)
    what = f"simulating {len(points)} x {config.episodes} episodes in mjx"
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
        **provenance(subject, config, "mjx"),
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
    feet = subject.env.robot.foot_geoms
    floor = subject.env.mj_model.geom("floor").friction[0]
    friction = float(max(floor, subject.env.mj_model.geom_friction[feet, 0].max()))
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
    outcome = _simulate(subject, points, episodes, seed, report)
    last = np.argmax(outcome.end > 0, axis=0)
    success = outcome.end[last, np.arange(len(last))] == ENDS.index("time limit")
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
    subject: Subject, points: list[Point], episodes: int, seed: int, report: Report | None
) -> Outcome:
    """The outcome of len(points) * episodes episodes, point by point."""
    env = subject.env
    robot, config = env.robot, env.config
    total = len(points) * episodes
    perturbation, delay = _perturbations(points, config.physics_dt, episodes)
    leaves, axes = _models(subject, points, episodes)
    structure = jax.tree.structure(env.model)
    noise = noise_scale(env.observation_names)

    def one_step(leaves: Any, policy: Policy, suffered: Perturbation, episode: Perturbed) -> Any:
        model = jax.tree.unflatten(structure, leaves)
        return perturbed_step(model, env.legged, robot, config, noise, policy, suffered, episode)

    batched = jax.vmap(one_step, in_axes=(axes, None, 0, 0))

    @jax.jit
    def chunk(
        leaves: Any, policy: Policy, suffered: Perturbation, batch: Perturbed
    ) -> tuple[Perturbed, Outcome]:
        def step(batch: Perturbed, _: None) -> tuple[Perturbed, Outcome]:
            batch = batched(leaves, policy, suffered, batch)
            state = batch.state
            return batch, Outcome(state.info["end"], state.metrics["speed"])

        return jax.lax.scan(step, batch, None, length=CHUNK)

    starts = fresh_starts(env, episodes, seed)
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 1), episodes)
    kept = history(delay, config.substeps)
    first = jax.vmap(lambda state, key: begin(robot, state, key, kept))(starts, keys)
    # Each point has the same starts, and the same noise and pushes but for their size.
    first = jax.tree.map(lambda x: jnp.tile(x, (len(points),) + (1,) * (x.ndim - 1)), first)
    first, perturbation = over_devices((first, perturbation), total)
    leaves = [
        leaf if axis is None else over_devices(leaf, total)
        for leaf, axis in zip(leaves, axes, strict=True)
    ]
    run = partial(chunk, leaves, subject.policy.act, perturbation)
    return until_all_ended(run, first, report)


def _perturbations(points: list[Point], dt: float, episodes: int) -> tuple[Perturbation, int]:
    """What each episode suffers, and the longest delay, in physics steps."""
    delay = np.array([round(point.delay / 1000 / dt) for point in points])
    columns = Perturbation(
        strength=np.array([point.strength / 100 for point in points], np.float32),
        delay=delay.astype(np.int32),
        push=np.array([point.push for point in points], np.float32),
        noise=np.array([point.noise for point in points], np.float32),
    )
    repeated = jax.tree.map(lambda column: jnp.repeat(column, episodes), columns)
    return repeated, int(delay.max())


def _models(
    subject: Subject, points: list[Point], episodes: int
) -> tuple[list[Any], list[int | None]]:
    """The arrays of every episode's model, and the axes that `vmap` maps."""
    config, quadruped = subject.env.config, subject.env.quadruped
    kinds = list(dict.fromkeys((point.friction, point.mass) for point in points))
    models = [
        mjx.put_model(
            varied_quadruped(quadruped, friction, mass).training_model(
                config.physics_dt,
                config.solver_iterations,
                config.line_search_iterations,
                config.contacts,
            )
        )
        for friction, mass in kinds
    ]
    stacked, axes = stack_models(models)
    kind = np.repeat([kinds.index((point.friction, point.mass)) for point in points], episodes)
    return [
        leaf if axis is None else leaf[kind] for leaf, axis in zip(stacked, axes, strict=True)
    ], axes
