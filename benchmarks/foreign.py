"""A policy in a simulator that it was not trained for: Drake, beside MuJoCo C.

    python benchmarks/foreign.py RUN [--episodes 64] [--seconds 4] [--out FOLDER]

Exports the run and drives the export in both, from the same starts, by the same commands, noise and
pushes, under eight conditions (benchmarks/simulators.py). Prints a table of falls, speeds and
errors; writes it as foreign.json, and film_strip.png of one episode in both.

A fall: the trunk leans by more than 1 rad, is lower than 45 % of its first height, or the floor
meets a link without a foot. The other figures are of the episodes without a fall in either. Speed
is along x, from the start to the end; with commands the mean size of the velocity. That and its
errors are as in an evaluation: means over 0.5 s, from 1 s after each command on. A command holds
for half of an episode.

Needs the extras `export` and `drake`. To see what contact does: --approximation, --stiffness,
--dissipation, --relaxation and --dt change Drake's alone.
"""

import argparse
import dataclasses
import importlib.metadata
import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.simulators import (
    Condition,
    Contact,
    Episode,
    Simulator,
    load_controller,
    run_episodes,
)

# Processes that simulate import this file as well: what takes seconds is imported where it is used.
if TYPE_CHECKING:
    from quadwalk.evaluation.load import LoadedRun

SIMULATORS: tuple[Simulator, ...] = ("Drake", "MuJoCo C")
PROCESSES = 2
CONDITIONS = {
    "the model": Condition(),
    "friction 0.4": Condition(friction=0.4),
    "5 kg more": Condition(load=5.0),
    "80 % torque": Condition(strength=0.8),
    "latency 12 ms": Condition(latency=0.012),
    "sensor noise": Condition(noise=1.0),
    "pushes of 1 m/s": Condition(push=1.0),
    "all at once": Condition(0.4, 5.0, 0.8, 0.012, 1.0, 1.0),
}
PICTURE = (400, 260)  # pixels
ACROSS = 4

Starts = list[tuple[np.ndarray, np.ndarray]]  # qpos (19,) and qvel (18,)


