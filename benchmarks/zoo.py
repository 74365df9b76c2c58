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

import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.shared import find_example_robots, make_parser
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
class Conversion:
    """What became of a file."""

    file: Path
    refusal: str  # why it is refused, or ""
    error: float  # relative to Pinocchio's figures; NaN where refused
    repairable: bool  # converts with --repair-inertia
    seconds: float  # of reading and converting, on one core
    verdict: str  # of training: "yes", or why not

    @property
    def exact(self) -> bool:
        """True if the file converts without a flag, to the dynamics that Pinocchio reads."""
        return not self.refusal and self.error < EXACT


def try_conversion(file: Path) -> Conversion:
    """Convert a URDF of any robot, and compare its dynamics with Pinocchio's reading.

    The result says why the file is refused and if --repair-inertia helps, or if it can be trained
    as a quadruped.
    """
    began = time.process_time()
    try:
        urdf = read_urdf(file)
    except UrdfError as error:
        reason = str(error).removeprefix(str(file)).lstrip(":, ")
        return Conversion(file, reason, np.nan, converts_repaired(file), np.nan, "")
    legs: tuple[Leg, ...] = ()
    verdict = "yes"
    try:
        urdf, legs = find_quadruped(urdf, NO_MESHES)
        complete_motors(urdf, legs, NO_MESHES)
    except UrdfError as error:
        verdict = str(error).removeprefix(f"{urdf.source}: ")
    xml = write_xml(convert(urdf, legs, NO_MESHES).spec)
    seconds = time.process_time() - began
    return Conversion(file, "", compute_error(urdf, xml), True, seconds, verdict)


def converts_repaired(file: Path) -> bool:
    """Return True if a file converts with --repair-inertia."""
    try:
        convert(read_urdf(file, repair_inertia=True), options=NO_MESHES)
    except UrdfError:
        return False
    return True


def compute_error(urdf: Urdf, xml: str) -> float:
    """Return the largest relative error of an MJCF's dynamics against Pinocchio's of the URDF."""
    from benchmarks.pinocchio_oracle import Pinocchio  # of the extra `zoo`

    model = mujoco.MjModel.from_xml_string(xml)
    return max(Pinocchio(urdf, model).compute_errors(STATES).values())


def format_conversions(conversions: list[Conversion], folder: Path) -> str:
    """Return tables of the files that are refused and of quadrupeds, and the counts of all."""
    exact = [c for c in conversions if c.exact]
    repairable = sum(c.repairable for c in conversions)
    worst = max((c.error for c in exact), default=np.nan)
    slowest = max(conversions, key=lambda c: 0.0 if np.isnan(c.seconds) else c.seconds)
    lines = [
        f"{len(conversions)} files: {len(exact)} convert exactly (worst relative error "
        f"{worst:.1g}), {len(conversions) - len(exact)} are refused or differ; "
        f"with --repair-inertia {repairable} convert. "
        f"Slowest conversion without meshes: {slowest.seconds:.2f} s ({slowest.file.name}).",
        "",
        "| refused | reason | with `--repair-inertia` |",
        "|---|---|---|",
    ]
    for c in conversions:
        if not c.exact:
            reason = c.refusal or f"differs from Pinocchio by {c.error:.1g}"
            repair = "converts" if c.repairable else "refused"
            lines.append(f"| {c.file.relative_to(folder)} | {reason} | {repair} |")
    lines += ["", "| quadruped | error | seconds |", "|---|---|---|"]
    for c in conversions:
        if c.verdict == "yes":
            lines.append(f"| {c.file.relative_to(folder)} | {c.error:.1g} | {c.seconds:.2f} |")
    return "\n".join(lines)


def find_quadrupeds(files: Iterable[Path]) -> list[Path]:
    """Return the files that can be trained as a quadruped without any flag."""
    quadrupeds = []
    for file in files:
        try:
            urdf, legs = find_quadruped(read_urdf(file), Options())
            complete_motors(urdf, legs, Options())
        except UrdfError:
            continue
        quadrupeds.append(file)
    return quadrupeds


