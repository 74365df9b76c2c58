"""Rollouts to test on: simulated in MuJoCo C, or drawn to order."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from quadwalk.evaluate.motion.forces import foot_forces, geom_ids
from quadwalk.evaluate.rollout import Rollout
from quadwalk.robot.quadruped import Quadruped

CONTROL_DT, SUBSTEPS = 0.02, 5
KP, KD = 160.0, 4.0  # stiff enough for legs that only follow the clock


@pytest.fixture(scope="session")
def simulate(quadruped: Quadruped) -> Callable[..., Rollout]:
    """simulate(steps, offsets, ...): legs swinging at set phases under PD control."""

    def run(
        steps: int,
        offsets: tuple[float, ...] = (0.0, 0.5, 0.5, 0.0),
        frequency: float = 3.0,  # Hz
        sweep: float = -0.25,  # rad, of the thighs
        lift: float = 0.3,  # rad, of the calves
        seed: int = 0,
    ) -> Rollout:
        model = quadruped.training_model(CONTROL_DT / SUBSTEPS, iterations=5)
        data = mujoco.MjData(model)
        data.qpos[:] = quadruped.home
        mujoco.mj_forward(model, data)
        geoms = geom_ids(model, quadruped.feet)
        rng = np.random.default_rng(seed)
        qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
        rows: dict[str, list] = {name: [] for name in ("target", "torque", "energy", "force")}
        phase_of = 2 * np.pi * np.array(offsets)
        for k in range(steps):
            phase = 2 * np.pi * frequency * k * CONTROL_DT + phase_of
            target = quadruped.home[7:].reshape(4, 3).copy()
            target[:, 1] += sweep * np.cos(phase)
            target[:, 2] -= lift * np.maximum(-np.sin(phase), 0.0)
            target = target.ravel() + 0.01 * rng.standard_normal(12)
            torques, energy = [], 0.0
            for _ in range(SUBSTEPS):
                torque = KP * (target - data.qpos[7:]) - KD * data.qvel[6:]
                data.ctrl[:] = np.clip(torque, -quadruped.effort, quadruped.effort)
                torques.append(data.ctrl.copy())
                power = np.maximum(data.ctrl * data.qvel[6:], 0.0).sum()
                energy += power * model.opt.timestep
                mujoco.mj_step(model, data)
            qpos.append(data.qpos.copy())
            qvel.append(data.qvel.copy())
            rows["target"].append(target)
            rows["torque"].append(np.mean(torques, axis=0))
            rows["energy"].append(energy)
            rows["force"].append(foot_forces(model, data, geoms))
        arrays = {name: np.array(values, dtype=np.float32) for name, values in rows.items()}
        states, rates = np.array(qpos, dtype=np.float32), np.array(qvel, dtype=np.float32)
        actions = ((arrays["target"] - quadruped.home[7:]) / 0.6).astype(np.float32)
        heading = 2 * np.arctan2(states[:, 6:7], states[:, 3:4])
        joints = states[:-1, 7:] - quadruped.home[7:]
        last = np.roll(actions, 1, axis=0)
        # As many numbers, and as noisy, as a policy sees.
        seen = [rates[:-1, :6], states[:-1, 3:6], heading[:-1], states[:-1, 1:2]]
        seen = np.concatenate([*seen, joints, rates[:-1, 6:], last], axis=1).astype(np.float32)
        terms = {
            "forward": rates[1:, 0],
            "alive": np.ones(steps, dtype=np.float32),
            "energy": arrays["energy"],
            "lateral": np.abs(rates[1:, 1]),
            "vertical": rates[1:, 2] ** 2,
            "roll_pitch_rate": np.abs(rates[1:, 3:5]).sum(axis=1),
            "yaw": np.abs(heading[1:, 0]),
            "offset": np.abs(states[1:, 1]),
            "tilt": (states[1:, 4:6] ** 2).sum(axis=1),
            "fall": np.zeros(steps, dtype=np.float32),
            "action_rate": (np.diff(actions, axis=0, prepend=actions[:1]) ** 2).mean(axis=1),
        }
        return Rollout(
            control_dt=CONTROL_DT,
            seed=seed,
            episode=0,
            end="time limit",
            qpos=states,
            qvel=rates,
            action=actions,
            target=arrays["target"],
            torque=arrays["torque"],
            energy=arrays["energy"],
            observation=seen,
            observation_names=tuple(f"seen {k}" for k in range(seen.shape[1])),
            contact=arrays["force"] > 0,
            foot_force=arrays["force"],
            reward_terms=terms,
            reward=terms["forward"] + 0.5,
        )

    return run


@pytest.fixture(scope="session")
def trot(simulate) -> Rollout:
    """2 s of diagonal legs swinging together."""
    return simulate(100)


@pytest.fixture(scope="session")
def swaying() -> Callable[[jax.Array], jax.Array]:
    """A policy that moves the legs a little by what it sees."""
    weights = 0.03 * jax.random.normal(jax.random.PRNGKey(1), (47, 12))
    return jax.tree_util.Partial(lambda w, seen: jnp.tanh(seen @ w), weights)
