"""Two XLA devices for all tests, the AlienGo and its environments, and URDFs of other robots."""

import dataclasses
import os
import signal
from collections.abc import Callable
from pathlib import Path

# Before JAX is imported, which sets it otherwise: XLA's messages would fill the output.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
# Tests compile much and compute little: twice as fast without most of the compiler's optimizations.
# Programs that tests start inherit this, but for one of tests/identify/test_identify.py.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")

import jax
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.learn.devices import set_up_devices
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.tasks import sprint

# Tests send Ctrl-C, which a shell without job control has the commands in its background ignore.
signal.signal(signal.SIGINT, signal.default_int_handler)

# So that what is shared between devices is tested as such.
set_up_devices(2)


@pytest.fixture(scope="session")
def quadruped() -> Quadruped:
    """Return the AlienGo, read from its URDF."""
    return load_quadruped()


@pytest.fixture(scope="session")
def env(quadruped) -> QuadrupedEnv:
    """Return the AlienGo's environment of the task `sprint`, in episodes of 0.1 s."""
    return QuadrupedEnv(quadruped, dataclasses.replace(sprint.TASK.env, episode_seconds=0.1))


@pytest.fixture(scope="session")
def reset(env):
    """Return the compiled reset: seed -> a batch of four fresh states."""
    compiled = jax.jit(jax.vmap(env.reset))
    return lambda seed: compiled(jax.random.split(jax.random.PRNGKey(seed), 4))


@pytest.fixture(scope="session")
def step(env):
    """Return the compiled step of a batch: (states, actions (n, 12)) -> states."""
    return jax.jit(jax.vmap(env.step))


@pytest.fixture(scope="session")
def same_result() -> Callable[..., None]:
    """Return a function that asserts that two runs' folders have equal metrics and policies.

    Without `best` their best policies may differ.
    """

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


FOLDER = os.environ.get("QUADWALK_REFERENCE_URDFS")
URDFS = sorted(Path(FOLDER).glob("*.urdf")) if FOLDER else []
MISSING = pytest.mark.skip(reason="QUADWALK_REFERENCE_URDFS names no folder of URDFs")


@pytest.fixture(
    params=URDFS or [pytest.param(None, marks=MISSING)],
    ids=lambda file: file and file.stem,
)
def reference_urdf(request) -> Path:
    """Return each URDF in the folder QUADWALK_REFERENCE_URDFS in turn; skip the test without it."""
    return request.param
