"""Two XLA devices for all tests, the AlienGo, and URDFs of other robots, where there are any."""

import importlib.util
import os
from pathlib import Path

import pytest

from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.train.devices import set_up_devices

# So that what is shared between devices is tested as such.
set_up_devices(2)


@pytest.fixture(scope="session")
def quadruped() -> Quadruped:
    """The AlienGo."""
    return load_quadruped()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test with a `reference_urdf` or `pybullet_urdf` once for each that there is."""
    for name, files, missing in (
        ("reference_urdf", reference_urdfs(), "QUADWALK_REFERENCE_URDFS names no folder of URDFs"),
        ("pybullet_urdf", pybullet_urdfs(), "pybullet is not installed"),
    ):
        if name in metafunc.fixturenames:
            none = pytest.param(None, marks=pytest.mark.skip(reason=missing))
            metafunc.parametrize(name, files or [none], ids=lambda file: file and file.stem)


def reference_urdfs() -> list[Path]:
    """URDFs of other quadrupeds, in a folder that the environment names."""
    folder = os.environ.get("QUADWALK_REFERENCE_URDFS")
    return sorted(Path(folder).glob("*.urdf")) if folder else []


def pybullet_urdfs() -> list[Path]:
    """The quadrupeds of PyPI's pybullet_data whose XML and physics are valid."""
    if importlib.util.find_spec("pybullet_data") is None:
        return []
    import pybullet_data

    folder = Path(pybullet_data.getDataPath())
    names = (
        "a1/a1", "aliengo/aliengo", "laikago/laikago_toes_zup", "quadruped/vision60",
        "quadruped/spirit40", "quadruped/minitaur_derpy", "quadruped/minitaur_fixed_knees",
        "quadruped/minitaur_rainbow_dash", "quadruped/minitaur_rainbow_dash_v1",
        "quadruped/minitaur_v1",
    )  # fmt: skip
    return [folder / f"{name}.urdf" for name in names]
