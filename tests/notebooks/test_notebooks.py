"""The notebooks, each from a clean kernel in an empty folder: what every cell is to show."""

import base64
import functools
import io
import itertools
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import nbformat
import numpy as np
import pytest
from PIL import Image

from notebooks.execute import HERE, execute, list_named_folders
from quadwalk.errors import UserError
from tests.evaluation.conftest import count_messages
from tests.test_api import find_orange

STUDIES = HERE.parent / "studies"
STEPS = 49_152  # two iterations
NAMES = sorted(path.stem for path in HERE.glob("*.ipynb"))


class Executed:
    """A notebook with its outputs, and the folder that it ran in."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.folder = folder
        self.notebook = execute(path, folder)

    def outputs(self, code: str) -> list[nbformat.NotebookNode]:
        """Return the outputs of the one cell that has `code` in it."""
        cells = [cell for cell in self.notebook.cells if cell.cell_type == "code"]
        (code_cell,) = (cell for cell in cells if code in cell.source)
        return code_cell.outputs

    def text(self, code: str) -> str:
        """Return the text that this cell prints."""
        return "".join(out.get("text") or out.data["text/plain"] for out in self.outputs(code))

    def picture(self, code: str) -> np.ndarray:
        """Return the one picture (height, width, 3) that the cell shows."""
        (png,) = (
            output.data["image/png"]
            for output in self.outputs(code)
            if "image/png" in output.get("data", {})
        )
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"))


@pytest.fixture(scope="module")
def executed(tmp_path_factory) -> Callable[[str], Executed]:
    """Return executed(name): that notebook, executed once."""

    @functools.cache
    def run(name: str) -> Executed:
        folder = tmp_path_factory.mktemp(name) / "work"
        folder.mkdir()
        return Executed(HERE / f"{name}.ipynb", folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QUADWALK_STEPS", str(STEPS))
        patch.setenv("QUADWALK_SECONDS", "2")
        patch.setenv("QUADWALK_ROBOTS", "64")
        patch.setenv("QUADWALK_PICTURES", "1")
        yield run


def curves(picture: np.ndarray) -> int:
    """Return the number of colors of a plot, each of some 100 pixels or more, without grays."""
    colored = picture[np.ptp(picture.astype(int), axis=2) > 60]
    _, counts = np.unique(colored // 16, axis=0, return_counts=True)
    return int((counts >= 100).sum())


@pytest.mark.parametrize("name", NAMES)
def test_as_committed_each_shows_its_pictures_and_names_a_commit(name):
    """Check that it is as `make notebooks` leaves it.

    That is, every cell was run, in order, from a clean kernel.
    """
    path = HERE / f"{name}.ipynb"
    cells = nbformat.read(path, as_version=4).cells
    code = [cell for cell in cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    kinds = [kind for cell in code for out in cell.outputs for kind in out.get("data", {})]
    assert "image/png" in kinds
    assert "error" not in {out.output_type for cell in code for out in cell.outputs}
    assert re.search(r"\*Executed at commit [0-9a-f]{7,}[^*]*\.\*$", cells[0].source)
    assert "**After this lesson you can** " in cells[0].source
    exercises = cells[-1].source.partition("## Exercises")[2]
    checks = re.findall(r"```python\n(.*?)```", exercises, re.DOTALL)
    assert len(checks) == 2
    for check in checks:
        assert "assert " in check
        compile(check, name, "exec")
    assert path.stat().st_size < 1.6e6


def test_without_the_extra_zoo_the_one_of_another_robot_says_so_at_once(monkeypatch, tmp_path):
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(tmp_path))
    cells = nbformat.read(HERE / "07_your_robot.ipynb", as_version=4).cells
    first = next(cell for cell in cells if cell.cell_type == "code")
    with pytest.raises(UserError, match=r"no file .*go2\.urdf: expected .* zoo: .*install .*zoo"):
        exec(first.source, {})


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_shown_of_the_machine_it_ran_on(executed, name):
    execution = executed(name)
    outputs = [output for cell in execution.notebook.cells for output in cell.get("outputs", [])]
    assert list_named_folders(execution.notebook) == []
    assert str(execution.folder) not in json.dumps([o.get("text", "") for o in outputs])
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []


@pytest.mark.parametrize(
    ("output", "has_folder"),
    [
        (nbformat.v4.new_output("stream", text=f"in {sys.prefix}/lib"), True),
        (nbformat.v4.new_output("display_data", {"text/plain": f"{Path.home()}/a"}), True),
        # What looks like one by chance, in the letters that a picture is written in.
        (nbformat.v4.new_output("display_data", {"image/png": f"{Path.home()}/a"}), False),
        (nbformat.v4.new_output("display_data", {"image/jpeg": f"{Path.home()}/a"}), False),
        (nbformat.v4.new_output("stream", text="in runs/a"), False),
    ],
)
def test_folders_in_outputs_are_found(output, has_folder):
    cell = nbformat.v4.new_code_cell(outputs=[output])
    assert bool(list_named_folders(nbformat.v4.new_notebook(cells=[cell]))) == has_folder


def test_the_robot_is_drawn_and_its_joints_moved(executed):
    notebook = executed("01_robot")
    assert 'name="FR_thigh_joint"' in notebook.text("robot.urdf.index")
    assert '<joint name="FR_thigh_joint"' in notebook.text("xml.index")
    assert 0.01 < find_orange(notebook.picture("render_home(")).mean() < 0.3
    strip = find_orange(notebook.picture("np.linspace(robot.lower"))
    height, width = strip.shape
    panels = [
        strip[round(a * height) : round((a + 1 / 3) * height)][:, round(b * width) :][
            :, : width // 5
        ]
        for a in (0, 1 / 3, 2 / 3)
        for b in np.arange(5) / 5
    ]
    assert min(panel.mean() for panel in panels) > 0.005


def test_a_dropped_robot_lies_without_motors_and_stands_with_them(executed):
    notebook = executed("01_robot")
    off, on = map(int, re.findall(r"rests at (\d+) cm", notebook.text("rests at")))
    assert 3 < off < 15  # half of the trunk, 11 cm high, and what lies under it
    assert 30 < on < 40  # the standing height is 38 cm
    assert find_orange(notebook.picture("rests at")).mean() > 0.01
    assert curves(notebook.picture("standing height")) >= 2


def test_both_physics_let_a_crowd_fall_alike(executed):
    notebook = executed("01_robot")
    assert "64 robots fell for 1.2 s" in notebook.text("in_quadwalk = ")
    assert "64 robots fell for 1.2 s" in notebook.text("in_mjx = ")
    half, most = map(float, re.findall(r"less than ([\d.]+) µm", notebook.text("apart =")))
    assert half < 1.0
    assert most < 1000.0  # where feet strike the floor a moment apart
    assert curves(notebook.picture("robots, dropped")) >= 1
    assert curves(notebook.picture("apart =")) >= 2


def test_a_training_with_a_reward_of_ones_own_is_drawn_beside_the_usual(executed):
    notebook = executed("02_train")
    rewards, rows = {}, []
    for run in (notebook.folder / "runs").iterdir():
        config = json.loads((run / "config.json").read_text())["config"]
        rewards[config["task"]] = set(config["env"]["reward"])
        rows.append([json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()])
    assert rewards["high_steps"] - rewards["sprint"] == {"high_steps"}
    assert [[row["steps"] for row in each] for each in rows] == [[STEPS // 2, STEPS]] * 3
    for number, code in enumerate(("usual = ", "proud = "), 1):
        assert curves(notebook.picture(code)) >= number, code
    assert "-0.02  energy" in notebook.text("term.function.__doc__")
    for label in ("usual reward", "high steps"):
        assert label in notebook.text("strides/s")
    assert find_orange(notebook.picture("film_strip(")).mean() > 0.01


def test_a_scale_is_changed_while_training_runs(executed):
    notebook = executed("02_train")
    (desk,) = (notebook.folder / "runs").glob("*/desk.jsonl")
    changes = [json.loads(line) for line in desk.read_text().splitlines()]
    names = [(change["name"], change["old"], change["new"]) for change in changes]
    assert names == [("env.reward.energy.scale", -0.02, -0.5)]
    assert curves(notebook.picture("training.join()")) >= 1


def test_an_evaluation_shows_a_packaged_policy_from_all_sides(executed):
    notebook = executed("03_evaluate")
    assert notebook.text("result = quadwalk.evaluate(RUN").startswith("run: 33 million steps")
    assert notebook.text("meters").count("episode") == 8
    strip = notebook.picture("film_strip(")
    assert strip.shape == (2 * 225 + 4, 4 * 360 + 3 * 4, 3)
    assert find_orange(strip).mean() > 0.01
    assert curves(notebook.picture("result.report()")) >= 4
    assert "duty factor" in notebook.text("gait.duty_factor")
    table = notebook.text("quadwalk.compare(")
    assert "MJX" in table
    assert "MuJoCo C" in table
    assert curves(notebook.picture("quadwalk.compare(")) >= 2


def test_the_recording_is_whole_and_read_back(executed):
    notebook = executed("03_evaluate")
    assert count_messages(notebook.folder / "episode_000.mcap") > 100
    listing = notebook.text("get_summary()")
    assert "/contacts" in listing
    assert "foxglove.FrameTransforms" in listing
    assert curves(notebook.picture("iter_decoded_messages(")) >= 2


def test_the_gecko_is_told_from_the_cheetah(executed):
    notebook = executed("04_gecko")
    for code in ('film(["blog", "sprint"])', "film(of_post)", "film(of_ours)"):
        assert find_orange(notebook.picture(code)).mean() > 0.01, code
    for code in ('footfalls(["blog"', "dots(of_post)", "dots(of_ours)"):
        assert curves(notebook.picture(code)) >= 2, code
    rows = notebook.text('table(["blog", "sprint"])').splitlines()
    gecko, cheetah = (dict(zip(rows[0].split(), row.split()[1:], strict=False)) for row in rows[1:])
    assert float(gecko["speed"]) < float(cheetah["speed"])
    assert float(gecko["body_contact"]) > 0.1
    assert float(cheetah["body_contact"]) == 0.0
    assert gecko["gaits"] == "irregular"
    assert cheetah["gaits"].startswith("gallop")


def test_what_breaks_the_ideal_policy_is_drawn_and_listed(executed):
    notebook = executed("05_real_world")
    assert "latency          (0.0, 0.02)" in notebook.text("getattr(drawn, field.name)")
    assert curves(notebook.picture('label="seen"')) >= 1
    assert find_orange(notebook.picture("film_strip(")).mean() > 0.01
    assert curves(notebook.picture("draw_sweep(")) >= 2
    results = json.loads((STUDIES / "robustness/results.json").read_text())["runs"]
    listing = notebook.text("def share(")
    rows = re.findall(r"^sensor noise +([\d.]+) level +(\d+) +(\d+)$", listing, re.MULTILINE)
    assert [row[0] for row in rows] == ["0.5", "1", "2"]
    for value, *shares in rows:
        for share, result in zip(shares, results, strict=True):
            points = {p["value"]: p["success"] for p in result["sweeps"]["noise"]["points"]}
            assert float(share) == pytest.approx(100 * points[float(value)], abs=0.6)


def test_where_robots_fail_on_uneven_ground_is_drawn_and_listed(executed):
    notebook = executed("06_ground")
    results = json.loads((STUDIES / "ground/results.json").read_text())
    variants = dict.fromkeys(result["variant"] for result in results)
    for code in ("draw_kinds(shown", 'films("stairs_up")', 'films("blocks")', 'films("course")'):
        picture = notebook.picture(code)
        filled = picture[:, picture.min(axis=(0, 2)) < 255]  # not where a row has fewer pictures
        assert find_orange(filled).mean() > 0.005, code
    maps = [out for out in notebook.outputs("draw_terrain(") if "image/png" in out.get("data", {})]
    assert len(maps) == len(variants)
    listing = notebook.text("for variant, difficulty in (")
    worst: dict[tuple[str, float, str], float] = {}  # of all seeds
    for variant, difficulty in (("seeing", 1.0), ("seeing", 0.5), ("blind", 2 / 3)):
        cells = [r["ground"]["cells"] for r in results if r["variant"] == variant]
        for cell in itertools.chain(*cells):
            if abs(cell["difficulty"] - difficulty) < 0.01:
                case = (variant, difficulty, cell["kind"].replace("_", " "))
                worst[case] = min(cell["success"], worst.get(case, 1.0))
    rows = re.findall(r"^  (\w[\w ]*?) +(\d+) % succeed", listing, re.MULTILINE)
    assert rows == [(kind, f"{100 * share:.0f}") for (*_, kind), share in worst.items()]


def test_a_robot_of_ones_own_is_imported_stands_and_learns_from_the_packaged_policy(executed):
    notebook = executed("07_your_robot")
    assert notebook.text("robot = load_quadruped(URDF)").startswith(
        "go2_description: 16.1 kg, stands 32"
    )
    assert np.ptp(notebook.picture("render_home(").astype(int)) > 100
    assert int(re.search(r"stands (\d+) cm", notebook.text("env.motor.kp"))[1]) > 25
    config = json.loads((notebook.folder / "runs/go2/config.json").read_text())["config"]
    assert config["init"].endswith("pretrained/walk")
    assert notebook.text("for rollout, figures in").count("command") == 8
    assert len(notebook.outputs("film_strip(")) == 1


def test_sessions_at_the_reward_desk_are_drawn_and_compared(executed):
    notebook = executed("08_desk")
    results = json.loads((STUDIES / "desk/results.json").read_text())
    assert find_orange(notebook.picture('draw_pictures("blog"')).mean() > 0.01
    for name, figure in (("blog", "body_contact"), ("walk", "swing_height"), ("run", "power")):
        code = f'compare("{name}"'
        assert curves(notebook.picture(code)) >= 1, code
        _, last = re.search(
            rf"^{figure} +(\S+) -> +(\S+)", notebook.text(code), re.MULTILINE
        ).groups()
        assert float(last) == pytest.approx(results[name]["policies"][-1][figure], abs=0.006)
