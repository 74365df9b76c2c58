"""Steps that gave no number: kept in the run, and replayed."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from quadwalk.env.env import MAX_SPEED, EnvState, QuadrupedEnv
from quadwalk.errors import UsageError, UserError
from quadwalk.learn import nan
from quadwalk.paths import ALIENGO_URDF
from quadwalk.physics.motor import PhysicsState
from quadwalk.robot.load import load_robot
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run, create_run
from quadwalk.runs.log import read_metrics
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import RobotConfig
from quadwalk.task_files import load_task
from quadwalk.tasks import sprint

CONFIG = replace(sprint.TASK, robot=RobotConfig(ALIENGO_URDF))


@pytest.fixture(scope="module")
def env() -> QuadrupedEnv:
    return QuadrupedEnv(load_robot(CONFIG.robot), CONFIG.env)


@pytest.fixture
def run(tmp_path, env) -> Run:
    return create_run(tmp_path, "a", files={"robot.urdf": env.quadruped.urdf.encode()})


def standing(env, roll_rate: float) -> EnvState:
    """Return the state in the home pose, as the trunk rolls by so many rad/s."""
    velocity = np.zeros(18, np.float32)
    velocity[3] = roll_rate
    physics = PhysicsState(np.asarray(env.robot.home, np.float32), velocity)
    return EnvState(physics, np.zeros(12, np.float32), np.int32(7))


@pytest.mark.parametrize("roll_rate", [1e-3, 1e20])
def test_a_step_is_kept_and_goes_wrong_again(run, env, roll_rate):
    before, action = standing(env, roll_rate), np.full(12, 0.25, np.float32)
    path = nan.keep(run, before, action, CONFIG, 640)
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


@pytest.mark.parametrize("task", ["blog", "run"])
def test_a_step_of_another_task_is_replayed_as_it_was(run, env, task):
    """Check targets that depend on the joints, in `blog`, and steps under conditions, in `run`."""
    config = replace(load_task(task), robot=CONFIG.robot)
    often = replace(config.env.randomization, push_seconds=config.env.control_dt)
    config = replace(config, env=replace(config.env, randomization=often))
    task = QuadrupedEnv(env.quadruped, config.env)
    state = jax.jit(task.reset)(jax.random.PRNGKey(0))
    action = np.full(12, -1.0, np.float32)
    path = nan.keep(run, state.pipeline_state, action, config, 64)
    qpos, qvel = nan.replay(path)
    after = jax.jit(task.step)(state, action).pipeline_state.physics
    np.testing.assert_allclose(qpos[-1], after.qpos, atol=1e-6)
    np.testing.assert_allclose(qvel[-1], after.qvel, atol=1e-4)
    with np.load(path) as archive:  # without this package
        assert archive["before/physics/qpos"].shape == (19,)
        assert archive["before/steps"] == 0


def test_enough_is_enough(run, env):
    for count in range(nan.KEPT):
        assert nan.keep(run, standing(env, 0.0), np.zeros(12), CONFIG, count)
    assert nan.keep(run, standing(env, 0.0), np.zeros(12), CONFIG, 99) is None
    assert len(list(run.nan.iterdir())) == nan.KEPT


DAMAGED = "is damaged or foreign"


@pytest.mark.parametrize(
    ("content", "config", "message"),
    [
        (b"", None, DAMAGED),
        (b"PK\x03\x04 half", None, DAMAGED),
        ({"qpos": np.zeros(3)}, {}, "holds a step that cannot be used"),
        # Of before it held all.
        ({"action": np.zeros(12, np.float32)}, to_dict(CONFIG), "does not fit .* has no before/"),
    ],
)
def test_a_file_that_cannot_be_replayed_is_named(run, content, config, message):
    run.nan.mkdir()
    path = run.nan / "step_000000000001.npz"
    if config is None:
        path.write_bytes(content)
    else:
        checkpoint.save(path, content, {"kind": "nan", "config": config})
    with pytest.raises(UserError, match=rf"step_000000000001\.npz {message}"):
        nan.replay(path)


def test_a_training_whose_physics_diverges_ends_without_a_policy(tmp_path, flags, train, capsys):
    """Train the toy where nearly each of its steps gives no number."""
    diverging = "--env.termination.tipped.angle=0.01"
    with pytest.raises(
        UserError, match=r"^physics diverged: 1,0\d\d states of 1,\d+ were not finite"
    ):
        train(*flags(tmp_path, "nan", 60, diverging, "--quiet"))
    run = Run(tmp_path / "nan")
    assert not run.policy.exists()
    assert len(read_metrics(run)) < 30


def test_the_command_wants_one_file():
    with pytest.raises(UsageError, match="missing: file"):
        nan.main([])


def test_a_training_keeps_them_counts_them_and_goes_on(tmp_path, flags, train, capsys):
    train(*flags(tmp_path, "nan", 30, "--env.termination.tipped.angle=0.5"))
    run = Run(tmp_path / "nan")
    rows = read_metrics(run)
    assert len(rows) == 30
    counts = np.diff([0.0, *(row["train/nan"] for row in rows)])
    assert counts.sum() > 3
    with_nan = [row["steps"] for row, count in zip(rows, counts, strict=True) if count]
    files = sorted(run.nan.iterdir())
    assert [int(path.stem[5:]) for path in files] == with_nan[: nan.KEPT]
    for path in files:
        arrays, metadata = checkpoint.load(path, "nan")
        assert arrays["before/physics/qpos"][1] > 0.5  # which is when the toy gives no number
        tipped = metadata["config"]["env"]["termination"]["tipped"]
        assert tipped["params"] == {"angle": 0.5}
    assert "NaN states" in capsys.readouterr().out
    assert all(np.isfinite(row["loss/value"]) for row in rows)
