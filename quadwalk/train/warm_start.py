"""A training that begins with another run's networks: for another robot, reward or ground."""

from typing import Any

import jax
import numpy as np
from brax.training.acme.running_statistics import NestedMeanStd, RunningStatisticsState
from brax.training.agents.ppo.losses import PPONetworkParams
from brax.training.types import UInt64

from quadwalk.errors import UserError
from quadwalk.robot.mirror import mirror
from quadwalk.settings.training import TrainConfig
from quadwalk.task.env import QuadrupedEnv
from quadwalk.train.networks import Basis, Networks, networks_for, plain, structured
from quadwalk.train.ppo import Learner
from quadwalk.train.robot import load_robot
from quadwalk.train.runs import checkpoint
from quadwalk.train.runs.directory import Run, latest_checkpoint
from quadwalk.train.runs.resume import read_config

KNOWN = 8  # iterations for which the source's statistics count: another robot's soon outweigh them
NAMED = 6  # observations that a note names, at most


def begun_from(
    source: Run, config: TrainConfig, env: QuadrupedEnv, networks: Networks, learner: Learner
) -> tuple[Learner, list[str]]:
    """`learner` with the networks of a run's newest checkpoint, and notes on what differs.

    Observations are matched by name, those of joints by the joint's place. One that is new has
    weights of zero, so that the policy acts as it did. Actions are as random as at a start. Raises
    a `UserError` in one line for networks that cannot be taken over.
    """
    notes: list[str] = []
    path = latest_checkpoint(source, notes.append)
    if path is None:
        raise UserError(f"--init: {source.path} has no checkpoint; expected a run that was saved")
    theirs = read_config(source)
    for name in ("hidden", "activation"):
        own, other = getattr(config.ppo, name), getattr(theirs.ppo, name)
        if own != other:
            raise UserError(f"--init: {source.path} has --ppo.{name} {other}; here it is {own}")
    there = QuadrupedEnv(load_robot(theirs.robot), theirs.env)
    before = networks_for(there, theirs.ppo)
    if before.whole.mirror is None and networks.whole.mirror is not None:
        raise UserError(
            f"--init: {source.path} has networks that are not symmetric; expected "
            "--ppo.no-symmetric as well"
        )
    params, normalizer = _read(path)
    policy = plain(params.policy, before.seen, before.outputs)
    value = plain(params.value, before.whole, _of_value(before))
    names, known = _names(env), {name: place for place, name in enumerate(_names(there))}
    rows = np.array([known.get(name, -1) for name in names])
    size = networks.seen.size
    # What the policy sees comes first, and may have been the value network's alone.
    seen = np.where(rows[:size] < there.policy_size, rows[:size], -1)
    _noisy_again(policy)
    taken = PPONetworkParams(
        policy=structured(_first_rows(policy, seen), networks.seen, networks.outputs),
        value=structured(_first_rows(value, rows), networks.whole, _of_value(networks)),
    )
    assert config.envs is not None
    count = KNOWN * config.envs * config.ppo.unroll
    statistics = _statistics(learner.normalizer, normalizer, rows, count)
    new = [name for name, row in zip(names, rows, strict=True) if row < 0]
    gone = sorted(set(known) - set(names))
    notes += [f"--init: {_listed(new)} new to these networks"] if new else []
    notes += [f"--init: {_listed(gone)} no longer seen"] if gone else []
    return learner._replace(params=taken, normalizer=statistics), notes


def _read(path: Any) -> tuple[PPONetworkParams, NestedMeanStd]:
    """The networks and statistics in a checkpoint."""
    leaves, _ = checkpoint.load(path, "checkpoint")
    networks: dict[str, Any] = {"policy": {}, "value": {}}
    for name, leaf in leaves.items():
        kind, _, place = name.removeprefix("learner/params/").partition("/params/")
        if kind in networks:
            layer, _, part = place.partition("/")
            networks[kind].setdefault(layer, {})[part] = leaf
    statistics = NestedMeanStd(leaves["learner/normalizer/mean"], leaves["learner/normalizer/std"])
    return PPONetworkParams(**{k: {"params": own} for k, own in networks.items()}), statistics


def _of_value(networks: Networks) -> Basis:
    """The basis of a value network's output: a number that the mirror keeps."""
    return Basis(1, None if networks.whole.mirror is None else mirror([0], [1]))


def _names(env: QuadrupedEnv) -> list[str]:
    """The names of all that networks see, a joint's by its place, a critic's as "critic ..."."""
    places = {joint: f"joint{place}" for place, joint in enumerate(env.quadruped.joints)}

    def placed(name: str) -> str:
        own, bracket, ago = name.partition("[")
        joint = next((j for j in places if own.endswith(f"_{j}")), None)
        return own.removesuffix(joint) + places[joint] + bracket + ago if joint else name

    return [placed(n) for n in env.observation_names] + [
        f"critic {placed(n)}" for n in env.critic_names
    ]


def _noisy_again(policy: Any) -> None:
    """Let the standard deviations of a plain policy be those of a start."""
    layers = policy["params"]
    last = layers[f"hidden_{len(layers) - 1}"]
    half = len(last["bias"]) // 2
    last["kernel"] = np.array(last["kernel"])
    last["bias"] = np.array(last["bias"])
    last["kernel"][:, half:] = 0.0
    last["bias"][half:] = 0.0


def _first_rows(params: Any, rows: np.ndarray) -> Any:
    """Plain weights whose input i was `rows[i]`, or is new where that is -1."""
    layers = dict(params["params"])
    kernel = np.asarray(layers["hidden_0"]["kernel"])
    taken = np.where(rows[:, None] < 0, 0.0, kernel[rows]).astype(np.float32)
    layers["hidden_0"] = {**layers["hidden_0"], "kernel": taken}
    return {"params": layers}


def _statistics(
    like: RunningStatisticsState, known: NestedMeanStd, rows: np.ndarray, count: int
) -> RunningStatisticsState:
    """Those of `known`, as of `count` observations; of what is new, mean 0 and spread 1."""
    mean = np.where(rows < 0, 0.0, np.asarray(known.mean)[rows]).astype(np.float32)
    std = np.where(rows < 0, 1.0, np.asarray(known.std)[rows]).astype(np.float32)
    found = like.replace(
        count=UInt64(hi=np.uint32(0), lo=np.uint32(count)),
        mean=mean,
        std=std,
        summed_variance=np.float32(count) * std**2,
    )
    return jax.tree.map(lambda new, old: np.asarray(new, old.dtype), found, like)


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}: {'is' if len(names) == 1 else 'are'}"
