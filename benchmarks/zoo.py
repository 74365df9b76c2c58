"""The URDFs that people have: each converts exactly, or is refused for a reason; quadrupeds run.

    python benchmarks/zoo.py [--folder DIR] [--markdown FILE]
    python benchmarks/zoo.py --train [--steps 8000000] [--only a1 go2] [--markdown FILE]
        [--cores 2] [--cluster auto]

The first converts every URDF of PyPI's example-robot-data, or of DIR, without its meshes. It
compares masses, frames, mass matrix, bias forces and inverse dynamics with Pinocchio's, in 20
random states, through MJCF's six digits. A file that is refused is tried with --repair-inertia.

The second takes the quadrupeds among them and lets each stand for 10 s in MuJoCo C on PD control of
its home pose. It trains each with the default task and no other flag, as many at a time as have
cores here or on a Ray cluster. The policy is evaluated in MuJoCo C with every collision shape. What
--runs has from before is not trained again. To see that it works: --steps 100000 --only a1.

Both need the packages of the extra `zoo`. Tables go to standard output, or to FILE as Markdown.
"""

import argparse
import os
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from quadwalk.api import evaluate
from quadwalk.cli.process import run_command
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import PlaceConfig, add_place_flags, read_place
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import Outcome, run_jobs
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.quadruped import Quadruped, complete_motors, find_quadruped, load_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.urdf import Urdf, read_urdf
from quadwalk.runs.directory import Run
from quadwalk.tasks.run import TASK

EXACT = 1e-5  # largest relative error, of six digits
STATES = 20
EPISODES = 64
STEPS = 8_000_000  # three minutes on two cores
STANDS = 0.8  # of the home height, after 10 s
NO_MESHES = Options(meshes=False)


@dataclass(frozen=True)
class Converted:
    """What became of a file."""

    file: Path
    refused: str  # why, or ""
    error: float  # relative to Pinocchio's figures; NaN where refused
    repaired: bool  # whether it converts with --repair-inertia
    seconds: float  # of reading and converting, on one core
    verdict: str  # of training: "yes", or why not

    @property
    def exact(self) -> bool:
        """Whether it converts without a flag, to what Pinocchio reads."""
        return not self.refused and self.error < EXACT


def example_robot_data() -> Path | None:
    """The folder of example-robot-data's robots; None where it is not installed.

    That, or the folder that QUADWALK_EXAMPLE_ROBOTS names.
    """
    if named := os.environ.get("QUADWALK_EXAMPLE_ROBOTS"):
        return Path(named)
    for name in ("purelib", "platlib"):
        folder = Path(sysconfig.get_path(name))
        robots = folder / "cmeel.prefix/share/example-robot-data/robots"
        if robots.is_dir():
            return robots
    return None


def try_conversion(file: Path) -> Converted:
    """Read, convert and compare one file."""
    began = time.process_time()
    try:
        urdf = read_urdf(file)
    except UrdfError as error:
        reason = str(error).removeprefix(str(file)).lstrip(":, ")
        return Converted(file, reason, np.nan, _converts_repaired(file), np.nan, "")
    legs: tuple[Leg, ...] = ()
    verdict = "yes"
    try:
        urdf, legs = find_quadruped(urdf, NO_MESHES)
        complete_motors(urdf, legs, NO_MESHES)
    except UrdfError as error:
        verdict = str(error).removeprefix(f"{urdf.source}: ")
    spec = convert(urdf, legs, NO_MESHES).spec
    xml = write_xml(spec)
    seconds = time.process_time() - began
    return Converted(file, "", error_of(urdf, xml), True, seconds, verdict)


def _converts_repaired(file: Path) -> bool:
    try:
        convert(read_urdf(file, repair_inertia=True), options=NO_MESHES)
    except UrdfError:
        return False
    return True


def error_of(urdf: Urdf, xml: str) -> float:
    """Largest error of an MJCF against Pinocchio's reading of the URDF."""
    from pinocchio_oracle import Pinocchio  # beside this file

    return max(Pinocchio(urdf, mujoco.MjModel.from_xml_string(xml)).errors(STATES).values())


def conversions(files: Iterable[Path], folder: Path) -> str:
    """A table of what became of each file, and how many there are of each kind."""
    found = [try_conversion(file) for file in files]
    exact, repaired = sum(f.exact for f in found), sum(f.repaired for f in found)
    slowest = max(found, key=lambda f: 0.0 if np.isnan(f.seconds) else f.seconds)
    worst = max((f.error for f in found if f.exact), default=np.nan)
    lines = [
        f"{len(found)} files: {exact} convert exactly (worst relative error {worst:.1g}), "
        f"{len(found) - exact} are refused or differ; with --repair-inertia {repaired} convert. "
        f"Slowest conversion without meshes: {slowest.seconds:.2f} s ({slowest.file.name}).",
        "",
        "| refused | reason | with `--repair-inertia` |",
        "|---|---|---|",
    ]
    for f in found:
        if not f.exact:
            reason = f.refused or f"differs from Pinocchio by {f.error:.1g}"
            repair = "converts" if f.repaired else "refused"
            lines.append(f"| {f.file.relative_to(folder)} | {reason} | {repair} |")
    lines += ["", "| quadruped | error | seconds |", "|---|---|---|"]
    for f in found:
        if f.verdict == "yes":
            lines.append(f"| {f.file.relative_to(folder)} | {f.error:.1g} | {f.seconds:.2f} |")
    return "\n".join(lines)


