"""`python -m quadwalk.robot URDF [-o OUT]`: convert a URDF to MJCF."""

import argparse
import sys
from pathlib import Path

from quadwalk.errors import UsageError, run_command
from quadwalk.robot.legs import find_legs
from quadwalk.robot.mjcf import build_spec, write_xml
from quadwalk.robot.tree import build_tree
from quadwalk.robot.urdf import UrdfError, read_urdf


def main() -> None:
    """Read the arguments, convert, write."""
    parser = argparse.ArgumentParser(
        prog="python -m quadwalk.robot", description="Convert a URDF to MJCF (MuJoCo XML)."
    )
    parser.add_argument("urdf", type=Path, metavar="URDF", help="the robot's description")
    parser.add_argument("-o", "--out", type=Path, help="file to write; without it, standard output")
    arguments = parser.parse_args()
    urdf = read_urdf(arguments.urdf)
    try:
        legs = find_legs(build_tree(urdf.robot), urdf.source)
    except UrdfError:
        legs = None  # any tree of links converts; only training asks for a quadruped
    xml = write_xml(build_spec(urdf, legs))
    if arguments.out is None:
        sys.stdout.write(xml)
        return
    try:
        arguments.out.write_text(xml)
    except OSError as error:
        raise UsageError(f"{arguments.out}: cannot be written ({error.strerror})") from None


if __name__ == "__main__":
    run_command(main)