def stands(quadruped: Quadruped) -> bool:
    """Return True if PD control of its home pose keeps a robot up for 10 s in MuJoCo C.

    Its trunk is then higher than a share `STANDS` of its height in that pose.
    """
    model = quadruped.make_full_model()
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    stiffness = 1.4 * model.body_subtreemass[0] * quadruped.gravity * quadruped.home[2]
    while data.time < 10:
        torque = stiffness * (quadruped.home[7:] - data.qpos[7:] - 0.025 * data.qvel[6:])
        data.ctrl = np.clip(torque, -quadruped.effort, quadruped.effort)
        mujoco.mj_step(model, data)
    return bool(data.qpos[2] > STANDS * quadruped.home[2])


def make_name(file: Path) -> str:
    """Return the name of the run of a URDF's robot: of the folder two above it, and its own."""
    return f"{file.parents[1].name}-{file.stem}"


def judge(run: Run) -> dict[str, float | str]:
    """Evaluate a run in MuJoCo C; return its mean speed, m/s, share of falls, and gait.

    Gait and Froude number are those of the episode of median speed.
    """
    evaluation = evaluate(run, episodes=EPISODES, engine="mujoco")
    summary, typical = evaluation.summary, evaluation.results["typical_episode"]
    return {
        "speed": summary["speed"]["mean"],
        "falls": summary["fall_rate"],
        "froude": typical["froude"],
        "gait": typical["gait"],
    }


def format_row(quadruped: Quadruped, name: str, outcome: Outcome) -> str:
    """Return the row of a robot in the table, after its training: `outcome` is of `judge`.

    Simulates if the robot stands on PD control.
    """
    mass = quadruped.make_full_model().body_subtreemass[0]
    label = f"{name} | {mass:.1f} | {'yes' if stands(quadruped) else 'no'}"
    if outcome.error is not None or outcome.stopped:
        return f"| {label} | failed: {outcome.error or 'stopped'} | | | | |"
    figures = outcome.value
    return (
        f"| {label} | {figures['speed']:.2f} | {figures['froude']:.2f} | {figures['falls']:.0%} | "
        f"{figures['gait']} | {figures['speed'] / quadruped.foot_speed:.2f} |"
    )


def train_all(files: list[Path], steps: int, runs: Path, place: PlaceConfig) -> str:
    """Train and evaluate the quadruped of every file; print each row, and return the table.

    Each trains for `steps` control steps, as a run in the folder `runs`, at `place`.
    """
    quadrupeds = {make_name(file): load_quadruped(file) for file in files}
    jobs = []
    for file in files:
        robot = replace(TASK.robot, urdf=file)
        task = replace(TASK, name=make_name(file), runs=runs.resolve(), steps=steps, robot=robot)
        jobs.append(Job(fix_sizes(task, place), judge))
    rows = {}
    for outcome in run_jobs(jobs, make_place(place), len(jobs)):
        name = outcome.job.name
        rows[name] = format_row(quadrupeds[name], name, outcome)
        print(rows[name], flush=True)
    heads = "| robot | kg | stands | m/s | Froude | falls | gait | of the thigh motors' speed |"
    return "\n".join(
        [heads, "|---|---|---|---|---|---|---|---|", *(rows[name] for name in quadrupeds)]
    )


def main() -> None:
    """Convert all files, or, with --train, train all quadrupeds; print the table."""
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("--folder", type=Path, help="of URDFs (default: example-robot-data's)")
    add("--train", action="store_true", help="train and evaluate the quadrupeds")
    add("--steps", type=int, default=STEPS, help="control steps of each training")
    add("--only", nargs="+", default=[], metavar="NAME", help="robots whose path has a NAME in it")
    add("--runs", type=Path, help="folder of the runs (default: a temporary one)")
    add("--markdown", type=Path, metavar="FILE", help="where the table goes")
    add_place_flags(parser)
    options = parser.parse_args()
    folder = options.folder or find_example_robots()
    if folder is None:
        sys.exit("error: example-robot-data is not installed; expected it, or --folder DIR")
    files = sorted(folder.rglob("*.urdf"))
    if options.train:
        files = find_quadrupeds(files)
    if options.only:
        files = [file for file in files if any(name in str(file) for name in options.only)]
    if options.train:
        with tempfile.TemporaryDirectory() as temporary:
            runs = options.runs or Path(temporary)
            table = train_all(files, options.steps, runs, read_place(options))
    else:
        table = format_conversions([try_conversion(file) for file in files], folder)
        print(table)
    if options.markdown:
        options.markdown.write_text(table + "\n")


if __name__ == "__main__":
    run_command(main)