def sample_episodes(
    loaded: "LoadedRun", episodes: int, seed: int, friction: float | None
) -> tuple[Starts, np.ndarray]:
    """Return first states and commands (episodes, T, 3); each episode has two commands in turn.

    Commands are in m/s and rad/s, and within what a floor of `friction`, None for the model's,
    holds. For a task without commands they are 0.
    """
    import jax

    from quadwalk.env.command import sample_velocity
    from quadwalk.evaluation.rollout import reset_episodes

    env, steps = loaded.env, loaded.env.config.episode_steps
    first = jax.device_get(reset_episodes(env, episodes, seed)).pipeline_state
    starts = list(zip(first.qpos.astype(float), first.qvel.astype(float), strict=True))
    commands = np.zeros((episodes, steps, 3))
    if env.config.command.active:
        grip = env.config.gravity * (friction or env.friction)
        keys = jax.random.split(jax.random.PRNGKey(seed), (episodes, 2))
        pairs = jax.vmap(jax.vmap(lambda key: sample_velocity(env.config.command, key, grip)))(keys)
        commands[:] = np.repeat(pairs, -(-steps // 2), axis=1)[:, :steps]
    return starts, commands


def compute_figures(episode: Episode, commands: np.ndarray | None, dt: float) -> dict[str, float]:
    """Return the speed of an episode, m/s, and how far it is from its commands, m/s and rad/s.

    Speed and errors are as the module says. `commands` (steps, 3) is None for a task without; the
    error is then that of the heading, the mean |yaw|, deg.
    """
    from quadwalk.evaluation.metrics import (
        SETTLING,
        WINDOW,
        average_windows,
        compute_heading_velocity,
        compute_tracking_errors,
        to_roll_pitch_yaw,
    )

    poses, steps = episode.qpos, len(episode.target)
    if commands is None:
        yaw = to_roll_pitch_yaw(poses[1:, 3:7])[:, 2]
        speed = (poses[-1, 0] - poses[0, 0]) / (dt * steps)
        return {"speed": speed, "heading_error": float(np.degrees(np.abs(yaw).mean()))}
    velocity = compute_heading_velocity(poses, dt)
    velocity_error, yaw_rate_error = compute_tracking_errors(velocity, commands[:steps], dt)
    means = average_windows(velocity[round(SETTLING / dt) :], round(WINDOW / dt))
    speed = float(np.linalg.norm(means[:, :2], axis=1).mean()) if len(means) else np.nan
    return {"speed": speed, "velocity_error": velocity_error, "yaw_rate_error": yaw_rate_error}


def summarize(
    figures: list[dict[str, float]], fell: np.ndarray, upright: np.ndarray
) -> dict[str, Any]:
    """Return the share of falls in one condition, and the means of the other figures.

    Both come with their 95 % intervals. `figures` has those of each episode. `fell` and `upright`
    (episodes,) are bools: the means are those of `upright` episodes.
    """
    from quadwalk.evaluation.metrics import compute_share_interval, summarize_values

    rows = [figures[index] for index in np.flatnonzero(upright)]
    means = {name: summarize_values([row[name] for row in rows]) for name in figures[0]}
    interval = compute_share_interval(int(fell.sum()), len(fell))
    return {"falls": float(fell.mean()), "falls_ci95": list(interval), **means}


def format_table(results: list[dict[str, Any]]) -> str:
    """Return a Markdown table of falls and figures in both simulators, a row for each condition."""
    from quadwalk.evaluation.metrics import get_mean

    lines: list[list[str]] = []
    for result in results:
        cells = {"condition": result["condition"]}
        for simulator in SIMULATORS:
            cells[f"falls, {simulator}, %"] = f"{100.0 * result[simulator]['falls']:.1f}"
        for name in result["Drake"]:
            if name.startswith("falls"):
                continue
            drake, mujoco = (get_mean(result[simulator][name]) for simulator in SIMULATORS)
            digits = 1 if name == "heading_error" else 3
            title = name.replace("_", " ")
            cells[f"{title}, Drake"] = f"{drake:.{digits}f}"
            cells[f"{title}, MuJoCo C"] = f"{mujoco:.{digits}f}"
            if name == "speed":
                cells["Drake / MuJoCo C, %"] = f"{100.0 * drake / mujoco:.1f}"
        if not lines:
            lines = [list(cells), ["---"] * len(cells)]
        lines.append(list(cells.values()))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def draw_film_strip(episodes: dict[Simulator, Episode], loaded: "LoadedRun") -> np.ndarray:
    """Return a picture (H, W, 3) uint8 with a row for each simulator, at the same times."""
    from PIL import Image, ImageDraw, ImageFont

    from quadwalk.render.canvas import Camera, Canvas
    from quadwalk.render.images import make_film_strip

    dt, font, pictures = loaded.env.config.control_dt, ImageFont.load_default(size=16), []
    canvas = Canvas(loaded.env.quadruped.make_full_model(), *PICTURE)
    steps = min(len(episode.target) for episode in episodes.values())
    for simulator in SIMULATORS:
        episode = episodes[simulator]
        for row in np.linspace(0, steps, ACROSS + 1).astype(int)[1:]:
            x, y = episode.qpos[row, :2]
            camera = Camera(np.array([x, y, 0.25]), distance=1.45, azimuth=118.0, elevation=-14.0)
            image = Image.fromarray(canvas.draw(episode.qpos[row], camera))
            text = f"{simulator}   {row * dt:.2f} s   {x:.2f} m ahead, {y:.2f} m to the left"
            ImageDraw.Draw(image).text((8, 6), text, fill=(30, 34, 40), font=font)
            pictures.append(np.asarray(image))
    return make_film_strip(pictures, ACROSS)


def measure(
    folder: Path,
    loaded: "LoadedRun",
    names: list[str],
    episodes: int,
    seed: int,
    contact: Contact,
) -> tuple[list[dict[str, Any]], dict[Simulator, Episode]]:
    """Drive the export in `folder` under the conditions `names`; return a summary of each.

    With them comes an episode of the first condition in each simulator. Simulates in processes, and
    prints each share of falls as it comes.
    """
    config = loaded.env.config
    jobs, figures, fell = {}, {}, {}
    samples: dict[Simulator, Episode] = {}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(PROCESSES, multiprocessing.cpu_count()), spawn) as pool:
        for name in names:
            condition = CONDITIONS[name]
            starts, commands = sample_episodes(loaded, episodes, seed, condition.friction)
            for simulator in SIMULATORS:
                job = pool.submit(
                    run_episodes, folder, simulator, condition, starts, commands, contact
                )
                jobs[job] = name, simulator, commands
        for job in as_completed(jobs):
            name, simulator, commands = jobs[job]
            rollouts = job.result()
            figures[name, simulator] = [
                compute_figures(
                    episode, commands[row] if config.command.active else None, config.control_dt
                )
                for row, episode in enumerate(rollouts)
            ]
            fell[name, simulator] = np.array([episode.fell for episode in rollouts])
            print(f"{name}, {simulator}: {fell[name, simulator].mean():.1%} falls", flush=True)
            if name == names[0]:
                samples[simulator] = rollouts[0]
    results = []
    for name in names:
        upright = ~np.any([fell[name, simulator] for simulator in SIMULATORS], axis=0)
        result = {"condition": name, **dataclasses.asdict(CONDITIONS[name])}
        for simulator in SIMULATORS:
            key = name, simulator
            result[simulator] = summarize(figures[key], fell[key], upright)
        results.append(result)
    return results, samples


def parse_options() -> argparse.Namespace:
    """Parse the command line of this benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("run", help="name or path of a run, or a policy that comes trained")
    add("--episodes", type=int, default=64, help="of each condition in each simulator")
    add("--seconds", type=float, default=4.0, help="of an episode")
    add("--seed", type=int, default=0)
    add("--only", nargs="+", choices=CONDITIONS, default=list(CONDITIONS), metavar="CONDITION")
    add("--runs", type=Path, default=Path("runs"), help="folder that holds all runs")
    add("--out", type=Path, help="folder of the results (default: foreign/ in the run's)")
    group = parser.add_argument_group("Drake's contact")
    for field in dataclasses.fields(Contact):
        kind = str if field.name == "approximation" else float
        group.add_argument(f"--{field.name}", type=kind, default=field.default)
    return parser.parse_args()


def main() -> None:
    """Export a run, drive it in both simulators, print and write the results."""
    from rich.console import Console

    from quadwalk.cli.shell import suggest_install
    from quadwalk.errors import UserError
    from quadwalk.evaluation.load import load_run
    from quadwalk.evaluation.results import make_provenance
    from quadwalk.export.bundle import export_run
    from quadwalk.files import write_json
    from quadwalk.render.images import save_png
    from quadwalk.runs.directory import find_ready, get_results_folder
    from quadwalk.terrain.terrain import FLAT

    options = parse_options()
    run = find_ready(options.runs, options.run, "run")
    out = options.out or get_results_folder(options.runs, run) / "foreign"
    contact = Contact(**{f.name: getattr(options, f.name) for f in dataclasses.fields(Contact)})
    try:
        drake = importlib.metadata.version("drake")
    except importlib.metadata.PackageNotFoundError:
        raise UserError(f"drake is not installed; this needs: {suggest_install('drake')}") from None
    export_run(run, "last", out / "export", Console(stderr=True, highlight=False))
    loaded = load_run(run, options.seconds, engine="fast", ground=FLAT)
    if loaded.env.config.reset.tumbled:
        raise UserError(f"{run.name} begins on the ground; expected a task that begins on its feet")
    # Refuses a policy with observations that it lacks.
    load_controller(out / "export").Controller(out / "export/policy.onnx")
    results, samples = measure(
        out / "export", loaded, options.only, options.episodes, options.seed, contact
    )
    print(format_table(results))
    about = make_provenance(loaded, options.seed) | {"drake": drake, "episodes": options.episodes}
    about |= {"contact": dataclasses.asdict(contact), "conditions": results}
    write_json(out / "foreign.json", about)
    save_png(draw_film_strip(samples, loaded), out / "film_strip.png")
    print(f"written to {out}: foreign.json, film_strip.png, export/")


if __name__ == "__main__":
    from quadwalk.cli.process import run_command

    run_command(main)
