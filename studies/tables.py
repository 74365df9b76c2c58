"""The measured tables of README and docs, made from the figures in studies/results.

    python -m studies.tables            # write them into the pages
    python -m studies.tables --check    # name the pages that do not agree, and write nothing

In a page a table stands between `<!-- table: NAME -->` and `<!-- end -->`; `TABLES` has a function
for each NAME. A file of studies/results is one measurement: `policy`, `commit`, `machine`,
`command` and `date` say where its `figures` come from. Those are rows, as a list of objects.
"""

import argparse
import json
import re
import string
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from quadwalk.cli.process import run_command
from quadwalk.errors import UserError
from quadwalk.files import open_atomic

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "studies" / "results"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
MARKED = re.compile(r"<!-- table: (\w+) -->\n(.*?)<!-- end -->", re.DOTALL)

Row = Mapping[str, Any]
Templates = Mapping[str, str]  # of cells, by the column's heading or the quantity's name


class _Cell(string.Formatter):
    """Format a cell, as `str.format` does; a list becomes its items with commas between them."""

    def format_field(self, value: Any, spec: str) -> str:
        """Return one value as text; `KeyError` for None, which stands for no value."""
        if value is None or value == []:
            raise KeyError(spec)
        if isinstance(value, list):
            items = ["-" if item is None else self.format_field(item, spec) for item in value]
            return ", ".join(items)
        text = str(format(value, spec))
        return text.replace(",", " ") if spec.endswith(",") else text


def load_result(name: str) -> dict[str, Any]:
    """Return the content of studies/results/NAME.json."""
    path = RESULTS / f"{name}.json"
    try:
        content: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise UserError(f"{path} is no JSON file that can be read; expected a result") from error
    return content


def fill(template: str, row: Row) -> str:
    """Return a cell: the template with the figures of a row; empty if one of them is missing."""
    try:
        return _Cell().vformat(template, (), row)
    except (KeyError, IndexError, TypeError):
        return ""


def format_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""

    def join(cells: Sequence[str]) -> str:
        return "|" + "".join(f" {cell} |" if cell else " |" for cell in cells)

    return "\n".join([join(heads), "|" + "---|" * len(heads), *map(join, rows)])


def list_rows(rows: Sequence[Row], columns: Templates) -> str:
    """Return a table with a row for each of `rows`."""
    cells = [[fill(template, row) for template in columns.values()] for row in rows]
    return format_table(list(columns), cells)


def list_quantities(rows: Sequence[Row], quantities: Templates) -> str:
    """Return a table with a column for each of `rows`, and a line for each quantity.

    A row's `name` is its heading. A quantity that no row has is left out.
    """
    lines = []
    for name, template in quantities.items():
        cells = [fill(template, row) for row in rows]
        if any(cells):
            names = [fill(name, row) for row, cell in zip(rows, cells, strict=True) if cell]
            lines.append([names[0], *cells])
    return format_table(["quantity", *(row["name"] for row in rows)], lines)


def format_span(rows: Sequence[Row], template: str) -> str:
    """Return the lowest and the highest of a figure over the rows, or the one that all have."""
    texts = sorted({text for row in rows if (text := fill(template, row))}, key=float)
    return " to ".join(dict.fromkeys((texts[0], texts[-1]))) if texts else ""


def describe_source(result: Row) -> str:
    """Return the commands of a measurement, and a line with its machine, commit and date."""
    parts = [result["machine"], result["commit"] and f"commit {result['commit']}", result["date"]]
    block = "\n".join(["```sh", *result["command"], "```"]) if result["command"] else ""
    line = ", ".join(filter(None, parts))
    return "\n\n".join(filter(None, [block, line and f"{line[0].upper()}{line[1:]}."]))


def add_source(table: str, result: Row) -> str:
    """Return a table with its source below it."""
    return "\n\n".join(filter(None, [table, describe_source(result)]))


# Policies.