def quadrupeds(files: Iterable[Path]) -> list[Path]:
    """Those of the files that train as a quadruped as they are."""
    found = []
    for file in files:
        try:
            urdf, legs = find_quadruped(read_urdf(file), Options())
            complete_motors(urdf, legs, Options())
        except UrdfError:
            continue
        found.append(file)
    return found


def stands(quadruped: Quadruped) -> bool:
    """Whether PD control of the home pose, with the gains of training, keeps it up for 10 s."""
    model = quadruped.make_full_model()
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    stiffness = 1.4 * model.body_subtreemass[0] * quadruped.gravity * quadruped.home[2]
    while data.time < 10:
        torque = stiffness * (quadruped.home[7:] - data.qpos[7:] - 0.025 * data.qvel[6:])
        data.ctrl = np.clip(torque, -quadruped.effort, quadruped.effort)
        mujoco.mj_step(model, data)
    return bool(data.qpos[2] > STANDS * quadruped.home[2])


def name_of(file: Path) -> str:
    """What a robot's run is called."""
    return f"{file.parents[1].name}-{file.stem}"


def judge(run: Run) -> dict[str, float | str]:
    """The figures of a run in MuJoCo C."""
    judged = evaluate(run, episodes=EPISODES, engine="mujoco")
    summary, typical = judged.summary, judged.results["typical_episode"]
    return {
        "speed": summary["speed"]["mean"],
        "falls": summary["fall_rate"],
        **{name: typical[name] for name in ("froude", "gait")},
    }


def label(quadruped: Quadruped, name: str) -> str:
    """The first cells of a robot's row."""
    mass = quadruped.make_full_model().body_subtreemass[0]
    return f"{name} | {mass:.1f} | {'yes' if stands(quadruped) else 'no'}"


def row(quadruped: Quadruped, name: str, found: Outcome) -> str:
    """The row of a robot whose training has ended."""
    if found.error is not None or found.stopped:
        return f"| {label(quadruped, name)} | failed: {found.error or 'stopped'} | | | | |"
    figures = found.value
    return (
        f"| {label(quadruped, name)} | {figures['speed']:.2f} | {figures['froude']:.2f} | "
        f"{figures['falls']:.0%} | {figures['gait']} | "
        f"{figures['speed'] / quadruped.foot_speed:.2f} |"
    )


def trainings(files: list[Path], steps: int, runs: Path, where: PlaceConfig) -> str:
    """The table of every quadruped, trained and evaluated."""
    quadrupeds = {name_of(file): load_quadruped(file) for file in files}
    jobs = []
    for file in files:
        robot = replace(TASK.robot, urdf=file)
        own = replace(TASK, name=name_of(file), runs=runs.resolve(), steps=steps, robot=robot)
        jobs.append(Job(fix_sizes(own, where), judge))
    rows = {}
    for found in run_jobs(jobs, make_place(where), len(jobs)):
        name = found.job.name
        rows[name] = row(quadrupeds[name], name, found)
        print(rows[name], flush=True)
    heads = "| robot | kg | stands | m/s | Froude | falls | gait | of the thigh motors' speed |"
    return "\n".join(
        (heads, "|---|---|---|---|---|---|---|---|", *(rows[name] for name in quadrupeds))
    )


def main() -> None:
    """Convert, or train, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--folder", type=Path, help="of URDFs (default: example-robot-data's)")
    add("--train", action="store_true", help="train and evaluate the quadrupeds")
    add("--steps", type=int, default=STEPS, help="control steps of each training")
    add("--only", nargs="+", default=[], metavar="NAME", help="robots whose path has a NAME in it")
    add("--runs", type=Path, help="folder of the runs (default: a temporary one)")
    add("--markdown", type=Path, metavar="FILE", help="where the table goes")
    add_place_flags(parser)
    arguments = parser.parse_args()
    folder = arguments.folder or example_robot_data()
    if folder is None:
        sys.exit("error: example-robot-data is not installed; expected it, or --folder DIR")
    files = sorted(folder.rglob("*.urdf"))
    if arguments.train:
        files = quadrupeds(files)
    if arguments.only:
        files = [file for file in files if any(name in str(file) for name in arguments.only)]
    if arguments.train:
        with tempfile.TemporaryDirectory() as temporary:
            runs = arguments.runs or Path(temporary)
            table = trainings(files, arguments.steps, runs, read_place(arguments))
    else:
        table = conversions(files, folder)
        print(table)
    if arguments.markdown:
        arguments.markdown.write_text(table + "\n")


if __name__ == "__main__":
    run_command(main)
