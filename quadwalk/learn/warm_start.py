"""A training that starts with another run's networks: for another robot, reward or terrain."""

import re
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import NestedMeanStd, RunningStatisticsState, UInt64
from quadwalk.env.actions import about_home
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.observations import last_action
from quadwalk.errors import UserError
from quadwalk.learn.distribution import compute_raw_std
from quadwalk.learn.networks import Networks, make_env_networks
from quadwalk.learn.one_robot import (
    change_actions,
    join_translations,
    make_one_robot_config,
    to_one_robot,
    translate_actions,
    translate_observations,
)
from quadwalk.learn.ppo import Learner
from quadwalk.learn.statistics import compute_scale
from quadwalk.learn.symmetric import to_symmetric
from quadwalk.robot.load import load_robot
from quadwalk.robot.mirror import NotSymmetric, RobotMirror, compute_home_axes, make_mirror
from quadwalk.runs.directory import Run
from quadwalk.runs.policy import read_policy
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.terms import ActionMap
from quadwalk.settings.training import TrainConfig

COUNTED = 8  # iterations for which the source's statistics count: new ones soon outweigh them
LISTED = 6  # observations that a note names, at most
# Share of a start's standard deviation, for a policy of the same task. With all of it Go2 falls in
# 50 to 80 % of the episodes of its first million steps, from the AlienGo's `drive` or `universal`.
KNOWN_NOISE = 0.5
CRITIC = "critic "  # before the names of observations that the value network alone sees


def warm_start_from(
    source: Run, config: TrainConfig, env: QuadrupedEnv, networks: Networks, learner: Learner
) -> tuple[Learner, list[str]]:
    """Return `learner` with the networks of a run's newest policy, and notes on differences.

    Observations are matched by name, those of joints by the joint's place and the way it turns.
    Legs whose knees point the other way move their feet alike. Networks of many bodies become those
    of this robot. A new observation has weights of zero, so that the policy acts as it did. Actions
    are as random as at a start, and in the same task `KNOWN_NOISE` of that. Raises a
    `UserError` for networks that cannot be taken over.
    """
    notes: list[str] = []
    if not source.policy.exists():
        raise UserError(f"--init: {source.path} has no policy; expected a run that was saved")
    saved = read_policy(source.policy)
    source_config = saved.config
    for name in ("hidden", "activation"):
        value, source_value = getattr(config.ppo, name), getattr(source_config.ppo, name)
        if value != source_value:
            raise UserError(
                f"--init: {source.path} has --ppo.{name} {source_value}; here it is {value}"
            )
    source_env = QuadrupedEnv(load_robot(source_config.robot), source_config.env)
    source_networks = make_env_networks(source_env, source_config.ppo)
    if source_networks.critic_obs.mirror is None and networks.critic_obs.mirror is not None:
        raise UserError(
            f"--init: {source.path} has networks that are not symmetric; expected "
            "--ppo.no-symmetric as well"
        )
    plain, statistics = {"policy": saved.weights}, saved.statistics
    if saved.value is not None:
        plain["value"], statistics = saved.value.weights, saved.value.statistics
    is_of_many = source_config.env.unit_leg is not None and config.env.unit_leg is None
    if is_of_many:
        source_env, plain, statistics = take_robot(env, source_config.env, plain, statistics)
    names, source_names = name_observations(env), name_observations(source_env)
    # Without a value network the statistics are those of the policy's observations, the first.
    columns = {name: i for i, name in enumerate(list(source_names)[: len(statistics.mean)])}
    rows = np.array([columns.get(name, -1) for name in names])
    turn, turn_action = compute_turns(env, source_env, list(names))
    scale = np.asarray(compute_scale(statistics))[rows]
    size = networks.policy_obs.size
    policy = change_inputs(plain["policy"], rows[:size], turn[:size, :size], scale[:size])
    output_layer = policy["params"][f"hidden_{len(config.ppo.hidden)}"]
    # Raw standard deviations of 0 are those of a start. Go1 from an AlienGo's `run`, 1.2 million
    # steps, two seeds: 4.5 and 4.8 m/s; with the source's own 4.1 and 4.1, with half a start's 4.5.
    raw_stds = {"kernel": 0.0, "bias": 0.0}
    if is_of_many or source_config.task == config.task:
        raw_stds["bias"] = compute_raw_std(KNOWN_NOISE)
    for name, weights in output_layer.items():
        means = np.split(np.asarray(weights), 2, axis=-1)[0] @ np.linalg.inv(turn_action).T
        stds = np.full_like(means, raw_stds[name])
        output_layer[name] = np.float32(np.concatenate([means, stds], axis=-1))
    params = learner.params._replace(
        policy=to_symmetric(policy, networks.policy_obs, networks.outputs)
    )
    if "value" in plain:
        value = change_inputs(plain["value"], rows, turn, scale)
        params = params._replace(
            value=to_symmetric(value, networks.critic_obs, networks.value_output)
        )
    else:
        notes.append(f"--init: {source.policy} has no value network: a new one is trained")
    assert config.envs is not None
    count = COUNTED * config.envs * config.ppo.unroll
    normalizer = change_statistics(learner.normalizer, statistics, rows, turn, count)
    for label, only, others in (
        ("new to these networks", names, source_names),
        ("no longer seen", source_names, names),
    ):
        missing = [name for place, name in only.items() if place not in others]
        if missing:
            notes.append(f"--init: {format_names(missing)} {label}")
    return learner._replace(params=params, normalizer=normalizer), notes


