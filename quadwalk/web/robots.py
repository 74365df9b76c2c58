"""The robots of a page: runs of this machine, loaded and converted when the page asks for them."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from rich.console import Console

from quadwalk.cli.shell import get_python, quote_words
from quadwalk.errors import UsageError, UserError
from quadwalk.evaluation.load import LoadedRun, find_robot_for, load_run
from quadwalk.files import make_folder, open_atomic
from quadwalk.learn.acting import load_checkpoint_policy, load_policy
from quadwalk.learn.devices import set_up_devices
from quadwalk.paths import PRETRAINED
from quadwalk.runs.changes import STEPS
from quadwalk.runs.directory import Run, list_checkpoints
from quadwalk.settings.training import RobotConfig
from quadwalk.terrain.terrain import FLAT
from quadwalk.web import site
from quadwalk.web.actor import PythonActor
from quadwalk.web.serve import Actor, Content

# They get robots up where no other run is named for that: the AlienGo, and any other.
GETUPS = [Run(PRETRAINED / "getup"), Run(PRETRAINED / "universal_getup")]
SECONDS = 3600.0  # of an episode: the page's has no end


def load(run: Run, which: str, robot: RobotConfig | None = None) -> LoadedRun:
    """Load the policy `which` of `run`, "last" or "best", for a flat floor.

    A policy of many bodies may drive another `robot`.
    """
    return load_run(run, SECONDS, which, "mujoco", ground=FLAT, robot=robot)


class LiveSite:
    """The files of a page that this machine serves, with `run` first."""

    def __init__(
        self,
        run: Run,
        which: str,
        getup: Run | None,
        others: list[Run],
        robot: RobotConfig | None = None,
    ) -> None:
        """Load a run, with another `robot` if named; `others` when the page asks for them."""
        set_up_devices(1)
        self._run, self._which, self._robot = run, which, robot
        self._first = load(run, which, robot)
        self.notes = self._first.notes if robot else ()  # lines on the other robot
        self._is_remote = site.is_python_needed(self._first)
        self._getup = getup
        self.files: dict[str, Content] = {}
        dog = make_dog(self._first, getup, self._is_remote)
        for label, file in list_policies(run).items():
            name = site.make_policy_name(f"{run.name}.{file.stem}")
            dog.policies[label] = name
            self.files[name] = partial(convert, self._first, file)
        # Files are called by runs: of two runs of one name the first is shown.
        rest = {other.name: other for other in reversed(others) if other.name != run.name}
        for name, other in rest.items():
            self.files[site.make_entry_name(name)] = partial(self._add, other)
        ground = site.make_ground(self._first.env)
        self.files |= site.make_site([dog], ground, live=True, others=reversed(rest))

    def _add(self, run: Run) -> bytes:
        """Load another run, add its files, and return the first that the page reads.

        Raises `UserError` where it cannot be loaded or needs Python.
        """
        loaded = load(run, "last")
        site.check_shareable(loaded)
        dog = make_dog(loaded, self._getup)
        self.files |= dog.files
        return dog.to_json()

    @property
    def make_actor(self) -> Callable[[], Actor] | None:
        """Function that makes an actor for one page; None where the policy needs no Python."""
        return partial(PythonActor, self._first) if self._is_remote else None

    def add_comparison(self, get_changes: Callable[[], list[dict[str, Any]]]) -> None:
        """Add the policies from before the last change at a training's desk, and of now.

        `get_changes` returns the changes that hold, each with the control steps before it.
        """

        def convert_before() -> bytes:
            changes = [change for change in get_changes() if change["name"] != STEPS]
            if not changes:
                raise UserError("nothing has been changed at the desk yet")
            path = self._run.locate_checkpoint(changes[-1]["steps"])
            return convert(self._first, path)

        self.files[site.make_policy_name("desk/before")] = convert_before
        after = site.make_policy_name("desk/after")
        self.files[after] = lambda: convert(self._first, self._run.policy)

    def load_newest(self) -> bytes:
        """Load the newest policy of the run; return it as the page reads it."""
        self._first = load(self._run, self._which, self._robot)
        policy = site.pack_policy(self._first)
        name = site.make_policy_name(self._run.name)
        self.files[name] = policy  # for pages that come back to it
        return policy


def export_page(
    runs: list[Run],
    which: str,
    out: Path,
    getup: Run | None,
    console: Console,
    robot: RobotConfig | None = None,
) -> None:
    """Write a page with these runs to the folder `out`, or to one file whose name ends in .html.

    Raises `UserError` where a policy cannot act without Python.
    """
    files = make_files(runs, which, getup, robot)
    if out.suffix == ".html":
        content = site.to_single_file(files)
        make_folder(out.parent)
        with open_atomic(out) as file:
            file.write(content)
        console.print(f"written to {out}: {len(content) / 1e6:.1f} MB, opens by double-click")
        return
    make_folder(out)
    site.write_folder(files, out)
    size = sum(map(len, files.values())) / 1e6
    console.print(f"written to {out}: {len(files)} files, {size:.1f} MB, for any web server")
    console.print(f"try it: {quote_words(get_python(), '-m', 'http.server', '-d', out)}")


def make_files(
    runs: list[Run], which: str, getup: Run | None = None, robot: RobotConfig | None = None
) -> dict[str, bytes]:
    """Return the files, by name, of a page that runs the policies of `runs` without Python.

    `which` policy of each run it is: "last" or "best". `getup` is the run that gets robots up;
    None: a packaged one. Policies of many bodies drive another `robot`, if named. Raises
    `UserError` where a policy cannot act without Python, and `UsageError` for two runs of one name.
    """
    names = [run.name for run in runs]
    if len(set(names)) < len(names):
        raise UsageError(f"two runs have the same name: {', '.join(names)}; expected other names")
    set_up_devices(1)
    dogs = []
    for run in runs:
        loaded = load(run, which, robot)
        site.check_shareable(loaded)
        dogs.append(make_dog(loaded, getup))
    return site.make_site(dogs, site.make_ground(loaded.env))


def list_policies(run: Run) -> dict[str, Path]:
    """Return the files of a run's other policies by label: the best, and its checkpoints."""
    policies = {"best": run.best} if run.best.exists() else {}
    for path in reversed(list_checkpoints(run)):
        policies[f"{int(path.stem.removeprefix('step_')):,} steps"] = path
    return policies


def convert(loaded: LoadedRun, file: Path) -> bytes:
    """Return another policy of a run as the page reads it, from its file or its checkpoint's."""
    if file.name.startswith("step_"):
        policy = load_checkpoint_policy(file, loaded.env.quadruped.joints)
    else:
        policy = load_policy(file)
    return site.pack_policy(replace(loaded, file=file, policy=policy))


def make_dog(loaded: LoadedRun, getup: Run | None, remote: bool = False) -> site.Dog:
    """Return a run's robot for the page, with the policy that gets it up."""
    return site.make_dog(loaded, load_getup(loaded, getup), remote)


def load_getup(loaded: LoadedRun, getup: Run | None) -> LoadedRun | None:
    """Load another policy that gets the robot of `loaded` up; return None where none does.

    It is that of the run `getup`; if that is None, the first of `GETUPS` that has this robot.
    """
    for run in GETUPS if getup is None else [getup]:
        riser = load_once(run, find_robot_for(run, loaded))
        if loaded.has_same_robot(riser):
            return None if run.path == loaded.run.path else riser
    return None


@lru_cache(maxsize=4)
def load_once(run: Run, robot: RobotConfig | None) -> LoadedRun:
    """Load the last policy of `run` as `load` does; several robots of a page share it."""
    return load(run, "last", robot)
