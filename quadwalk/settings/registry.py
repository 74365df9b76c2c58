"""The names by which files call the package's terms, wherever the code stands.

config.json, policies and exports hold a name of `TERMS`, such as "reward:energy". So a function
can move or be renamed: then its place here changes and its name stays. A new term of the package
has a line here. A term of a user's task file is named by file and function, "task.py:my_term".
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from quadwalk.env import actions, observations, rewards, terminations
from quadwalk.errors import UsageError, UserError
from quadwalk.task_files import TASK_FILE, get_source, is_from_task_file, run_task_file
from quadwalk.tasks import blog

TERMS: dict[str, Callable[..., Any]] = {
    "reward:forward": rewards.forward,
    "reward:fall": rewards.fall,
    "reward:yaw_error": rewards.yaw_error,
    "reward:energy": rewards.energy,
    "reward:cost_of_transport": rewards.cost_of_transport,
    "reward:alive": rewards.alive,
    "reward:lateral": rewards.lateral,
    "reward:offset": rewards.offset,
    "reward:vertical": rewards.vertical,
    "reward:tilt": rewards.tilt,
    "reward:roll_pitch_rate": rewards.roll_pitch_rate,
    "reward:action_rate": rewards.action_rate,
    "reward:joint_speed": rewards.joint_speed,
    "reward:upright": rewards.upright,
    "reward:raised": rewards.raised,
    "reward:at_home": rewards.at_home,
    "reward:crossed": rewards.crossed,
    "reward:follow": rewards.follow,
    "reward:follow_yaw_rate": rewards.follow_yaw_rate,
    "reward:track": rewards.track,
    "reward:approach": rewards.approach,
    "reward:yaw_rate_off": rewards.yaw_rate_off,
    "reward:momentary_yaw_rate_off": rewards.momentary_yaw_rate_off,
    "reward:fidget": rewards.fidget,
    "reward:legs_in_trunk": rewards.legs_in_trunk,
    "reward:drag": rewards.drag,
    "reward:slip": rewards.slip,
    "reward:slip_share": rewards.slip_share,
    "reward:short_stride": rewards.short_stride,
    "reward:swing_error": rewards.swing_error,
    "reward:crouch": rewards.crouch,
    "reward:feet_behind": rewards.feet_behind,
    "reward:flight": rewards.flight,
    "reward:kneel": rewards.kneel,
    "reward:trot": rewards.trot,
    "reward:diagonal": rewards.diagonal,
    "reward:progress": blog.progress,
    "reward:inclined": blog.inclined,
    "reward:heading": blog.heading,
    "reward:movement": blog.movement,
    "observation:velocity": observations.velocity,
    "observation:angular_velocity": observations.angular_velocity,
    "observation:gravity": observations.gravity,
    "observation:heading": observations.heading,
    "observation:offset": observations.offset,
    "observation:command": observations.command,
    "observation:trot_clock": observations.trot_clock,
    "observation:joint_pos": observations.joint_positions,
    "observation:joint_vel": observations.joint_velocities,
    "observation:last_action": observations.last_action,
    "observation:height": observations.height,
    "observation:height_scan": observations.height_scan,
    "observation:scan_ahead": observations.scan_ahead,
    "observation:contacts": observations.contacts,
    "observation:strides": observations.strides,
    "observation:mean_yaw_rate_error": observations.mean_yaw_rate_error,
    "observation:body": observations.body,
    "observation:conditions": observations.conditions,
    "observation:world_position": blog.world_position,
    "observation:world_orientation": blog.world_orientation,
    "observation:world_velocity": blog.world_velocity,
    "observation:world_angular_velocity": blog.world_angular_velocity,
    "observation:joint_angles": blog.joint_angles,
    "termination:tipped": terminations.tipped,
    "termination:low": terminations.low,
    "termination:touched": terminations.touched,
    "termination:trunk_touched": terminations.trunk_touched,
    "termination:rolled_or_pitched": blog.rolled_or_pitched,
    "termination:below": blog.below,
    "action:about_home": actions.about_home,
    "action:feet_alike": actions.feet_alike,
    "action:about_standard": actions.about_standard,
    "action:between_bounds": blog.between_bounds,
}
# Names in files of earlier versions: of a whole module, or of a single term, which goes first.
ALIASES = {
    "quadwalk.task.reward": "reward",
    "quadwalk.task.observation": "observation",
    "quadwalk.task.termination": "termination",
    "quadwalk.task.actions": "action",
    "quadwalk.task.observation:joint_positions": "observation:joint_pos",
    "quadwalk.task.observation:joint_velocities": "observation:joint_vel",
    "quadwalk.tasks.blog:progress": "reward:progress",
    "quadwalk.tasks.blog:inclined": "reward:inclined",
    "quadwalk.tasks.blog:heading": "reward:heading",
    "quadwalk.tasks.blog:movement": "reward:movement",
    "quadwalk.tasks.blog:world_position": "observation:world_position",
    "quadwalk.tasks.blog:world_orientation": "observation:world_orientation",
    "quadwalk.tasks.blog:world_velocity": "observation:world_velocity",
    "quadwalk.tasks.blog:world_angular_velocity": "observation:world_angular_velocity",
    "quadwalk.tasks.blog:joint_angles": "observation:joint_angles",
    "quadwalk.tasks.blog:rolled_or_pitched": "termination:rolled_or_pitched",
    "quadwalk.tasks.blog:below": "termination:below",
    "quadwalk.tasks.blog:between_bounds": "action:between_bounds",
}
_NAMES = {function: name for name, function in TERMS.items()}


def get_term_name(function: Callable[..., Any]) -> str:
    """Return the name that stands for a term's function in files.

    Raises `UsageError` if the function could not be found again by a name.
    """
    if function in _NAMES:
        return _NAMES[function]
    name = function.__qualname__
    if is_from_task_file(function) and name.isidentifier():
        return f"{TASK_FILE}:{name}"
    raise UsageError(
        f"the function {name} of a term is defined in {function.__module__}; expected one of the "
        "terms in quadwalk/settings/registry.py or, by a name of its own, one in a task's file, so "
        "that the run can be evaluated and resumed"
    )


def find_term(name: str, folder: Path) -> Callable[..., Any]:
    """Return the function that `name` stands for in a file of this or an earlier version.

    A function of a user's task file is read from the copy in `folder`, that of the run. Raises
    `UserError` if there is no such function.
    """
    module, _, function_name = name.partition(":")
    if module == TASK_FILE:
        function = getattr(run_task_file(folder / TASK_FILE), function_name, None)
        if not callable(function):
            raise UserError(f"{module} has no function {function_name!r} (any more)")
        return function
    term = TERMS.get(to_current_name(name))
    if term is None:
        raise UserError(f"{name!r} is no term of this version of quadwalk or of {TASK_FILE}")
    return term


def to_current_name(name: str) -> str:
    """Return the name that a term has in this version, from its name in a file of any version."""
    module, _, function = name.partition(":")
    if name in ALIASES:
        return ALIASES[name]
    return f"{ALIASES[module]}:{function}" if module in ALIASES else name


def get_task_source(functions: Iterable[Callable[..., Any]]) -> bytes | None:
    """Return the task file that defines some of the functions; None if none does."""
    sources = {get_source(function) for function in functions if is_from_task_file(function)}
    if len(sources) > 1:
        raise UsageError("the task has functions of several files; expected one")
    return sources.pop() if sources else None
