"""The figures of a policy for studies/results: from the files of `eval.py` and of a training.

An evaluation has hundreds of numbers. These functions choose those that pages show. Shares are in
percent, lengths of steps in m, deviations at a stand in mm.
"""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from quadwalk.evaluation.metrics import get_mean
from quadwalk.runs.directory import Run

# A held command is followed where the error of the velocity, m/s, or of the yaw rate, rad/s, is at
# most so much, and so much of the command.
BOUND, SHARE = 0.1, 0.05
DIFFICULTIES = (1 / 2, 2 / 3, 1.0)
# Metrics of episodes: those that a task does not have are left out.
COURSE = ("speed", "lateral_drift", "heading_error", "velocity_error", "yaw_rate_error")
GAIT = ("gait", "stride_frequency", "stride_length", "cost_of_transport")


def read_figures(run: Run, evaluations: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of a run's policy by kind: of its training, and of its evaluations.

    Of a kind the last of the evaluations counts.
    """
    figures: dict[str, Any] = {}
    if run.timing.exists():
        figures["training"] = read_training(run)
    for content in evaluations:
        figures |= choose_sweep(content) if "sweeps" in content else choose_metrics(content)
    return figures


def read_training(run: Run) -> dict[str, Any]:
    """Return steps, minutes, cores and steps/s of a run's training.

    The minutes are those of the iterations: start and compilation are not among them. With the
    networks of another run, whose folder is still there, `first_minutes` are those of its training.
    """
    config = json.loads(run.config.read_text())["config"]
    seconds = _read_seconds(run)
    training = {
        "steps": config["steps"],
        "minutes": round(seconds / 60, 1),
        "steps_per_second": round(config["steps"] / seconds),
        "cores": config["devices"],
    }
    first = Run(Path(config["init"])) if config["init"] else None
    if first and first.timing.exists():
        training["first_minutes"] = round(_read_seconds(first) / 60, 1)
    return training


def _read_seconds(run: Run) -> float:
    *_, last = run.timing.read_text().splitlines()
    return float(json.loads(last)["time/elapsed"])


def choose_metrics(content: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a metrics.json: of its episodes, and of each suite that it has."""
    course = choose_course(content["summary"])
    if content["randomized"]:
        figures: dict[str, Any] = {"randomized": course}
    elif content["engine"] == "mujoco":
        figures = {
            "mujoco": course,
            "gait": {name: content["typical_episode"][name] for name in GAIT},
        }
    else:
        figures = {}
    choose: dict[str, Callable[[Any], dict[str, Any]]] = {
        "gaits": choose_gaits,
        "steering": choose_steering,
        "standing": choose_standing,
        "ground": choose_ground,
    }
    return figures | {name: choose[name](content[name]) for name in choose if name in content}


def choose_course(summary: dict[str, Any]) -> dict[str, Any]:
    """Return the means over episodes, and the share without a fall, %."""
    episodes = summary["episodes"]
    means = {name: summary[name]["mean"] for name in COURSE if summary.get(name)}
    falls = round(summary["fall_rate"] * episodes)
    return {
        "episodes": episodes,
        "falls": falls,
        "no_fall": 100.0 * (1.0 - falls / episodes),
        **means,
    }


def choose_gaits(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """Return figures of feet at three speeds ahead: the lowest, about a third, the highest."""
    ahead = [row for row in rows if row["command"][0] > 0 and not any(row["command"][1:])]
    picks = [ahead[0], ahead[len(ahead) // 3], ahead[-1]]
    names = ("stride_frequency", "duty_factor", "swing_height_p10", "slip", "cost_of_transport")
    return {
        "command": [row["command"][0] for row in picks],
        **{name: [row[name] for row in picks] for name in names},
    }


def choose_steering(steering: dict[str, Any]) -> dict[str, Any]:
    """Return how well held and changing commands are followed."""
    cells = steering["cells"]
    straight = [cell for cell in cells if cell["command"][2] == 0.0]
    fastest = max(straight, key=lambda cell: cell["command"][0])
    slowest = min(straight, key=lambda cell: cell["command"][0])
    errors = [compute_error_share(cell) for cell in cells]
    worst = cells[errors.index(max(errors))]
    changing = steering["changing"]
    return {
        "commands": len(cells),
        "episodes": steering["episodes"],
        "followed": sum(error <= 1.0 for error in errors),
        "with_a_fall": sum(cell["success"] < 1.0 for cell in cells),
        "largest_error": max(errors),
        "worst": [worst["command"][0], worst["command"][2]],
        "worst_errors": [get_mean(worst["velocity_error"]), get_mean(worst["yaw_rate_error"])],
        "ahead": [fastest["command"][0], get_mean(fastest["forward"])],
        "back": [slowest["command"][0], get_mean(slowest["forward"])],
        "drift": max(math.degrees(abs(get_mean(cell["yaw_rate"]))) for cell in straight),
        "responses": [response["time"] for response in steering["responses"]],
        "stand": _choose_stand(steering["standing"]),
        "stand_without_creep": _choose_stand(steering["standing_without_creep"]),
        "changing_episodes": changing["episodes"],
        "changing": 100.0 * changing["success"],
        "changing_ci95": [100.0 * end for end in changing["success_ci95"]],
    }


def compute_error_share(cell: dict[str, Any]) -> float:
    """Return the larger of the errors of velocity and yaw rate, each relative to its bound.

    `cell` is of a held command. Infinity stands for one at which no episode lasted long enough.
    """
    forward, lateral, turn = cell["command"]
    velocity = get_mean(cell["velocity_error"]) / (BOUND + SHARE * math.hypot(forward, lateral))
    yaw_rate = get_mean(cell["yaw_rate_error"]) / (BOUND + SHARE * abs(turn))
    error = max(velocity, yaw_rate)
    return math.inf if math.isnan(error) else error


def _choose_stand(standing: dict[str, Any]) -> list[float]:
    """Return how far the trunk moves, mm: the mean of the episodes, and the most."""
    if standing["most"] is None:
        return []
    return [1e3 * standing["moved"]["mean"], 1e3 * standing["most"]]


def choose_standing(standing: dict[str, Any]) -> dict[str, Any]:
    """Return the shares that stand 2, 3 and 6 s after the start, %, by condition."""
    names = ("standing_2s", "standing_3s", "standing_6s")
    return {
        "episodes": standing["episodes"],
        "conditions": {
            condition["name"]: [100.0 * condition[name] for name in names]
            for condition in standing["conditions"]
        },
    }


def choose_ground(ground: dict[str, Any]) -> dict[str, Any]:
    """Return success, %, by kind of ground, at the difficulties nearest to `DIFFICULTIES`.

    Over all kinds there are the means of `arrived`, %, and of the velocity error, m/s.
    """
    measured = ground["difficulties"]
    difficulties = [min(measured, key=lambda x: abs(x - level)) for level in DIFFICULTIES]
    cells = {(cell["kind"], cell["difficulty"]): cell for cell in ground["cells"]}
    kinds = ground["kinds"]

    def compute_means(name: str, factor: float = 1.0) -> list[float]:
        rows = [[cells[kind, difficulty][name] for kind in kinds] for difficulty in difficulties]
        values = [[get_mean(x) if isinstance(x, dict) else x for x in row] for row in rows]
        return [factor * sum(row) / len(row) for row in values]

    return {
        "episodes": ground["episodes"],
        "difficulties": difficulties,
        "kinds": {
            kind.replace("_", " "): [
                100.0 * cells[kind, difficulty]["success"] for difficulty in difficulties
            ]
            for kind in kinds
        },
        "success": compute_means("success", 100.0),
        "arrived": compute_means("arrived", 100.0),
        "velocity_error": compute_means("velocity_error"),
    }


def choose_sweep(content: dict[str, Any]) -> dict[str, Any]:
    """Return the points of a sweep that pages name, %, and how many had a fall."""
    sweeps = content["sweeps"]
    shares = {
        name: {point["value"]: 100.0 * point["success"] for point in sweep["points"]}
        for name, sweep in sweeps.items()
    }
    points = [share for values in shares.values() for share in values.values()]
    return {
        "sweep": {
            "episodes": content["episodes"],
            "friction": shares["friction"].get(0.2),
            "everything": shares["everything"].get(1.5),
            "pushes": shares["push"].get(1.5),
            "points": len(points),
            "with_a_fall": sum(share < 100.0 for share in points),
        }
    }
