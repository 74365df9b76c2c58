"""What the robot tests share: Pinocchio as an independent reader."""

import pytest

from benchmarks.pinocchio_oracle import Pinocchio


@pytest.fixture
def pinocchio():
    """`pinocchio(urdf, model)`: the URDF in Pinocchio, to compare a MuJoCo model with."""
    return Pinocchio
