"""What the robot tests share: Pinocchio as an independent reader, and the robots of others."""

import pytest

from benchmarks.zoo import example_robot_data


@pytest.fixture
def pinocchio():
    """`pinocchio(urdf, model)`: the URDF in Pinocchio, to compare a MuJoCo model with."""
    pytest.importorskip("pinocchio", reason="pin is not installed")
    from benchmarks.pinocchio_oracle import Pinocchio

    return Pinocchio


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test with a `zoo_urdf` once for each file of example-robot-data, where there is one."""
    if "zoo_urdf" not in metafunc.fixturenames:
        return
    folder = example_robot_data()
    if folder is None:
        none = pytest.param(
            None,
            marks=pytest.mark.skip(
                reason="neither example-robot-data nor QUADWALK_EXAMPLE_ROBOTS is there"
            ),
        )
        metafunc.parametrize("zoo_urdf", [none], ids=["example-robot-data"])
    else:
        files = sorted(folder.rglob("*.urdf"))
        metafunc.parametrize("zoo_urdf", files, ids=[str(f.relative_to(folder)) for f in files])
