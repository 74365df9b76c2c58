"""Any text in a flag or in a run's file: it can be used, or one line says why not."""

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
from quadwalk.evaluation.command import EvalConfig, SweepConfig
from quadwalk.experiments.commands import compare
from quadwalk.experiments.options import CompareConfig, TuneConfig
from quadwalk.export.cli import ExportConfig
from quadwalk.learn.acting import load_checkpoint_policy, load_policy
from quadwalk.learn.flags import parse_config
from quadwalk.paths import ALIENGO_URDF
from quadwalk.progress.curves import draw_learning_curve
from quadwalk.robot.cli import ConvertConfig
from quadwalk.robot.cli import main as convert
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs.cli import ListRunsConfig
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
from quadwalk.terrain.cli import TerrainConfig
from quadwalk.terrain.cli import main as draw_terrain
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


def check_settles(action: Callable[..., object], *arguments: Any) -> None:
    """Assert that `action` returns or raises a `UserError` of one line."""
    try:
        action(*arguments)
    except UserError as error:
        message = str(error)
        assert message.strip(), "nothing is said"
        assert "\n" not in message
        assert len(message) < 1000 or "x" * 5000 in message or "9" * 5000 in message


def sample(things: Iterable[Any], key: str, count: int) -> list[Any]:
    """Return so many of `things`, always the same for `key`."""
    things = list(things)
    return random.Random(zlib.crc32(key.encode())).sample(things, min(count, len(things)))


@pytest.mark.parametrize("task", list_tasks())
def test_settings_of_a_task(task):
    config = load_task(task)
    for name in flatten(config):
        for value in sample(VALUES, task + name, 4):
            check_settles(change_settings, config, {name: value})
    for name in sample(flatten(config), task, 6):
        for word in sample(WORDS, task + name, 1):
            check_settles(parse_config, [task, f"--{name.replace('_', '-')}={word}"])


@pytest.mark.parametrize(
    "config",
    [
        *(EvalConfig, SweepConfig, ExportConfig, ViewConfig, CompareConfig, TuneConfig),
        *(ListRunsConfig, ConvertConfig, TerrainConfig),
    ],
)
def test_flags_of_the_other_commands(config):
    for field in dataclasses.fields(config):
        flag = f"--{field.name.replace('_', '-')}"
        for word in sample(WORDS, flag, 3):
            check_settles(parse, config, [f"{flag}={word}"], "prog")


@pytest.mark.parametrize("word", WORDS)
def test_names_of_tasks_runs_variants_and_files(word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "quadwalk.terrain.picture.draw_kinds", lambda *_: np.zeros((2, 2, 3), np.uint8)
    )
    check_settles(parse_config, [word])
    check_settles(parse_config, [f"--resume={word}"])
    check_settles(create_run, tmp_path, word)
    check_settles(find_any_run, tmp_path, word)
    check_settles(find_ready, Path(word), "latest", "walk")
    check_settles(compare, [word, "--seeds", word])
    for flag in sample(("--mesh-dirs", "--rotor", "--out", "--render"), word, 1):
        check_settles(convert, [str(ALIENGO_URDF), "-q", f"{flag}={word}"])
    for flag in sample(("--out", "--kinds", "--levels", "--robot.urdf"), word, 1):
        check_settles(draw_terrain, ["-o", "a.png", f"{flag}={word}"])


# What a run's files are read for.
READERS: dict[str, tuple[Callable[[Run], object], ...]] = {
    "config.json": (read_config_to_resume,),
    "metrics.jsonl": (
        lambda run: draw_learning_curve(read_history(run)),
        lambda run: append_row(run),
    ),
    "timing.jsonl": (read_history, lambda run: append_row(run)),
    "policy.npz": (lambda run: load_policy(run.policy),),
    "best.npz": (lambda run: load_score(run.best),),
    "checkpoints/step_000000000003.npz": (
        list_policies,
        lambda run: find_latest_checkpoint(run, str),
        lambda run: load_checkpoint_policy(run.locate_checkpoint(3), ("a",) * 12),
    ),
    "robot.urdf": (lambda run: load_robot(RobotConfig(run.urdf)),),
}


def append_row(run: Run) -> None:
    with MetricsLog(run, resume_at=2) as log:
        log.append({"steps": 3, "x": 1.0})


@pytest.fixture(scope="module")
def trained(tmp_path_factory, quadruped: Quadruped) -> Run:
    """Return a run with every file that training writes."""
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
        check_settles(find_run, tmp_path, "latest")
        for reader in READERS[name]:
            check_settles(reader, run)

    for content in damage(name, original, random.Random(0)):
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


def damage(name: str, content: bytes, rng: random.Random) -> Iterator[bytes]:
    """Yield contents that may be in the place of a file with this `content`."""
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
            odd = json.dumps(replace(data, path, rng.choice(VALUES[:-1])))
            yield odd.encode() + b"\n" + b"".join(rest)
        yield json.dumps(data | {"long": "x" * 10**7}).encode() + b"\n" + b"".join(rest)


def replace(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    copy = data.copy()
    copy[path[0]] = replace(data[path[0]], path[1:], value)
    return copy