TRAINING = {
    "training: steps": "{training[steps]:,}",
    "training: minutes, cores": "{training[minutes]:.1f}, {training[cores]}",
    "minutes of the run it begins with": "{training[first_minutes]:.1f}",
    "trained at commit": "{commit}",
    "trained on": "{machine}",
}
RANDOMIZED = "everything at once: "
SWEEP = {
    "sweep, friction 0.2: no fall, % of {sweep[episodes]}": "{sweep[friction]:.0f}",
    "sweep, pushes of 1.5 m/s: no fall, %": "{sweep[pushes]:.0f}",
    "sweep, all ranges wider by 50 %: no fall, %": "{sweep[everything]:.0f}",
    "sweep: points with a fall": "{sweep[with_a_fall]} of {sweep[points]}",
}
GAITS = {
    "three speeds ahead, m/s": "{gaits[command]:.2g}",
    "strides/s": "{gaits[stride_frequency]:.1f}",
    "lowest tenth of swings, m": "{gaits[swing_height_p10]:.3f}",
    "slip, share of the way": "{gaits[slip]:.3f}",
    "cost of transport at these": "{gaits[cost_of_transport]:.2f}",
}
RUN = {
    "speed in MuJoCo C, m/s": "{mujoco[speed]:.2f}",
    "falls": "{mujoco[falls]} of {mujoco[episodes]}",
    "lateral drift in 20 s, m": "{mujoco[lateral_drift]:.1f}",
    "mean heading error, degrees": "{mujoco[heading_error]:.1f}",
    "gait": "{gait[gait]}",
    "strides/s, their length, m": "{gait[stride_frequency]:.1f}, {gait[stride_length]:.2f}",
    "cost of transport": "{gait[cost_of_transport]:.2f}",
    RANDOMIZED + "no fall, % of {randomized[episodes]}": "{randomized[no_fall]:.1f}",
    RANDOMIZED + "speed, m/s": "{randomized[speed]:.2f}",
}
FOLLOWING = {
    "velocity error in MuJoCo C, m/s": "{mujoco[velocity_error]:.3f}",
    "yaw rate error, rad/s": "{mujoco[yaw_rate_error]:.3f}",
    "falls": "{mujoco[falls]} of {mujoco[episodes]}",
    RANDOMIZED + "no fall, % of {randomized[episodes]}": "{randomized[no_fall]:.1f}",
    RANDOMIZED + "velocity error, m/s": "{randomized[velocity_error]:.3f}",
    RANDOMIZED + "yaw rate error, rad/s": "{randomized[yaw_rate_error]:.3f}",
}
STEERING = {
    "held commands that are followed": "{steering[followed]} of {steering[commands]}",
    "held commands with a fall": "{steering[with_a_fall]} of {steering[commands]}",
    "largest error, share of its bound": "{steering[largest_error]:.2f}",
    "that command, m/s and rad/s": "{steering[worst]:.2g}",
    "its errors, m/s and rad/s": "{steering[worst_errors]:.2f}",
    "fastest command straight ahead, speed, m/s": "{steering[ahead]:.2f}",
    "fastest command back, speed, m/s": "{steering[back]:.2f}",
    "largest drift in heading straight ahead, degrees/s": "{steering[drift]:.1f}",
    "a stand to 0.9 of top speed, back, left to right turn, s": "{steering[responses]:.2f}",
    "at the command to stand: trunk moves, mean and most, mm": "{steering[stand]:.1f}",
    "the same, with MuJoCo's no-slip solver": "{steering[stand_without_creep]:.1f}",
    "randomized, commands that change: no fall in 20 s, % of {steering[changing_episodes]}": (
        "{steering[changing]:.1f}"
    ),
    "its 95 % interval": "{steering[changing_ci95]:.1f}",
}
QUANTITIES: dict[str, Templates] = {
    "run": {**RUN, **SWEEP, **TRAINING},
    "walk": {**FOLLOWING, **GAITS, **SWEEP, **TRAINING},
    "drive": {**STEERING, **FOLLOWING, **GAITS, **SWEEP, **TRAINING},
    "getup": TRAINING,
    "rough": {
        "difficulty": "{ground[difficulties]:.2g}",
        "all kinds: no fall, %": "{ground[success]:.1f}",
        "all kinds: reach the edge of the tile, %": "{ground[arrived]:.1f}",
        "all kinds: velocity error, m/s": "{ground[velocity_error]:.2f}",
        **TRAINING,
    },
}


def make_policy_table(task: str) -> str:
    """Return the table of a task: its policies side by side, with their source."""
    result = load_result(task)
    rows = result["figures"]
    quantities = {**list_conditions(rows), **list_kinds(rows), **QUANTITIES[task]}
    return add_source(list_quantities(rows, quantities), result)


def list_conditions(rows: Sequence[Row]) -> Templates:
    """Return the quantities of a policy that stands up: one for each condition."""
    conditions = dict.fromkeys(
        name for row in rows for name in row.get("standing", {}).get("conditions", ())
    )
    return {
        f"{name}: stands after 2, 3, 6 s, %": f"{{standing[conditions][{name}]:.1f}}"
        for name in conditions
    }


def list_kinds(rows: Sequence[Row]) -> Templates:
    """Return the quantities of a policy on uneven ground: one for each kind."""
    kinds = dict.fromkeys(name for row in rows for name in row.get("ground", {}).get("kinds", ()))
    return {f"{name}: no fall, %": f"{{ground[kinds][{name}]:.0f}}" for name in kinds}


