"""`quadwalk robot URDF [-o OUT] [--render PNG]`: convert a URDF to MJCF, or draw it."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import tyro

from quadwalk.bounds import Positive, Settings
from quadwalk.cli.arguments import parse
from quadwalk.errors import UsageError, UserError
from quadwalk.files import open_atomic
from quadwalk.render.canvas import render_home
from quadwalk.render.images import save_png
from quadwalk.robot.from_mjcf import read_robot
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.quadruped import complete_motors, find_quadruped, list_joints
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.structure.tree import ONE_WAY
from quadwalk.robot.urdf import Urdf, release_from_world


@dataclass(frozen=True)
class ConvertConfig(Settings):
    """Convert a URDF to MJCF (MuJoCo XML). Any tree of links converts."""

    # the robot's description
    urdf: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="URDF")] = None
    # file to write; None: standard output
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    render: Path | None = None  # draw the robot in its home pose as this PNG
    mesh_dirs: tuple[Path, ...] = ()  # folders of mesh files, besides the URDF's own
    fix: tuple[str, ...] = ()  # joints to fix, by name or pattern: a head, a lidar, an arm
    effort: Positive | None = None  # Nm, effort limit of legs' motors for which the URDF has none
    speed: Positive | None = None  # rad/s, velocity limit of the same
    meshes: bool = True  # mesh shapes; without them others remain
    # replace an inertia that no body can have by the nearest valid one
    repair_inertia: bool = False
    floating_base: bool = False  # let the root link float
    fixed_base: bool = False  # fix the root link to the ground
    # armature of the joints that a pattern names, as JOINTS=INERTIA,GEAR: the rotor's inertia
    # (kg m^2) times the gear ratio squared; may be given several times
    rotor: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    # no report of what was fused, dropped, assumed
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False  # the report in full

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.floating_base and self.fixed_base:
            raise UsageError("--floating-base and --fixed-base; expected one of them")


def main(args: Sequence[str], prog: str = "quadwalk robot") -> None:
    """Convert, write, draw and report as the arguments say."""
    try:
        convert_file(_find_urdf(parse(ConvertConfig, args, prog), prog))
    except UserError as error:
        raise type(error)(_name_flags(str(error))) from None


def _find_urdf(config: ConvertConfig, prog: str) -> ConvertConfig:
    """Return `config` with the URDF, which a list of folders or joints before it has swallowed."""
    if config.urdf is not None:
        return config
    if len(config.mesh_dirs) > 1 and os.path.isfile(config.mesh_dirs[-1]):
        return replace(config, mesh_dirs=config.mesh_dirs[:-1], urdf=config.mesh_dirs[-1])
    if len(config.fix) > 1 and os.path.isfile(config.fix[-1]):
        return replace(config, fix=config.fix[:-1], urdf=Path(config.fix[-1]))
    raise UsageError(f"no URDF; expected the path of one ({prog} --help lists all options)")


def _name_flags(text: str) -> str:
    """Return `text` with the flags of training in it by their names here."""
    return text.replace("--robot.", "--")


def convert_file(config: ConvertConfig) -> None:
    """Convert, write, draw and report as `config` says."""
    assert config.urdf is not None
    for folder in config.mesh_dirs:
        if not os.path.isdir(folder):
            raise UsageError(f"--mesh-dirs {folder}: expected a folder")
    urdf = read_robot(config.urdf, config.repair_inertia, config.fix, config.speed)
    joints = [joint.name for joint in urdf.robot.joints if joint.type in ONE_WAY]
    options = Options(
        floating=config.floating_base or (False if config.fixed_base else None),
        meshes=config.meshes,
        mesh_folders=config.mesh_dirs,
        armature=_compute_armatures(config.rotor, joints),
        effort=config.effort,
        speed=config.speed,
    )
    urdf, legs, verdict = _find_legs(urdf, options)
    conversion = convert(urdf, legs, options)
    xml = write_xml(conversion.spec)
    if config.out is not None:
        with open_atomic(config.out) as file:
            file.write(xml.encode())
    elif config.render is None:
        sys.stdout.write(xml)
    if config.render is not None:
        save_png(render_home(conversion.spec.compile()), config.render)
    if not config.quiet:
        for line in conversion.report.to_lines(sys.maxsize if config.verbose else 4):
            print(line, file=sys.stderr)
        for line in list_joints(conversion.spec, legs) if legs else ():
            print(line, file=sys.stderr)
        print(f"trains as a quadruped: {_name_flags(verdict)}", file=sys.stderr)


def _find_legs(urdf: Urdf, options: Options) -> tuple[Urdf, tuple[Leg, ...], str]:
    """Return the URDF to convert, a quadruped's legs, and "yes", or why none can be trained."""
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


def _compute_armatures(rotors: Sequence[str], joints: list[str]) -> dict[str, float]:
    """Return the armature of joints, kg m^2, from `JOINTS=INERTIA,GEAR`: INERTIA * GEAR^2."""
    armatures: dict[str, float] = {}
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
            all_joints = ", ".join(joints) or "none"
            raise UsageError(f"--rotor {rotor}: names no moving joint; there are {all_joints}")
        armatures.update(dict.fromkeys(names, inertia * gear**2))
    return armatures
