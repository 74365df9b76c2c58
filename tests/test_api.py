"""The package as a notebook uses it: each function, and the errors where one is misused."""

import dataclasses
import io
import os
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import quadwalk
import quadwalk.gym
from quadwalk.errors import UsageError, UserError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.runs.log import read_metrics
from quadwalk.settings.training import RobotConfig
from quadwalk.task_files import load_task
from tests.evaluation.conftest import count_messages
from tests.programs import python

BATCH = 64  # control steps in an iteration of the tiny training
TINY = {
    "envs": 16,
    "ppo.eval_envs": 2,
    "ppo.unroll": 4,
    "ppo.epochs": 1,
    "ppo.minibatches": 2,
    "ppo.hidden": (16,),
}
EPISODES, SECONDS = 2, 0.6


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def trained(runs):
    """Return a run of two iterations, and the rows that its watcher saw."""
    rows = []
    run = quadwalk.train(
        "run", steps=2 * BATCH, runs=runs, name="tiny", seed=3, quiet=True,
        overrides={**TINY, "env.reward.energy": -0.5}, watch=rows.append,
    )  # fmt: skip
    return run, rows


@pytest.fixture(scope="module")
def results(trained):
    """Evaluate that run in MJX and in MuJoCo C; return the results by engine."""
    run, _ = trained
    return {
        engine: quadwalk.evaluate(run, episodes=EPISODES, seconds=SECONDS, engine=engine, seed=1)
        for engine in ("mjx", "mujoco")
    }


def find_orange(picture: np.ndarray) -> np.ndarray:
    """Return a mask of the robot's color in a picture (height, width, 3)."""
    red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
    return (red > 150) & (green > 0.3 * red) & (green < 0.7 * red) & (blue < 0.3 * red)


def test_an_environment_resets_and_steps_in_a_batch():
    env = quadwalk.make("walk")
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), 4))
    assert state.obs.shape == (4, env.observation_size)
    after = jax.jit(jax.vmap(env.step))(state, jnp.zeros((4, env.action_size)))
    assert np.isfinite(after.obs).all()
    # Four robots with starts and commands of their own.
    assert len(np.unique(after.obs[:, 0])) == 4
    np.testing.assert_array_equal(after.pipeline_state.steps, 1)


def test_overrides_and_the_robot_reach_the_environment(tmp_path):
    urdf = ALIENGO_URDF.read_text()
    mass = float(re.search(r'<mass value="([\d.]+)"', urdf)[1])  # the trunk's
    heavy = urdf.replace(f'<mass value="{mass}"', f'<mass value="{mass + 10.0}"', 1)
    (tmp_path / "heavy.urdf").write_text(heavy)
    usual = quadwalk.make("run")
    changes = {"env.reward.energy": -0.5, "env.reward.forward.max_speed": 2.0, "env.substeps": 4}
    changed = quadwalk.make("run", robot=str(tmp_path / "heavy.urdf"), overrides=changes)
    g = changed.quadruped.gravity
    assert changed.robot.weight == pytest.approx(usual.robot.weight + 10.0 * g)
    assert changed.config.reward["energy"].scale == -0.5
    assert changed.config.reward["forward"].params == {"max_speed": 2.0}
    assert changed.config.control_dt == pytest.approx(0.8 * usual.config.control_dt)
    assert usual.config.reward["energy"].scale != -0.5


def test_a_configs_robot_is_made_and_another_urdf_leaves_its_other_settings(tmp_path):
    """Check a URDF whose calves have no effort limit; the config gives it."""
    limp = ALIENGO_URDF.read_text().replace('effort="44.4"', 'effort="0"')
    for name in ("own", "other"):
        (tmp_path / f"{name}.urdf").write_text(limp.replace("aliengo", name))
    robot = RobotConfig(tmp_path / "own.urdf", effort=30.0)
    config = dataclasses.replace(load_task("sprint"), robot=robot)
    for urdf, name in ((None, "own"), (tmp_path / "other.urdf", "other")):
        quadruped = quadwalk.make(config, urdf).quadruped
        assert quadruped.name == name
        assert list(quadruped.effort[2::3]) == [30.0] * 4
    gone = dataclasses.replace(config, robot=RobotConfig(tmp_path / "gone.urdf"))
    for make in (
        quadwalk.gym.QuadrupedGymEnv, lambda task: quadwalk.gym.QuadrupedGymVectorEnv(2, task)
    ):  # fmt: skip
        with pytest.raises(UserError, match=r"gone\.urdf"):
            make(gone)


