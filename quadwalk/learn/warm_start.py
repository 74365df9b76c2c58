"""A training that begins with another run's networks: for another robot, reward or ground."""

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import NestedMeanStd, RunningStatisticsState, UInt64
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.observations import last_action
from quadwalk.errors import UserError
from quadwalk.learn.networks import (
    Basis,
    Networks,
    divisors,
    networks_for,
    plain,
    structured,
)
from quadwalk.learn.ppo import Learner
from quadwalk.robot.load import load_robot
from quadwalk.robot.mirror import NotSymmetric, RobotMirror, compute_home_axes, make_mirror
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run, find_latest_checkpoint
from quadwalk.runs.policy import collect_layers, read_policy
from quadwalk.runs.resume import read_config
from quadwalk.settings.training import TrainConfig

KNOWN = 8  # iterations for which the source's statistics count: another robot's soon outweigh them
NAMED = 6  # observations that a note names, at most
CRITIC = "critic "  # what the names of those begin with that the value network alone sees


def begun_from(
    source: Run, config: TrainConfig, env: QuadrupedEnv, networks: Networks, learner: Learner
) -> tuple[Learner, list[str]]:
    """`learner` with the networks of a run's newest checkpoint, and notes on what differs.

    Observations are matched by name, those of joints by the joint's place and the way it turns, and
    legs whose knees point the other way move their feet alike. One that is new has weights of zero,
    so that the policy acts as it did. Actions are as random as at a start. Of a run without a
    checkpoint it is the policy alone. Raises a `UserError` in one line for networks that cannot be
    taken over.
    """
    notes: list[str] = []
    path = find_latest_checkpoint(source, notes.append)
    if path is None and not source.policy.exists():
        raise UserError(f"--init: {source.path} has no checkpoint; expected a run that was saved")
    theirs = read_policy(source.policy).config if path is None else read_config(source)
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
    found, statistics = _read(source, path, before)
    names, known = _names(env), _names(there)
    # A policy alone has seen the first of them.
    places = {name: place for place, name in enumerate(list(known)[: len(statistics.mean)])}
    rows = np.array([places.get(name, -1) for name in names])
    seen, actions = _turned(env, there, list(names))
    size, spread = networks.seen.size, np.asarray(divisors(statistics))[rows]
    policy = _taken(found["policy"], rows[:size], seen[:size, :size], spread[:size])
    last = policy["params"][f"hidden_{len(config.ppo.hidden)}"]
    # Raw standard deviations of 0 are those of a start. Go1 from an AlienGo's `run`, 1.2 million
    # steps, two seeds: 4.5 and 4.8 m/s; with the source's own 4.1 and 4.1, with half a start's 4.5.
    for name, own in last.items():
        means = np.split(np.asarray(own), 2, axis=-1)[0] @ np.linalg.inv(actions).T
        last[name] = np.float32(np.concatenate([means, np.zeros_like(means)], axis=-1))
    params = learner.params.replace(policy=structured(policy, networks.seen, networks.outputs))
    if "value" in found:
        value = _taken(found["value"], rows, seen, spread)
        params = params.replace(value=structured(value, networks.whole, _of_value(networks)))
    else:
        notes.append(f"--init: {source.path} has a policy alone: the value network is a new one")
    assert config.envs is not None
    count = KNOWN * config.envs * config.ppo.unroll
    normalizer = _statistics(learner.normalizer, statistics, rows, seen, count)
    new = [own for name, own in names.items() if name not in known]
    gone = [own for name, own in known.items() if name not in names]
    notes += [f"--init: {_listed(new)} new to these networks"] if new else []
    notes += [f"--init: {_listed(gone)} no longer seen"] if gone else []
    return learner._replace(params=params, normalizer=normalizer), notes


def _read(
    source: Run, path: Path | None, networks: Networks
) -> tuple[dict[str, Any], NestedMeanStd]:
    """The plain networks in a checkpoint, or in the run's policy file, and their statistics."""
    if path is None:
        leaves, _ = checkpoint.load(source.policy, "policy")
        found = {"policy": {"params": collect_layers(leaves, "policy/params/")}}
        place = "normalizer"
    else:
        leaves, _ = checkpoint.load(path, "checkpoint")
        policy, value = (
            {"params": collect_layers(leaves, f"learner/params/{name}/params/")}
            for name in ("policy", "value")
        )
        found = {
            "policy": plain(policy, networks.seen, networks.outputs),
            "value": plain(value, networks.whole, _of_value(networks)),
        }
        place = "learner/normalizer"
    return found, NestedMeanStd(leaves[f"{place}/mean"], leaves[f"{place}/std"])


def _of_value(networks: Networks) -> Basis:
    """The basis of a value network's output: a number that the mirror keeps."""
    return Basis(1, None if networks.whole.mirror is None else make_mirror([0], [1]))


def _names(env: QuadrupedEnv) -> dict[str, str]:
    """What networks see by its name with joints' places: its name, a critic's "critic ..."."""
    places = {joint: f"joint{place}" for place, joint in enumerate(env.quadruped.joints)}

    def placed(name: str) -> str:
        own, bracket, ago = name.partition("[")
        # One joint's name may be the end of another's.
        joint = max((j for j in places if own.endswith(f"_{j}")), key=len, default=None)
        return own.removesuffix(joint) + places[joint] + bracket + ago if joint else name

    names = *env.sensors.names, *(CRITIC + name for name in env.sensors.critic_names)
    return {placed(name): name for name in names}


