"""The options of `eval.py`."""

from collections.abc import Set
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quadwalk.bounds import Bounds, Count, Few, Natural, Port, Seed, Settings
from quadwalk.errors import UsageError

Engine = Literal["fast", "mjx", "mujoco"]

# What a sweep and a live robot make use of.
_SWEEP = {"run", "episodes", "seconds", "engine", "policy", "seed", "out", "sweep", "runs"}
_LIVE = {"run", "policy", "view", "browser", "host", "port", "runs"}


@dataclass(frozen=True)
class EvalConfig(Settings):
    """Roll a trained policy out, measure it, and write its episodes as MCAP files.

    Several runs are evaluated from the same starts and compared.
    """

    # names or paths of runs, or "latest"; run, walk, drive, getup and rough come trained
    run: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = (
        "latest",
    )
    episodes: Count = 16  # how many, each from another start; in a sweep, for each of its points
    # s, the time limit of an episode
    seconds: Annotated[float, Bounds(0.0, 3600.0, open="low", unit="s")] = 20.0
    # what steps the physics: mjx; mujoco, MuJoCo C with every shape colliding and a converged
    # solver, compared with mjx where the ground is flat; or fast, the engine trained in
    engine: Engine = "mjx"
    # each episode under conditions drawn as in training: friction, loads, motors, delays, noise,
    # pushes; otherwise the robot is as its model says and nothing disturbs it
    randomized: bool = False
    policy: Literal["last", "best"] = "last"  # the run's last, or that of its best checkpoint
    seed: Seed = 0  # of the starts and the ground; the same seed gives the same episodes
    # where the ground is uneven: episodes of each kind at each difficulty, for the table and the
    # picture of these; of a robot that starts in any pose: of each condition, for the table of how
    # soon it stands in MuJoCo C; of a robot that is driven: of each four commands, for the picture
    # of how it follows them in MuJoCo C; 0: without them
    cell_episodes: Natural = 16
    levels: Few = 3  # difficulties in these, evenly from the least trained on to the greatest
    # folder for the results; None: a new one in the run's
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    mcap: Natural | None = None  # of the episodes, how many to write as MCAP; None: the first 16
    video: Literal["none", "gif", "mp4"] = "none"  # 3 s of it running; mp4 needs ffmpeg
    # in place of all that: the share of episodes without a fall as friction, mass, motors, gains,
    # delays, pushes and sensor noise vary, one by one and all at once
    sweep: bool = False
    # in place of all that: drive it live, in MuJoCo's window or, without a screen, in a page
    view: bool = False
    browser: bool = False  # drive it live in a page of the browser, whatever screen there is
    host: str = "127.0.0.1"  # address that the page is served at: this machine alone
    port: Port = 8080  # of the page; if it is taken, the next that is free
    runs: Path = Path("runs")  # folder that holds all runs

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.run:
            raise UsageError("no run; expected names or paths of runs, or nothing")
        if self.live and len(self.run) > 1:
            raise UsageError(f"{len(self.run)} runs with --view; expected one")
        if self.sweep:
            self._check_used("with --sweep", _SWEEP)
        elif self.live:
            self._check_used(f"with --{'browser' if self.browser else 'view'}", _LIVE)
        else:
            self._check_used("without --view", {f.name for f in fields(self)} - {"host", "port"})

    @property
    def recordings(self) -> int:
        """How many episodes to write as MCAP at most: each takes a third of a second and 1 MB."""
        return 16 if self.mcap is None else self.mcap

    @property
    def live(self) -> bool:
        """Whether it is to be driven, not evaluated."""
        return self.view or self.browser

    def _check_used(self, when: str, used: Set[str]) -> None:
        for field in fields(self):
            if field.name not in used and getattr(self, field.name) != field.default:
                raise UsageError(
                    f"--{field.name.replace('_', '-')} has no effect {when}; expected without it"
                )
