"""Tasks of the package and of a user's own file, and what is wrong with one that is none."""

import dataclasses

import pytest

from quadwalk.env import rewards as reward
from quadwalk.errors import UsageError, UserError
from quadwalk.settings.registry import find_term, get_task_source, get_term_name
from quadwalk.settings.terms import Observation, Reward
from quadwalk.task_files import TASK_FILE, load_task
from quadwalk.tasks import list_tasks

OWN_TASK = """
import dataclasses
from quadwalk.settings.terms import Reward
from quadwalk.tasks import sprint

def still(robot, step):
    return 1.0

TASK = dataclasses.replace(sprint.TASK, task="still", env=dataclasses.replace(
    sprint.TASK.env, reward={**sprint.TASK.env.reward, "still": Reward(still, scale=2.0)}))
"""


@pytest.mark.parametrize(
    "name",
    [
        "blog",
        "drive",
        "getup",
        "obstacles",
        "rough",
        "run",
        "sprint",
        "universal",
        "universal_getup",
        "walk",
    ],
)
def test_a_task_of_the_package_is_found_by_its_name(name):
    assert name in list_tasks()
    assert load_task(name).task == name


def test_the_file_of_an_earlier_run_that_names_what_is_gone_is_refused_in_one_line(tmp_path):
    (tmp_path / TASK_FILE).write_text("from quadwalk.env.config import REAL_WORLD\n")
    with pytest.raises(UsageError, match=r"task.py, line 1: .* named 'quadwalk.env.config'"):
        load_task(tmp_path / TASK_FILE)


def test_a_function_of_the_package_is_found_again_where_it_is():
    where = get_term_name(reward.energy)
    assert where == "reward:energy"
    assert find_term(where, folder=None) is reward.energy


def test_a_function_of_a_users_file_is_found_again_in_the_runs_copy(tmp_path):
    (tmp_path / "mine.py").write_text(OWN_TASK)
    task = load_task(tmp_path / "mine.py")
    function = task.env.reward["still"].function
    assert (task.task, function(None, None)) == ("still", 1.0)
    assert get_term_name(function) == "task.py:still"
    source = get_task_source([reward.energy, function])
    assert source == OWN_TASK.encode()
    (tmp_path / TASK_FILE).write_bytes(source)
    assert find_term("task.py:still", tmp_path)(None, None) == 1.0
    assert get_task_source([reward.energy]) is None


def test_the_file_of_an_earlier_version_is_read_with_a_line_that_names_the_new_imports(
    tmp_path, capsys
):
    imports = "from quadwalk.task import reward\nfrom quadwalk.task.reflections import mirrors\n"
    (tmp_path / "mine.py").write_text(imports + OWN_TASK)
    assert load_task(tmp_path / "mine.py").task == "still"
    line = (
        f"warning: {tmp_path / 'mine.py'}: quadwalk.task.reflections is now quadwalk.terms, "
        "quadwalk.task import reward is now quadwalk.terms import rewards as reward; "
        "version 0.4 reads no others\n"
    )
    assert capsys.readouterr().err == line


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read"),
        ("x = 1", "TASK"),
        ("TASK = 3", "TASK"),
        ("\n\nTASK = (", "line 3"),
        ("import nothing_of_that_name", "line 1: ModuleNotFoundError"),
        ("\n1 / 0", "line 2: ZeroDivisionError"),
        ("x = 1\0", "null bytes"),
        ("import sys\nsys.exit(3)", "line 2: SystemExit: 3"),
        ("raise ValueError('a\\nb')", "line 1: ValueError: a b"),
        (
            "from quadwalk.tasks import run\nfrom dataclasses import replace\n"
            "replace(run.TASK, steps=0)",
            "line 3: --steps is 0",
        ),
    ],
)
def test_a_file_that_is_no_task_is_named_in_one_line(tmp_path, content, message):
    file = tmp_path / "mine.py"
    if content is not None:
        file.write_text(content)
    with pytest.raises(UsageError, match=message) as error:
        load_task(file)
    assert str(file) in str(error.value)


def test_a_task_file_can_be_interrupted(tmp_path):
    (tmp_path / "mine.py").write_text("raise KeyboardInterrupt")
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            load_task(tmp_path / "mine.py")


def test_a_name_that_is_no_task_is_told_those_there_are():
    with pytest.raises(UsageError, match=r"'rum'.*run.*walk"):
        load_task("rum")


@pytest.mark.parametrize(
    "where", ["os:system", "task.py:system", "quadwalk.nowhere:f", "quadwalk.paths:f", "reward:jnp"]
)
def test_what_is_no_function_of_a_task_is_refused(tmp_path, where):
    (tmp_path / TASK_FILE).write_text(OWN_TASK)
    with pytest.raises(UserError, match=where.partition(":")[0]):
        find_term(where, tmp_path)


def test_a_function_that_cannot_be_found_again_is_refused():
    with pytest.raises(UsageError, match="lambda"):
        get_term_name(lambda robot, step: 0.0)
    with pytest.raises(UsageError, match="json"):
        get_term_name(__import__("json").dumps)


def test_a_term_with_other_parameters_than_its_functions_is_refused():
    with pytest.raises(UsageError, match=r"forward.*\['speed'\].*\['max_speed'\]"):
        Reward(reward.forward, {"speed": 1.0}, scale=1.0)
    with pytest.raises(UsageError, match="max_speed"):
        Reward(reward.forward, scale=1.0)


def test_an_observation_names_its_numbers_by_their_count_or_as_told():
    part = Observation(reward.energy)
    joints = tuple(f"joint{i}" for i in range(12))
    assert part.name_numbers("height", 1, joints) == ("height",)
    assert part.name_numbers("speed", 3, joints) == ("speed_x", "speed_y", "speed_z")
    assert part.name_numbers("angle", 12, joints)[11] == "angle_joint11"
    assert part.name_numbers("scan", 2, joints) == ("scan_0", "scan_1")
    with_labels = dataclasses.replace(part, labels=("left", "right"))
    assert with_labels.name_numbers("scan", 2, joints) == ("scan_left", "scan_right")
    with pytest.raises(UsageError, match="scan has 3 numbers and 2 labels"):
        with_labels.name_numbers("scan", 3, joints)