def test_a_training_returns_its_run_and_is_watched(trained, runs):
    run, rows = trained
    assert run.path == runs / "tiny"
    assert [row["steps"] for row in rows] == [BATCH, 2 * BATCH]
    np.testing.assert_equal(read_metrics(run), rows)  # NaN where nothing ended
    config = quadwalk.load_policy(run).config
    assert (config.seed, config.envs, config.ppo.hidden) == (3, 16, (16,))
    assert config.env.reward["energy"].scale == -0.5


def test_a_training_is_gone_on_with_where_it_ended(trained, runs):
    run, _ = trained
    shutil.copytree(run.path, runs / "longer")
    rows = []
    again = quadwalk.train(
        resume="longer", steps=3 * BATCH, runs=runs, quiet=True, watch=rows.append
    )
    assert again.path == runs / "longer"
    assert [row["steps"] for row in rows] == [3 * BATCH]
    assert again.metrics.read_bytes().startswith(run.metrics.read_bytes())
    policy = quadwalk.load_policy(again)
    assert policy.steps == 3 * BATCH
    assert policy.config.env.reward["energy"].scale == -0.5


def test_a_policy_acts_as_it_did_in_its_evaluation(trained, results):
    run, _ = trained
    rollout = results["mjx"].typical
    for source in (run, run.policy):
        policy = quadwalk.load_policy(source)
        assert policy.steps == 2 * BATCH
        assert policy.joints == results["mjx"].loaded.env.quadruped.joints
        action = policy.act(jnp.asarray(rollout.observation))
        np.testing.assert_allclose(action, rollout.action, atol=1e-5)


@pytest.mark.parametrize("engine", ["mjx", "mujoco"])
def test_an_evaluation_measures_its_episodes_in_that_engine(results, engine):
    result = results[engine]
    assert result.results["engine"] == engine
    assert [rollout.episode for rollout in result.rollouts] == list(range(EPISODES))
    for rollout, figures in zip(result.rollouts, result.episodes, strict=True):
        assert 0 < rollout.time[-1] <= SECONDS + 1e-9
        assert figures["distance"] == pytest.approx(rollout.qpos[-1, 0] - rollout.qpos[0, 0])
    distances = [figures["distance"] for figures in result.episodes]
    assert result.summary["distance"]["mean"] == pytest.approx(np.mean(distances))
    assert result.gait.speed == pytest.approx(result.typical.qvel[:, 0].mean(), abs=0.2)


def test_both_engines_start_alike(results):
    for one, other in zip(results["mjx"].rollouts, results["mujoco"].rollouts, strict=True):
        np.testing.assert_allclose(one.qpos[0], other.qpos[0], atol=1e-6)
    first, second = results["mjx"].rollouts
    assert not np.allclose(first.qpos[0], second.qpos[0])


def test_a_film_strip_is_an_image_of_the_robot(results):
    strip = results["mjx"].film_strip(width=160, height=100)
    assert isinstance(strip, Image.Image)
    robot = find_orange(np.asarray(strip))
    assert robot.shape[0] >= 2 * 100
    assert robot.shape[1] >= 4 * 160
    middles = [robot[y : y + 100, x : x + 160] for y in (0, 100) for x in range(0, 640, 160)]
    assert min(part.mean() for part in middles) > 0.005  # in each of the eight


def test_recordings_are_written_and_whole(results, tmp_path):
    files = results["mujoco"].save_mcap(tmp_path / "new" / "folder")
    assert [file.name for file in files] == ["episode_000.mcap", "episode_001.mcap"]
    assert all(count_messages(file) > 100 for file in files)
    assert len(results["mjx"].save_mcap(tmp_path, episodes=1)) == 1


