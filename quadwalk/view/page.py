"""A page of the browser in which a robot runs live, to be driven."""

import queue
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path

import viser

from quadwalk.errors import UserError
from quadwalk.runs.directory import Run, get_modified_time
from quadwalk.view import choices
from quadwalk.view.live import LiveRobot
from quadwalk.view.pace import Pace
from quadwalk.view.panel import Actions, Panel
from quadwalk.view.stage import Stage
from quadwalk.view.traces import Traces

_FRAME, _PLOT, _STATUS, _LOOK = 1 / 30, 1 / 6, 1 / 4, 1.0  # s between pictures, plots, ...
_REST = 0.002  # s, of sleep between looks at the clock


class Page:
    """A live robot in the pages of `server`, which `run_for` steps in real time.

    Requests come in threads of the server and are done between two control steps.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        run: Run,
        root: Path,
        label: str = choices.LAST,
        getup: Run | None = None,
    ) -> None:
        """`root` has the other runs, `label` is a policy of `run`, `getup` gets fallen ones up."""
        self._getup = getup
        self._server, self._root, self._chosen = server, root, run
        self._asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.playing = True
        self._due = dict.fromkeys((_FRAME, _PLOT, _STATUS, _LOOK), 0.0)
        self._open(run, label)

    def run_for(self, seconds: float = float("inf")) -> None:
        """Step, draw and answer for so many seconds on the wall."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            while not self._asked.empty():
                try:
                    self._asked.get()()
                except UserError as error:
                    self._tell(str(error))
                except Exception as error:  # whatever a client sent that no page of ours would
                    self._tell(f"{type(error).__name__}: {error}")
            for _ in range(self.pace.due() if self.playing else 0):
                began = time.perf_counter()
                self.live.step()
                self.pace.done(time.perf_counter() - began)
                self.traces.add(self.live)
            self._show()
            time.sleep(_REST)

    def _open(self, run: Run, label: str) -> None:
        """Show another run's robot, driven by the policy called `label`."""
        loaded = choices.open_run(run, label)
        self.run, self.label, self.file = run, label, loaded.file
        self._loaded = get_modified_time(loaded.file)
        self.live = LiveRobot(loaded, getup=choices.getup_of(loaded, self._getup))
        # The step is compiled meanwhile.
        ready = threading.Thread(target=self.live.prepare)
        ready.start()
        dt = self.live.env.stepping.control_dt
        self.pace, self.traces = Pace(dt), Traces(dt)
        self.stage = Stage(self._server, self.live)
        runs = choices.run_choices(self._root, self._chosen)
        self._policies = list(choices.policy_choices(run))
        self.panel = Panel(
            self._server,
            self.live,
            self.stage,
            self._actions(runs),
            (list(runs), choices.label_of(self._root, run)),
            (self._policies, label),
        )
        self.live.command[:] = self.panel.commanded() if self.panel.command else 0.0
        ready.join()
        self.pace.restart()

    def _actions(self, runs: dict[str, Run]) -> Actions:
        def play() -> None:
            self.playing = not self.playing
            self.pace.restart()

        def speed(value: float) -> None:
            self.pace.speed = value
            self.pace.restart()

        def reset() -> None:
            self.live.reset()
            self.traces.clear()

        return Actions(
            ask=self._asked.put,
            play=play,
            speed=speed,
            reset=reset,
            run=lambda label: self._open(runs[label], choices.LAST),
            policy=self._take,
        )

    def _take(self, label: str) -> None:
        """Let another of the run's policies drive on."""
        file = choices.choose_policy(self.run, label)
        when = get_modified_time(file)
        self.live.policy = choices.read_policy(file, self.live.env.quadruped.joints)
        self.label, self.file, self._loaded = label, file, when
        self.pace.restart()

    def _look(self) -> None:
        """Take the policy anew if training has written it, and list new checkpoints."""
        if get_modified_time(self.file) != self._loaded and self.file.exists():
            self._take(self.label)
        policies = list(choices.policy_choices(self.run))
        if policies and policies != self._policies:  # none where its folder is gone
            self._policies = policies
            self.panel.policies.options = policies

    def _show(self) -> None:
        if self._now(_FRAME):
            self.stage.draw(self.live, self.traces)
        if self._now(_PLOT) and self.playing:
            self.panel.plot(self.traces)
        if self._now(_STATUS):
            self.panel.status.content = self.status()
        if self._now(_LOOK):
            try:
                self._look()
            except UserError as error:  # it may be gone, or half of it on another file system
                self._tell(str(error))

    def status(self) -> str:
        """What the page says first: policy, speed, and whether real time is kept."""
        live, pace = self.live, self.pace
        name = _verbatim(self.run.name)
        lines = [
            f"**{name}**, {self.label}, {live.policy.steps:,} steps of training",
            f"{live.time:.1f} s, {live.velocity[0]:.2f} m/s"
            + (", **getting up**" if live.rising else ", **fallen**" if live.fell else ""),
        ]
        if not self.playing:
            lines.append("paused")
        elif not pace.kept:
            lines.append(
                f"**not in real time**: {pace.reached:.2f} s in a second, not {pace.speed:g}"
            )
        else:
            slowed = "" if pace.speed == 1.0 else f", slowed to {pace.speed:g}"
            lines.append(f"real time{slowed}; {pace.most:.0f} times as fast is possible")
        return "  \n".join(lines)

    def _now(self, period: float) -> bool:
        """Whether `period` has gone since this was last true."""
        now = time.monotonic()
        if now < self._due[period]:
            return False
        self._due[period] = now + period
        return True

    def _tell(self, text: str) -> None:
        for client in self._server.get_clients().values():
            client.add_notification("quadwalk", text, auto_close_seconds=10.0)


def _verbatim(text: str) -> str:
    """Markdown that shows `text` as it is: in a page Markdown may hold HTML, scripts too."""
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", " ".join(text.split()))