def _turned(
    env: QuadrupedEnv, there: QuadrupedEnv, names: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """What observations (n, n) and actions (12, 12) in `env` are `there`, as matrices.

    A joint's change their signs where its axis points the other way, in the standing pose. Where a
    knee does, the thigh's are more by the calf's, and the calf's change their signs: then foot and
    trunk move alike, exactly so for a thigh as long as its calf. Small actions move the joints'
    targets as far as there.
    """
    axes, others = (compute_home_axes(e.quadruped, e.mj_model) for e in (env, there))
    turned = np.where(np.sum(axes * others, axis=1) < 0.0, -1.0, 1.0)
    observations, actions = map(np.diag, _signs(env, turned))
    rows = {name: row for row, name in enumerate(names)}
    for leg in np.flatnonzero(env.robot.knees_ahead != there.robot.knees_ahead).tolist():
        thigh, calf = 3 * leg + 1, 3 * leg + 2
        bend = np.sign(others[thigh] @ others[calf])
        _turn(actions, thigh, calf, bend)
        for name, row in rows.items():
            partner = rows.get(re.sub(rf"joint{thigh}(?=\[|$)", f"joint{calf}", name), row)
            if partner != row:
                _turn(observations, row, partner, bend)
    actions = actions * _reach(env) / _reach(there)[:, None]
    terms = {**env.config.observation, **env.config.critic}
    acted = {f"{name}_joint0" for name, term in terms.items() if term.function is last_action}
    for name in names:
        if name.removeprefix(CRITIC).partition("[")[0] in acted:
            own_rows = [rows[name.replace("joint0", f"joint{joint}")] for joint in range(12)]
            observations[np.ix_(own_rows, own_rows)] = actions
    return observations, actions


def _signs(env: QuadrupedEnv, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signs, 1 or -1, of observations (n,) and actions (12,) where joints have those of `turned`.

    What changes its sign with its joint: so terms say how they mirror.
    """
    if np.all(turned > 0.0):
        return np.ones(env.observation_size), turned
    feet = make_mirror(np.arange(4), np.ones(4))
    try:
        signs, usual = (
            env.sensors.find_mirrors(RobotMirror(make_mirror(np.arange(12), own), feet))
            for own in (turned, np.ones(12))
        )
    except NotSymmetric as error:
        joint = env.quadruped.joints[int(np.argmin(turned))]
        raise UserError(f"--init: {joint!r} turns the other way in that run, and {error}") from None
    return signs.observation.sign * usual.observation.sign, signs.action.sign * usual.action.sign


def _turn(matrix: np.ndarray, thigh: int, calf: int, bend: float) -> None:
    """Turn the knee of these rows of `matrix` to the other side of its leg."""
    matrix[thigh] += bend * matrix[calf]
    matrix[calf] *= -1.0


def _reach(env: QuadrupedEnv) -> np.ndarray:
    """(12,) rad, how far actions of 1 move joints' targets, by small ones either way from 0.

    Of a joint that stands at a limit it is the way that is left; 1 where none moves it.
    """
    action, home = 0.1, jnp.asarray(env.robot.home_joints, jnp.float32)
    none, more, less = (
        np.asarray(env.config.action(env.robot, jnp.full(12, own), home))
        for own in (0.0, action, -action)
    )
    moved = np.maximum(np.abs(more - none), np.abs(less - none))
    return np.where(moved > 0.0, moved / action, 1.0)


def _taken(params: Any, rows: np.ndarray, seen: np.ndarray, spread: np.ndarray) -> Any:
    """Plain weights of inputs that `seen` (n, n) makes of one's own, once `rows` of the source.

    A row of -1 is new. Inputs are divided by their `spread` (n,), one's own by the same.
    """
    layers = {name: dict(layer) for name, layer in params["params"].items()}
    kernel = np.where(rows[:, None] < 0, 0.0, np.asarray(layers["hidden_0"]["kernel"])[rows])
    layers["hidden_0"]["kernel"] = np.float32((seen * spread / spread[:, None]).T @ kernel)
    return {"params": layers}


def _statistics(
    like: RunningStatisticsState,
    known: NestedMeanStd,
    rows: np.ndarray,
    seen: np.ndarray,
    count: int,
) -> RunningStatisticsState:
    """Those of `known`, as of `count` observations.

    What is new, of weight 0, has been constant in them: its spread then is that of what follows,
    whatever its unit, to a factor that goes to 1.
    """
    std = np.where(rows < 0, 1.0, known.std[rows])
    found = like.replace(
        count=UInt64(hi=np.uint32(0), lo=np.uint32(count)),
        mean=np.linalg.solve(seen, np.where(rows < 0, 0.0, known.mean[rows])),
        std=std,
        summed_variance=count * np.where(rows < 0, 0.0, std) ** 2,
    )
    return jax.tree.map(lambda new, old: np.asarray(new, old.dtype), found, like)


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}: {'is' if len(names) == 1 else 'are'}"
