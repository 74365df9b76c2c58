"""Tables and lines that an evaluation prints on standard output."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from quadwalk.evaluation.gait import Gait
from quadwalk.evaluation.metrics import METRICS, compare_engines

_NONE = "-"
_TEXT_COLUMNS = ("", "unit")  # headings of columns of words; the others have numbers


def print_summary(summary: dict[str, Any], title: str) -> None:
    """Print a table of the falls and metrics in `summary`, which is of `summarize_episodes`."""
    falls = summary["fall_rate"] * summary["episodes"]
    share, interval = _format_share(summary)
    rows: list[Sequence[str]] = [(f"falls ({falls:.0f} episodes)", share, interval, "", "", "%")]
    for name, heading, unit in list_shown_metrics(summary):
        figure = summary[name] or dict.fromkeys(("mean", "ci95", "median", "worst"))
        texts = [format_number(figure[key]) for key in ("mean", "ci95", "median", "worst")]
        rows.append((heading, *texts, unit))
    print_table(title, ("", "mean", "± 95 %", "median", "worst", "unit"), rows)


def print_engines(mjx: dict[str, Any], mujoco: dict[str, Any]) -> None:
    """Print a table of two engines' summaries and their differences, as of `compare_engines`."""
    differences = compare_engines(mjx, mujoco)
    falls = 100 * differences["fall_rate"]["difference"]
    rows = [("falls", format_falls(mjx), format_falls(mujoco), f"{falls:+z.1f}", "", "%")]
    for name, heading, unit, _ in METRICS:
        if name in differences:
            texts = (format_value(mjx[name]), format_value(mujoco[name]))
            change = format_number(differences[name]["difference"], "+z.3f")
            percent = format_number(differences[name]["percent"], "+z.1f", " %")
            rows.append((heading, *texts, change, percent, unit))
    headings = ("", "MJX", "MuJoCo C", "difference", "of MJX's", "unit")
    print_table("MuJoCo C against MJX, the same starts", headings, rows)


def describe_gait(gait: Gait, episode: int) -> str:
    """Return the gait of one episode in a line or two; "-" for what could not be measured."""
    # Of the feet that have any.
    swing, slip = 100 * np.fmin.reduce(gait.swing_height), 100 * np.fmax.reduce(gait.slip_share)
    return (
        f"gait of episode {episode}: {gait.gait}, "
        f"{format_number(gait.stride_frequency, '.2f')} strides/s "
        f"of {format_number(gait.stride_length, '.2f')} m, "
        f"duty factor {format_number(np.mean(gait.duty_factor), '.2f')}, "
        f"swing height {format_number(swing, '.1f')} cm or more, "
        f"slip up to {format_number(slip, '.1f')} % of the way, "
        f"feet at {format_number(np.mean(gait.touchdown_speed), '.2f')} m/s before touch-down, "
        f"cost of transport {format_number(gait.cost_of_transport, '.2f')}\n"
        f"of their limits, at most: torque {format_number(100 * np.max(gait.torque_peak), '.0f')} "
        f"%, joint speed {format_number(100 * np.max(gait.joint_speed_peak), '.0f')} %; "
        f"torques change sign in {format_number(100 * np.mean(gait.torque_reversals), '.0f')} % "
        "of control steps; "
        f"actions change at {format_number(gait.action_rate, '.1f')}/s (root mean square; they "
        "are in [-1, 1])"
    )


def list_shown_metrics(*summaries: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return name, heading and unit of each metric in the summaries, reward terms last."""
    names = dict.fromkeys(name for summary in summaries for name in summary)
    terms = [name for name in names if name.startswith("reward/")]
    rows = [row[:3] for row in METRICS if row.name in names]
    return [*rows, *((name, f"  {name.partition('/')[2]}", "") for name in terms)]


def format_value(figure: dict[str, Any] | None) -> str:
    """Format an entry of a summary as "mean ± half its 95 % interval"; "-" for None."""
    if figure is None:
        return _NONE
    # As many decimals as leave the mean four digits, up to three.
    decimals = 3 - min(len(f"{abs(figure['mean']):.0f}") - 1, 3)
    text = f"{figure['mean']:z.{decimals}f}"  # z: never -0.000
    return text if figure["ci95"] is None else f"{text} ± {figure['ci95']:.{decimals}f}"


def format_number(value: float | None, form: str = "z.3f", unit: str = "") -> str:
    """Format a number by the format specification `form`, with `unit` after it.

    None and NaN become "-".
    """
    return _NONE if value is None or math.isnan(value) else f"{value:{form}}{unit}"


def format_percent(share: float) -> str:
    """Format a share, 0 to 1, as whole percents."""
    return f"{100 * share:.0f}"


def format_falls(summary: dict[str, Any]) -> str:
    """Format the share of falls in percent, with its 95 % interval."""
    return "{} ({})".format(*_format_share(summary))


def _format_share(summary: dict[str, Any]) -> tuple[str, str]:
    """Return the share of falls and its 95 % interval as two texts, in percent."""
    low, high = (100 * end for end in summary["fall_rate_ci95"])
    return f"{100 * summary['fall_rate']:.1f}", f"{low:.0f} to {high:.0f}"


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str] | None]) -> None:
    """Print a table on standard output; a row that is None draws a line.

    Columns of names and units are aligned to the left, numbers to the right. Names and headings may
    take several lines, but no word is broken: lines may be longer than the terminal is wide.
    """
    rows = list(rows)
    console = _make_console()
    columns = list(zip(headings, *(row for row in rows if row is not None), strict=True))
    is_tight = sum(max(map(len, column)) + 3 for column in columns) >= console.width
    table = Table(title=title, title_justify="left")
    least = 1
    for heading, *cells in columns:
        if heading in _TEXT_COLUMNS:
            width = max(map(_measure_longest_word, (heading, *cells)))
            table.add_column(heading, min_width=width)
        else:
            width = max([_measure_longest_word(heading), *map(len, cells)])
            table.add_column(heading, justify="right", width=width if is_tight else None)
        least += width + 3
    for row in rows:
        if row is None:
            table.add_section()
        else:
            table.add_row(*row)
    console.width = max(console.width, least)
    console.print(table)


def print_text(text: str) -> None:
    """Print a paragraph on standard output; on a terminal, lines end between words."""
    console = _make_console()
    console.print(text, soft_wrap=not console.is_terminal)


def _make_console() -> Console:
    """Return a console for standard output that prints text as it is, without markup or emoji."""
    return Console(markup=False, emoji=False, highlight=False)


def _measure_longest_word(text: str) -> int:
    """Return the length of the longest word of `text` plus its indentation."""
    indentation = len(text) - len(text.lstrip())
    return indentation + max(map(len, text.split()), default=0)
