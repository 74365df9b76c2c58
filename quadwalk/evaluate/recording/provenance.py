"""Where an evaluation's numbers come from: code, policy, versions, robot."""

import subprocess
from pathlib import Path
from typing import Any

from quadwalk.evaluate.subject import Subject
from quadwalk.robot.mjcf import write_xml
from quadwalk.shell import ROOT
from quadwalk.train.robot import load_robot
from quadwalk.train.runs.directory import versions


def provenance(subject: Subject, seed: int) -> dict[str, Any]:
    """Plain values for JSON that say what was evaluated, from starts by `seed`, and by what."""
    return {
        "run": subject.run.name,
        "engine": subject.env.engine,
        "seed": seed,
        "seconds": subject.env.config.episode_seconds,
        "randomised": subject.env.config.randomisation.enabled,
        "training_steps": subject.policy.steps,
        "policy_sha256": subject.sha256,
        "revision": revision(),
        "versions": versions(),
    }


def revision(source: Path = ROOT) -> str:
    """The git commit that `source` has checked out, "-dirty" after it where files differ from it.

    The package's version where `source` is no checkout or there is no git.
    """
    # An installed package may lie inside some other project's checkout, whose commit is not its.
    if (source / ".git").exists():
        command = ["git", "--no-optional-locks", "-C", str(source), "describe", "--always"]
        try:
            done = subprocess.run(
                [*command, "--dirty", "--abbrev=40", "--exclude=*"],
                capture_output=True,
                text=True,
                timeout=10,
            )
        except (OSError, subprocess.SubprocessError):
            pass
        else:
            if done.returncode == 0 and done.stdout.strip():
                return f"git {done.stdout.strip()}"
    return f"quadwalk {versions()['quadwalk']}"


def attachments(subject: Subject) -> dict[str, bytes]:
    """Files to go with every recording: the run's configuration, and the robot as MJCF.

    The MJCF is what `python -m quadwalk.robot` writes: every shape, and the joints' friction.
    """
    quadruped = subject.env.quadruped
    if subject.env.terrain is not None:  # without the ground, of which the recording shows its own
        quadruped = load_robot(subject.policy.config.robot)
    files = {f"{quadruped.name}.xml": write_xml(quadruped.spec).encode()}
    if subject.config is not None:
        files["config.json"] = subject.config
    return files
