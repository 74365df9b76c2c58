"""A short training in each engine, from the same seed: what they learn from is the same."""

import dataclasses

import numpy as np
import pytest

from quadwalk.errors import UsageError
from quadwalk.learn.flags import parse_config
from quadwalk.learn.loop import train
from quadwalk.runs.directory import Run
from quadwalk.runs.log import read_metrics
from quadwalk.tasks import sprint

ENVS, UNROLL, ITERATIONS = 64, 8, 6
FLAGS = (
    f"sprint --envs={ENVS} --ppo.unroll={UNROLL} --steps={ENVS * UNROLL * ITERATIONS} --devices=2 "
    "--quiet --ppo.eval-envs=2 --ppo.epochs=1 --ppo.minibatches=2 --ppo.hidden=32 "
    # As training has it the engines' solvers stop at different points of the same problem.
    "--env.solver-iterations=6 --env.line-search-iterations=8"
)


@pytest.fixture(scope="module")
def figures_by_engine(tmp_path_factory) -> dict[str, dict[str, np.ndarray]]:
    """Train in each engine; return the figures of every iteration."""
    runs = tmp_path_factory.mktemp("runs")
    figures = {}
    for engine in ("fast", "mjx"):
        flags = f"{FLAGS} --name={engine} --runs={runs} --env.engine={engine}"
        train(*parse_config(flags.split()))
        rows = read_metrics(Run(runs / engine))
        assert len(rows) == ITERATIONS
        figures[engine] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return figures


# Measured: 3.5 % for the tilt, 1.6 % for the others.
def test_the_first_iteration_earns_the_same_rewards_term_by_term(figures_by_engine):
    """Check one policy with the same starts and noise: only the physics differs."""
    terms = [name for name in figures_by_engine["fast"] if name.startswith("train/reward")]
    assert len(terms) > 10
    for name in terms:
        fast, mjx = (figures_by_engine[engine][name][0] for engine in ("fast", "mjx"))
        # A handful of falls: one of them may come a step later, in the next iteration.
        one = 10.0 / (ENVS * UNROLL) if name in ("train/reward", "train/reward/fall") else 0.0
        # Robots go either way, each at some 0.3 m/s: their mean speed is near 0.
        still = 5e-3 if name == "train/reward/forward" else 0.0
        assert fast == pytest.approx(mjx, rel=0.08, abs=1.01 * one + still), name


# Measured: 4 % at most; what falls and where it runs depends on much less.
def test_what_is_learnt_from_stays_alike(figures_by_engine):
    """Check rewards that stay alike, though policies differ after some updates."""
    for name in ("alive", "energy", "action_rate", "roll_pitch_rate", "vertical", "lateral"):
        fast, mjx = (
            figures_by_engine[engine][f"train/reward/{name}"][1:] for engine in ("fast", "mjx")
        )
        assert fast.mean() == pytest.approx(mjx.mean(), rel=0.15), name
    for figures in figures_by_engine.values():
        assert figures["train/nan"][-1] == 0
        assert all(np.isfinite(figures["loss/value"]))
        assert figures["loss/value"][-1] < 0.1 * figures["loss/value"][0]


def test_an_engine_that_training_has_not_is_refused():
    with pytest.raises(UsageError, match=r"env\.engine is 'mujoco'; expected fast or mjx"):
        dataclasses.replace(sprint.TASK.env, engine="mujoco")
