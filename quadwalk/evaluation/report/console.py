"""What an evaluation prints: tables and the gait on standard output, how far it is meanwhile."""

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from quadwalk.evaluation.motion.gait import Gait
from quadwalk.evaluation.statistics import figure_mean
from quadwalk.evaluation.summary import FIGURES, engine_differences, engines_of
from quadwalk.settings.environment import COMMANDED

_NONE = "-"
# What the table of a sweep shows beside success, of what there is.
_SWEPT = {
    "speed": "speed, m/s",
    "heading_error": "heading error, deg",
    "velocity_error": "velocity error, m/s",
    "yaw_rate_error": "yaw rate error, rad/s",
}


def print_summary(summary: dict[str, Any], title: str) -> None:
    """Falls and figures of one run's episodes."""
    falls = summary["fall_rate"] * summary["episodes"]
    share, interval = _falls(summary)
    rows: list[Sequence[str]] = [(f"falls ({falls:.0f} episodes)", share, interval, "", "", "%")]
    for name, heading, unit in _figures(summary):
        figure = summary[name]
        texts = [_text(figure and figure[key]) for key in ("mean", "ci95", "median", "worst")]
        rows.append((heading, *texts, unit))
    print_table(title, ("", "mean", "± 95 %", "median", "worst", "unit"), rows)


def print_engines(mjx: dict[str, Any], mujoco: dict[str, Any]) -> None:
    """Two engines' summaries side by side, and their `engine_differences`."""
    differences = engine_differences(mjx, mujoco)
    falls = 100 * differences["fall_rate"]["difference"]
    rows = [("falls", _falls_text(mjx), _falls_text(mujoco), f"{falls:+z.1f}", "", "%")]
    for name, heading, unit, _ in FIGURES:
        if name in differences:
            texts = (figure_text(mjx[name]), figure_text(mujoco[name]))
            change = _text(differences[name]["difference"], "+z.3f")
            percent = _text(differences[name]["percent"], "+z.1f", " %")
            rows.append((heading, *texts, change, percent, unit))
    headings = ("", "MJX", "MuJoCo C", "difference", "of MJX's", "unit")
    print_table("MuJoCo C against MJX, the same starts", headings, rows)


def print_comparison(labels: Sequence[str], results: Sequence[dict[str, Any]]) -> None:
    """Metrics of runs from the same starts side by side, one column each."""
    summaries = [result["summary"] for result in results]
    rows = [
        ("training", *(f"{result['training_steps']:,}" for result in results), "steps"),
        ("falls", *map(_falls_text, summaries), "%"),
    ]
    for name, heading, unit in _figures(*summaries):
        # A run may have been trained without some of the terms.
        rows.append((heading, *(figure_text(each.get(name)) for each in summaries), unit))
    rows.append(("gait", *(result["typical_episode"]["gait"] for result in results), ""))
    title = (
        f"{summaries[0]['episodes']} episodes each from the same starts, engine "
        f"{engines_of(results)}, mean ± 95 %"
    )
    print_table(title, ("", *labels, "unit"), rows)


def print_sweep(results: dict[str, Any]) -> None:
    """Success, speed and tracking at each point of each sweep; a star marks the model's value."""
    shown = {name: heading for name, heading in _SWEPT.items() if name in results["nominal"]}
    rows: list[Sequence[str] | None] = []
    for sweep in results["sweeps"].values():
        heading = sweep["heading"] + (f", {sweep['unit']}" if sweep["unit"] else "")
        for number, point in enumerate(sweep["points"]):
            low, high = (100 * end for end in point["success_ci95"])
            star = "*" if point["value"] == sweep["nominal"] else " "
            success = f"{100 * point['success']:.0f} ({low:.0f} to {high:.0f})"
            name = "" if number else heading
            figures = [figure_text(point[figure]) for figure in shown]
            rows.append((name, f"{point['value']:g}{star}", success, *figures))
        rows.append(None)
    title = f"{results['run']}: {results['episodes']} episodes at each point, mean ± 95 %, "
    headings = ("", "value", "success, %", *shown.values())
    print_table(f"{title}* the model's", headings, rows)