def test_evaluations_are_compared_in_a_table_and_as_plots(results, capsys):
    figure = quadwalk.compare({"in MJX": results["mjx"], "in C": results["mujoco"]})
    table = capsys.readouterr().out
    assert "in MJX" in table
    assert "in C" in table
    assert f"{EPISODES} episodes" in table
    (panel,) = (axes for axes in figure.axes if axes.get_title("left") == "Speed along x, m/s")
    assert [label.get_text() for label in panel.get_xticklabels()] == ["in MJX", "in C"]
    dots = [line.get_ydata() for line in panel.lines if len(line.get_xdata()) == EPISODES]
    for result, speeds in zip(results.values(), dots, strict=True):
        np.testing.assert_allclose(speeds, [figures["speed"] for figures in result.episodes])


def test_a_report_is_shown_by_a_notebook_that_has_not_set_up_pyplot(results):
    from IPython.core.formatters import DisplayFormatter

    data, _ = DisplayFormatter().format(results["mjx"].report())
    assert Image.open(io.BytesIO(data["image/png"])).size == (1600, 1800)


def test_other_episodes_are_not_compared(results):
    other = SimpleNamespace(results={**results["mjx"].results, "seed": 2})
    with pytest.raises(UsageError, match="other episodes, seconds or seeds"):
        quadwalk.compare({"a": results["mjx"], "b": other})
    with pytest.raises(UsageError, match="expected one or more"):
        quadwalk.compare({})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda runs: quadwalk.make("wlak"), "wlak"),
        (lambda runs: quadwalk.make(overrides={"env.reward.enrgy": 1}), "did you mean 'energy'"),
        (lambda runs: quadwalk.make(robot="no.urdf"), "no.urdf"),
        (lambda runs: quadwalk.train("run", runs=runs, stepps=1), "stepps"),
        (lambda runs: quadwalk.train("run", runs=runs, resume="tiny"), "resume uses the task"),
        (
            lambda runs: quadwalk.train(runs=runs, resume="tiny", init=runs / "tiny"),
            "expected no init",
        ),
        (lambda runs: quadwalk.train(resume="nobody", runs=runs), "nobody"),
        (lambda runs: quadwalk.evaluate("nobody", runs=runs), "nobody"),
        (lambda runs: quadwalk.evaluate("tiny", runs=runs, engine="bullet"), "bullet"),
        (lambda runs: quadwalk.evaluate("tiny", runs=runs, policy="worst"), "worst"),
        (lambda runs: quadwalk.evaluate("tiny", runs=runs, episodes=0), "episodes"),
        (lambda runs: quadwalk.load_policy(Path("no.npz")), "no.npz"),
    ],
)
def test_what_cannot_be_is_named_in_one_line(trained, runs, call, message):
    with pytest.raises(UserError, match=re.escape(message)):
        call(runs)


def count_devices_after(code: str) -> tuple[int, str]:
    """Return JAX's number of devices after `code` in a new process of two cores, and warnings."""
    program = (
        f"import quadwalk.learn.devices as d; d.count_cores = lambda: 2\n{code}\n"
        "import jax; print(len(jax.devices()))"
    )
    env = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = python("-c", program, env={**env, "JAX_PLATFORMS": "cpu"}, timeout=120)
    assert done.returncode == 0, done.stderr
    return int(done.stdout), done.stderr


def test_nothing_has_to_be_called_before_jax_is_imported():
    code = "import jax, quadwalk; quadwalk.make()"
    assert count_devices_after(code) == (2, "")


def test_it_is_said_once_that_jax_has_already_computed():
    code = "import jax.numpy; jax.numpy.ones(2) + 1; import quadwalk; quadwalk.make(); "
    count, warned = count_devices_after(code + "quadwalk.make('walk')")
    assert count == 1
    assert warned.count("JAX has already computed: quadwalk uses 1 CPU device instead of 2;") == 1
