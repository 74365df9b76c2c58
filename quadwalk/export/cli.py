"""`quadwalk export`: write a policy as ONNX, with all that is needed to use it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quadwalk.cli.arguments import make_console, parse
from quadwalk.cli.shell import get_python, quote_words, suggest_install
from quadwalk.errors import UsageError, UserError
from quadwalk.runs.directory import describe_origin, find_any_run, find_ready, get_results_folder
from quadwalk.settings.training import OtherRobotConfig


@dataclass(frozen=True)
class ExportConfig:
    """Write a policy as ONNX, with deploy.yaml, MJCF, URDF and scripts that run it in MuJoCo."""

    # names or paths of runs, or "latest"; run, walk, drive, getup and others come trained. Several
    # are for --web
    run: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = (
        "latest",
    )
    # folder for the files; None: export/ in the run's; with --web a name that ends in .html is one
    # file, which opens by double-click
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    policy: Literal["last", "best"] = "last"  # the run's last, or that of its best checkpoint
    # name or path of a run that gets a fallen robot up, as getup; run_policy.py then goes on
    getup: str | None = None
    # run the export that the folder holds, or which is written first, with its run_policy.py, and
    # compare each step with the policy and MuJoCo C here: observation, action, target, physics
    check: bool = False
    # compare this NPZ by a runtime of your own, as run_policy.py --save writes it, but for physics
    recording: Path | None = None
    # write a page that runs the robot in any browser, for any web server, instead
    web: bool = False
    runs: Path = Path("runs")  # folder that holds all runs
    robot: OtherRobotConfig = field(default_factory=OtherRobotConfig)


def main(args: Sequence[str], prog: str = "quadwalk export") -> None:
    """Export the run that the arguments name, or check its export."""
    config = parse(ExportConfig, args, prog)
    runs = [find_ready(config.runs, which, "run") for which in config.run]
    robot = config.robot.find()
    console = make_console()
    if config.web:
        from quadwalk.web.robots import export_page

        getup = None if config.getup is None else find_any_run(config.runs, config.getup)
        out = config.out or get_results_folder(config.runs, runs[0]) / "page"
        export_page(runs, config.policy, out, getup, console, robot)
        return
    if len(runs) > 1:
        raise UsageError("several runs were given; expected one, or --web for a page of them all")
    run = runs[0]
    out = config.out or get_results_folder(config.runs, run) / "export"
    checked = config.check or config.recording is not None
    try:
        from quadwalk.export.bundle import export_run, load_flat
        from quadwalk.export.check import check_export
    except ModuleNotFoundError as error:
        if error.name not in ("onnx", "onnxruntime"):
            raise
        raise UserError(
            f"{error.name} is not installed; export needs: {suggest_install('export')}"
        ) from None
    if not checked or not (out / "policy.onnx").exists():
        console.print(f"exporting {describe_origin(config.runs, run)}")
        getup = None if config.getup is None else find_any_run(config.runs, config.getup)
        for path in export_run(run, config.policy, out, console, getup, robot):
            print(path)
    if checked:
        console.print(f"checking {config.recording or out}")
        check_export(load_flat(run, config.policy, robot), out, config.recording, console)
        print("no difference")
    else:
        console.print(f"see it run with: {quote_words(get_python(), out / 'run_policy.py')}")
