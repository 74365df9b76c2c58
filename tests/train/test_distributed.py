"""Several processes that share a training, on this machine."""

import os
import re
import shutil
import signal
import socket
import time

import pytest

from quadwalk.errors import UsageError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.train.flags import parse_config
from quadwalk.train.runs.directory import Run
from quadwalk.train.runs.log import read_metrics
from tests.test_task_files import OWN_TASK

ITERATIONS = 100


def shared(number: int, count: int, port: int) -> list[str]:
    """Flags of process `number` of `count`."""
    values = {"coordinator": f"127.0.0.1:{port}", "processes": count, "process": number}
    return [f"--distributed.{name}={value}" for name, value in values.items()]


@pytest.fixture
def port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def pair(start, tmp_path, port):
    """Two processes with the same flags, and what they say, in order."""

    def begin(*flags: str):
        outputs = [tmp_path / f"output{number}" for number in (0, 1)]
        return [
            start(output, *flags, *shared(number, 2, port)) for number, output in enumerate(outputs)
        ], outputs

    return begin


def join(processes, outputs) -> None:
    for process, output in zip(processes, outputs, strict=True):
        process.join(200)
        assert process.exitcode == 0, output.read_text()


def test_two_processes_learn_what_one_with_two_devices_does(
    pair, tmp_path, flags, same_result, train
):
    # Bit for bit: a mean over two devices is one addition, which does not care for the order.
    train(*flags(tmp_path, "alone", ITERATIONS))
    processes, outputs = pair(*flags(tmp_path, "shared", ITERATIONS))
    run = Run(tmp_path / "shared")
    while not (run.metrics.exists() and run.metrics.stat().st_size):
        assert processes[0].is_alive(), outputs[0].read_text()
        time.sleep(0.01)
    os.kill(processes[1].pid, signal.SIGINT)  # and both stop, after the same iteration
    join(processes, outputs)
    steps = read_metrics(run)[-1]["steps"]
    assert steps < 64 * ITERATIONS
    assert f"stopped after {steps:,} of" in outputs[0].read_text()
    assert "stopped" not in outputs[1].read_text()
    assert run.checkpoint(steps).exists()
    processes, outputs = pair(f"--runs={tmp_path}", "--resume=shared")
    join(processes, outputs)
    assert f"after {steps:,} steps" in outputs[0].read_text()
    same_result(run.path, tmp_path / "alone", best=False)  # its checkpoints were others


def test_processes_that_differ_or_cannot_begin_all_say_so(start, tmp_path, flags, port):
    """Different is what they say: the same robot may lie in other places."""
    for number in (0, 1):
        shutil.copy(ALIENGO_URDF, tmp_path / f"robot{number}.urdf")
        (tmp_path / f"task{number}.py").write_text(
            OWN_TASK.replace("return 1.0", f"return {number}.0")
        )
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").write_text("")
    differ = ("different settings", "different settings")
    for name, flag, expected in (
        ("a", "--seed={}", differ),
        ("b", f"{tmp_path}/task{{}}.py", differ),
        (
            "taken",
            f"--robot.urdf={tmp_path}/robot{{}}.urdf",
            ("run 'taken' exists", "another process could not begin"),
        ),
    ):
        outputs = [tmp_path / f"{name}{number}" for number in (0, 1)]
        processes = [
            start(output, flag.format(n), *flags(tmp_path, name, 5), *shared(n, 2, port))
            for n, output in enumerate(outputs)
        ]
        for process, output, part in zip(processes, outputs, expected, strict=True):
            process.join(100)
            errors = [line for line in output.read_text().splitlines() if "error" in line]
            assert len(errors) == 1, output.read_text()
            assert part in errors[0]
            assert process.exitcode in (1, 2)


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--distributed.processes=2"], "--distributed.coordinator"),
        (["--distributed.process=1"], "--distributed.coordinator"),
        (["--distributed.coordinator=here", "--distributed.processes=2"], "HOST:PORT"),
        (["--distributed.coordinator=here:0", "--distributed.processes=2"], "HOST:PORT"),
        (["--distributed.coordinator=a:1", "--distributed.processes=0"], "--distributed.processes"),
        (["--distributed.coordinator=a:1", "--distributed.process=1"], "--distributed.process"),
    ],
)
def test_flags_that_make_no_sense_are_named(flags, named):
    with pytest.raises(UsageError, match=re.escape(named)):
        parse_config(flags)
