"""Sessions at the reward desk, each repeated by this script: numbers change while a policy trains.

    python -m studies.desk.sessions [--only blog walk run] [--runs runs] [--out results.json]

- `blog`: the blog post's task learns to crawl on its knees, until two terms get it on its feet.
- `walk`: the packaged policy goes on, until one number asks its feet to swing higher.
- `run`: the packaged policy slows to a chosen speed, until one slider makes energy dear.

`on_iteration` changes the numbers where a hand would at the page. Policies are kept as training
goes, and afterwards each runs in MuJoCo C, every shape colliding. Results go to `--out`, which
notebook 08 tells in pictures. A run that is there already is measured and not trained again;
`train.py --replay` repeats one with the page.
"""

import argparse
import dataclasses
import json
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import quadwalk
from quadwalk.cli.process import run_command
from quadwalk.env import rewards
from quadwalk.evaluation.load import Command, load_run
from quadwalk.evaluation.metrics import get_mean, to_json_number
from quadwalk.evaluation.results import evaluate_policy
from quadwalk.files import open_atomic
from quadwalk.learn.desk import DeskIteration
from quadwalk.learn.devices import set_up_devices
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.settings.terms import Reward
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task
from studies.gecko.gait import find_body_contact, sample_frames

RESULTS = Path(__file__).parent / "results.json"
EPISODES = 4  # of a policy that is measured
SECONDS = 10.0  # of an episode
POLICIES = "policies"  # folder in a run's: the policies that were kept as it trained
TIMES = "processor.json"  # in a run's folder: processor time after each iteration, s


@dataclasses.dataclass(frozen=True)
class Session:
    """A training, what is changed in it, and what is asked of the robot when it is measured."""

    task: TrainConfig
    steps: int
    every: int  # control steps between the policies that are kept
    changes: Mapping[int, Mapping[str, float]]  # numbers by name, by the control steps before them
    init: str | None = None  # a packaged policy; None: training begins with random networks
    command: Command | None = None


def make_sessions() -> dict[str, Session]:
    """Return the sessions by name."""
    return {
        "blog": Session(
            add_terms(
                load_task("blog"),
                kneel=Reward(rewards.kneel, {"height": 0.05}, scale=0.0),
                at_home=Reward(rewards.at_home, {"joints": 0.4, "height": 0.6}, scale=0.0),
            ),
            steps=16_000_000,
            every=960_000,
            changes={
                4_000_000: {"env.reward.kneel": -3.0, "env.reward.at_home": 3.0},
                8_000_000: {"env.reward.at_home": 1.0},
            },
        ),
        "walk": Session(
            load_task("walk"),
            init="walk",
            steps=5_000_000,
            every=540_000,
            changes={2_000_000: {"env.reward.trot.height": 0.13}},
            command=(0.8, 0.0, 0.0),
        ),
        "run": Session(
            load_task("run"),
            init="run",
            steps=6_000_000,
            every=540_000,
            changes={
                0: {"env.reward.forward.max_speed": 3.5},
                3_000_000: {"env.reward.energy": -0.3},
            },
        ),
    }


def add_terms(task: TrainConfig, **terms: Reward) -> TrainConfig:
    """Return `task` with more rewards, by name."""
    env = dataclasses.replace(task.env, reward={**task.env.reward, **terms})
    return dataclasses.replace(task, env=env)


def train_session(name: str, session: Session, runs: Path) -> Run:
    """Train a session; keep policies in the run's folder, and what each took of the processor."""
    folder = runs / name
    policies = folder / POLICIES
    due = dict(session.changes)
    kept_steps = 0
    times = []

    def change(iteration: DeskIteration) -> Mapping[str, float]:
        nonlocal kept_steps
        times.append({"steps": iteration.steps, "processor": time.process_time()})
        if iteration.steps - kept_steps >= session.every:
            kept_steps = iteration.steps
            place = policies / str(iteration.steps)
            place.mkdir(parents=True)
            for file in ("policy.npz", "robot.urdf"):
                shutil.copy(folder / file, place)
        passed = [steps for steps in due if steps <= iteration.steps]
        return {key: value for steps in passed for key, value in due.pop(steps).items()}

    run = quadwalk.train(
        session.task,
        init=None if session.init is None else PRETRAINED / session.init,
        name=name,
        runs=runs,
        steps=session.steps,
        devices=1,
        checkpoint_steps=session.every,
        on_iteration=change,
    )
    (folder / TIMES).write_text(json.dumps(times))
    return run


def measure_policy(policy: Run, command: Command | None) -> dict[str, Any]:
    """Return figures of a policy, each the mean of `EPISODES` in MuJoCo C.

    `body_contact` is the share of time in which anything but a foot is on the floor, and
    `foot_contact` that in which a foot is. `frames` are the `sample_frames` of the first episode.
    """
    loaded = load_run(policy, SECONDS, engine="mujoco", command=command)
    result = evaluate_policy(loaded, EPISODES, seed=0)
    gait, summary = result.gait, result.summary
    contacts = [find_body_contact(each, loaded.env.quadruped) for each in result.rollouts]
    feet = [each.contact.any(axis=1) for each in result.rollouts]
    speed = "speed" if command is None else "path_speed"
    names = {"speed": speed, "cost_of_transport": "cost_of_transport", "power": "power"}
    figures = {name: to_json_number(get_mean(summary[metric])) for name, metric in names.items()}
    return {
        **figures,
        "duration": summary["duration"]["mean"],
        "swing_height": to_json_number(float(gait.swing_height.mean())),
        "stride_frequency": to_json_number(gait.stride_frequency),
        "gait": gait.gait,
        "height": float(gait.body_height[0]),
        "body_contact": float(np.mean([contact.mean() for contact in contacts])),
        "foot_contact": float(np.mean([contact.mean() for contact in feet])),
        "frames": sample_frames(result.rollouts[0]),
    }


def measure_session(run: Run, session: Session) -> dict[str, Any]:
    """Return the changes of a session, and the figures of its policies: those kept, and the last.

    `steps` and `processor`, s of one core, count what training took until then.
    """
    times = {row["steps"]: row["processor"] for row in json.loads((run.path / TIMES).read_text())}
    lines = [json.loads(line) for line in run.desk.read_text().splitlines()]
    changes = [{**line, "processor": times[line["steps"]]} for line in lines]
    saved_runs = {int(path.name): Run(path) for path in (run.path / POLICIES).iterdir()}
    saved_runs[max(times)] = run
    policies = [
        {
            "steps": steps,
            "processor": times[steps],
            **measure_policy(saved_runs[steps], session.command),
        }
        for steps in sorted(saved_runs)
    ]
    return {"changes": changes, "policies": policies}


def main() -> None:
    """Train and measure the sessions that are asked for, and write their figures."""
    sessions = make_sessions()
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=sessions, default=list(sessions))
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    set_up_devices(1)
    for name in options.only:
        session = sessions[name]
        run = Run(options.runs / name)
        if not run.policy.exists():
            run = train_session(name, session, options.runs)
        results = json.loads(options.out.read_text()) if options.out.exists() else {}
        results[name] = measure_session(run, session)
        with open_atomic(options.out) as file:
            file.write(json.dumps(results, indent=1).encode())


if __name__ == "__main__":
    run_command(main)
