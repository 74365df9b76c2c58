"""How far robots get on ground that they have not seen: seeing, blind, and over obstacles.

    python -m studies.ground.study [--seeds 2] [--episodes 256] [--only seeing] [--runs runs/ground]

Trains `rough`, `rough` blind and `obstacles` from each seed, unless the folder has them. It
evaluates each in MuJoCo C, every shape colliding, under conditions drawn as in training, on fields
of unseen seeds: success, speed and error by kind and difficulty, and pictures' states of single
episodes. Results go to `--out` as they come, and notebooks/06_ground.ipynb shows them. To see that
it works:

    python -m studies.ground.study --steps 50000 --seeds 1 --episodes 2 --seconds 1 \\
        --runs /tmp/runs --out /tmp/results.json
"""

import argparse
import itertools
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.cli.process import run_command
from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.rollout import roll_out
from quadwalk.evaluation.suites.terrain import make_cells_env, measure_terrain
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import add_place_flags, read_place
from quadwalk.learn.flags import parse_config
from quadwalk.runs.directory import Run
from quadwalk.terrain.heightfield import Heightfield
from studies.cases import Results, run_cases

VARIANTS = {
    "seeing": "rough",
    "blind": "rough --env.blind",
    "obstacles": "obstacles",
}
LEVELS = 7  # difficulties 0, 1/6, ... 1: a half and two thirds are among them
FILMED = ("stairs_up", "blocks", "course")  # kinds of which an episode's states are kept
FRAMES, SECONDS = 8, 4.0  # of those, over so long from the start
MARGIN = 1.2  # m of ground kept around their path


def make_job(name: str, seed: int, options: argparse.Namespace) -> Job:
    """Return the job that trains a variant with a seed and evaluates it."""
    flags = VARIANTS[name]
    config, _ = parse_config(shlex.split(flags))
    run = flags.replace("--", "").replace(" env.", "_")
    steps, runs = options.steps or config.steps, options.runs.resolve()
    config = replace(config, name=f"{run}_s{seed}", runs=runs, seed=seed, steps=steps)
    function = partial(judge, episodes=options.episodes, seconds=options.seconds)
    return Job(fix_sizes(config, read_place(options)), function)


def judge(run: Run, episodes: int, seconds: float) -> dict[str, Any]:
    """Evaluate a run on unseen ground; return its entry in results.json.

    `episodes` are those on each kind of ground at each difficulty, of `seconds` at most.
    """
    loaded = load_run(run, seconds, engine="mujoco", randomized=True)
    ground = measure_terrain(loaded, episodes, seed=0, levels=LEVELS)
    return {
        "steps": loaded.policy.steps,
        "engine": "mujoco",
        "ground": ground,
        "films": {kind: film_episode(run, kind) for kind in FILMED if kind in ground["kinds"]},
    }


def film_episode(run: Run, kind: str) -> dict[str, Any]:
    """Return an episode on ground of this kind at the greatest difficulty, undisturbed.

    It is JSON data: `FRAMES` states (19,), and the ground around the path.
    """
    loaded = load_run(run, SECONDS, engine="mujoco")
    env = make_cells_env(loaded, (kind,), levels=2)
    assert env.terrain is not None
    tile = env.terrain.tiles.index(env.terrain.find_tile(kind, 1))
    begin = jax.jit(lambda env, keys, tiles: jax.vmap(env.reset)(keys, tiles))
    first = begin(env, jax.random.PRNGKey(1)[None], jnp.array([tile]))

    def get_qpos(env: Any, before: Any, action: Any, after: Any) -> Any:
        return after.pipeline_state.qpos

    ((_, _, path),) = roll_out(env, loaded.policy.act, first, get_qpos)
    rows = np.linspace(0, len(path) - 1, FRAMES).round().astype(int)
    states = path[rows].astype(float)
    return {"qpos": states.round(4).tolist(), "ground": _crop(env.terrain.field, states[:, :2])}


def _crop(field: Heightfield, path: np.ndarray) -> dict[str, Any]:
    """Return the heights of a field around `path` (n, 2), m, with cell and origin, as JSON data."""
    last = np.array(field.heights.shape[::-1]) - 1
    (left, low), (right, high) = (
        np.clip((edge - field.origin) / field.cell, 0, last).astype(int)
        for edge in (path.min(axis=0) - MARGIN, path.max(axis=0) + MARGIN)
    )
    heights = field.heights[low : high + 1, left : right + 1].astype(float)
    origin = (field.origin[0] + field.cell * left, field.origin[1] + field.cell * low)
    return {"cell": field.cell, "origin": origin, "heights": heights.round(3).tolist()}


def main() -> None:
    """Train and evaluate every variant with every seed; write the results as they come."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--episodes", type=int, default=256, help="in each cell")
    parser.add_argument("--seconds", type=float, default=20.0, help="of an episode, at most")
    parser.add_argument("--steps", type=int, help="of each training (default: the task's)")
    parser.add_argument("--runs", type=Path, default=Path("runs/ground"))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results.json")
    parser.add_argument("--only", nargs="+", choices=list(VARIANTS), help="of the variants")
    add_place_flags(parser)
    options = parser.parse_args()
    results = Results(options.out, VARIANTS)  # a file that is broken should not cost a training
    cases = list(itertools.product(options.only or VARIANTS, range(options.seeds)))
    jobs = {case: make_job(*case, options) for case in cases}
    for (name, seed), result in run_cases(jobs, read_place(options)):
        results.add({"variant": name, "seed": seed, **result})
    print(f"written to {options.out}")


if __name__ == "__main__":
    run_command(main)
