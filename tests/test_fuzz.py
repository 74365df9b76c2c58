"""Whatever stands in a flag or in a run's file: it can be used, or one line says why not."""

import dataclasses
import json
import random
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadwalk.cli.arguments import parse
from quadwalk.errors import UserError
from quadwalk.evaluation.command import EvalConfig
from quadwalk.experiments.commands import compare
from quadwalk.experiments.options import CompareConfig, TuneConfig
from quadwalk.export.cli import ExportConfig
from quadwalk.learn.acting import load_checkpoint_policy, load_policy
from quadwalk.learn.flags import parse_config
from quadwalk.paths import ALIENGO_URDF
from quadwalk.progress.curves import draw_learning_curve
from quadwalk.robot.cli import main as robot
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs.directory import (
    Run,
    create_run,
    find_any_run,
    find_latest_checkpoint,
    find_ready,
    find_run,
)
from quadwalk.runs.log import MetricsLog, read_history
from quadwalk.runs.policy import load_score
from quadwalk.runs.resume import read_config_to_resume
from quadwalk.settings.serialize import change_settings, flatten
from quadwalk.settings.training import RobotConfig
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks
from quadwalk.terrain.cli import main as ground
from quadwalk.web.robots import list_policies
from quadwalk.web.view import ViewConfig
from tests.settings.test_serialize import places
from tests.untrained import write_run

WORDS = (
    *("nan", "inf", "-inf", "1e999", "1e12", "1e-320", "0", "-1", "1.5", "9" * 5000, "None"),
    *("", " ", "-x", "--", "ü", "x" * 5000, "../..", "/dev/null", "[red]", "[/red]", "a\nb", "=,"),
)
VALUES: tuple[Any, ...] = (
    *(float("nan"), float("inf"), -1e308, 1e12, 1e-320, 0, -1, 1.5, 10**400, None, True),
    *("", "x", "a\0b", "\ud800", (), (1,), ("a", None), [], [[]], {}, {"a": 1}, object()),
)


def settles(action: Callable[..., object], *arguments: Any) -> None:
    """Assert that `action` returns or raises what is one line for the user."""
    try:
        action(*arguments)
    except UserError as error:
        message = str(error)
        assert message.strip(), "nothing is said"
        assert "\n" not in message
        assert len(message) < 1000 or "x" * 5000 in message or "9" * 5000 in message


def some(things: Iterable[Any], key: str, count: int) -> list[Any]:
    """So many of them, by chance, always the same for `key`."""
    things = list(things)
    return random.Random(zlib.crc32(key.encode())).sample(things, min(count, len(things)))


def flags_of(config: Any) -> dict[str, None]:
    return dict.fromkeys(f"--{name.replace('_', '-')}" for name in flatten(config))


TRAINING = {flag: task for task in list_tasks() for flag in flags_of(load_task(task))}


@pytest.mark.parametrize("part", range(8))
def test_flags_of_training(part):
    for flag in sorted(TRAINING)[part::8]:
        for word in some(WORDS, flag, 1):
            settles(parse_config, [TRAINING[flag], f"{flag}={word}"])


@pytest.mark.parametrize("task", list_tasks())
def test_settings_of_a_task(task):
    config = load_task(task)
    for name in flatten(config):
        for value in some(VALUES, task + name, 6):
            settles(change_settings, config, {name: value})


