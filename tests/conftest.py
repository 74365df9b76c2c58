"""Two XLA devices for all tests, the AlienGo and its environments, and URDFs of other robots."""

import dataclasses
import os
import signal
from collections.abc import Callable
from pathlib import Path

# Before JAX is imported, which sets it otherwise: XLA's messages would fill the output.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
# Tests compile much and compute little: twice as fast without most of the compiler's optimizations.
# Programs that tests start inherit this; tests/test_end_to_end.py trains once with all of them.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")

import jax
import mujoco
import numpy as np
import pytest

from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.task.env import QuadrupedEnv
from quadwalk.tasks import sprint
from quadwalk.train.devices import set_up_devices

# Tests send Ctrl-C, which a shell without job control has the commands in its background ignore.
signal.signal(signal.SIGINT, signal.default_int_handler)

# So that what is shared between devices is tested as such.
set_up_devices(2)

BATCH = 4
STEPS = 200


@pytest.fixture(scope="session")
def quadruped() -> Quadruped:
    """The AlienGo."""
    return load_quadruped()


@pytest.fixture(scope="session")
def env(quadruped) -> QuadrupedEnv:
    return QuadrupedEnv(quadruped, dataclasses.replace(sprint.TASK.env, episode_seconds=0.1))


@pytest.fixture(scope="session")
def body_env(env) -> QuadrupedEnv:
    """The same, but that knees and trunk touch the floor too."""
    return QuadrupedEnv(env.quadruped, dataclasses.replace(env.config, contacts="body"))


@pytest.fixture(scope="session")
def reset(env):
    """Compiled: seed -> a batch of fresh states."""
    compiled = jax.jit(jax.vmap(env.reset))
    return lambda seed: compiled(jax.random.split(jax.random.PRNGKey(seed), BATCH))


@pytest.fixture(scope="session")
def step(env):
    """Compiled: (states, actions) -> states."""
    return jax.jit(jax.vmap(env.step))


def step_in_place(
    env: QuadrupedEnv, model: mujoco.MjModel | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """A robot in MuJoCo C stepping in place: torques applied, and the states they led through."""
    model = model or env.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = env.robot.home
    data.qpos[2] += 0.03  # dropped, so that contacts begin
    data.qvel[:6] = np.random.default_rng(0).uniform(-0.2, 0.2, 6)
    phase = np.pi * np.array([0, 1, 1, 0])
    torques, states = [], [np.r_[data.qpos, data.qvel]]
    for k in range(STEPS):
        lift = np.maximum(np.sin(2 * np.pi * 2.5 * k * model.opt.timestep + phase), 0.0)
        target = env.robot.home_joints.reshape(4, 3) + np.stack([0 * lift, lift, -2 * lift], 1) / 8
        torque = 80 * (target.ravel() - data.qpos[7:]) - 2 * data.qvel[6:]
        data.ctrl[:] = torque = np.clip(torque, -env.quadruped.effort, env.quadruped.effort)
        mujoco.mj_step(model, data)
        torques.append(torque)
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(torques), np.array(states)


@pytest.fixture(scope="session")
def stepping_in_place():
    """`step_in_place` as a fixture."""
    return step_in_place


@pytest.fixture(scope="session")
def same_result() -> Callable[..., None]:
    """Assert that two runs, as folders, ended in the same state by the same way."""

    def arrays(path: Path) -> dict[str, bytes]:
        with np.load(path) as archive:
            return {name: archive[name].tobytes() for name in archive.files if "." not in name}

    def compare(run: Path, expected: Path, best: bool = True) -> None:
        assert (run / "metrics.jsonl").read_bytes() == (expected / "metrics.jsonl").read_bytes()
        last = max(path.name for path in (expected / "checkpoints").iterdir())
        for file in ("policy.npz", f"checkpoints/{last}", *["best.npz"] * best):
            assert arrays(run / file) == arrays(expected / file), file
        assert not list(run.rglob("*.part"))

    return compare


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test with a `reference_urdf` once for each that there is."""
    if "reference_urdf" in metafunc.fixturenames:
        missing = pytest.mark.skip(reason="QUADWALK_REFERENCE_URDFS names no folder of URDFs")
        files = reference_urdfs() or [pytest.param(None, marks=missing)]
        metafunc.parametrize("reference_urdf", files, ids=lambda file: file and file.stem)


def reference_urdfs() -> list[Path]:
    """URDFs of other quadrupeds, in a folder that the environment names."""
    folder = os.environ.get("QUADWALK_REFERENCE_URDFS")
    return sorted(Path(folder).glob("*.urdf")) if folder else []
