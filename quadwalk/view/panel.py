"""The panel of a page: what can be set, pressed and chosen, and the plots."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import viser
from viser import uplot

from quadwalk.view.live import MAX_LATENCY, LiveRobot, Settings
from quadwalk.view.stage import Stage
from quadwalk.view.traces import Traces

SPEEDS = {"1": 1.0, "1/2": 0.5, "1/4": 0.25, "1/10": 0.1}
_KEYS = (("W", "S"), ("Q", "E"), ("A", "D"))  # more and less of each number of a command
_COMMAND = ("forward, m/s (W S)", "to the left, m/s (Q E)", "turn left, rad/s (A D)")
# viser's keys for its camera are the same: it listens a floor above where its commands listen.
_KEEP_CAMERA = """<img src="data:," hidden onerror="
  const keys = ['KeyW', 'KeyA', 'KeyS', 'KeyD', 'KeyQ', 'KeyE'];
  const root = document.documentElement;
  if (!root.quadwalk) {
    root.quadwalk = true;
    root.addEventListener('keydown', event => keys.includes(event.code) && event.stopPropagation());
  }
">"""
_PRESSES = 10  # of a key, from 0 to the end of a command's range
_DARK, _BLUE, _GREEN = "#7d8590", "#326edc", "#3caa50"


@dataclass(frozen=True)
class Actions:
    """What the panel asks of its page; `ask` may be called in any of the server's threads."""

    ask: Callable[[Callable[[], None]], None]  # has what it is given called between control steps
    play: Callable[[], None]  # play or pause
    speed: Callable[[float], None]
    reset: Callable[[], None]
    run: Callable[[str], None]  # the label of a run
    policy: Callable[[str], None]  # of a policy