def take_robot(
    env: QuadrupedEnv, config: EnvConfig, plain: dict[str, Any], statistics: NestedMeanStd
) -> tuple[QuadrupedEnv, dict[str, Any], NestedMeanStd]:
    """Return networks of many bodies, with the task `config`, as those of the robot of `env` alone.

    The environment that they are of then moves that robot's own joints. Where a knee is ahead, only
    small actions do the same.
    """
    many = QuadrupedEnv(env.quadruped, config)
    action = ActionMap(about_home, config.action.params)
    one = QuadrupedEnv(env.quadruped, replace(make_one_robot_config(config), action=action))
    observation = translate_observations(many, one, "observation")
    policy, policy_statistics = to_one_robot(
        plain["policy"], jax.tree.map(lambda x: x[: many.policy_size], statistics), observation
    )
    actions = np.linalg.inv(translate_actions(many, one))
    networks = {"policy": change_actions(policy, actions)}
    if "value" not in plain:
        return one, networks, policy_statistics
    both = join_translations(observation, translate_observations(many, one, "critic"))
    networks["value"], statistics = to_one_robot(plain["value"], statistics, both)
    return one, networks, statistics


def name_observations(env: QuadrupedEnv) -> dict[str, str]:
    """Return the names of an observation's numbers, by names with the joint's place for its name.

    A number that only the value network sees has a name that begins with "critic".
    """
    places = {joint: f"joint{place}" for place, joint in enumerate(env.quadruped.joints)}

    def place_joint(name: str) -> str:
        number, bracket, ago = name.partition("[")
        # One joint's name may be the end of another's.
        joint = max((j for j in places if number.endswith(f"_{j}")), key=len, default=None)
        return number.removesuffix(joint) + places[joint] + bracket + ago if joint else name

    names = *env.sensors.names, *(CRITIC + name for name in env.sensors.critic_names)
    return {place_joint(name): name for name in names}


