"""The parts of the live view, each drawn for a terminal of a given width."""

import math
from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from quadwalk.train.progress.state import State
from quadwalk.train.progress.text import duration, number, percent, quantity, sparkline

_SHARE = 8  # characters of the bar beside a reward term


def line(*parts: tuple[str, str] | str) -> Text:
    """One line, cut off with an ellipsis where the terminal ends."""
    return Text.assemble(*parts, no_wrap=True, overflow="ellipsis")


def bar(state: State, width: int) -> RenderableType:
    details = [f"{100 * state.fraction:3.0f} %", f"{duration(state.seconds_left)} left"]
    if width >= 60:
        details.insert(1, f"{quantity(state.rate)} steps/s")
    if width >= 76:
        details.insert(1, f"{quantity(state.steps)} of {quantity(state.total_steps)} steps")
    text = "  " + "   ".join(details)
    length = max(4, min(60, width - len(text)))
    row = Table.grid()
    row.add_row(
        ProgressBar(
            total=1.0,
            completed=state.fraction,
            width=length,
            complete_style="cyan",
            finished_style="green",
        ),
        Text(text, no_wrap=True),
    )
    return row


def figures(state: State, width: int) -> RenderableType:
    speed, falls = state.get("train/speed"), state.get("train/fall_rate")
    room = min(40, width - 22)
    lines = [
        line(
            _label("speed"),
            (f"{number(speed):>7}", "bold"),
            (" m/s  ", "dim"),
            (sparkline(state.speeds, room), "cyan"),
        ),
        line(
            _label("falls"),
            (f"{percent(falls, unit=False):>7}", "bold"),
            (" % of episodes", "dim"),
        ),
        line(_label("reward"), (f"{number(state.get('train/reward')):>7}", "bold")),
    ]
    if "eval/speed" in state.metrics:
        lines.append(
            line(
                _label("tested"),
                (f"{number(state.get('eval/speed')):>7}", "bold"),
                (" m/s  ", "dim"),
                f"{percent(state.get('eval/fall_rate'))} falls",
            )
        )
    if state.get("train/nan") > 0:
        count = f"{quantity(state.get('train/nan')):>7}"
        lines.append(
            line(_label("NaN"), (count, "bold yellow"), (" states, episodes ended", "dim"))
        )
    return Group(*lines)


def _label(name: str) -> tuple[str, str]:
    return f"{name:<8}", "dim"


def terms(terms: Mapping[str, float], width: int) -> RenderableType:
    """The reward's terms in as many columns as fit, each with a bar of its share."""
    longest = min(max(map(len, terms)), max(6, width - 12))
    cell = longest + 1 + 7 + 1 + _SHARE + 3
    columns = max(1, min(3, width // cell, math.ceil(len(terms) / 2)))
    rows = math.ceil(len(terms) / columns)
    largest = max((abs(value) for value in terms.values() if math.isfinite(value)), default=0.0)
    cells = [_term(name, value, largest, longest) for name, value in terms.items()]
    table = Table.grid(padding=(0, 3, 0, 0))
    for row in range(rows):
        # Down, then across: neighbours stay neighbours.
        table.add_row(*cells[row::rows])
    return table


def _term(name: str, value: float, largest: float, longest: int) -> Text:
    share = abs(value) / largest if math.isfinite(value) and largest > 0 else 0.0
    length = math.ceil(share * _SHARE) if value else 0
    return line(
        (f"{name[:longest]:<{longest}} ", "dim"),
        f"{number(value):>7} ",
        (f"{'■' * length:<{_SHARE}}", "green" if value > 0 else "red"),
    )
