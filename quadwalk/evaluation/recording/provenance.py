"""Where an evaluation's numbers come from: code, policy, versions, robot."""

import contextlib
import subprocess
from pathlib import Path
from typing import Any

from quadwalk.cli.shell import ROOT
from quadwalk.evaluation.loaded import LoadedRun
from quadwalk.robot.load import load_robot
from quadwalk.robot.mjcf import write_xml
from quadwalk.runs.directory import get_versions


def provenance(loaded: LoadedRun, seed: int) -> dict[str, Any]:
    """Plain values for JSON that say what was evaluated, from starts by `seed`, and by what."""
    return {
        "run": loaded.run.name,
        "engine": loaded.env.engine,
        "seed": seed,
        "seconds": loaded.env.config.episode_seconds,
        "randomized": loaded.env.config.randomization.enabled,
        "training_steps": loaded.policy.steps,
        "policy_sha256": loaded.sha256,
        "notes": list(loaded.notes),
        "revision": revision(),
        "versions": get_versions(),
    }


def revision(source: Path = ROOT) -> str:
    """The git commit that `source` has checked out, "-dirty" after it where files differ from it.

    The package's version where `source` is no checkout or there is no git.
    """
    # An installed package may lie inside some other project's checkout, whose commit is not its.
    if (source / ".git").exists():
        command = ["git", "--no-optional-locks", "-C", str(source), "describe", "--always"]
        command += ["--dirty", "--abbrev=40", "--exclude=*"]
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            found = subprocess.check_output(
                command, stderr=subprocess.DEVNULL, text=True, timeout=10
            ).strip()
            if found:
                return f"git {found}"
    return f"quadwalk {get_versions()['quadwalk']}"


def attachments(loaded: LoadedRun) -> dict[str, bytes]:
    """Files for every recording: the run's configuration, and the MJCF of `quadwalk robot`."""
    quadruped = loaded.env.quadruped
    if loaded.env.terrain is not None:  # without the ground, of which the recording shows its own
        quadruped = load_robot(loaded.policy.config.robot)
    files = {f"{quadruped.name}.xml": write_xml(quadruped.spec).encode()}
    if loaded.config is not None:
        files["config.json"] = loaded.config
    return files