# Measurements that are rows already.

# Of robots that `universal` drives.
DRIVE_COLUMNS: Templates = {
    "no fall, %": "{no_fall:.1f}",
    "velocity error, m/s": "{velocity_error:.2f}",
    "yaw rate error, rad/s": "{yaw_rate_error:.2f}",
    "fastest command, m/s": "{fastest:.1f}",
    "beyond the bodies trained on": "{beyond}",
}
COLUMNS: dict[str, Templates] = {
    "machines": {
        "name": "{name}",
        "processor": "{processor}",
        "MuJoCo C, steps/s": "{steps_per_second}",
    },
    "accuracy": {
        "": "{setting}",
        "position": "{position:.1f} mm",
        "velocity": "{velocity:.3f} m/s",
        "deepest foot": "{depth:.1f} mm",
    },
    "physics": {"": "{setting}", "x MuJoCo C": "{ratio:.2g}"},
    "page": {
        "robot": "{robot}",
        "MJCF in the page, kB": "{kilobytes:.0f}",
        "shapes": "{shapes}",
        "triangles": "{triangles:,}",
        "before they were made fewer": "{triangles_before:,}",
    },
    "zoo": {
        "robot": "{robot}",
        "kg": "{mass:.1f}",
        "stands": "{stands}",
        "m/s": "{speed:.2f}",
        "Froude": "{froude:.2f}",
        "gait": "{gait}",
        "of the thigh motors' speed": "{share:.2f}",
    },
    "universal": {
        "robot": "{robot}",
        "kg": "{mass:.1f}",
        "gets up within 4 s, %": "{gets_up:.1f}",
        **DRIVE_COLUMNS,
    },
    "mjcf": {
        "robot": "{robot}",
        "kg": "{mass:.1f}",
        "error": "{error}",
        "stands": "{stands}",
        **DRIVE_COLUMNS,
    },
    "foreign": {
        "condition": "{condition}",
        "`run`: m/s": "{run_speed:.2f}",
        "heading error, deg": "{run_heading_error:.1f}",
        "`walk`: m/s": "{walk_speed:.2f}",
        "velocity error, m/s": "{walk_velocity_error:.2f}",
        "yaw rate error, rad/s": "{walk_yaw_rate_error:.3f}",
        "`drive`: m/s": "{drive_speed:.2f}",
        "velocity error of `drive`, m/s": "{drive_velocity_error:.2f}",
        "yaw rate error of `drive`, rad/s": "{drive_yaw_rate_error:.3f}",
    },
    "cluster": {"what": "{what}", "figure": "{ratio:.2f}", "command": "{how}"},
    "gymnasium": {
        "control steps/s": "{part}",
        "Stable-Baselines3": "{stable_baselines:,}",
        "`python train.py sprint`": "{quadwalk:,}",
    },
    "ppo": {
        "metric": "{metric}",
        "5 to 20 % of the steps": "{early}",
        "20 to 60 %": "{middle}",
        "last 10 %": "{late}",
    },
    "identified": {
        "policy": "{policy}",
        "conditions": "{conditions}",
        "falls on the model, %": "{falls[0]:.1f}",
        "identified, %": "{falls[1]:.1f}",
        "on the model": "{figures[0]}",
        "identified": "{figures[1]}",
        "unit": "{unit}",
    },
    "slippery": {
        "friction": "{quantity}",
        "0.2": "{values[0]:.3g}",
        "0.3": "{values[1]:.3g}",
        "0.4": "{values[2]:.3g}",
        "0.8": "{values[3]:.3g}",
    },
    "speed": {
        "quantity": "{quantity}",
        "value": "{value}",
        "machine, commit": "{where}",
        "command": "{how}",
    },
}


def make_rows_table(name: str) -> str:
    """Return the table of a measurement whose figures are its rows, with their source."""
    result = load_result(name)
    return add_source(list_rows(result["figures"], COLUMNS[name]), result)


ROBUSTNESS = {
    "everything at once, half the trained ranges": "{everything[0.5]:.0f}",
    "everything at once, the trained ranges": "{everything[1.0]:.0f}",
    "everything at once, ranges wider by 50 %": "{everything[1.5]:.0f}",
    "friction 0.2": "{friction[0.2]:.0f}",
    "action delay of 32 ms": "{delay[32.0]:.0f}",
    "sensor delay of 30 ms": "{sensor_delay[30.0]:.0f}",
    "noise level 2": "{noise[2.0]:.0f}",
    "pushes of 1.5 m/s, sideways": "{push[1.5]:.0f}",
    "pushes of 1.5 m/s, ahead": "{push_ahead[1.5]:.0f}",
    "undisturbed: speed, m/s": "{speed:.2f}",
}