def compute_turns(
    env: QuadrupedEnv, source_env: QuadrupedEnv, names: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return matrices from observations (n, n) and actions (12, 12) to those of the source.

    Where a joint's axis points the other way in the standing pose, its numbers change their signs.
    Where a knee does, the calf's are added to the thigh's, and the calf's change their signs. Then
    foot and trunk move alike, exactly so for a thigh as long as its calf. Small actions move the
    joints' targets as far as in the source.
    """
    axes, knees_ahead = find_joint_directions(env)
    source_axes, source_knees_ahead = find_joint_directions(source_env)
    joint_signs = np.where(np.sum(axes * source_axes, axis=1) < 0.0, -1.0, 1.0)
    observations, actions = map(np.diag, compute_signs(env, joint_signs))
    rows = {name: row for row, name in enumerate(names)}
    for leg in np.flatnonzero(knees_ahead != source_knees_ahead).tolist():
        thigh, calf = 3 * leg + 1, 3 * leg + 2
        bend = np.sign(source_axes[thigh] @ source_axes[calf])
        pairs = [
            (row, rows.get(re.sub(rf"joint{thigh}(?=\[|$)", f"joint{calf}", name), row))
            for name, row in rows.items()
        ]
        for matrix, turned in ((actions, [(thigh, calf)]), (observations, pairs)):
            for thigh_row, calf_row in turned:
                if thigh_row != calf_row:
                    matrix[thigh_row] += bend * matrix[calf_row]
                    matrix[calf_row] *= -1.0
    actions = actions * measure_reach(env) / measure_reach(source_env)[:, None]
    terms = {**env.config.observation, **env.config.critic}
    acted = {f"{name}_joint0" for name, term in terms.items() if term.function is last_action}
    for name in names:
        if name.removeprefix(CRITIC).partition("[")[0] in acted:
            joints = [rows[name.replace("joint0", f"joint{joint}")] for joint in range(12)]
            observations[np.ix_(joints, joints)] = actions
    return observations, actions


def find_joint_directions(env: QuadrupedEnv) -> tuple[np.ndarray, np.ndarray]:
    """Return the axes (12, 3) of the joints that policies speak of, and which knees are ahead (4,).

    Where `EnvConfig.unit_leg` is set, these are standard joints.
    """
    if env.config.unit_leg is not None:
        return np.tile(np.eye(3)[[0, 1, 1]], (4, 1)), np.zeros(4, bool)
    return compute_home_axes(env.quadruped, env.mj_model), np.asarray(env.robot.knees_ahead)


def compute_signs(env: QuadrupedEnv, joint_signs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the signs, 1 or -1, by which observations (n,) and actions (12,) change.

    `joint_signs` (12,) are -1 for joints that turn the other way in the source. Terms declare how
    they mirror: from that follows which of their numbers change sign with a joint.
    """
    if np.all(joint_signs > 0.0):
        return np.ones(env.observation_size), joint_signs
    feet = make_mirror(np.arange(4), np.ones(4))
    try:
        turned, usual = (
            env.sensors.find_mirrors(RobotMirror(make_mirror(np.arange(12), signs), feet))
            for signs in (joint_signs, np.ones(12))
        )
    except NotSymmetric as error:
        joint = env.quadruped.joints[int(np.argmin(joint_signs))]
        raise UserError(f"--init: {joint!r} turns the other way in that run, and {error}") from None
    return turned.observation.sign * usual.observation.sign, turned.action.sign * usual.action.sign


def measure_reach(env: QuadrupedEnv) -> np.ndarray:
    """Return how far a joint's target moves per unit of a small action, (12,), rad.

    For a joint at a limit it is the motion to the free side; 1 where no action moves it.
    """
    action, home = 0.1, jnp.asarray(env.robot.home_joints, jnp.float32)
    none, more, less = (
        np.asarray(env.config.action(env.robot, jnp.full(12, value), home))
        for value in (0.0, action, -action)
    )
    changes = [more - none, less - none]
    if env.config.unit_leg is not None:
        changes = [np.asarray(env.robot.to_standard(change)) for change in changes]
    motions = np.max(np.abs(changes), axis=0)
    return np.where(motions > 0.0, motions / action, 1.0)


def change_inputs(params: Any, rows: np.ndarray, turn: np.ndarray, scale: np.ndarray) -> Any:
    """Return the weights of a source's plain network for observations of this environment.

    `turn` (n, n) maps an observation of this environment to the source's convention. `rows` (n,)
    are then the rows of its numbers in the source's first layer, -1 for new ones, which get weights
    of 0. Both networks' inputs are divided by `scale` (n,).
    """
    layers = {name: dict(layer) for name, layer in params["params"].items()}
    kernel = np.where(rows[:, None] < 0, 0.0, np.asarray(layers["hidden_0"]["kernel"])[rows])
    layers["hidden_0"]["kernel"] = np.float32((turn * scale / scale[:, None]).T @ kernel)
    return {"params": layers}


def change_statistics(
    like: RunningStatisticsState,
    source: NestedMeanStd,
    rows: np.ndarray,
    turn: np.ndarray,
    count: int,
) -> RunningStatisticsState:
    """Return a source's statistics for observations of this environment, as if of `count`.

    `rows` and `turn` are as in `change_inputs`. A new number, whose weights are zero, counts as
    constant so far. Its deviation then is that of what follows, in any unit, to a factor that
    approaches 1.
    """
    std = np.where(rows < 0, 1.0, source.std[rows])
    statistics = like.replace(
        count=UInt64(hi=np.uint32(0), lo=np.uint32(count)),
        mean=np.linalg.solve(turn, np.where(rows < 0, 0.0, source.mean[rows])),
        std=std,
        summed_variance=count * np.where(rows < 0, 0.0, std) ** 2,
    )
    return jax.tree.map(lambda new, old: np.asarray(new, old.dtype), statistics, like)


def format_names(names: list[str]) -> str:
    """Return the beginning of a sentence: `names`, cut short, then "is" or "are"."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return f"{', '.join(names[:LISTED])}{more}: {'is' if len(names) == 1 else 'are'}"
