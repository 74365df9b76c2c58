"""A trained policy as files for use elsewhere: ONNX, deploy.yaml, the robot, and a script."""

from pathlib import Path


def run_policy_path() -> Path:
    """The script that an export contains; it runs where it is copied to, without quadwalk."""
    return Path(__file__).with_name("run_policy.py")