@pytest.mark.parametrize("flag", ["--resume", "--runs", "--name"])
def test_flags_that_choose_what_is_trained(flag, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for word in WORDS:
        settles(parse_config, [f"{flag}={word}"])
        if flag == "--name":
            settles(create_run, tmp_path, word)


@pytest.mark.parametrize(
    "config", [EvalConfig, ExportConfig, ViewConfig, CompareConfig, TuneConfig]
)
def test_flags_of_the_other_commands(config, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for field in dataclasses.fields(config):
        flag = f"--{field.name.replace('_', '-')}"
        for word in some(WORDS, flag, 5):
            settles(parse, config, [f"{flag}={word}"], "prog")


@pytest.mark.parametrize("word", WORDS)
def test_arguments_that_are_no_flags(word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settles(parse_config, [word])
    settles(parse, EvalConfig, [word], "prog")
    settles(find_any_run, tmp_path, word)
    settles(find_ready, Path(word), "latest", "walk")
    settles(compare, [word, "--seeds", word])


@pytest.mark.parametrize("word", WORDS)
def test_arguments_of_robot_and_ground(word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "quadwalk.terrain.picture.draw_kinds", lambda *_: np.zeros((2, 2, 3), np.uint8)
    )
    for flag in ("--mesh-dirs", "--rotor", "--out", "--render", "--nothing"):
        for argv in some(([str(ALIENGO_URDF), "-q", f"{flag}={word}"], [word]), flag + word, 1):
            settles(robot, argv)
    for flag in ("--out", "--kinds", "--levels", "--seed", "--robot.urdf"):
        settles(ground, ["-o", "a.png", f"{flag}={word}"])


# What a run's files are read for.
READERS: dict[str, tuple[Callable[[Run], object], ...]] = {
    "config.json": (read_config_to_resume,),
    "metrics.jsonl": (
        lambda run: draw_learning_curve(read_history(run)),
        lambda run: appended(run),
    ),
    "timing.jsonl": (read_history, lambda run: appended(run)),
    "policy.npz": (lambda run: load_policy(run.policy),),
    "best.npz": (lambda run: load_score(run.best),),
    "checkpoints/step_000000000003.npz": (
        list_policies,
        lambda run: find_latest_checkpoint(run, str),
        lambda run: load_checkpoint_policy(run.locate_checkpoint(3), ("a",) * 12),
    ),
    "robot.urdf": (lambda run: load_robot(RobotConfig(run.urdf)),),
}


def appended(run: Run) -> None:
    with MetricsLog(run, resume_at=2) as log:
        log.append({"steps": 3, "x": 1.0})


@pytest.fixture(scope="module")
def trained(tmp_path_factory, quadruped: Quadruped) -> Run:
    """A run with every file that training writes."""
    policies = dict.fromkeys(("policy.npz", "best.npz", "checkpoints/step_000000000003.npz"), 3)
    run = write_run(tmp_path_factory.mktemp("trained"), "dog", quadruped, policies)
    with MetricsLog(run) as log:
        for steps in (1, 2, 3):
            log.append({"steps": steps, "eval/speed": 1.0, "train/reward/a": 2.0}, {"t": 1.0})
    return run


@pytest.mark.parametrize("name", READERS)
def test_files_of_a_run(name, trained, tmp_path):
    run = Run(tmp_path / "dog")
    shutil.copytree(trained.path, run.path)
    file, original = run.path / name, (trained.path / name).read_bytes()

    def read() -> None:
        settles(find_run, tmp_path, "latest")
        for reader in READERS[name]:
            settles(reader, run)

    for content in damaged(name, original, random.Random(0)):
        file.write_bytes(content)
        read()
    file.unlink()
    read()  # it is not there
    file.unlink(missing_ok=True)
    file.symlink_to(file.name)
    read()
    file.unlink()
    file.mkdir()
    read()


def damaged(name: str, content: bytes, rng: random.Random) -> Iterator[bytes]:
    """What may be in the place of a file with this `content`."""
    yield from (b"", bytes(100), b"\xff\xfe", b"[" * 100_000, b'{"a":' * 100_000, b"{}", b"3")
    yield from (content[: rng.randrange(len(content))] for _ in range(10))
    for _ in range(20):
        flipped = bytearray(content)
        for _ in range(rng.choice((1, 5))):
            flipped[rng.randrange(len(flipped))] = rng.randrange(256)
        yield bytes(flipped)
    if ".json" in name:
        first, *rest = content.splitlines(keepends=True) if name.endswith("l") else [content]
        data = json.loads(first)
        for path in rng.choices([(), *places(data)], k=60):
            odd = json.dumps(replaced(data, path, rng.choice(VALUES[:-1])))
            yield odd.encode() + b"\n" + b"".join(rest)
        yield json.dumps(data | {"long": "x" * 10**7}).encode() + b"\n" + b"".join(rest)


def replaced(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    copy = data.copy()
    copy[path[0]] = replaced(data[path[0]], path[1:], value)
    return copy