class Panel:
    """The panel for one live robot; made anew for another."""

    def __init__(
        self,
        server: viser.ViserServer,
        live: LiveRobot,
        stage: Stage,
        actions: Actions,
        runs: tuple[Sequence[str], str],
        policies: tuple[Sequence[str], str],
    ) -> None:
        """`runs` and `policies` are the labels to choose from, and the one that is driven."""
        server.gui.reset()
        self._gui, self._ask = server.gui, actions.ask
        self.status = server.gui.add_markdown("")
        self._add_buttons(stage, actions)
        self.command = self._add_command(live)
        self._add_push(live)
        self._add_ground(live, actions)
        self._settings = self._add_settings(live)
        with self._gui.add_folder("Policy"):
            self._choose("run", runs, actions.run)
            self.policies = self._choose("policy", policies, actions.policy)
        self._add_plots(live)
        self._add_keys(live, actions)
        self._gui.add_html(_KEEP_CAMERA)

    def settings(self) -> dict[str, float]:
        """What its sliders say, by the names of `Settings`."""
        percent = {"strength": 0.01, "latency": 0.001}
        return {name: _within(s) * percent.get(name, 1.0) for name, s in self._settings.items()}

    def commanded(self) -> np.ndarray:
        """(3,) the command that its sliders say."""
        return np.array([_within(slider) for slider in self.command])

    def plot(self, traces: Traces) -> None:
        count = len(self._speed.data)
        self._speed.data = traces.speed[:count]
        self._footfalls.data = traces.footfalls

    def _add_buttons(self, stage: Stage, actions: Actions) -> None:
        gui = self._gui
        play = gui.add_button_group("Time", ("play or pause", "reset"))
        chosen = {"play or pause": actions.play, "reset": actions.reset}
        self._when(play.on_click, lambda way: chosen[way]())
        speed = gui.add_button_group("Speed", tuple(SPEEDS))
        self._when(speed.on_click, lambda text: actions.speed(SPEEDS[text]))
        follow = gui.add_checkbox("camera follows", True)
        self._when(follow.on_update, lambda on: setattr(stage, "follow", on))
        shapes = gui.add_checkbox("collision shapes", False)
        self._when(shapes.on_update, stage.show_collision)

    def _add_command(self, live: LiveRobot) -> list[Any]:
        """A slider for each number of the command, over the range trained on."""
        config = live.env.config.command
        ranges = (config.forward, config.lateral, config.yaw_rate)
        with self._gui.add_folder("Command"):
            if not config.active:
                self._gui.add_markdown("This policy takes none: it runs along x.")
                return []
            sliders = [
                self._gui.add_slider(label, low, high, 0.01, 0.0)
                if low <= 0.0 <= high and low < high
                else self._gui.add_slider(label, low, max(high, low + 0.01), 0.01, low)
                for label, (low, high) in zip(_COMMAND, ranges, strict=True)
            ]
            stop = self._gui.add_button("Stop (space)")

        def command(_: float) -> None:
            live.command[:] = self.commanded()

        for slider in sliders:
            self._when(slider.on_update, command)
        self._when(stop.on_click, lambda _: self._set_command(0.0, 0.0, 0.0))
        return sliders

    def _set_command(self, *values: float) -> None:
        for slider, value in zip(self.command, values, strict=True):
            slider.value = round(float(np.clip(value, slider.min, slider.max)), 2)

    def _add_push(self, live: LiveRobot) -> None:
        ways = {"ahead": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
        with self._gui.add_folder("Push"):
            size = self._gui.add_slider("by, m/s", 0.1, 3.0, 0.1, 1.0)
            buttons = self._gui.add_button_group("to", tuple(ways))

        def push(way: str) -> None:
            forward, left = ways[way]
            live.push(forward * _within(size), left * _within(size))

        self._when(buttons.on_click, push)
        self._push = push
        with self._gui.add_folder("Fall"):
            over = self._gui.add_button("Throw over (T)")
        self._when(over.on_click, lambda _: live.throw())

    def _add_ground(self, live: LiveRobot, actions: Actions) -> None:
        """What to start on, where there is a choice: kinds of ground and their difficulties."""
        terrain = live.env.terrain
        if terrain is None or len(terrain.tiles) == 1:
            return
        names = [tile.kind.replace("_", " ") for tile in terrain.tiles]
        levels = [f"{tile.difficulty:g}" for tile in terrain.tiles]
        with self._gui.add_folder("Ground"):
            kind = self._gui.add_dropdown("kind", tuple(dict.fromkeys(names)))
            level = self._gui.add_dropdown("difficulty", tuple(dict.fromkeys(levels)))

        def start(_: str) -> None:
            places = list(zip(names, levels, strict=True))
            live.tile = places.index((kind.value, level.value))
            actions.reset()

        for dropdown in (kind, level):
            self._when(dropdown.on_update, start)

    def _add_settings(self, live: LiveRobot) -> dict[str, Any]:
        usual = Settings(friction=round(live.env.friction, 2))
        heaviest = float(round(0.4 * live.env.robot.mass))
        with self._gui.add_folder("Robot and floor"):
            add = self._gui.add_slider
            sliders = {
                "friction": add("friction", 0.1, 1.5, 0.05, usual.friction),
                "payload": add("payload, kg", -0.25 * heaviest, heaviest, 0.25, 0.0),
                "strength": add("motor strength, %", 50.0, 120.0, 1.0, 100.0),
                "latency": add("latency, ms", 0.0, 1000.0 * MAX_LATENCY, 1.0, 0.0),
                "noise": add("sensor noise, level", 0.0, 3.0, 0.1, 0.0),
            }
        for slider in sliders.values():
            self._when(slider.on_update, lambda _: live.change(**self.settings()))
        return sliders

    def _choose(self, label: str, choices: tuple[Sequence[str], str], chosen: Any) -> Any:
        labels, first = choices
        dropdown = self._gui.add_dropdown(label, tuple(labels), initial_value=first)
        self._when(dropdown.on_update, chosen)
        return dropdown

    def _add_plots(self, live: LiveRobot) -> None:
        traces = Traces(live.env.stepping.control_dt)
        command, legs = live.env.config.command, live.env.quadruped.legs
        series = [_line("s", _DARK), _line("forward, m/s", _BLUE), _line("command, m/s", _GREEN)]
        count = 3 if command.active else 2
        low, high = command.forward
        seconds = uplot.Scale(time=False)  # not of a day
        window = self._gui.add_panel()
        window.float(x=10, y=-10, width=380)
        with window.add_tab("the last seconds"):
            self._speed = self._gui.add_uplot(
                traces.speed[:count],
                tuple(series[:count]),
                scales={
                    "x": seconds,
                    "y": uplot.Scale(range=(low - 0.5, high + 0.5 if high else None)),
                },
                height=160,
            )
            self._footfalls = self._gui.add_uplot(
                traces.footfalls,
                (_line("s", _DARK), *(_line(leg, _DARK) for leg in legs)),
                title=f"feet on the floor, from the top: {' '.join(legs)}",
                scales={"x": seconds, "y": uplot.Scale(range=(-0.2, 4.0))},
                axes=(uplot.Axis(), uplot.Axis(show=False)),
                legend=uplot.Legend(show=False),
                height=140,
            )

    def _add_keys(self, live: LiveRobot, actions: Actions) -> None:
        def change(index: int, sign: int) -> None:
            slider = self.command[index]
            end = slider.max if sign > 0 else -slider.min
            values = list(self.commanded())
            values[index] += sign * max(end, 0.1) / _PRESSES
            self._set_command(*values)

        for index in range(len(self.command)):
            for key, sign in zip(_KEYS[index], (1, -1), strict=True):
                name = _COMMAND[index].partition(",")[0]
                label = f"{name}: {'more' if sign > 0 else 'less'}"
                self._key(label, key, partial(change, index, sign))
        self._key("play or pause", "K", actions.play)
        self._key("throw over", "T", live.throw)
        self._key("reset", "R", actions.reset)
        self._key("push to the left", "P", lambda: self._push("left"))
        if self.command:
            self._key("stop", "space", lambda: self._set_command(0.0, 0.0, 0.0))
            fastest = self.command[0].max  # straight ahead
            self._key("gallop", "W", lambda: self._set_command(fastest, 0.0, 0.0), "shift")

    def _when(self, register: Callable[..., Any], action: Callable[[Any], None]) -> None:
        """Have `action` called with the value of a control that `register` listens to."""
        register(lambda event: self._ask(partial(action, event.target.value)))

    def _key(self, label: str, key: Any, action: Callable[[], None], modifier: Any = None) -> None:
        async def pressed(_: Any) -> None:  # in the server's own thread: in the order of the keys
            self._ask(action)

        self._gui.add_command(label, hotkey=key, modifier=modifier).on_trigger(pressed)


def _line(label: str, color: str) -> uplot.Series:
    return uplot.Series(label=label, stroke=color, width=1.5)


def _within(slider: Any) -> float:
    """Its value, between its ends: a client can send any number, NaN too."""
    return min(max(slider.min, slider.value), slider.max)
