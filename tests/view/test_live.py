"""The robot behind the page: it moves as evaluations do, and what is changed takes effect."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import EnvState
from quadwalk.physics.motor import MotorConfig
from quadwalk.runs.directory import Run
from quadwalk.tasks import getup
from quadwalk.view.choices import LAST, getup_of, open_run
from quadwalk.view.live import LYING, RISING, STEADY, LiveRobot
from tests.view.conftest import write_run


@pytest.mark.parametrize("which", ["live", "hare", "goat"])
def test_it_moves_as_the_environment_does(which, request):
    """Against `QuadrupedEnv.step` in MuJoCo C, which evaluations step; with late targets."""
    robot = request.getfixturevalue(which)
    robot.change(latency=0.013, strength=0.9, payload=3.0, friction=0.5)
    robot.command[:] = 1.0, 0.2, -0.3
    robot.reset()
    robot.data.qpos[2] += 0.005  # not just on the floor, where a rounding error decides
    env = robot.env
    start: EnvState = jax.tree.map(jnp.asarray, robot.state())
    state = jax.jit(env.reset)(jax.random.PRNGKey(0)).replace(pipeline_state=start)
    state = env.begun(state, 0, conditions=start.conditions)
    quickly = {"xla_backend_optimization_level": 0}  # compiled
    step = jax.jit(lambda s: env.step(s, robot.policy.act(s.obs)), compiler_options=quickly)
    for _ in range(10):
        state = step(state)
        robot.step()
        assert robot.data.qpos == pytest.approx(np.asarray(state.pipeline_state.qpos), abs=5e-5)


def test_it_stands_on_its_feet_at_first(fresh):
    mujoco.mj_kinematics(fresh.model, fresh.data)
    feet = [fresh.model.geom(name) for name in fresh.env.quadruped.feet]
    low = min(fresh.data.geom_xpos[foot.id][2] - foot.size[0] for foot in feet)
    assert low == pytest.approx(0.0, abs=1e-9)
    assert not fresh.data.qvel.any()
    assert (fresh.time, fresh.fell) == (0.0, False)


def test_it_stands_on_the_ground_of_the_tile_that_is_chosen(goat):
    tiles = goat.env.terrain.tiles
    assert len({tile.kind for tile in tiles}) == 2
    for index, tile in enumerate(tiles):
        goat.tile = index
        goat.reset()
        mujoco.mj_forward(goat.model, goat.data)
        np.testing.assert_allclose(goat.data.qpos[:2], tile.start)
        floor = goat.model.geom("floor").id
        gaps = []
        for foot in goat.env.quadruped.feet:
            center, down = goat.data.geom(foot).xpos, np.array([0.0, 0.0, -1.0])
            distance = mujoco.mj_rayHfield(goat.model, goat.data, floor, center, down, None)
            gaps.append(distance - goat.model.geom(foot).size[0])
        assert min(gaps) == pytest.approx(0.0, abs=2e-3)
        assert goat.state().tile == index
        assert not goat.fell


def test_the_policy_sees_the_command(fresh):
    actions = []
    for command in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
        fresh.reset()
        fresh.command[:] = command
        fresh.step()
        actions.append(fresh.state().last_action)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(actions[one] - actions[other]).max() > 1e-4


@settings(max_examples=20, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-3.1, 3.1))
def test_a_push_changes_the_velocity_by_what_it_says(live, forward, left, heading):
    live.reset()
    live.data.qpos[3:7] = np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)
    live.data.qvel[:3] = 0.3, -0.2, 0.1
    before, velocity = live.data.qvel.copy(), live.velocity
    live.push(forward, left)
    assert live.heading == pytest.approx(heading)
    assert live.velocity - velocity == pytest.approx([forward, left, 0.0])
    assert live.data.qvel[2:] == pytest.approx(before[2:])
    assert np.linalg.norm(live.data.qvel[:2] - before[:2]) == pytest.approx(np.hypot(forward, left))


def test_friction_and_payload_are_those_of_the_model(fresh):
    usual = fresh.model
    fresh.change(friction=0.3, payload=4.0)
    trunk = fresh.model.body(fresh.env.quadruped.trunk).id
    assert np.all(fresh.model.geom_friction[:, 0] == np.float32(0.3))
    assert fresh.model.body_mass.sum() == pytest.approx(usual.body_mass.sum() + 4.0)
    assert fresh.model.body_mass[trunk] == pytest.approx(usual.body_mass[trunk] + 4.0)
    assert usual.geom_friction[0, 0] == pytest.approx(fresh.env.friction)  # another is changed


@pytest.fixture
def still() -> SimpleNamespace:
    """A policy that holds the home pose."""
    return SimpleNamespace(act=jax.tree_util.Partial(lambda seen: jnp.zeros(12)))


def test_a_payload_presses_on_the_feet(fresh, still, monkeypatch):
    """Standing for a second, the feet bear the weight, with 4 kg and without."""
    monkeypatch.setattr(fresh, "policy", still)
    weights = []
    for payload in (0.0, 4.0):
        fresh.change(payload=payload)
        fresh.reset()
        borne = []
        for _ in range(60):
            fresh.step()
            borne.append(fresh.foot_force.sum())
        weights.append(np.mean(borne[40:]))
    assert weights[0] == pytest.approx(fresh.env.robot.weight, rel=0.02)
    assert weights[1] - weights[0] == pytest.approx(4.0 * 9.81, rel=0.05)


def test_strength_weakens_the_motors(fresh, still, monkeypatch):
    """As in the environment, which `test_it_moves_as_the_environment_does` steps at another."""
    monkeypatch.setattr(fresh, "policy", still)
    speeds = []
    for strength in (0.0, 0.7, 1.0):
        fresh.change(strength=strength)
        assert fresh.state().conditions.variation.strength == pytest.approx(strength)
        fresh.reset()
        fresh.data.qpos[2] += 0.5  # in the air, calves far from their targets
        fresh.data.qpos[9::3] += 0.8  # rad
        fresh.step()
        speeds.append(np.abs(fresh.data.qvel[8::3]).mean())
    assert speeds[0] < 0.1 * speeds[1]
    assert speeds[1] < 0.95 * speeds[2]


def test_noise_is_what_the_task_states_and_new_in_every_step(hare, still, monkeypatch):
    """Of 40 steps, each in the same state, and so with the same true frame."""
    monkeypatch.setattr(hare, "policy", still)
    scale = hare.env.sensors.noise_scale

    def seen(noise: float, steps: int) -> np.ndarray:
        hare.change(latency=0.0, noise=noise)
        hare.reset()
        qpos, rows = hare.data.qpos.copy(), []
        for _ in range(steps):
            hare.data.qpos[:], hare.data.qvel[:] = qpos, 0.0
            hare.step()
            rows.append(hare.state().frames[0])
        return np.array(rows)

    error = seen(2.0, 40) - seen(0.0, 1)
    assert np.all(error[:, scale == 0.0] == 0.0)
    level = error[:, scale > 0.0] / scale[scale > 0.0]
    assert level.std() == pytest.approx(2.0, rel=0.1)
    assert len(np.unique(level[:, 0])) == 40


def test_one_that_fell_stands_up_anew(fresh):
    steps = round(LYING / fresh.env.stepping.control_dt)
    for _ in range(steps + 2):
        fresh.data.qpos[3:7] = 0.0, 1.0, 0.0, 0.0  # on its back
        fresh.step()
        if not fresh.steps:
            break
        assert fresh.fell
    assert fresh.steps == 0
    assert fresh.data.qpos == pytest.approx(fresh.env.robot.home)


def test_what_diverged_begins_anew(fresh):
    fresh.data.qvel[0] = 1e5
    fresh.step()
    assert fresh.data.qpos == pytest.approx(fresh.env.robot.home)


def test_the_settings_are_of_the_names_that_the_panel_uses(fresh):
    names = [field.name for field in dataclasses.fields(fresh.settings)]
    assert names == ["friction", "payload", "strength", "latency", "noise"]


@pytest.fixture(scope="module")
def rising(runs, quadruped):
    """A robot with a policy to get up, which has learnt nothing."""
    run = write_run(runs.parent, "getup", quadruped, {"policy.npz": 8}, getup.TASK)
    loaded = open_run(Run(runs / "dog"), LAST)
    return LiveRobot(loaded, getup=getup_of(loaded, run))


def test_what_has_fallen_gets_up_and_then_drives_on(rising):
    dt = rising.env.stepping.control_dt
    assert not rising.rising
    rising.throw()
    for _ in range(round(3.0 / dt)):
        rising.step()
        if rising.rising:
            break
    assert rising.rising
    assert rising.fell
    # Once it stands it is the other policy's turn, with no memory of the fall.
    home = rising.env.robot.home
    for count in range(1 + round(STEADY / dt)):
        assert rising.rising, count
        rising.data.qpos[2:7], rising.data.qpos[7:] = home[2:7], home[7:]
        rising.data.qvel[:] = 0.0
        rising.step()
    assert not rising.rising
    assert rising.state().steps == 0
    assert not rising.state().last_action.any()


def test_each_policy_acts_with_the_gains_that_it_was_trained_with(runs, quadruped):
    """One to get up whose motors give nothing, however strong they are."""
    env = getup.TASK.env
    limp = dataclasses.replace(env, motor=MotorConfig(kp=0.0, kd=0.0, joint_friction=False))
    task = dataclasses.replace(getup.TASK, env=limp)
    run = write_run(runs.parent, "limp", quadruped, {"policy.npz": 8}, task)
    loaded = open_run(Run(runs / "dog"), LAST)
    robot = LiveRobot(loaded, getup=getup_of(loaded, run))
    for strength in (1.0, 0.9):
        robot.change(strength=strength)
        robot.reset()
        robot.step()
        assert np.abs(robot.data.qfrc_applied[6:]).max() > 0.1
        robot.data.qpos[3:7] = 0.0, 1.0, 0.0, 0.0  # on its back
        robot.step()
        assert robot.rising
        robot.step()
        assert not robot.data.qfrc_applied.any()
    slow = dataclasses.replace(task, env=dataclasses.replace(limp, substeps=10))
    other = write_run(runs.parent, "slow", quadruped, {"policy.npz": 8}, slow)
    assert getup_of(loaded, other) is None  # its control period is not the driver's


def test_it_is_put_on_its_feet_where_it_does_not_get_up(rising):
    rising.reset()
    rising.data.qpos[3:7] = 0.0, 1.0, 0.0, 0.0  # on its back
    for _ in range(round((RISING + 0.5) / rising.env.stepping.control_dt)):
        rising.data.qpos[3:7], rising.data.qvel[:] = (0.0, 1.0, 0.0, 0.0), 0.0
        before = rising.steps
        rising.step()
        if rising.steps < before:
            break
    assert rising.steps == 0
    assert not rising.rising


def test_another_robot_has_no_use_for_it(runs):
    loaded = open_run(Run(runs / "dog"), LAST)
    assert getup_of(loaded, None) is None
    assert getup_of(loaded, loaded.run) is None
    heavier = QuadrupedEnv(loaded.env.quadruped, loaded.env.config)
    heavier.mj_model.body_mass[1] += 1.0
    other = dataclasses.replace(loaded, env=heavier)
    assert getup_of(loaded, Run(runs / "cat")) is not None
    assert getup_of(other, Run(runs / "cat")) is None
