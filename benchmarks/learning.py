"""What a training step costs: collecting, learning, the rest; and beside another commit's.

    python benchmarks/learning.py [--task sprint] [--against COMMIT] [--rounds 5] [--envs 2048]
        [--other-python PATH] [--processor-time]

Trains a task in iterations, in turn with the other commit's code, in a process of its
own each; what counts is the median of the ratios, since a machine's speed drifts. Costs are in
microseconds of a core for one control step of one environment. Physics alone is the control steps
of `collect` without policy, reward and fresh starts, from standing robots with random targets.

The other commit has the packages of its own lock, in an environment that is made once and kept, or
that of PATH. On a machine that others use too, --processor-time counts what the cores spent on it,
not what they waited: it is steady there.
"""

import argparse
import contextlib
import hashlib
import importlib
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import platformdirs
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parent.parent
ITERATIONS = 8  # in a round


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--task", default="sprint", help="one that the package comes with")
    parser.add_argument("--against", help="the commit to compare with")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--other-python", help="one with that commit's packages")
    parser.add_argument("--processor-time", action="store_true", help="for a busy machine")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work(options.task, options.envs, options.processor_time)
        return
    from quadwalk.tasks import list_tasks

    if options.task not in list_tasks():
        parser.error(f"no task {options.task!r}; expected one of: {', '.join(list_tasks())}")
    with contextlib.ExitStack() as stack:
        arguments = [f"--task={options.task}", f"--envs={options.envs}"]
        arguments += ["--processor-time"] * options.processor_time
        workers = {"this code": stack.enter_context(worker(ROOT, sys.executable, arguments))}
        if options.against:
            checkout = stack.enter_context(checked_out(options.against))
            python = options.other_python or environment_of(checkout)
            workers[options.against] = stack.enter_context(worker(checkout, python, arguments))
        rounds = [
            {name: ask(process) for name, process in workers.items()} for _ in range(options.rounds)
        ]
    some = getattr(os, "sched_getaffinity", None)  # of the cores, where the system lets choose
    cores = len(some(0)) if some else os.cpu_count() or 1
    for name in workers:
        columns = np.median([found[name] for found in rounds], axis=0)
        rest = columns[0] - columns[1] - columns[2] if columns[1] else 0.0
        labels = ("training", "collect", "learn", "physics alone", "rest")
        parts = zip(labels, [*columns, rest], strict=True)
        print(f"{name}: {cores * 1e6 / columns[0]:,.0f} training steps/s")
        for part, cost in parts:
            if cost:
                print(f"  {part:14}{cost:7.1f} us per control step and core")
    ours = np.array([found["this code"] for found in rounds])
    print(f"physics alone / training    {np.median(ours[:, 3] / ours[:, 0]):.2f}")
    if options.against:
        theirs = np.array([found[options.against] for found in rounds])
        ratio = np.median(theirs[:, 0] / ours[:, 0])
        print(f"training steps/s            {ratio:.2f} x {options.against}")


@contextlib.contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """A folder with the files of `commit`."""
    with tempfile.TemporaryDirectory() as folder:
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", folder, commit], check=True, capture_output=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run([*git, "remove", "--force", folder], check=True)


def environment_of(checkout: Path) -> str:
    """Return the Python of an environment with the packages that the lock in `checkout` names."""
    paths = (checkout / name for name in ("uv.lock", "requirements.lock"))  # the latter until 0.2
    lock = next(path for path in paths if path.exists()).read_bytes()
    if lock == (ROOT / "uv.lock").read_bytes():
        return sys.executable
    suits = tomllib.loads((checkout / "pyproject.toml").read_text())["project"]["requires-python"]
    names = [sys.executable, *(f"python3.{minor}" for minor in range(20, 9, -1))]
    python = next((name for name in names if version_of(name) in SpecifierSet(suits)), None)
    if python is None:
        sys.exit(f"error: no Python {suits} here; expected one, or --other-python PATH")
    cache = Path(platformdirs.user_cache_dir("quadwalk", appauthor=False))
    venv = cache / "environments" / hashlib.sha256(lock).hexdigest()[:12]
    make = ["make", "-C", str(checkout), f"VENV={venv}", f"PYTHON={python}", f"{venv}/.ready"]
    subprocess.run(make, check=True, stdout=sys.stderr)
    return str(venv / "bin" / "python")