def make_robustness_table() -> str:
    """Return the shares without a fall, %, that studies/robustness/results.json holds."""
    path = ROOT / "studies" / "robustness" / "results.json"
    runs = json.loads(path.read_text())["runs"]
    rows = []
    for run in runs:
        shares = {
            name: {f"{point['value']:.1f}": 100.0 * point["success"] for point in sweep["points"]}
            for name, sweep in run["sweeps"].items()
        }
        rows.append({"name": f"`{run['run']}`", "speed": run["nominal"]["speed"]["mean"], **shares})
    source = {
        "command": [f"python -m studies.robustness.study --episodes {runs[0]['episodes']}"],
        "commit": shorten_revision(runs[0]["revision"]),
        "machine": None,
        "date": None,
    }
    return add_source(list_quantities(rows, ROBUSTNESS), source)


def shorten_revision(revision: str) -> str:
    """Return the commit of a result's `revision`, "git COMMIT" or "quadwalk VERSION", in short."""
    kind, _, name = revision.partition(" ")
    return name[:7] if kind == "git" else revision


# The README. In a line of `SUMMARY` a figure in brackets is the span over all policies.

SUMMARY = (
    (
        "run",
        "`run`",
        "{mujoco[speed]:.1f} m/s in MuJoCo C; falls: {mujoco[falls]} of {mujoco[episodes]}",
    ),
    (
        "run",
        "`run`, everything randomized",
        "no fall in {randomized[no_fall]:.1f} % of {randomized[episodes]} episodes",
    ),
    (
        "drive",
        "`drive`, randomized",
        "no fall in {steering[changing]:.1f} % of {steering[changing_episodes]} episodes",
    ),
    (
        "rough",
        "`rough`",
        "no fall in {ground[success][0]:.1f} % at half difficulty, "
        "{ground[success][2]:.1f} % at full",
    ),
    (
        "getup",
        "`getup`",
        "stands after 3 s in {standing[conditions][model][1]:.1f} % of {standing[episodes]} poses",
    ),
    ("zoo", "14 robots by URDF alone", "{speed:.1f} m/s after three minutes; none falls"),
)


def make_summary_table() -> str:
    """Return the README's table of results: a line or two for each task."""
    lines = [[task, summarize(text, load_result(name)["figures"])] for name, task, text in SUMMARY]
    return format_table(("task", "result"), lines)


def summarize(text: str, rows: Sequence[Row]) -> str:
    """Return `text` with the span over `rows` in place of each figure that it names."""
    return re.sub(r"\{[^}]+\}", lambda field: format_span(rows, field[0]), text)


def make_tasks_table() -> str:
    """Return the README's table of tasks, with the minutes that each trains."""
    columns = {
        "task": "{task}",
        "the robot learns to": "{learns}",
        "steps": "{steps:.0f} M",
        "minutes on two cores": "{minutes}",
    }
    return list_rows(load_result("minutes")["figures"], columns)


TABLES: dict[str, Callable[[], str]] = {
    **{task: partial(make_policy_table, task) for task in QUANTITIES},
    **{name: partial(make_rows_table, name) for name in COLUMNS},
    "robustness": make_robustness_table,
    "summary": make_summary_table,
    "tasks": make_tasks_table,
}


def update(text: str) -> str:
    """Return the text of a page with its tables as the figures have them."""

    def replace(table: re.Match[str]) -> str:
        if table[1] not in TABLES:
            raise UserError(f"no table {table[1]!r}; expected one of: {', '.join(TABLES)}")
        return f"<!-- table: {table[1]} -->\n{TABLES[table[1]]()}\n<!-- end -->"

    return MARKED.sub(replace, text)


def find_outdated_pages() -> list[Path]:
    """Return the pages whose tables are not as the figures have them."""
    return [page for page in PAGES if update(page.read_text()) != page.read_text()]


def write_pages() -> None:
    """Write the tables into the pages, and print which of them have changed."""
    for page in find_outdated_pages():
        text = update(page.read_text())
        with open_atomic(page) as file:
            file.write(text.encode())
        print(f"written to {page.relative_to(ROOT)}")


def main() -> None:
    """Write the tables into the pages; with --check only name the pages that do not agree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    if not parser.parse_args().check:
        write_pages()
    elif pages := find_outdated_pages():
        names = ", ".join(str(page.relative_to(ROOT)) for page in pages)
        raise UserError(f"{names}: not as in studies/results; expected python -m studies.tables")


if __name__ == "__main__":
    run_command(main)
