"""Steps that gave no number: kept in the run, and replayed."""

from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from quadwalk.errors import UsageError, UserError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.physics.motor import Physics
from quadwalk.task.env import MAX_SPEED, EnvState, QuadrupedEnv
from quadwalk.task_files import load_task
from quadwalk.tasks import sprint
from quadwalk.train import nan
from quadwalk.train.robot import load_robot
from quadwalk.train.runs import checkpoint
from quadwalk.train.runs.directory import Run, create_run
from quadwalk.train.runs.log import read_metrics
from quadwalk.train.settings import RobotConfig

CONFIG = replace(sprint.TASK, robot=RobotConfig(ALIENGO_URDF))


@pytest.fixture(scope="module")
def env() -> QuadrupedEnv:
    return QuadrupedEnv(load_robot(CONFIG.robot), CONFIG.env)


@pytest.fixture
def run(tmp_path, env) -> Run:
    return create_run(tmp_path, "a", files={"robot.urdf": env.quadruped.urdf.encode()})


def standing(env, roll_rate: float) -> EnvState:
    """The home pose, as the trunk rolls by so many rad/s."""
    velocity = np.zeros(18, np.float32)
    velocity[3] = roll_rate
    physics = Physics(np.asarray(env.robot.home, np.float32), velocity, np.zeros(18, np.float32))
    return EnvState(physics, np.zeros(12, np.float32), np.int32(7))


@pytest.mark.parametrize("roll_rate", [1e-3, 1e20])
def test_a_step_is_kept_and_goes_wrong_again(run, env, roll_rate):
    before, action = standing(env, roll_rate), np.full(12, 0.25, np.float32)
    path = nan.keep(run, before, action, env.mj_model, CONFIG, 640)
    assert path == run.nan / "step_000000000640.npz"
    qpos, qvel = nan.replay(path)
    assert qpos.shape == (CONFIG.env.substeps + 1, 19)
    np.testing.assert_array_equal(qpos[0], before.physics.qpos)
    np.testing.assert_array_equal(qvel[0], before.physics.qvel)
    sound = bool(np.isfinite(qpos).all() and (np.abs(qvel) < MAX_SPEED).all())
    assert sound == (roll_rate < 1)
    if sound:
        assert not np.array_equal(qpos[1], qpos[0])
    else:
        assert not np.isfinite(qvel[-1]).all()


def test_a_step_of_another_task_is_replayed_as_it_was(run, env):
    # Its targets depend on where the joints are, its motors and gravity are not the robot's own.
    config = replace(load_task("blog"), robot=CONFIG.robot)
    task = QuadrupedEnv(env.quadruped, config.env)
    state = jax.jit(task.reset)(jax.random.PRNGKey(0))
    action = np.full(12, -1.0, np.float32)
    path = nan.keep(run, state.pipeline_state, action, task.mj_model, config, 64)
    qpos, qvel = nan.replay(path)
    after = jax.jit(task.step)(state, action).pipeline_state.physics
    np.testing.assert_allclose(qpos[-1], after.qpos, atol=1e-6)
    np.testing.assert_allclose(qvel[-1], after.qvel, atol=1e-4)


def test_what_is_kept_can_be_read_without_this_package(run, env):
    path = nan.keep(run, standing(env, 0.0), np.ones(12), env.mj_model, CONFIG, 64)
    with np.load(path) as archive:
        assert archive["qpos"].shape == (19,)
        assert archive["steps"] == 7
        files = {"model.mjb": archive["model"].tobytes()}
    model = mujoco.MjModel.from_binary_path("model.mjb", files)
    np.testing.assert_array_equal(model.body_mass, env.mj_model.body_mass)


def test_enough_is_enough(run, env):
    for count in range(nan.KEPT):
        assert nan.keep(run, standing(env, 0.0), np.ones(12), env.mj_model, CONFIG, count)
    assert nan.keep(run, standing(env, 0.0), np.ones(12), env.mj_model, CONFIG, 99) is None
    assert len(list(run.nan.iterdir())) == nan.KEPT


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half"])
def test_a_file_that_is_none_is_named(run, content):
    run.nan.mkdir()
    path = run.nan / "step_000000000001.npz"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"step_000000000001\.npz is damaged or foreign"):
        nan.replay(path)
    checkpoint.save(path, {"qpos": np.zeros(3)}, {"kind": "nan", "config": {}})
    with pytest.raises(UserError, match="holds a step that cannot be used"):
        nan.replay(path)


def test_the_command_wants_one_file(monkeypatch):
    monkeypatch.setattr("sys.argv", ["nan"])
    with pytest.raises(UsageError, match="expected one argument"):
        nan.main()


def test_a_training_keeps_them_counts_them_and_goes_on(tmp_path, flags, train, capsys):
    train(*flags(tmp_path, "nan", 30, "--env.termination.tipped.angle=0.5"))
    run = Run(tmp_path / "nan")
    rows = read_metrics(run)
    assert len(rows) == 30
    counts = np.diff([0.0, *(row["train/nan"] for row in rows)])
    assert counts.sum() > 3
    with_nan = [row["steps"] for row, count in zip(rows, counts, strict=True) if count]
    kept = sorted(run.nan.iterdir())
    assert [int(path.stem[5:]) for path in kept] == with_nan[: nan.KEPT]
    for path in kept:
        arrays, metadata = checkpoint.load(path, "nan")
        assert arrays["qpos"][1] > 0.5  # which is when the toy gives no number
        tipped = metadata["config"]["env"]["termination"]["tipped"]
        assert tipped["params"] == {"angle": 0.5}
    assert "NaN states" in capsys.readouterr().out
    assert all(np.isfinite(row["loss/value"]) for row in rows)
