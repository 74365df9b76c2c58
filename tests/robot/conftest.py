"""What the robot tests share: Pinocchio as an independent reader of URDF."""

import pytest


@pytest.fixture
def pinocchio():
    """`pinocchio(urdf, model)`: the URDF in Pinocchio, to compare a MuJoCo model with."""
    pytest.importorskip("pinocchio", reason="pin is not installed")
    from benchmarks.pinocchio_oracle import Pinocchio

    return Pinocchio
