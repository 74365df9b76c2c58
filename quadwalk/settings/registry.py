"""The names by which files call the package's terms, wherever the code stands.

config.json, policies and exports hold a name of `TERMS`, such as "reward:energy". So a function
can move or be renamed: then its place here changes and its name stays. A new term of the package
has a line here; a term of a user's task file is named by file and function and has none.
"""

# The module and function of each term.
TERMS = {
    "reward:forward": "quadwalk.task.reward:forward",
    "reward:fall": "quadwalk.task.reward:fall",
    "reward:yaw_error": "quadwalk.task.reward:yaw_error",
    "reward:energy": "quadwalk.task.reward:energy",
    "reward:alive": "quadwalk.task.reward:alive",
    "reward:lateral": "quadwalk.task.reward:lateral",
    "reward:offset": "quadwalk.task.reward:offset",
    "reward:vertical": "quadwalk.task.reward:vertical",
    "reward:tilt": "quadwalk.task.reward:tilt",
    "reward:roll_pitch_rate": "quadwalk.task.reward:roll_pitch_rate",
    "reward:action_rate": "quadwalk.task.reward:action_rate",
    "reward:joint_speed": "quadwalk.task.reward:joint_speed",
    "reward:upright": "quadwalk.task.reward:upright",
    "reward:raised": "quadwalk.task.reward:raised",
    "reward:at_home": "quadwalk.task.reward:at_home",
    "reward:crossed": "quadwalk.task.reward:crossed",
    "reward:follow": "quadwalk.task.reward:follow",
    "reward:follow_yaw_rate": "quadwalk.task.reward:follow_yaw_rate",
    "reward:track": "quadwalk.task.reward:track",
    "reward:approach": "quadwalk.task.reward:approach",
    "reward:yaw_rate_off": "quadwalk.task.reward:yaw_rate_off",
    "reward:fidget": "quadwalk.task.reward:fidget",
    "reward:drag": "quadwalk.task.reward:drag",
    "reward:kneel": "quadwalk.task.reward:kneel",
    "reward:trot": "quadwalk.task.reward:trot",
    "reward:diagonal": "quadwalk.task.reward:diagonal",
    "reward:progress": "quadwalk.tasks.blog:progress",
    "reward:inclined": "quadwalk.tasks.blog:inclined",
    "reward:heading": "quadwalk.tasks.blog:heading",
    "reward:movement": "quadwalk.tasks.blog:movement",
    "observation:velocity": "quadwalk.task.observation:velocity",
    "observation:angular_velocity": "quadwalk.task.observation:angular_velocity",
    "observation:gravity": "quadwalk.task.observation:gravity",
    "observation:heading": "quadwalk.task.observation:heading",
    "observation:offset": "quadwalk.task.observation:offset",
    "observation:command": "quadwalk.task.observation:command",
    "observation:trot_clock": "quadwalk.task.observation:trot_clock",
    "observation:joint_pos": "quadwalk.task.observation:joint_positions",
    "observation:joint_vel": "quadwalk.task.observation:joint_velocities",
    "observation:last_action": "quadwalk.task.observation:last_action",
    "observation:height": "quadwalk.task.observation:height",
    "observation:height_scan": "quadwalk.task.observation:height_scan",
    "observation:scan_ahead": "quadwalk.task.observation:scan_ahead",
    "observation:contacts": "quadwalk.task.observation:contacts",
    "observation:conditions": "quadwalk.task.observation:conditions",
    "observation:world_position": "quadwalk.tasks.blog:world_position",
    "observation:world_orientation": "quadwalk.tasks.blog:world_orientation",
    "observation:world_velocity": "quadwalk.tasks.blog:world_velocity",
    "observation:world_angular_velocity": "quadwalk.tasks.blog:world_angular_velocity",
    "observation:joint_angles": "quadwalk.tasks.blog:joint_angles",
    "termination:tipped": "quadwalk.task.termination:tipped",
    "termination:low": "quadwalk.task.termination:low",
    "termination:touched": "quadwalk.task.termination:touched",
    "termination:trunk_touched": "quadwalk.task.termination:trunk_touched",
    "termination:rolled_or_pitched": "quadwalk.tasks.blog:rolled_or_pitched",
    "termination:below": "quadwalk.tasks.blog:below",
    "action:about_home": "quadwalk.task.actions:about_home",
    "action:feet_alike": "quadwalk.task.actions:feet_alike",
    "action:between_bounds": "quadwalk.tasks.blog:between_bounds",
}
# What files of before call a term: those of a whole module, or a single one, which goes first.
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
_NAMES = {place: name for name, place in TERMS.items()}


def find_registered_name(place: str) -> str | None:
    """Return the name of the term at a place, "module:function"; None where there is none."""
    return _NAMES.get(place)


def to_current_name(name: str) -> str:
    """Return the name that a term has today, of the name in a file of any version."""
    module, _, function = name.partition(":")
    if name in ALIASES:
        return ALIASES[name]
    return f"{ALIASES[module]}:{function}" if module in ALIASES else name