def print_by_ground(results: dict[str, Any]) -> None:
    """Success, speed and error on each kind of ground, the difficulties side by side."""
    levels = len(results["difficulties"])
    rows: list[Sequence[str] | None] = []
    for index, kind in enumerate(results["kinds"]):
        cells = results["cells"][index * levels : (index + 1) * levels]
        shares = (f"{100 * cell['success']:.0f}" for cell in cells)
        rows.append((kind.replace("_", " "), *shares, "% success"))
        rows.append(("", *(f"{100 * cell['arrived']:.0f}" for cell in cells), "% arrival"))
        rows.append(("", *(figure_text(cell["speed"]) for cell in cells), "m/s"))
        if results["command"] is not None:
            errors = (figure_text(cell["velocity_error"]) for cell in cells)
            rows.append(("", *errors, "m/s off"))
        rows.append(None)
    command = "" if results["command"] is None else f" at a command of {results['command']:g} m/s"
    title = (
        f"ground that training did not have,{command} {results['episodes']} episodes each; "
        "success: no fall before the tile's edge or the time limit, arrival: reached the edge"
    )
    headings = ("", *(f"difficulty {x:.2g}" for x in results["difficulties"]), "unit")
    print_table(title, headings, rows)


def print_standing(results: dict[str, Any]) -> None:
    """The share of robots that stand so long after the start, under each condition."""
    rows = []
    for found in results["conditions"]:
        low, high = (100 * end for end in found["success_ci95"])
        after = [100 * share for name, share in found.items() if name.startswith("standing_")]
        rows.append((found["name"], *(f"{x:.1f}" for x in after), f"{low:.1f} to {high:.1f}"))
    title = f"standing in MuJoCo C, of {results['episodes']} random poses"
    print_table(title, ("", "after 2 s, %", "after 3 s, %", "after 6 s, %", "95 % at 3 s"), rows)


def print_steering(results: dict[str, Any]) -> None:
    """The commands that are followed worst, and how soon changes of the command are."""
    cells = sorted(
        results["cells"],
        key=lambda cell: -np.nan_to_num(figure_mean(cell["velocity_error"]), nan=9.0),
    )
    rows: list[Sequence[str] | None] = []
    for cell in cells[:6]:
        forward, _, turn = cell["command"]
        off = figure_text(cell["velocity_error"]), figure_text(cell["yaw_rate_error"])
        success = f"{100 * cell['success']:.0f}"
        rows.append((f"{forward:zg} m/s, {turn:zg} rad/s", success, *off))
    title = f"the six of {len(cells)} commands followed worst, {results['episodes']} episodes each"
    print_table(title, ("command", "success, %", "m/s off", "rad/s off"), rows)
    rows = []
    for each in results["responses"]:
        which = COMMANDED.index(each["part"])
        change = f"{each['before'][which]:z.3g} to {each['after'][which]:z.3g}"
        unit = "rad/s" if each["part"] == "yaw_rate" else "m/s"
        shares = (f"{100 * (each[name] or 0.0):.0f}" for name in ("overshoot", "falls"))
        rows.append((f"{change} {unit}", _text(each["time"], ".2f"), *shares))
    print_table("changes of the command", ("", "s", "overshoot, %", "falls, %"), rows)
    for name, how in (("standing", ""), ("standing_without_creep", " without creep of the soles")):
        still = results[name]
        if still["most"] is not None:
            mean, most = (1e3 * x for x in (still["moved"]["mean"], still["most"]))
            print_text(
                f"at the command to stand{how} the trunk moves by {mean:.1f} mm in the mean of "
                f"{results['episodes']} episodes, by {most:.1f} mm at most"
            )
    long = results["changing"]
    low, high = (100 * end for end in long["success_ci95"])
    print_text(
        f"{100 * long['success']:.1f} % ({low:.1f} to {high:.1f}) of {long['episodes']} episodes "
        f"of {long['seconds']:g} s end without a fall, randomized, with commands that change"
    )


def describe_gait(gait: Gait, episode: int) -> str:
    """The gait of one episode in a line or two; "-" for what a robot that stands has not."""
    # Of the feet that have any.
    swing, slip = 100 * np.fmin.reduce(gait.swing_height), 100 * np.fmax.reduce(gait.slip_share)
    return (
        f"gait of episode {episode}: {gait.gait}, {_text(gait.stride_frequency, '.2f')} strides/s "
        f"of {_text(gait.stride_length, '.2f')} m, "
        f"duty factor {_text(np.mean(gait.duty_factor), '.2f')}, "
        f"swing height {_text(swing, '.1f')} cm or more, "
        f"slip up to {_text(slip, '.1f')} % of the distance, "
        f"cost of transport {_text(gait.cost_of_transport, '.2f')}\n"
        f"of their limits, at most: torque {_text(100 * np.max(gait.torque_peak), '.0f')} %, "
        f"joint speed {_text(100 * np.max(gait.joint_speed_peak), '.0f')} %; "
        f"actions change at {_text(gait.action_rate, '.1f')}/s (root mean square; they are in "
        "[-1, 1])"
    )