def version_of(python: str) -> str:
    """The version of a Python; 0 where there is none of that name."""
    code = "import platform; print(platform.python_version())"
    try:
        done = subprocess.run([python, "-c", code], capture_output=True, text=True)
    except FileNotFoundError:
        return "0"
    return done.stdout.strip() or "0"


@contextlib.contextmanager
def worker(checkout: Path, python: str, arguments: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A process that trains with the code in `checkout`; it has compiled when it is given."""
    command = [python, __file__, "--work", *arguments]
    path = {**os.environ, "PYTHONPATH": str(checkout)}
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=path, text=True, stdin=pipe, stdout=pipe) as process:
        ask(process)
        yield process
        assert process.stdin is not None
        process.stdin.close()


def ask(process: subprocess.Popen[str]) -> list[float]:
    """A round of the worker's: what `work` prints."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return [float(x) for x in process.stdout.readline().split()]


def work(task: str, envs: int, processor_time: bool) -> None:
    """For each line read, train a round and print the costs, 0 of what cannot be distinguished."""
    clock = time.process_time if processor_time else time.perf_counter
    import dataclasses

    from quadwalk.learn.devices import choose_devices

    try:
        module = importlib.import_module(f"quadwalk.tasks.{task}")
    except ImportError:
        if task != "sprint":  # which a commit may have by its earlier name
            raise
        module = importlib.import_module("quadwalk.tasks.run")
    config, devices = choose_devices(dataclasses.replace(module.TASK, envs=envs))
    import jax

    from quadwalk.env.env import QuadrupedEnv
    from quadwalk.learn import ppo
    from quadwalk.learn.devices import make_mesh
    from quadwalk.learn.networks import make_env_networks
    from quadwalk.robot.quadruped import load_quadruped

    env = QuadrupedEnv(load_quadruped(), config.env)
    networks = make_env_networks(env, config.ppo)
    mesh = make_mesh(devices)
    state = ppo.init_state(env, networks, config.ppo, mesh, envs, 0)
    iterate = ppo.Iteration(env, networks, config.ppo, mesh, iterations=1000)
    for _ in range(4):
        state, _ = jax.block_until_ready(iterate(state))

    split = jax.sharding.PartitionSpec(ppo.AXIS)
    physics = state.workers.envs.pipeline_state.physics
    target = env.robot.home_joints + np.random.default_rng(0).normal(
        0.0, 0.1, (config.ppo.unroll, 12)
    ).astype(np.float32)

    def control_steps(physics):
        from quadwalk.physics.engines import ENGINES

        def one(physics, target):
            step = ENGINES[env.engine].step
            return jax.vmap(lambda p: step(env.model, env.stepping, p, target)[0])(physics), None

        return jax.lax.scan(one, physics, target)[0]

    alone = jax.jit(
        jax.shard_map(control_steps, mesh=mesh, in_specs=split, out_specs=split, check_vma=False)
    )
    jax.block_until_ready(alone(physics))
    share = (1 if processor_time else len(devices)) * 1e6 / (ITERATIONS * envs * config.ppo.unroll)
    for _ in sys.stdin:
        parts = [0.0, 0.0]
        began = clock()
        for _ in range(ITERATIONS):
            start = clock()
            workers, rollout, _, key = jax.block_until_ready(iterate.collect(*state))
            middle = clock()
            learner, _ = jax.block_until_ready(iterate.learn(state.learner, rollout, key))
            state = ppo.TrainState(learner, workers)
            parts = [parts[0] + middle - start, parts[1] + clock() - middle]
        whole = clock() - began
        physics = state.workers.envs.pipeline_state.physics
        began = clock()
        for _ in range(ITERATIONS):
            physics = jax.block_until_ready(alone(physics))
        costs = [whole, *parts, clock() - began]
        print(*(cost * share for cost in costs), flush=True)


if __name__ == "__main__":
    main()
