"""What `eval.py` can be asked for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quadwalk.errors import UsageError, check_port

Engine = Literal["fast", "mjx", "mujoco"]


@dataclass(frozen=True)
class EvalConfig:
    """Roll a trained policy out, measure it, and write its episodes as MCAP files.

    Several runs are judged from the same starts and compared.
    """

    # names or paths of runs, or "latest"; walk and run come trained
    run: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = (
        "latest",
    )
    episodes: int = 16  # how many, each from another start; in a sweep, for each of its points
    seconds: float = 20.0  # s, the time limit of an episode
    # what steps the physics: mjx; mujoco, MuJoCo C with every shape colliding and a converged
    # solver, compared with mjx where the ground is flat; or fast, the engine trained in
    engine: Engine = "mjx"
    # each episode under conditions drawn as in training: friction, loads, motors, delays, noise,
    # pushes; otherwise the robot is as its model says and nothing disturbs it
    randomised: bool = False
    policy: Literal["last", "best"] = "last"  # the run's last, or that of its best checkpoint
    seed: int = 0  # of the starts and the ground; the same seed gives the same episodes
    # where the ground is uneven: episodes of each kind at each difficulty, for the table and the
    # picture of these; 0: without them
    cell: int = 16
    levels: int = 3  # difficulties in these, evenly from the least trained on to the greatest
    out: Path | None = None  # folder for the results; None: a new one in the run's
    mcap: int | None = None  # of the episodes, how many to write as MCAP; None: the first 16
    video: Literal["none", "gif", "mp4"] = "none"  # 3 s of it running; mp4 needs ffmpeg
    # in place of all that: the share of episodes without a fall as friction, mass, motors, gains,
    # delays, pushes and sensor noise vary, one by one and all at once
    sweep: bool = False
    # in place of all that: drive it live, in MuJoCo's window or, without a screen, in a page
    view: bool = False
    browser: bool = False  # drive it live in a page of the browser, whatever screen there is
    host: str = "127.0.0.1"  # address that the page is served at: this machine alone
    port: int = 8080  # of the page; if it is taken, the next that is free
    runs: Path = Path("runs")  # folder that holds all runs

    def __post_init__(self) -> None:
        if not self.run:
            raise UsageError("no run is named; expected names or paths of runs, or nothing")
        if self.episodes < 1:
            raise UsageError(f"--episodes is {self.episodes}; expected 1 or more")
        if not 0.0 < self.seconds <= 3600.0:
            raise UsageError(f"--seconds is {self.seconds}; expected more than 0, up to 3600")
        if self.engine not in ("fast", "mjx", "mujoco"):
            raise UsageError(f"--engine is {self.engine!r}; expected fast, mjx or mujoco")
        if not 0 <= self.seed < 2**32:
            raise UsageError(f"--seed is {self.seed}; expected 0 to {2**32 - 1}")
        if self.mcap is not None and self.mcap < 0:
            raise UsageError(f"--mcap is {self.mcap}; expected 0 or more")
        if self.cell < 0:
            raise UsageError(f"--cell is {self.cell}; expected 0 or more")
        if self.levels < 1:
            raise UsageError(f"--levels is {self.levels}; expected 1 or more")
        if self.live and len(self.run) > 1:
            raise UsageError(f"--view shows one run; {len(self.run)} are named")
        check_port(self.port)
        if self.sweep:
            self._check_sweep()

    @property
    def recordings(self) -> int:
        """How many episodes to write as MCAP at most: each takes a third of a second and 1 MB."""
        return 16 if self.mcap is None else self.mcap

    @property
    def live(self) -> bool:
        """Whether it is to be driven, not judged."""
        return self.view or self.browser

    def _check_sweep(self) -> None:
        asked = {
            "--mcap": self.mcap is not None,
            "--video": self.video != "none",
            "--view": self.live,
            "--randomised": self.randomised,
        }
        for flag, given in asked.items():
            if given:
                raise UsageError(
                    f"{flag} cannot be given with --sweep, which records no episodes "
                    "and has conditions of its own"
                )
