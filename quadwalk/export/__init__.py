"""A trained policy as files for use elsewhere: ONNX, deploy.yaml, the robot, and scripts."""

from pathlib import Path


def scripts() -> list[Path]:
    """The scripts that an export contains; they run where they are copied to, without quadwalk."""
    return [Path(__file__).with_name(name) for name in ("run_policy.py", "controller.py")]
