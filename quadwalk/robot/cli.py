"""`quadwalk robot URDF [-o OUT] [--render PNG]`: convert a URDF to MJCF, or draw it."""

import argparse
import os
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from quadwalk.cli.arguments import ArgumentParser
from quadwalk.errors import UsageError, UserError
from quadwalk.files import atomic_write
from quadwalk.render.canvas import render_home
from quadwalk.render.images import save_png
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.quadruped import complete_motors, find_quadruped, list_joints
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.structure.tree import ONE_WAY
from quadwalk.robot.urdf import Urdf, read_urdf, release_from_world


def parse_arguments(argv: Sequence[str], prog: str) -> argparse.Namespace:
    """The command line's arguments."""
    parser = ArgumentParser(
        prog=prog,
        description="Convert a URDF to MJCF (MuJoCo XML). Any tree of links converts.",
    )
    add = parser.add_argument
    add("urdf", type=Path, nargs="?", metavar="URDF", help="the robot's description")
    add("-o", "--out", type=Path, metavar="XML", help="file to write (default: standard output)")
    add("--render", type=Path, metavar="PNG", help="draw the robot in its home pose")
    add(
        "--mesh-dirs",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="folders of mesh files, besides the URDF's own",
    )
    add(
        "--fix",
        nargs="+",
        default=[],
        metavar="JOINT",
        help="joints to fix, by name or pattern: a head, a lidar, an arm",
    )
    add("--effort", type=float, metavar="NM", help="of legs' motors for which the URDF has none")
    add("--speed", type=float, metavar="RAD_PER_S", help="the same")
    add("--no-meshes", action="store_true", help="leave mesh shapes out")
    add(
        "--repair-inertia",
        action="store_true",
        help="replace an inertia that no body can have by the nearest valid one",
    )
    base = parser.add_mutually_exclusive_group()
    base.add_argument("--floating-base", action="store_true", help="let the root link float")
    base.add_argument("--fixed-base", action="store_true", help="fix the root link to the ground")
    add(
        "--rotor",
        action="append",
        default=[],
        metavar="JOINTS=INERTIA,GEAR",
        help="armature of the joints that a pattern names: rotor inertia (kg m^2) times gear^2",
    )
    add("-q", "--quiet", action="store_true", help="no report of what was fused, dropped, assumed")
    add("-v", "--verbose", action="store_true", help="the report in full")
    arguments = parser.parse_args(argv)
    # The list of folders or joints before it has swallowed the URDF.
    for values in (arguments.mesh_dirs, arguments.fix):
        if arguments.urdf is None and len(values) > 1 and os.path.isfile(values[-1]):
            arguments.urdf = Path(values.pop())
    if arguments.urdf is None:
        parser.error("the following arguments are required: URDF")
    for flag in ("effort", "speed"):
        value = getattr(arguments, flag)
        if value is not None and not 0 < value < 1e9:
            raise UsageError(f"--{flag} is {value:g}; expected a number above 0")
    return arguments


def main(argv: Sequence[str], prog: str = "quadwalk robot") -> None:
    """Convert, write, draw and report as `argv` says; `prog` is what the help calls the command."""
    try:
        convert_file(parse_arguments(argv, prog))
    except UserError as error:
        raise type(error)(name_flags(str(error))) from None


def name_flags(text: str) -> str:
    """Return `text` with the flags of training in it by their names here."""
    return text.replace("--robot.", "--")


def convert_file(arguments: argparse.Namespace) -> None:
    """Convert, write, draw and report as the `arguments` say."""
    for folder in arguments.mesh_dirs:
        if not os.path.isdir(folder):
            raise UsageError(f"--mesh-dirs {folder}: expected a folder")
    urdf = read_urdf(arguments.urdf, arguments.repair_inertia, tuple(arguments.fix))
    joints = [joint.name for joint in urdf.robot.joints if joint.type in ONE_WAY]
    options = Options(
        floating=arguments.floating_base or (False if arguments.fixed_base else None),
        meshes=not arguments.no_meshes,
        mesh_folders=tuple(arguments.mesh_dirs),
        armature=armatures(arguments.rotor, joints),
        effort=arguments.effort,
        speed=arguments.speed,
    )
    urdf, legs, verdict = recognize(urdf, options)
    conversion = convert(urdf, legs, options)
    xml = write_xml(conversion.spec)
    if arguments.out is not None:
        with atomic_write(arguments.out) as file:
            file.write(xml.encode())
    elif arguments.render is None:
        sys.stdout.write(xml)
    if arguments.render is not None:
        save_png(render_home(conversion.spec.compile()), arguments.render)
    if not arguments.quiet:
        for line in conversion.report.to_lines(sys.maxsize if arguments.verbose else 4):
            print(line, file=sys.stderr)
        for line in list_joints(conversion.spec, legs) if legs else ():
            print(line, file=sys.stderr)
        print(f"trains as a quadruped: {name_flags(verdict)}", file=sys.stderr)


def recognize(urdf: Urdf, options: Options) -> tuple[Urdf, tuple[Leg, ...], str]:
    """Return what to convert, a quadruped's legs, and "yes", or why none can be trained."""
    legs: tuple[Leg, ...] = ()
    if options.floating is False:
        return urdf, legs, "no, for its base is fixed to the ground"
    released = release_from_world(urdf)
    try:
        released, legs = find_quadruped(released, options)
        return complete_motors(released, legs, options), legs, "yes"
    except UrdfError as error:
        reason = str(error).removeprefix(f"{urdf.source}: ")
    return released if legs or options.floating else urdf, legs, f"no: {reason}"


def armatures(rotors: list[str], joints: list[str]) -> dict[str, float]:
    """Armature (kg m^2) by joint from `JOINTS=INERTIA,GEAR` options, INERTIA * GEAR^2."""
    found: dict[str, float] = {}
    for rotor in rotors:
        pattern, _, values = rotor.partition("=")
        try:
            inertia, gear = map(float, values.split(","))
        except ValueError:
            inertia = gear = -1.0
        if not (0 <= inertia < 1e3 and 0 < gear < 1e4):
            raise UsageError(
                f"--rotor {rotor}: expected JOINTS=INERTIA,GEAR, as in '*_hip_joint=1.4e-4,8'"
            )
        names = [name for name in joints if fnmatchcase(name, pattern)]
        if not names:
            there = ", ".join(joints) or "none"
            raise UsageError(f"--rotor {rotor}: names no moving joint; there are {there}")
        found.update(dict.fromkeys(names, inertia * gear**2))
    return found