def figure_text(figure: dict[str, Any] | None) -> str:
    """A figure of a summary as "mean ± half its 95 % interval"; "-" where there is none."""
    if figure is None:
        return _NONE
    # As many decimals as leave the mean four digits, up to three.
    decimals = 3 - min(len(f"{abs(figure['mean']):.0f}") - 1, 3)
    text = f"{figure['mean']:z.{decimals}f}"  # z: never -0.000
    return text if figure["ci95"] is None else f"{text} ± {figure['ci95']:.{decimals}f}"


@contextlib.contextmanager
def simulating(
    console: Console, what: str, steps: int, dt: float
) -> Iterator[Callable[[int], None]]:
    """Show a line about `what`, episodes of up to `steps` control steps of `dt` s, while it runs.

    Yields the function to call with the steps done; when all episodes end early, that is the end.
    """
    with console.status(f"{what}: compiling (up to half a minute, the first time)") as status:
        first: tuple[float, int] | None = None

        def report(done: int) -> None:
            nonlocal first
            now = time.monotonic()
            if first is None or done <= first[1]:  # before it came compilation, or other episodes
                first = (now, done)
                left = ""
            else:
                pace = (now - first[0]) / (done - first[1])
                left = f", {pace * max(steps - done, 0):.0f} s left"
            status.update(f"{what}: {min(done, steps) * dt:.0f} of {steps * dt:g} s{left}")

        yield report


def _figures(*summaries: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Name, heading and unit of the figures in any of the summaries, then of the reward's terms."""
    names = dict.fromkeys(name for summary in summaries for name in summary)
    terms = [name for name in names if name.startswith("reward/")]
    rows = [row[:3] for row in FIGURES if row.name in names]
    return [*rows, *((name, f"  {name.partition('/')[2]}", "") for name in terms)]


def _falls(summary: dict[str, Any]) -> tuple[str, str]:
    """The share of falls in percent, and its 95 % interval."""
    low, high = (100 * end for end in summary["fall_rate_ci95"])
    return f"{100 * summary['fall_rate']:.1f}", f"{low:.0f} to {high:.0f}"


def _falls_text(summary: dict[str, Any]) -> str:
    return "{} ({})".format(*_falls(summary))


def _text(value: float | None, form: str = "z.3f", unit: str = "") -> str:
    return _NONE if value is None or math.isnan(value) else f"{value:{form}}{unit}"


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str] | None]) -> None:
    """Print a table on standard output, its names and units to the left; None draws a line.

    Names and headings may take several lines, but no word is broken. Where the terminal is too
    narrow for that, the frame goes, and then lines are longer than it is wide.
    """
    rows = list(rows)
    console = _console()
    columns = list(zip(headings, *(row for row in rows if row is not None), strict=True))
    narrow = [_narrowest(*column) for column in columns]
    natural = [max(map(len, column)) for column in columns]
    frame = 3 * len(columns) + 1
    table = Table(title=title, title_justify="left")
    if sum(narrow) + frame > console.width:
        table.box, table.pad_edge = None, False
    tight = sum(natural) + frame > console.width
    for heading, least in zip(headings, narrow, strict=True):
        if heading in ("", "unit"):
            table.add_column(heading, min_width=least)
        else:
            table.add_column(heading, justify="right", width=least if tight else None)
    for row in rows:
        if row is None:
            table.add_section()
        else:
            table.add_row(*row)
    console.width = max(console.width, sum(narrow) + 2 * (len(narrow) - 1))
    console.print(table)


def print_text(text: str) -> None:
    """Print a paragraph on standard output; on a terminal, lines end between words."""
    console = _console()
    console.print(text, soft_wrap=not console.is_terminal)


def _console() -> Console:
    return Console(markup=False, emoji=False, highlight=False)


def _narrowest(heading: str, *cells: str) -> int:
    """Return the least width at which no word breaks; names have words, other cells are one."""
    width = _widest_word if heading in ("", "unit") else len
    return max([_widest_word(heading), *map(width, cells)])


def _widest_word(text: str) -> int:
    """Return the width of the longest word, and of the indentation before it."""
    indentation = len(text) - len(text.lstrip())
    return indentation + max(map(len, text.split()), default=0)
