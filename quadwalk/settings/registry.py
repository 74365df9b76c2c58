"""The names by which files call the package's terms, wherever the code stands.

config.json, policies and exports hold a name of `TERMS`, such as "reward:energy". So a function
can move or be renamed: then its place here changes and its name stays. A new term of the package
has a line here; a term of a user's task file is named by file and function and has none.
"""

# The module and function of each term.
TERMS = {
    "reward:forward": "quadwalk.env.rewards:forward",
    "reward:fall": "quadwalk.env.rewards:fall",
    "reward:yaw_error": "quadwalk.env.rewards:yaw_error",
    "reward:energy": "quadwalk.env.rewards:energy",
    "reward:alive": "quadwalk.env.rewards:alive",
    "reward:lateral": "quadwalk.env.rewards:lateral",
    "reward:offset": "quadwalk.env.rewards:offset",
    "reward:vertical": "quadwalk.env.rewards:vertical",
    "reward:tilt": "quadwalk.env.rewards:tilt",
    "reward:roll_pitch_rate": "quadwalk.env.rewards:roll_pitch_rate",
    "reward:action_rate": "quadwalk.env.rewards:action_rate",
    "reward:joint_speed": "quadwalk.env.rewards:joint_speed",
    "reward:upright": "quadwalk.env.rewards:upright",
    "reward:raised": "quadwalk.env.rewards:raised",
    "reward:at_home": "quadwalk.env.rewards:at_home",
    "reward:crossed": "quadwalk.env.rewards:crossed",
    "reward:follow": "quadwalk.env.rewards:follow",
    "reward:follow_yaw_rate": "quadwalk.env.rewards:follow_yaw_rate",
    "reward:track": "quadwalk.env.rewards:track",
    "reward:approach": "quadwalk.env.rewards:approach",
    "reward:yaw_rate_off": "quadwalk.env.rewards:yaw_rate_off",
    "reward:fidget": "quadwalk.env.rewards:fidget",
    "reward:drag": "quadwalk.env.rewards:drag",
    "reward:kneel": "quadwalk.env.rewards:kneel",
    "reward:trot": "quadwalk.env.rewards:trot",
    "reward:diagonal": "quadwalk.env.rewards:diagonal",
    "reward:progress": "quadwalk.tasks.blog:progress",
    "reward:inclined": "quadwalk.tasks.blog:inclined",
    "reward:heading": "quadwalk.tasks.blog:heading",
    "reward:movement": "quadwalk.tasks.blog:movement",
    "observation:velocity": "quadwalk.env.observations:velocity",
    "observation:angular_velocity": "quadwalk.env.observations:angular_velocity",
    "observation:gravity": "quadwalk.env.observations:gravity",
    "observation:heading": "quadwalk.env.observations:heading",
    "observation:offset": "quadwalk.env.observations:offset",
    "observation:command": "quadwalk.env.observations:command",
    "observation:trot_clock": "quadwalk.env.observations:trot_clock",
    "observation:joint_pos": "quadwalk.env.observations:joint_positions",
    "observation:joint_vel": "quadwalk.env.observations:joint_velocities",
    "observation:last_action": "quadwalk.env.observations:last_action",
    "observation:height": "quadwalk.env.observations:height",
    "observation:height_scan": "quadwalk.env.observations:height_scan",
    "observation:scan_ahead": "quadwalk.env.observations:scan_ahead",
    "observation:contacts": "quadwalk.env.observations:contacts",
    "observation:conditions": "quadwalk.env.observations:conditions",
    "observation:world_position": "quadwalk.tasks.blog:world_position",
    "observation:world_orientation": "quadwalk.tasks.blog:world_orientation",
    "observation:world_velocity": "quadwalk.tasks.blog:world_velocity",
    "observation:world_angular_velocity": "quadwalk.tasks.blog:world_angular_velocity",
    "observation:joint_angles": "quadwalk.tasks.blog:joint_angles",
    "termination:tipped": "quadwalk.env.terminations:tipped",
    "termination:low": "quadwalk.env.terminations:low",
    "termination:touched": "quadwalk.env.terminations:touched",
    "termination:trunk_touched": "quadwalk.env.terminations:trunk_touched",
    "termination:rolled_or_pitched": "quadwalk.tasks.blog:rolled_or_pitched",
    "termination:below": "quadwalk.tasks.blog:below",
    "action:about_home": "quadwalk.env.actions:about_home",
    "action:feet_alike": "quadwalk.env.actions:feet_alike",
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
